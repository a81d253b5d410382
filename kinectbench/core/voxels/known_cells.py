"""Which cells of a grid are known, looked up in one or two other grids of any orientation."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Grid
from kinectbench.core.types import Bools, Float64

# Voxels along a tile's edge, and cells along a block's.
TILE, BLOCK = 4, 8
# States of a tile or a block of cells: all unknown, all known, some of each, beyond the grid, partly so.
NONE, ALL, MIXED, BEYOND, CUT = 0, 1, 2, 3, 4
# A corner may be off by this many voxels because of rounding.
SLACK = 1e-6


@dataclass(frozen=True)
class KnownGrid:
    """The known voxels of one grid.

    Attributes:
        grid: where the voxels lie; of any orientation.
        known: (nx, ny, nz) uint8, 1 = known.
        tiles: (ceil(nx / 4), ceil(ny / 4), ceil(nz / 4)) uint8, a value for each block of 4^3 voxels: NONE,
            ALL or MIXED, as none, all or some of its voxels are known.
    """

    grid: Grid
    known: NDArray[np.uint8]
    tiles: NDArray[np.uint8]


def known_grid(grid: Grid, known: Bools) -> KnownGrid:
    """Make a `KnownGrid` from a grid and the mask (nx, ny, nz) of its known voxels."""
    return KnownGrid(grid, known.view(np.uint8), _tiles(np.ascontiguousarray(known)))


def known_in(fine: KnownGrid, coarse: KnownGrid, grid: Grid) -> NDArray[np.uint8]:
    """Return which cells of a grid have their centre in a known voxel.

    Outside both grids of voxels nothing is known. Blocks of 8^3 cells whose voxels are all known, or all
    unknown, are set at once; the result is the same as cell by cell.

    Args:
        fine: decides on the cells whose centre lies in its grid.
        coarse: decides on the other cells.
        grid: the grid of cells, of any orientation; its sides must be multiples of 8.

    Returns:
        (nx, ny, nz / 8) uint8, packed along z; a set bit is a known cell.
    """
    return np.asarray(
        _known_in(
            (fine.known, fine.tiles, _index_map(fine.grid, grid)),
            (coarse.known, coarse.tiles, _index_map(coarse.grid, grid)),
            *grid.shape,
        )
    )


def _index_map(to: Grid, grid: Grid) -> Float64:
    """Return the affine map (3, 4) from positions in `grid` to positions in `to`, each in its own cells."""
    T = to.T_grid_world @ grid.T_world_grid
    scale = grid.voxel_size_m / to.voxel_size_m
    return np.concatenate([T[:3, :3] * scale, T[:3, 3:] / to.voxel_size_m], axis=1)


@numba.njit(cache=True, nogil=True)
def _tiles(known):  # type: ignore[no-untyped-def]
    nx, ny, nz = known.shape
    tiles = np.empty(((nx - 1) // TILE + 1, (ny - 1) // TILE + 1, (nz - 1) // TILE + 1), np.uint8)
    for i in range(tiles.shape[0]):
        for j in range(tiles.shape[1]):
            for k in range(tiles.shape[2]):
                tile = known[i * TILE : (i + 1) * TILE, j * TILE : (j + 1) * TILE, k * TILE : (k + 1) * TILE]
                count = tile.sum()
                tiles[i, j, k] = NONE if count == 0 else ALL if count == tile.size else MIXED
    return tiles


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _known_in(fine, coarse, nx, ny, nz):  # type: ignore[no-untyped-def]
    packed = np.full((nx, ny, nz // BLOCK), np.uint8(255))  # most are known
    for i in range(0, nx, BLOCK):
        for j in range(0, ny, BLOCK):
            for byte in range(nz // BLOCK):
                beyond = False
                state, inside = _block_state(fine, i, j, byte * BLOCK)
                if not inside:
                    around, inside_coarse = _block_state(coarse, i, j, byte * BLOCK)
                    if not inside_coarse:
                        around = NONE if around in (BEYOND, NONE) else CUT
                    if state == BEYOND:
                        beyond, state = True, around
                    elif state != around or around == MIXED:
                        state = CUT
                if state == ALL:
                    continue
                block = packed[i : i + BLOCK, j : j + BLOCK, byte]
                if state == NONE:
                    block[:] = 0
                elif state == CUT:
                    _set_across(block, fine, coarse, i, j, byte * BLOCK)
                elif beyond:
                    _set_within(block, coarse, i, j, byte * BLOCK)
                else:
                    _set_within(block, fine, i, j, byte * BLOCK)
    return packed


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _block_state(level, i, j, k):  # type: ignore[no-untyped-def]
    """Return (state, whether the block lies inside the grid) of the block of 8^3 cells from (i, j, k) on.

    The state is that of the tiles that hold the cells' centres, MIXED if they differ, or BEYOND if none does.
    `level` is (voxels, tiles, map from cells to voxels) of a `KnownGrid`.
    """
    known, tiles, M = level
    x0, x1, in_x = _reach(M[0], i, j, k, known.shape[0])
    y0, y1, in_y = _reach(M[1], i, j, k, known.shape[1])
    z0, z1, in_z = _reach(M[2], i, j, k, known.shape[2])
    if x1 < x0 or y1 < y0 or z1 < z0:
        return BEYOND, False
    inside = in_x and in_y and in_z
    state = tiles[x0, y0, z0]
    for x in range(x0, x1 + 1):
        for y in range(y0, y1 + 1):
            for z in range(z0, z1 + 1):
                if tiles[x, y, z] != state:
                    return MIXED, inside
    return np.int64(state), inside


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _reach(row, i, j, k, count):  # type: ignore[no-untyped-def]
    """Return first and last tile that a block touches along one axis, and whether it lies inside the grid.

    If it touches no tile, last < first. `row` maps cells to voxels along the axis, (i, j, k) is the block's
    first cell, and `count` the number of voxels.
    """
    half = BLOCK / 2
    middle = row[0] * (i + half) + row[1] * (j + half) + row[2] * (k + half) + row[3]
    reach = (BLOCK - 1) / 2 * (abs(row[0]) + abs(row[1]) + abs(row[2])) + SLACK
    low, high = middle - reach, middle + reach
    if high < 0 or low >= count:
        return 0, -1, False
    first, last = int(max(0.0, low)) // TILE, int(min(count - 1.0, high)) // TILE
    return first, last, low >= 0 and high < count


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _set_within(block, level, i, j, k):  # type: ignore[no-untyped-def]
    """Set the bytes (8, 8), each 8 cells along z, of a block whose centres all lie in the grid of `level`.

    `level` is (voxels, tiles, map from cells to voxels); (i, j, k) is the block's first cell.
    """
    known, _, M = level
    for a in range(BLOCK):
        for b in range(BLOCK):
            x, y, z = _centre(M, i + a, j + b, k)
            bits = 0
            for n in range(BLOCK):
                bits <<= 1
                bits |= known[
                    np.uint32(x + n * M[0, 2]), np.uint32(y + n * M[1, 2]), np.uint32(z + n * M[2, 2])
                ]
            block[a, b] = bits


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _set_across(block, fine, coarse, i, j, k):  # type: ignore[no-untyped-def]
    """Set the bytes (8, 8), each 8 cells along z, of a block that crosses a grid's border.

    `fine` and `coarse` are levels, and (i, j, k) is the block's first cell, as in `_set_within`.
    """
    for a in range(BLOCK):
        for b in range(BLOCK):
            at_fine, at_coarse = _centre(fine[2], i + a, j + b, k), _centre(coarse[2], i + a, j + b, k)
            bits = 0
            for n in range(BLOCK):
                voxel = _voxel(fine, at_fine, n)
                if voxel < 0:
                    voxel = max(0, _voxel(coarse, at_coarse, n))
                bits = (bits << 1) | voxel
            block[a, b] = bits


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _voxel(level, start, n):  # type: ignore[no-untyped-def]
    """Return 1 if the n-th cell along z after `start` lies in a known voxel, 0 if not, -1 beyond the grid.

    `start` is a cell's centre in voxels of `level`, which is (voxels, tiles, map from cells to voxels).
    """
    known, _, M = level
    x, y, z = start[0] + n * M[0, 2], start[1] + n * M[1, 2], start[2] + n * M[2, 2]
    if x < 0 or y < 0 or z < 0 or x >= known.shape[0] or y >= known.shape[1] or z >= known.shape[2]:
        return -1
    return np.int64(known[np.uint32(x), np.uint32(y), np.uint32(z)])


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _centre(M, i, j, k):  # type: ignore[no-untyped-def]
    """Map the centre of the cell (i, j, k) by the affine map M (3, 4) to a position (x, y, z) in voxels."""
    u, v, w = i + 0.5, j + 0.5, k + 0.5
    return (
        M[0, 0] * u + M[0, 1] * v + M[0, 2] * w + M[0, 3],
        M[1, 0] * u + M[1, 1] * v + M[1, 2] * w + M[1, 3],
        M[2, 0] * u + M[2, 1] * v + M[2, 2] * w + M[2, 3],
    )
