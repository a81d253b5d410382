"""What noise-free depth says of the cells of its grid: which it falls into, and which the view has seen.

The grid's axes are the view's optical axes, so camera and grid frames differ by a shift only.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, Grid
from kinectbench.voxels.pair_file import BLOCK

# Edge of the windows of pixels in which the nearest and the farthest reach are looked up.
WINDOW_PX = 8


def partial_grids(
    depth_m: NDArray[np.float32], camera: Camera, T_world_camera: NDArray[np.float64], grid: Grid
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The cells that back-projected depth falls into, at full resolution and by blocks of 4^3 ("any").

    Args:
        depth_m: (height, width) float32, 0 = none.
        camera: intrinsics.
        T_world_camera: (4, 4); has the grid's orientation.
        grid: in the view's optical axes, sides multiples of 32.

    Returns:
        (nx, ny, nz / 8) and (nx / 4, ny / 4, nz / 32) uint8, packed along z.
    """
    corner_camera = _corner(grid, T_world_camera)
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


def visible_cells(
    depth_m: NDArray[np.float32], camera: Camera, T_world_camera: NDArray[np.float64], grid: Grid
) -> NDArray[np.uint8]:
    """Cells whose centre is at most one voxel behind the noise-free depth of the pixel it falls on.

    The rule of `voxels.view_grids.seen_cells` with a standard deviation of zero: a pixel without depth sees
    nothing, and cells outside the image are not seen.

    Args:
        depth_m: (height, width) float32, 0 = none.
        camera: intrinsics.
        T_world_camera: (4, 4); has the grid's orientation.
        grid: in the view's optical axes, in front of the camera.

    Returns:
        (nx, ny, nz / 8) uint8, packed along z.
    """
    import cv2

    reach_m = np.where(depth_m > 0, depth_m.astype(np.float64) + grid.voxel_size_m, -np.inf)
    window, corner = np.ones((WINDOW_PX, WINDOW_PX), np.uint8), (0, 0)
    farthest_m = cv2.dilate(reach_m, window, anchor=corner, borderType=cv2.BORDER_REPLICATE)
    nearest_m = cv2.erode(reach_m, window, anchor=corner, borderType=cv2.BORDER_REPLICATE)
    x, y, z = (
        start + (np.arange(count) + 0.5) * grid.voxel_size_m
        for start, count in zip(_corner(grid, T_world_camera), grid.shape, strict=True)
    )
    columns = _inside(camera.fx * x[:, None] / z + camera.cx, camera.width)
    rows = _inside(camera.fy * y[:, None] / z + camera.cy, camera.height)
    lefts, tops = _windows(columns), np.ascontiguousarray(_windows(rows).T)
    return np.asarray(_visible(reach_m, nearest_m, farthest_m, lefts, tops, columns, rows, z))


def _corner(grid: Grid, T_world_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """The grid's corner (3,) in the camera's frame, metres."""
    corner: NDArray[np.float64] = (grid.T_world_grid[:3, 3] - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    return corner


def _inside(pixels: NDArray[np.float64], count: int) -> NDArray[np.int32]:
    """The pixels that coordinates fall on; -1 outside the image."""
    nearest = np.rint(pixels)
    return np.where((nearest >= 0) & (nearest < count), nearest, -1).astype(np.int32)


def _windows(pixels: NDArray[np.int32]) -> NDArray[np.int32]:
    """For each eight cells, where the window of pixels that they all fall on begins; -1 if there is none."""
    first, last = pixels[:, ::8], pixels[:, 7::8]
    low = np.minimum(first, last)
    return np.where(np.maximum(first, last) - low < WINDOW_PX, low, -1).astype(np.int32)


@numba.njit(cache=True, error_model="numpy")
def _visible(reach, nearest, farthest, lefts, tops, columns, rows, z):  # type: ignore[no-untyped-def]
    """Eight cells at a time: mostly the pixels around decide all of them alike."""
    nx, ny, nb = lefts.shape[0], tops.shape[1], lefts.shape[1]
    packed = np.zeros((nx, ny, nb), np.uint8)
    above, below = _rows_with_depth(farthest)
    for i in range(nx):
        for byte in range(nb):
            left, nearer, farther = lefts[i, byte], z[byte * 8], z[byte * 8 + 7]
            for j in range(ny):
                top = tops[byte, j]
                if left >= 0 and top >= 0:
                    if top < above[left] or top > below[left] or nearer > farthest[top, left]:
                        continue
                    if farther <= nearest[top, left]:
                        packed[i, j, byte] = 255
                        continue
                bits = 0
                for k in range(byte * 8, byte * 8 + 8):
                    u, v = columns[i, k], rows[j, k]
                    bits = (bits << 1) | (1 if u >= 0 and v >= 0 and z[k] <= reach[v, u] else 0)
                packed[i, j, byte] = bits
    return packed


@numba.njit(cache=True)
def _rows_with_depth(farthest):  # type: ignore[no-untyped-def]
    """The first and the last row of each column of windows that reaches anything."""
    first = np.full(farthest.shape[1], farthest.shape[0])
    last = np.full(farthest.shape[1], -1)
    for v in range(farthest.shape[0]):
        for u in range(farthest.shape[1]):
            if farthest[v, u] > -np.inf:
                first[u] = min(first[u], v)
                last[u] = v
    return first, last


def packed_containment(partial: NDArray[np.uint8], full: NDArray[np.uint8]) -> float:
    """Share of the partial's cells whose block of `full`, dilated once, holds anything.

    The same as `voxels.morphology.containment` on packed grids (64, 64, 8) and (256, 256, 32) uint8; 1 for
    an empty partial.
    """
    return float(_containment(partial, full))


@numba.njit(cache=True)
def _containment(partial, full):  # type: ignore[no-untyped-def]
    cells, inside = 0, 0
    for i in range(partial.shape[0]):
        for j in range(partial.shape[1]):
            for k in range(partial.shape[2] * 8):
                if partial[i, j, k >> 3] & (128 >> (k & 7)):
                    cells += 1
                    inside += _touched(full, i * BLOCK, j * BLOCK, k * BLOCK)
    return inside / cells if cells else 1.0


@numba.njit(cache=True)
def _touched(full, x, y, z):  # type: ignore[no-untyped-def]
    """Whether the block from (x, y, z) or a cell next to it holds anything: 0 or 1."""
    nx, ny, nz = full.shape[0], full.shape[1], full.shape[2] * 8
    for i in range(max(0, x - 1), min(nx, x + BLOCK + 1)):
        for j in range(max(0, y - 1), min(ny, y + BLOCK + 1)):
            for k in range(max(0, z - 1), min(nz, z + BLOCK + 1)):
                if full[i, j, k >> 3] & (128 >> (k & 7)):
                    return 1
    return 0
