"""How many cells are set, and how much of a partial lies in its full shape: on packed grids."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.voxels.pair_file import BLOCK


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
