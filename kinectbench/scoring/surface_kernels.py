"""Nearest cells and normals of voxel surfaces. Import late: numba is slow to load."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinectbench.core.types import Float64, Int32

Packed = NDArray[np.uint8]

_SIDE = 32  # blocks along an axis; a packed byte is one column of a block


@dataclass(frozen=True)
class Cells:
    """A set of cells, sorted by block.

    Attributes:
        index: (n,) int32, the cells; a block's are together, in C order.
        start: (b + 1,) int32, where each block that is not empty begins.
        box: (b, 6) int32, the smallest and the largest x, y, z of each block's cells.
    """

    index: Int32
    start: Int32
    box: Int32

    def __len__(self) -> int:
        return len(self.index)


def cells_of(packed: Packed) -> Cells:
    """The set cells of a packed grid, (256, 256, 32) uint8, most significant bit first."""
    return Cells(*_sorted_cells(np.ascontiguousarray(packed)))


def nearest(queries: Cells, targets: Cells) -> tuple[Int32, Int32]:
    """The nearest target of every query; of several the first in C order.

    Args:
        queries: any number of cells.
        targets: at least one cell.

    Returns:
        (n,) int32 squared distance in cells, and (n,) int32 which of `targets.index` it is, for each of
        `queries.index`.
    """
    boxes = targets.box.T.copy()
    found = _nearest(queries.index, queries.start, queries.box, targets.index, targets.start, boxes)
    return found[0], found[1]


@njit(cache=True, error_model="numpy")
def _sorted_cells(packed):  # type: ignore[no-untyped-def]
    """`index`, `start` and `box` of the set cells."""
    counts = np.zeros(_SIDE**3 + 1, np.int64)
    for x in range(packed.shape[0]):
        for y in range(packed.shape[1]):
            for b in range(packed.shape[2]):
                byte = packed[x, y, b]
                while byte:
                    counts[((x >> 3) * _SIDE + (y >> 3)) * _SIDE + b + 1] += 1
                    byte &= byte - np.uint8(1)
    first = np.cumsum(counts)
    used = np.flatnonzero(counts[1:])
    start = np.empty(len(used) + 1, np.int32)
    for n in range(len(used)):
        start[n] = first[used[n]]
    start[len(used)] = first[-1]
    index = np.empty(first[-1], np.int32)
    for x in range(packed.shape[0]):
        for y in range(packed.shape[1]):
            for b in range(packed.shape[2]):
                byte = packed[x, y, b]
                block = ((x >> 3) * _SIDE + (y >> 3)) * _SIDE + b
                for bit in range(8):
                    if byte and byte & (128 >> bit):
                        index[first[block]] = x << 16 | y << 8 | b << 3 | bit
                        first[block] += 1
    box = np.empty((len(used), 6), np.int32)
    for n in range(len(used)):
        box[n, :3], box[n, 3:] = 255, 0
        for cell in index[start[n] : start[n + 1]]:
            for axis in range(3):
                value = cell >> (16 - 8 * axis) & 255
                box[n, axis] = min(box[n, axis], value)
                box[n, 3 + axis] = max(box[n, 3 + axis], value)
    return index, start, box


@njit(cache=True, error_model="numpy")
def _nearest(query, query_start, query_box, target, target_start, target_box):  # type: ignore[no-untyped-def]
    """(2, n): squared distance and position of the nearest target of every query; `target_box` is (6, b)."""
    nearest = np.empty((2, len(query)), np.int32)
    least, most = np.empty(target_box.shape[1], np.int32), np.empty(target_box.shape[1], np.int32)
    box_rows, last = target_box.T.copy(), np.int64(0)
    for block in range(len(query_box)):
        _block_bounds(query_box[block], target_box, least, most)
        candidates = np.flatnonzero(least <= most.min())
        candidates = candidates[np.argsort(least[candidates])].astype(np.uint32)
        for n in range(query_start[block], query_start[block + 1]):
            x, y, z = query[n] >> 16, query[n] >> 8 & 255, query[n] & 255
            # the last cell's answer is a good bound on this one's
            best, best_cell = _squared(x, y, z, target[last]), last
            for at in range(len(candidates)):
                other = candidates[np.uint32(at)]
                if least[other] > best:
                    break
                if _to_box(x, y, z, box_rows, other) <= best:
                    begin, end = np.uint32(target_start[other]), np.uint32(target_start[other + np.uint32(1)])
                    found = np.int32(1 << 30)
                    for m in range(begin, end):  # vector code
                        found = min(found, _squared(x, y, z, target[np.uint32(m)]))
                    if found <= best:
                        for m in range(begin, end):
                            if _squared(x, y, z, target[np.uint32(m)]) == found:
                                if found < best or target[np.uint32(m)] < target[best_cell]:
                                    best_cell = np.int64(m)
                                break
                        best = found
            nearest[0, n], nearest[1, n] = best, best_cell
            last = best_cell
    return nearest


@njit(cache=True, error_model="numpy")
def _block_bounds(box, boxes, least, most):  # type: ignore[no-untyped-def]
    """Bounds of the squared distance between the cells of a box and those of each of `boxes` (6, b).

    No pair is nearer than `least`; every cell of the box has one of the other within `most`.
    """
    least[:], most[:] = 0, 0
    for axis in range(3):
        low, high = box[axis], box[3 + axis]
        lows, highs = boxes[axis], boxes[3 + axis]
        for n in range(len(least)):
            gap = max(lows[n] - high, low - highs[n], np.int32(0))
            span = max(highs[n] - low, high - lows[n])
            least[n] += gap * gap
            most[n] += span * span


@njit(cache=True, error_model="numpy")
def _to_box(x, y, z, boxes, n):  # type: ignore[no-untyped-def]
    """Squared distance from a cell to box n."""
    zero = np.int32(0)
    a = max(boxes[n, 0] - x, x - boxes[n, 3], zero)
    b = max(boxes[n, 1] - y, y - boxes[n, 4], zero)
    c = max(boxes[n, 2] - z, z - boxes[n, 5], zero)
    return np.int32(a * a + b * b + c * c)


@njit(cache=True, error_model="numpy")
def _squared(x, y, z, cell):  # type: ignore[no-untyped-def]
    """Squared distance between two cells."""
    a, b, c = x - (cell >> 16), y - (cell >> 8 & 255), z - (cell & 255)
    return np.int32(a * a + b * b + c * c)


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
