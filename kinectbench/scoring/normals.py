"""Normals of voxel surfaces, and how well two surfaces agree in them. Import late: numba is slow to load."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Int32 = NDArray[np.int32]
Float64 = NDArray[np.float64]
Packed = NDArray[np.uint8]

RADIUS_CELLS = 3

_WIDTH = 2 * RADIUS_CELLS + 1
_BITS = np.unpackbits(np.arange(1 << _WIDTH, dtype=np.uint8)[:, None], axis=1)[:, 8 - _WIDTH :].astype(
    np.int32
)
_COUNT = _BITS.sum(axis=1).astype(np.int32)
_MOMENT = (_BITS * np.arange(-RADIUS_CELLS, RADIUS_CELLS + 1, dtype=np.int32)).sum(axis=1).astype(np.int32)


def normals(solid: Packed, cells: Int32) -> Float64:
    """The outward normal of a solid at some of its surface cells, (n, 3) float64; zero where it has none.

    It points away from the centre of mass of what is occupied in the 7^3 cells around (outside the grid is
    empty): zero only in pieces that are symmetric in them, such as a single cell or a plate one cell thick.
    Own rule.

    Args:
        solid: (256, 256, 32) uint8, packed, most significant bit first.
        cells: (n,) int32, x << 16 | y << 8 | z.
    """
    moments = -_moments(np.ascontiguousarray(solid), cells).astype(np.float64)
    lengths = np.sqrt((moments**2).sum(axis=1, keepdims=True))
    units: Float64 = np.divide(moments, lengths, out=np.zeros_like(moments), where=lengths > 0)
    return units


def agreement(first: Float64, second: Float64) -> float:
    """Mean of |n . n'| over rows of unit normals (n, 3), n > 0; 1 where both are zero, 0 where one is."""
    cosines = np.abs((first * second).sum(axis=1))
    cosines[~first.any(axis=1) & ~second.any(axis=1)] = 1.0
    return float(cosines.mean())


@njit(cache=True, error_model="numpy")
def _moments(solid, cells):  # type: ignore[no-untyped-def]
    """(n, 3) int32: the sum of the offsets of the occupied cells around each cell."""
    moments = np.zeros((len(cells), 3), np.int32)
    side, last = solid.shape[0], solid.shape[2] - 1
    for n in range(len(cells)):
        x, y, z = cells[n] >> 16, cells[n] >> 8 & 255, cells[n] & 255
        b, shift = z >> 3, np.uint32(15 - RADIUS_CELLS - (z & 7))
        along_x = along_y = along_z = np.int32(0)
        for i in range(max(x - RADIUS_CELLS, 0), min(x + RADIUS_CELLS + 1, side)):
            for j in range(max(y - RADIUS_CELLS, 0), min(y + RADIUS_CELLS + 1, side)):
                word = np.uint32(solid[i, j, b]) << np.uint32(8)
                if b > 0:
                    word |= np.uint32(solid[i, j, b - 1]) << np.uint32(16)
                if b < last:
                    word |= np.uint32(solid[i, j, b + 1])
                window = (word >> shift) & np.uint32((1 << _WIDTH) - 1)
                along_x += (i - x) * _COUNT[window]
                along_y += (j - y) * _COUNT[window]
                along_z += _MOMENT[window]
        moments[n, 0], moments[n, 1], moments[n, 2] = along_x, along_y, along_z
    return moments
