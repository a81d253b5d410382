"""The cells that one view's depth falls into: the partial shape."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, Grid, transform_points
from kinectbench.voxels.pair_file import BLOCK


def depth_cells(
    depth_m: NDArray[np.float32],
    mask: NDArray[np.bool_],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    grid: Grid,
) -> NDArray[np.int64]:
    """The cells, also beyond the grid's bounds, that each pixel of a view's masked depth falls into.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        mask: (height, width) bool, pixels of the object.
        camera: intrinsics.
        T_world_camera: (4, 4).
        grid: any grid in the world.

    Returns:
        (n, 3) int64, one row a pixel.
    """
    points_camera = camera.backproject(depth_m)[mask & (depth_m > 0)]
    points_grid = transform_points(grid.T_grid_world @ T_world_camera, points_camera)
    cells: NDArray[np.int64] = np.floor(points_grid / grid.voxel_size_m).astype(np.int64)
    return cells


def occupy(cells: NDArray[np.int64], shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """A grid with the cells (n, 3) set; cells beyond its bounds are left out."""
    inside = np.all((cells >= 0) & (cells < np.array(shape)), axis=1)
    occupied = np.zeros(shape, dtype=bool)
    occupied[tuple(cells[inside].T)] = True
    return occupied


def partial_grids(
    depth_m: NDArray[np.float32], camera: Camera, T_world_camera: NDArray[np.float64], grid: Grid
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The cells that back-projected depth falls into, at full resolution and by blocks of 4^3 ("any").

    Args:
        depth_m: (height, width) float32, metres, 0 = none; of the object alone.
        camera: intrinsics.
        T_world_camera: (4, 4); has the grid's orientation, so that only a shift lies between the frames.
        grid: in the view's optical axes, sides multiples of 32.

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


@numba.njit(cache=True, error_model="numpy")
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


def corner_in_camera(grid: Grid, T_world_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """The corner (3,) of a grid in the view's axes, camera frame, metres."""
    corner: NDArray[np.float64] = (grid.T_world_grid[:3, 3] - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    return corner
