"""The cells that one view has seen.

The grid's axes are the view's optical axes, so camera and grid frames differ by a shift only.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, Grid, depth_sigma_m
from kinectbench.core.types import Float32, Float64
from kinectbench.core.voxels.view_grids import corner_in_camera

# Edge of the tiles of pixels whose nearest and farthest reach are kept.
TILE_PX = 4
# Cells along a block's edge, and the states of a block.
BLOCK = 8
NONE, ALL, SOME = 0, 1, 2


def seen_cells(
    depth_m: Float32, camera: Camera, T_world_camera: Float64, grid: Grid, *, noisy: bool = True
) -> NDArray[np.uint8]:
    """Return the cells that a view sees, up to just behind its depth d: z <= d + 2 sigma(d) + one cell.

    The whole image counts, unmasked; a pixel without depth sees nothing, and cells outside the image are not
    seen.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        camera: intrinsics.
        T_world_camera: (4, 4), camera to world; must have the grid's orientation.
        grid: a grid in the view's optical axes; its sides must be multiples of 8.
        noisy: whether the depth has a sensor's noise; else its standard deviation sigma is 0.

    Returns:
        (nx, ny, nz / 8) uint8, packed along z.
    """
    sigma_m = depth_sigma_m(depth_m) if noisy else np.zeros_like(depth_m)
    x, y, z = (
        start + (np.arange(count) + 0.5) * grid.voxel_size_m
        for start, count in zip(corner_in_camera(grid, T_world_camera), grid.shape, strict=True)
    )
    ahead_m = np.where(z > 0, z, np.nan)
    columns = _pixels(camera.fx * x[:, None] / ahead_m + camera.cx, camera.width)
    rows = _pixels(camera.fy * y[:, None] / ahead_m + camera.cy, camera.height)
    reach = _reach(depth_m, sigma_m, grid.voxel_size_m, z)
    return np.asarray(_seen(reach, _tiles(reach), columns, rows, grid.shape[2]))


def _pixels(exact: Float64, count: int) -> NDArray[np.uint32]:
    """Round pixel coordinates to the nearest of `count` pixels; NaN, or outside the image, gives `count`."""
    nearest = np.rint(exact)
    return np.where((nearest >= 0) & (nearest < count), nearest, count).astype(np.uint32)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _reach(depth, sigma, voxel, z):  # type: ignore[no-untyped-def]
    """For each pixel, count the layers of cells along z that it sees, from the first layer on.

    `depth` and `sigma`, its standard deviation, are (height, width); `voxel` is a cell's edge, and `z` (nz,)
    has the layers' middles. All are in metres. The result is (height + 1, width + 1) uint16: the extra row
    and column of 0 stand for pixels outside the image.
    """
    reach = np.zeros((depth.shape[0] + 1, depth.shape[1] + 1), np.uint16)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            d = np.float64(depth[v, u])
            if d > 0:
                farthest = d + 2 * np.float64(sigma[v, u]) + voxel
                layers = int(min(max((farthest - z[0]) / voxel + 1, 0.0), float(len(z))))
                # The layers themselves decide, not the rounding of a division.
                while layers < len(z) and z[layers] <= farthest:
                    layers += 1
                while layers > 0 and z[layers - 1] > farthest:
                    layers -= 1
                reach[v, u] = layers
    return reach


@numba.njit(cache=True, nogil=True)
def _tiles(reach):  # type: ignore[no-untyped-def]
    """Return the smallest and the largest `reach` (layers that a pixel sees) in each tile of 4 x 4 pixels."""
    height, width = reach.shape
    least = np.full(((height - 1) // TILE_PX + 1, (width - 1) // TILE_PX + 1), 65535, np.uint16)
    greatest = np.zeros_like(least)
    for v in range(height):
        for u in range(width):
            tile = v // TILE_PX, u // TILE_PX
            least[tile] = min(least[tile], reach[v, u])
            greatest[tile] = max(greatest[tile], reach[v, u])
    return least, greatest


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _seen(reach, tiles, columns, rows, nz):  # type: ignore[no-untyped-def]
    """Return the seen cells, packed; mostly the tiles of pixels decide for a whole block of 8^3 cells.

    Args:
        reach: result of `_reach`, layers that each pixel sees.
        tiles: result of `_tiles`.
        columns: (nx, nz), the pixel column into which cells at x and z project.
        rows: (ny, nz), the pixel row into which cells at y and z project.
        nz: number of layers.
    """
    nx, ny = len(columns), len(rows)
    packed = np.zeros((nx, ny, nz // BLOCK), np.uint8)
    lefts, rights = _ranges(columns)
    tops, bottoms = _ranges(rows)
    for i in range(nx // BLOCK):
        for j in range(ny // BLOCK):
            for byte in range(nz // BLOCK):
                block = packed[i * BLOCK : (i + 1) * BLOCK, j * BLOCK : (j + 1) * BLOCK, byte]
                span = lefts[i, byte], rights[i, byte], tops[j, byte], bottoms[j, byte]
                state = _state(tiles, span, reach.shape, byte * BLOCK)
                if state == ALL:
                    block[:] = 255
                elif state == SOME:
                    along = slice(byte * BLOCK, (byte + 1) * BLOCK)
                    u = columns[i * BLOCK : (i + 1) * BLOCK, along]
                    v = rows[j * BLOCK : (j + 1) * BLOCK, along]
                    _set_cells(block, reach, u, v, byte * BLOCK)
    return packed


@numba.njit(cache=True, nogil=True)
def _ranges(pixels):  # type: ignore[no-untyped-def]
    """Return the smallest and the largest of the coordinates `pixels` in each block of 8 x 8 cells."""
    first = np.empty((pixels.shape[0] // BLOCK, pixels.shape[1] // BLOCK), np.int64)
    last = np.empty_like(first)
    for i in range(first.shape[0]):
        for k in range(first.shape[1]):
            group = pixels[i * BLOCK : (i + 1) * BLOCK, k * BLOCK : (k + 1) * BLOCK]
            first[i, k], last[i, k] = group.min(), group.max()
    return first, last


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _state(tiles, span, shape, first):  # type: ignore[no-untyped-def]
    """Return ALL or NONE if all or none of a block's cells are seen, SOME if each cell must be tested.

    `tiles` is the result of `_tiles`. `span` has the block's first and last pixel column and its first and
    last row. `shape` is the shape of the array of pixels, with its extra row and column. `first` is the first
    of the block's eight layers.
    """
    left, right, top, bottom = span
    if left == shape[1] - 1 or top == shape[0] - 1:
        return NONE
    if right == shape[1] - 1 or bottom == shape[0] - 1:
        return SOME
    least, greatest = first + BLOCK, 0
    for v in range(top // TILE_PX, bottom // TILE_PX + 1):
        for u in range(left // TILE_PX, right // TILE_PX + 1):
            least = min(least, int(tiles[0][v, u]))
            greatest = max(greatest, int(tiles[1][v, u]))
        if least < first + BLOCK and first < greatest:
            return SOME
    return ALL if least == first + BLOCK else NONE


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _set_cells(block, reach, columns, rows, first):  # type: ignore[no-untyped-def]
    """Set the bytes (8, 8) of a block, testing each of 8 cells along z.

    A cell is seen if its layer, counted from `first` for the block, is less than `reach` at its pixel, which
    `rows` (8, 8) and `columns` (8, 8) give.
    """
    for a in range(BLOCK):
        for b in range(BLOCK):
            bits = 0
            for k in range(BLOCK):
                bits = (bits << 1) | (1 if first + k < reach[rows[b, k], columns[a, k]] else 0)
            block[a, b] = bits
