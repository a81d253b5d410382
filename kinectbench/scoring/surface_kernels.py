"""Surfaces of voxels: their cells, nearest cells and normals. Import late: numba is slow to load.

Little is stored per cell: a shape has a hundred thousand surface cells, but a prediction of noise has eight
million.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinectbench.core.types import Bools, Float64, Int32, Int64
from kinectbench.core.voxels.pair_file import Packed
from kinectbench.core.voxels.solid import packed_shell

_SIDE = 32  # blocks along an axis; a packed byte is one column of a block
# Number of cells matched at a time, at some 50 bytes each. A shape has fewer cells; noise takes 32 such
# parts.
_PART_CELLS = 1 << 18


@dataclass(frozen=True)
class Cells:
    """A set of cells, sorted by blocks of 8^3 cells.

    Attributes:
        index: (n,) int32, the cells as x << 16 | y << 8 | z, grouped by block, in C order within a block.
        start: (b + 1,) int32, where each of the b nonempty blocks begins in `index`; the last value is n.
        box: (b, 6) int32, the smallest and the largest x, y, z of each block's cells.
    """

    index: Int32
    start: Int32
    box: Int32

    def __len__(self) -> int:
        return len(self.index)

    def chosen(self, which: Bools) -> "Cells":
        """Return the cells that a mask (n,) selects; the boxes stay as they are."""
        before = np.concatenate([[0], np.cumsum(which)]).astype(np.int32)
        return Cells(self.index[which], before[self.start], self.box)


@dataclass(frozen=True)
class SolidSurface:
    """The surface cells of a solid.

    Attributes:
        packed: (256, 256, 32) uint8, the surface cells.
        cells: the same cells as a list.
        moments: (n, 3) int16, for each of `cells`, the sum of the offsets of the solid cells around it; it
            points inwards.
    """

    packed: Packed
    cells: Cells
    moments: NDArray[np.int16]

    def within(self, mask: Packed) -> "SolidSurface":
        """Return the surface cells within a packed mask; the surface itself if the mask contains them all."""
        packed = self.packed & mask
        if np.array_equal(packed, self.packed):
            return self
        return SolidSurface(packed, cells_of(packed), self.moments[is_set(mask, self.cells.index)])

    def parts(self) -> Iterator["SolidSurface"]:
        """Yield the surface in parts that consist of whole blocks, about `_PART_CELLS` cells each."""
        start, block = self.cells.start, 0
        while block < len(self.cells.box):
            first = start[block]
            end = int(np.searchsorted(start, first + _PART_CELLS))
            end = min(max(end, block + 1), len(self.cells.box))
            of = slice(first, start[end])
            cells = Cells(self.cells.index[of], start[block : end + 1] - first, self.cells.box[block:end])
            yield SolidSurface(self.packed, cells, self.moments[of])
            block = end


@dataclass
class Spread:
    """The distances of a surface's cells to another surface, and the agreement of their normals.

    Attributes:
        cells: (k,) int64, the number of cells at each squared distance 0, 1, 2, ... (in cells).
        agreement: the sum of |n . n'| over these cells; see `normal_agreement`.
    """

    cells: Int64 = field(default_factory=lambda: np.zeros(1, np.int64))
    agreement: float = 0.0

    def __len__(self) -> int:
        return int(self.cells.sum())

    def add(self, squared: Int32, cosines: Float64) -> None:
        """Add n cells, given their squared distances (n,) and their |n . n'| (n,)."""
        cells = np.bincount(squared, minlength=len(self.cells))
        cells[: len(self.cells)] += self.cells
        self.cells = cells
        self.agreement += float(cosines.sum())


def spreads(
    queries: SolidSurface, targets: SolidSurface, masks: Sequence[Packed], hidden: Packed
) -> list[tuple[Spread, Spread]]:
    """Return the distances of one surface to another within each of several parts of the grid.

    A query's nearest target in the whole grid is also its nearest target in any part that contains the
    target. So only the other queries are searched again for a part. Both surfaces are cut to each of the
    packed masks; the second spread of each counts only queries in the hidden cells.

    Returns:
        For each mask, the spread of the queries in the mask, and that of the queries that are also in
        `hidden`. If there are no targets, all distances and cosines are 0.
    """
    results = [(Spread(), Spread()) for _ in masks]
    cut = [targets.within(mask) for mask in masks]
    for part in queries.parts():
        index = part.cells.index
        everywhere, position, agreed = _matched(part, targets)
        behind = is_set(hidden, index)
        for mask, forward, (whole, occluded) in zip(masks, cut, results, strict=True):
            chosen, squared, cosines = is_set(mask, index), everywhere.copy(), agreed.copy()
            again = chosen & ~is_set(mask, targets.cells.index[position]) if len(targets.cells) else chosen
            some = SolidSurface(part.packed, part.cells.chosen(again), part.moments[again])
            squared[again], _, cosines[again] = _matched(some, forward)
            whole.add(squared[chosen], cosines[chosen])
            occluded.add(squared[chosen & behind], cosines[chosen & behind])
    return results


def solid_surface(solid: Packed) -> SolidSurface:
    """Return the surface of a packed solid (256, 256, 32) uint8: its cells that have an empty 6-neighbour."""
    packed = packed_shell(solid)
    cells = cells_of(packed)
    return SolidSurface(packed, cells, moments(solid, cells.index))


def _matched(queries: SolidSurface, targets: SolidSurface) -> tuple[Int32, Int32, Float64]:
    """Return each query's nearest target: its squared distance, its index, and |n . n'|; 0 if none exists."""
    n = len(queries.cells)
    if not n or not len(targets.cells):
        return np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
    squared, position = nearest_cells(queries.cells, targets.cells)
    return squared, position, normal_agreement(queries.moments, targets.moments, position)


def is_set(packed: Packed, index: Int32) -> Bools:
    """Return whether cells, (n,) int32 x << 16 | y << 8 | z, are set in a packed grid."""
    bits: Bools = _is_set(np.ascontiguousarray(packed).reshape(-1), index)
    return bits


@njit(cache=True, nogil=True)
def _is_set(packed, index):  # type: ignore[no-untyped-def]
    bits = np.empty(len(index), np.bool_)
    for n in range(len(index)):
        bits[n] = packed[index[n] >> 3] & (128 >> (index[n] & 7)) != 0
    return bits


def cells_of(packed: Packed) -> Cells:
    """Return the set cells of a packed grid, (256, 256, 32) uint8, most significant bit first."""
    return Cells(*_sorted_cells(np.ascontiguousarray(packed)))


def nearest_cells(queries: Cells, targets: Cells) -> tuple[Int32, Int32]:
    """Return the nearest target of every query; of equally near targets, the first in C order.

    Args:
        queries: any number of cells.
        targets: at least one cell.

    Returns:
        Squared distances in cells, (n,) int32, and positions in `targets.index`, (n,) int32, in the order of
        `queries.index`.
    """
    boxes = targets.box.T.copy()
    indices = _nearest(queries.index, queries.start, queries.box, targets.index, targets.start, boxes)
    return indices[0], indices[1]


@njit(cache=True, error_model="numpy", nogil=True)
def _sorted_cells(packed):  # type: ignore[no-untyped-def]
    """Return the fields `index`, `start` and `box` of `Cells` for the set cells of a packed grid."""
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


@njit(cache=True, error_model="numpy", nogil=True)
def _nearest(query, query_start, query_box, target, target_start, target_box):  # type: ignore[no-untyped-def]
    """Return the squared distance and the index of each query's nearest target: (2, n) int32.

    The arguments are the fields `index`, `start` and `box` of the `Cells` of queries, then of targets.
    """
    nearest = np.empty((2, len(query)), np.int32)
    least, most = np.empty(target_box.shape[1], np.int32), np.empty(target_box.shape[1], np.int32)
    box_rows, last = target_box.T.copy(), np.int64(0)
    for block in range(len(query_box)):
        _block_bounds(query_box[block], target_box, least, most)
        candidates = np.flatnonzero(least <= most.min())
        candidates = candidates[np.argsort(least[candidates])].astype(np.uint32)
        for n in range(query_start[block], query_start[block + 1]):
            x, y, z = query[n] >> 16, query[n] >> 8 & 255, query[n] & 255
            # The last cell's answer is a good bound for the next cell.
            best, best_cell = _squared(x, y, z, target[last]), last
            for at in range(len(candidates)):
                other = candidates[np.uint32(at)]
                if least[other] > best:
                    break
                if _to_box(x, y, z, box_rows, other) <= best:
                    begin, end = np.uint32(target_start[other]), np.uint32(target_start[other + np.uint32(1)])
                    least_squared = np.int32(1 << 30)
                    for m in range(begin, end):  # vector code
                        least_squared = min(least_squared, _squared(x, y, z, target[np.uint32(m)]))
                    if least_squared <= best:
                        for m in range(begin, end):
                            if _squared(x, y, z, target[np.uint32(m)]) == least_squared:
                                if least_squared < best or target[np.uint32(m)] < target[best_cell]:
                                    best_cell = np.int64(m)
                                break
                        best = least_squared
            nearest[0, n], nearest[1, n] = best, best_cell
            last = best_cell
    return nearest


@njit(cache=True, error_model="numpy", nogil=True)
def _block_bounds(box, boxes, least, most):  # type: ignore[no-untyped-def]
    """Write bounds (b,) of the squared distances from the cells of a box to those of each of `boxes` (6, b).

    No cell of the box is nearer than `least` to a cell of the other box, and none is farther than `most`.
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


@njit(cache=True, error_model="numpy", nogil=True)
def _to_box(x, y, z, boxes, n):  # type: ignore[no-untyped-def]
    """Return the squared distance from the cell (x, y, z) to box n of `boxes` (b, 6)."""
    zero = np.int32(0)
    a = max(boxes[n, 0] - x, x - boxes[n, 3], zero)
    b = max(boxes[n, 1] - y, y - boxes[n, 4], zero)
    c = max(boxes[n, 2] - z, z - boxes[n, 5], zero)
    return np.int32(a * a + b * b + c * c)


@njit(cache=True, error_model="numpy", nogil=True)
def _squared(x, y, z, cell):  # type: ignore[no-untyped-def]
    """Return the squared distance between the cell (x, y, z) and `cell`, which is x << 16 | y << 8 | z."""
    a, b, c = x - (cell >> 16), y - (cell >> 8 & 255), z - (cell & 255)
    return np.int32(a * a + b * b + c * c)


RADIUS_CELLS = 3

_WIDTH = 2 * RADIUS_CELLS + 1
_BITS = np.unpackbits(np.arange(1 << _WIDTH, dtype=np.uint8)[:, None], axis=1)[:, 8 - _WIDTH :].astype(
    np.int32
)
_COUNT = _BITS.sum(axis=1).astype(np.int32)
_MOMENT = (_BITS * np.arange(-RADIUS_CELLS, RADIUS_CELLS + 1, dtype=np.int32)).sum(axis=1).astype(np.int32)


def moments(solid: Packed, cells: Int32) -> NDArray[np.int16]:
    """Return first moments of the solid around surface cells: (n, 3) int16, opposite to outward normals.

    A moment is the sum of the offsets of the occupied cells among the 7^3 cells around a cell; space outside
    the grid is empty. It is zero only if these offsets cancel, as for a single cell or a plate one cell
    thick.

    Args:
        solid: (256, 256, 32) uint8, packed, most significant bit first.
        cells: (n,) int32, x << 16 | y << 8 | z.
    """
    return _moments(np.ascontiguousarray(solid), cells)  # type: ignore[no-any-return]


@njit(cache=True, error_model="numpy", nogil=True)
def normal_agreement(first, second, rows):  # type: ignore[no-untyped-def]
    """Return |n . n'| of the moments `first` (n, 3) and the moments `second[rows]` (n, 3): (n,) float64.

    It is 1 where neither cell has a normal (both moments are zero), and 0 where only one cell has one.
    """
    cosines = np.empty(len(first))
    for n in range(len(first)):
        a, b, c = np.float64(first[n, 0]), np.float64(first[n, 1]), np.float64(first[n, 2])
        m = rows[n]
        d, e, f = np.float64(second[m, 0]), np.float64(second[m, 1]), np.float64(second[m, 2])
        ours, theirs = np.sqrt(a * a + b * b + c * c), np.sqrt(d * d + e * e + f * f)
        if ours > 0 and theirs > 0:
            cosines[n] = abs(a / ours * (d / theirs) + b / ours * (e / theirs) + c / ours * (f / theirs))
        else:
            cosines[n] = 1.0 if ours == theirs else 0.0
    return cosines


@njit(cache=True, error_model="numpy", nogil=True)
def _moments(solid, cells):  # type: ignore[no-untyped-def]
    """Return the sum of the offsets of the occupied cells around each cell: (n, 3) int16, at most 49 * 6.

    `solid` is the packed grid of occupied cells; `cells` (n,) are as `Cells.index`.
    """
    moments = np.zeros((len(cells), 3), np.int16)
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
