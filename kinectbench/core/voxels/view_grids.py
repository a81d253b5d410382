"""The cube of a pair in the world, and the partial shape: the cells that its view's depth falls into.

The share of the partial shape that lies in the full shape is its containment.
"""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, Grid, rigid, transform_points
from kinectbench.core.types import Bools, Float32, Float64, Int64
from kinectbench.core.voxels.pair_file import BLOCK, FULL_CELLS, Packed, unpack
from kinectbench.core.voxels.point_cells import cell_numbers

# Two cells of margin on either side of the shape's longest extent.
OBJECT_SCALE = FULL_CELLS / (FULL_CELLS - 4)
VIEW_SCALE = 1.4
VIEW_FRONT_MARGIN = 0.1
# A pair whose cube of framing `view` cuts off more of the shape is refused.
MAX_CUT_SHARE = 0.05


def object_cube(vertices_world: Float64, T_world_camera: Float64) -> Grid:
    """Return the cube of framing `object` (the paper's), centred on the full shape's box in the view's axes.

    Its side is the box's longest extent x 256/252.

    Args:
        vertices_world: (n, 3) vertices of the full shape, metres.
        T_world_camera: (4, 4), camera to world; the cube gets the camera's axes.
    """
    low, high = _extent(np.ascontiguousarray(vertices_world), T_world_camera)
    return _cube((low + high) / 2, float((high - low).max()) * OBJECT_SCALE, T_world_camera)


def view_cube(points_camera: NDArray[np.floating], T_world_camera: Float64) -> Grid:
    """Return the cube of framing `view`, which depends on the visible points only, not on the hidden part.

    Its side is 1.4 times the longest side of the points' bounding box in the view's axes, without the 0.5 %
    of points farthest out on each side. It is centred on the box in x and y; in z it begins 0.1 of its side
    in front of the box.

    Args:
        points_camera: (n, 3) the view's points on the object, camera frame, metres.
        T_world_camera: (4, 4), camera to world; the cube gets the camera's axes.
    """
    # Axis by axis: half the memory, the same values.
    low, high = np.array([np.quantile(along, [0.005, 0.995]) for along in points_camera.T]).T
    side_m = VIEW_SCALE * float((high - low).max())
    centre = (low + high) / 2
    centre[2] = low[2] + (0.5 - VIEW_FRONT_MARGIN) * side_m
    origin_rotated = T_world_camera[:3, 3] @ T_world_camera[:3, :3]
    return _cube(centre + origin_rotated, side_m, T_world_camera)


def _cube(centre_rotated: Float64, side_m: float, T_world_camera: Float64) -> Grid:
    """Return the grid of 256 cells a side in the view's axes; `centre_rotated` is along these."""
    rotation = T_world_camera[:3, :3]
    corner_world = rotation @ (centre_rotated - side_m / 2)
    return Grid((FULL_CELLS,) * 3, side_m / FULL_CELLS, rigid(rotation, corner_world))


@numba.njit(cache=True, nogil=True)
def _extent(points_world, T_world_camera):  # type: ignore[no-untyped-def]
    """Return the smallest and the largest coordinates (3,) of points (n, 3), rotated into the view's axes."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for n in range(len(points_world)):
        x, y, z = points_world[n, 0], points_world[n, 1], points_world[n, 2]
        for axis in range(3):
            turned = x * T_world_camera[0, axis] + y * T_world_camera[1, axis] + z * T_world_camera[2, axis]
            low[axis], high[axis] = min(low[axis], turned), max(high[axis], turned)
    return low, high


def depth_cells(depth_m: Float32, mask: Bools, camera: Camera, T_world_camera: Float64, grid: Grid) -> Int64:
    """Return the cell that each pixel of a view's masked depth falls into, also outside the grid.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        mask: (height, width) bool, pixels of the object.
        camera: intrinsics.
        T_world_camera: (4, 4), camera to world.
        grid: any grid in the world.

    Returns:
        (n, 3) int64, one row per pixel with depth.
    """
    points_camera = camera.backproject(depth_m)[mask & (depth_m > 0)]
    points_grid = transform_points(grid.T_grid_world @ T_world_camera, points_camera)
    cells: Int64 = np.floor(points_grid / grid.voxel_size_m).astype(np.int64)
    return cells


def partial_grids(
    depth_m: Float32, camera: Camera, T_world_camera: Float64, grid: Grid
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the cells that back-projected depth falls into, and the blocks of 4^3 cells with any such cell.

    Args:
        depth_m: (height, width) float32, metres, 0 = none; of the object alone.
        camera: intrinsics.
        T_world_camera: (4, 4), camera to world; must have the grid's orientation.
        grid: a grid in the view's optical axes; its sides must be multiples of 32.

    Returns:
        (nx, ny, nz / 8) and (nx / 4, ny / 4, nz / 32) uint8, packed along z.
    """
    corner_camera = corner_in_camera(grid, T_world_camera)
    fine = np.zeros((*grid.shape[:2], grid.shape[2] // 8), np.uint8)
    coarse = np.zeros(
        (grid.shape[0] // BLOCK, grid.shape[1] // BLOCK, grid.shape[2] // (8 * BLOCK)), np.uint8
    )
    _mark(depth_m, camera.K, corner_camera, grid.voxel_size_m, fine, coarse)
    return fine, coarse


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _mark(depth, K, corner, voxel, fine, coarse):  # type: ignore[no-untyped-def]
    nx, ny, nz = fine.shape[0], fine.shape[1], fine.shape[2] * 8
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            d = np.float64(depth[v, u])
            if d <= 0:
                continue
            i = int(np.floor(((u - K[0, 2]) / K[0, 0] * d - corner[0]) / voxel))
            j = int(np.floor(((v - K[1, 2]) / K[1, 1] * d - corner[1]) / voxel))
            k = int(np.floor((d - corner[2]) / voxel))
            if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
                fine[i, j, k >> 3] |= 128 >> (k & 7)
                i, j, k = i // BLOCK, j // BLOCK, k // BLOCK
                coarse[i, j, k >> 3] |= 128 >> (k & 7)


def corner_in_camera(grid: Grid, T_world_camera: Float64) -> Float64:
    """Return the corner (3,) of a grid that has the view's axes, in the camera frame, metres."""
    corner: Float64 = (grid.T_world_grid[:3, 3] - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    return corner


def blocks_touched(full: Packed) -> Bools:
    """Return the blocks of 4^3 cells that hold a set cell, or touch such a block (26 neighbours).

    Args:
        full: (n, n, n / 8) uint8, packed.

    Returns:
        (n / 4, n / 4, n / 4) bool.
    """
    result: NDArray[Any] = full
    for axis in range(3):
        if axis == 2:  # along x and y eight cells are looked at at once
            result = unpack(result)
        layers = np.moveaxis(result, axis, 0)
        touched = layers[0::BLOCK] | layers[1::BLOCK] | layers[2::BLOCK] | layers[3::BLOCK]
        touched[1:] |= layers[BLOCK - 1 : -1 : BLOCK]
        touched[:-1] |= layers[BLOCK::BLOCK]
        result = np.moveaxis(touched, 0, axis)
    return result


def containment_of_cells(cells: Int64, full: Packed) -> float:
    """Return the share of a partial view's cells that touch the full shape, as in `blocks_touched`.

    Args:
        cells: (n, 3) int64, indices of blocks of 4^3 cells of `full`; repeated indices count once.
        full: (m, m, m / 8) uint8, packed, over the same box.

    Returns:
        In [0, 1]; 1 if there are no cells. Cells outside the grid do not touch.
    """
    if len(cells) == 0:
        return 1.0
    distinct = cells[np.unique(cell_numbers(cells), return_index=True)[1]]
    inside = distinct[np.all((distinct >= 0) & (distinct < full.shape[0] // BLOCK), axis=1)]
    return int(blocks_touched(full)[tuple(inside.T)].sum()) / len(distinct)


def containment(partial: Packed, full: Packed) -> float:
    """Return `containment_of_cells` of a packed partial; its sides have a quarter of the cells of `full`."""
    cells = unpack(partial)
    count = np.count_nonzero(cells)
    return np.count_nonzero(cells & blocks_touched(full)) / count if count else 1.0
