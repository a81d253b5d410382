"""The cells that one view has seen.

The grid's axes are the view's optical axes, so camera and grid frames differ by a shift only.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, Grid
from kinectbench.geometry.depth_noise import depth_sigma_m
from kinectbench.voxels.view_grids import corner_in_camera

# Edge of the tiles of pixels whose nearest and farthest reach are kept.
TILE_PX = 4
# Cells along a block's edge, and what is seen of one.
BLOCK = 8
NONE, ALL, SOME = 0, 1, 2


def seen_cells(
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    grid: Grid,
    *,
    noisy: bool = True,
) -> NDArray[np.uint8]:
    """Cells in the view's frustum with a valid depth d and z <= d + 2 sigma(d) + one voxel.

    The whole image counts, unmasked; a pixel without depth sees nothing, and cells outside the image are not
    seen.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        camera: intrinsics.
        T_world_camera: (4, 4); must have the grid's orientation.
        grid: a grid in the view's optical axes; its sides must be multiples of 8.
        noisy: the depth has a sensor's noise; else sigma is 0.

    Returns:
        (nx, ny, nz / 8) uint8, packed along z.
    """
    sigma_m = depth_sigma_m(depth_m) if noisy else np.zeros_like(depth_m)
    reach_m = _reach(depth_m, sigma_m, grid.voxel_size_m)
    x, y, z = (
        start + (np.arange(count) + 0.5) * grid.voxel_size_m
        for start, count in zip(corner_in_camera(grid, T_world_camera), grid.shape, strict=True)
    )
    ahead_m = np.where(z > 0, z, np.nan)
    columns = _pixels(camera.fx * x[:, None] / ahead_m + camera.cx, camera.width)
    rows = _pixels(camera.fy * y[:, None] / ahead_m + camera.cy, camera.height)
    return np.asarray(_seen(reach_m, _tiles(reach_m), columns, rows, z))


def _pixels(exact: NDArray[np.float64], count: int) -> NDArray[np.uint32]:
    """The pixels that coordinates fall on; `count` outside the image and behind the camera (NaN)."""
    nearest = np.rint(exact)
    return np.where((nearest >= 0) & (nearest < count), nearest, count).astype(np.uint32)


@numba.njit(cache=True)
def _reach(depth, sigma, voxel):  # type: ignore[no-untyped-def]
    """How deep each pixel sees; one row and one column more, where cells outside the image fall."""
    reach = np.full((depth.shape[0] + 1, depth.shape[1] + 1), -np.inf)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            d = np.float64(depth[v, u])
            if d > 0:
                reach[v, u] = d + 2 * np.float64(sigma[v, u]) + voxel
    return reach


@numba.njit(cache=True)
def _tiles(reach):  # type: ignore[no-untyped-def]
    """The nearest and the farthest reach in each tile of pixels."""
    height, width = reach.shape
    nearest = np.full(((height - 1) // TILE_PX + 1, (width - 1) // TILE_PX + 1), np.inf)
    farthest = np.full_like(nearest, -np.inf)
    for v in range(height):
        for u in range(width):
            tile = v // TILE_PX, u // TILE_PX
            nearest[tile] = min(nearest[tile], reach[v, u])
            farthest[tile] = max(farthest[tile], reach[v, u])
    return nearest, farthest


@numba.njit(cache=True, error_model="numpy")
def _seen(reach, tiles, columns, rows, z):  # type: ignore[no-untyped-def]
    """Block by block: mostly the pixels that a block of cells falls on decide all of them alike."""
    nx, ny, nz = len(columns), len(rows), len(z)
    packed = np.zeros((nx, ny, nz // BLOCK), np.uint8)
    lefts, rights = _ranges(columns)
    tops, bottoms = _ranges(rows)
    for i in range(nx // BLOCK):
        for j in range(ny // BLOCK):
            for byte in range(nz // BLOCK):
                block = packed[i * BLOCK : (i + 1) * BLOCK, j * BLOCK : (j + 1) * BLOCK, byte]
                span = lefts[i, byte], rights[i, byte], tops[j, byte], bottoms[j, byte]
                state = _state(tiles, span, reach.shape, z[byte * BLOCK], z[byte * BLOCK + BLOCK - 1])
                if state == ALL:
                    block[:] = 255
                elif state == SOME:
                    along = slice(byte * BLOCK, (byte + 1) * BLOCK)
                    u = columns[i * BLOCK : (i + 1) * BLOCK, along]
                    v = rows[j * BLOCK : (j + 1) * BLOCK, along]
                    _set_cells(block, reach, u, v, z[along])
    return packed


@numba.njit(cache=True)
def _ranges(pixels):  # type: ignore[no-untyped-def]
    """The first and the last pixel that each 8 x 8 cells fall on, those outside the image among them."""
    first = np.empty((pixels.shape[0] // BLOCK, pixels.shape[1] // BLOCK), np.int64)
    last = np.empty_like(first)
    for i in range(first.shape[0]):
        for k in range(first.shape[1]):
            group = pixels[i * BLOCK : (i + 1) * BLOCK, k * BLOCK : (k + 1) * BLOCK]
            first[i, k], last[i, k] = group.min(), group.max()
    return first, last


@numba.njit(cache=True, error_model="numpy")
def _state(tiles, span, shape, near_m, far_m):  # type: ignore[no-untyped-def]
    """Whether all or none of a block's cells, from near_m to far_m, are seen; SOME: look closer."""
    left, right, top, bottom = span
    if left == shape[1] - 1 or top == shape[0] - 1:
        return NONE
    if right == shape[1] - 1 or bottom == shape[0] - 1:
        return SOME
    nearest, farthest = np.inf, -np.inf
    for v in range(top // TILE_PX, bottom // TILE_PX + 1):
        for u in range(left // TILE_PX, right // TILE_PX + 1):
            nearest = min(nearest, tiles[0][v, u])
            farthest = max(farthest, tiles[1][v, u])
        if nearest < far_m and near_m <= farthest:
            return SOME
    return NONE if near_m > farthest else ALL


@numba.njit(cache=True, error_model="numpy")
def _set_cells(block, reach, columns, rows, z):  # type: ignore[no-untyped-def]
    """The bytes (8, 8) of a block, cell by cell along z."""
    for a in range(BLOCK):
        for b in range(BLOCK):
            bits = 0
            for k in range(BLOCK):
                bits = (bits << 1) | (1 if z[k] <= reach[rows[b, k], columns[a, k]] else 0)
            block[a, b] = bits
