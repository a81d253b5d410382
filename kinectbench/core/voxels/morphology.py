"""Surfaces, dilated blocks and containment of grids, of booleans and of packed bits."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools, Int64
from kinectbench.core.voxels.pair_file import BLOCK


def blocks_touched(occupied: Bools, block: int) -> Bools:
    """Blocks of `block`^3 cells that hold a cell of `occupied` dilated once (26 neighbours).

    Args:
        occupied: (n, n, n) bool, n a multiple of block.
        block: cells along a block's edge.

    Returns:
        (n / block,) * 3 bool.
    """
    result = occupied
    for axis in range(3):
        blocks = np.moveaxis(result, axis, 0)
        blocks = blocks.reshape(-1, block, *blocks.shape[1:])
        touched: Bools = np.any(blocks, axis=1)
        touched[1:] |= blocks[:-1, -1]
        touched[:-1] |= blocks[1:, 0]
        result = np.moveaxis(touched, 0, axis)
    return result


def containment_of_cells(cells: Int64, full: Bools, block: int) -> float:
    """Share of a partial view's cells that lie in the full shape, dilated by one of its own cells.

    Args:
        cells: (n, 3) int64, coarse cells of the partial, in any number each, also out of bounds.
        full: (m, m, m) bool over the same box.
        block: cells of `full` along a coarse cell's edge.

    Returns:
        In [0, 1]; 1 without any cells. Cells out of bounds are outside.
    """
    if len(cells) == 0:
        return 1.0
    distinct = np.unique(cells, axis=0)
    inside = distinct[np.all((distinct >= 0) & (distinct < full.shape[0] // block), axis=1)]
    return int(blocks_touched(full, block)[tuple(inside.T)].sum()) / len(distinct)


def containment(partial: Bools, full: Bools) -> float:
    """`containment_of_cells` of a partial grid (m, m, m) and a full one (n, n, n) over the same box."""
    return containment_of_cells(np.argwhere(partial), full, full.shape[0] // partial.shape[0])


def packed_shell(full: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Occupied cells with an empty 6-neighbour; outside the grid is empty.

    Args:
        full: (nx, ny, nz / 8) uint8, a solid packed along z, most significant bit first.

    Returns:
        The same shape, packed alike.
    """
    return np.asarray(_shell(np.ascontiguousarray(full)))


@numba.njit(cache=True)
def _shell(full):  # type: ignore[no-untyped-def]
    nx, ny, nb = full.shape
    shell = np.zeros_like(full)
    none = np.zeros(nb, np.uint8)
    for i in range(nx):
        for j in range(ny):
            here = full[i, j]
            left = full[i - 1, j] if i > 0 else none
            right = full[i + 1, j] if i < nx - 1 else none
            above = full[i, j - 1] if j > 0 else none
            below = full[i, j + 1] if j < ny - 1 else none
            for b in range(nb):
                bits = np.int64(here[b])
                if bits == 0:
                    continue
                before, after = bits >> 1, bits << 1
                if b > 0:
                    before |= (np.int64(here[b - 1]) & 1) << 7
                if b < nb - 1:
                    after |= np.int64(here[b + 1]) >> 7
                inner = left[b] & right[b] & above[b] & below[b] & before & after
                shell[i, j, b] = bits & ~inner
    return shell


def packed_count(packed: NDArray[np.uint8]) -> int:
    """The number of bits set in a contiguous packed grid of a multiple of 8 bytes."""
    return int(_count(packed.reshape(-1).view(np.uint64)))


@numba.njit(cache=True)
def _count(words):  # type: ignore[no-untyped-def]
    """Adds neighbouring bits, pairs and nibbles of each word (the usual parallel count)."""
    total = np.uint64(0)
    ones, pairs, nibbles = (
        np.uint64(0x5555555555555555), np.uint64(0x3333333333333333), np.uint64(0x0F0F0F0F0F0F0F0F),
    )  # fmt: skip
    for word in words:
        word = word - ((word >> np.uint64(1)) & ones)
        word = (word & pairs) + ((word >> np.uint64(2)) & pairs)
        word = (word + (word >> np.uint64(4))) & nibbles
        total += (word * np.uint64(0x0101010101010101)) >> np.uint64(56)
    return total


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
