"""What one first meets from a voxel that no camera saw: tallies of 26 directions."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float32

# The state of a voxel. SEALED and BEYOND are other words for OUTSIDE: in an opening too narrow to be one, and
# beyond the grid.
UNSEEN, OUTSIDE, INSIDE, NEUTRAL, SEALED, BEYOND = range(6)
DIRECTIONS = 26
_DOWN, _LEVEL, _UP = 0, 1, 2
# A tally holds four counts of at most 26, a byte each.
_BYTE = np.uint32(255)
_SHIFT = {INSIDE: 0, OUTSIDE: 8, SEALED: 16, BEYOND: 24}


@dataclass(frozen=True)
class Tally:
    """How many directions first meet what, from each UNSEEN voxel; zeros elsewhere.

    Attributes:
        by_slope: (3, nx, ny, nz) uint32: of the 9 directions that go down, the 8 level ones, the 9 that go
            up; the counts of INSIDE, OUTSIDE, SEALED and BEYOND are its bytes, from the lowest.
    """

    by_slope: NDArray[np.uint32]

    def down(self, *met: int) -> NDArray[np.uint8]:
        """How many of the 9 directions downwards meet one of these, (nx, ny, nz) uint8."""
        return _count(self.by_slope[_DOWN], met)

    def level(self, *met: int) -> NDArray[np.uint8]:
        """How many of the 8 horizontal directions do."""
        return _count(self.by_slope[_LEVEL], met)

    def up(self, *met: int) -> NDArray[np.uint8]:
        """How many of the 9 directions upwards do."""
        return _count(self.by_slope[_UP], met)

    def all(self, *met: int) -> NDArray[np.uint8]:
        """How many of all 26 do."""
        return _count(self.by_slope.sum(axis=0, dtype=np.uint32), met)

    @property
    def enclosed(self) -> Float32:
        """Of the directions that count, the share that meets INSIDE, float32 in [0, 1]; 0 if none counts."""
        total = self.by_slope.sum(axis=0, dtype=np.uint32)
        inside = _count(total, (INSIDE,))
        counted = inside + _count(total, (OUTSIDE, SEALED, BEYOND))
        share = np.zeros(inside.shape, np.float32)
        np.divide(inside, counted, out=share, where=inside > 0, dtype=np.float32)
        return share


def _count(tally: NDArray[np.uint32], met: tuple[int, ...]) -> NDArray[np.uint8]:
    total = np.zeros(tally.shape, np.uint8)
    for code in met:
        total += ((tally >> np.uint32(_SHIFT[code])) & _BYTE).astype(np.uint8)
    return total


def tally_rays(state: NDArray[np.uint8]) -> Tally:
    """Walk from each UNSEEN voxel through others of them until the first voxel that is not.

    Own rule; 26 sweeps, linear in voxels.

    Args:
        state: (nx, ny, nz) uint8 of UNSEEN, OUTSIDE (seen empty, seen floor, neighbours), SEALED (the same,
            in an opening that is none), INSIDE (just behind a measured surface of the object) and NEUTRAL
            (below a floor that was not seen). What lies beyond the grid is BEYOND.
    """
    return Tally(_tally(np.pad(state, 1, constant_values=BEYOND)))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _tally(state):  # type: ignore[no-untyped-def]
    """See `tally_rays`; the state has a border of one voxel."""
    nx, ny, nz = state.shape[0] - 2, state.shape[1] - 2, state.shape[2] - 2
    tally = np.zeros((3, nx, ny, nz), np.uint32)
    met = state.copy()
    for direction in range(27):
        dx, dy, dz = direction // 9 - 1, direction // 3 % 3 - 1, direction % 3 - 1
        if direction == 13:
            continue
        # Visit the neighbour in the direction before the voxel itself.
        for a in range(nx):
            i = nx - a if dx > 0 else a + 1
            for b in range(ny):
                j = ny - b if dy > 0 else b + 1
                own, into = state[i, j, 1 : nz + 1], met[i, j, 1 : nz + 1]
                if dx == 0 and dy == 0:
                    _walk_column(state[i, j], met[i, j], dz)
                else:
                    source = met[i + dx, j + dy, 1 + dz : nz + 1 + dz]
                    for k in range(nz):
                        into[k] = source[k] if own[k] == UNSEEN else own[k]
                count = tally[dz + 1, i - 1, j - 1]
                for k in range(nz):
                    met_k = into[k]
                    grows = (
                        np.uint32(met_k == INSIDE)
                        + (np.uint32(met_k == OUTSIDE) << np.uint32(8))
                        + (np.uint32(met_k == SEALED) << np.uint32(16))
                        + (np.uint32(met_k == BEYOND) << np.uint32(24))
                    )
                    count[k] += grows * np.uint32(own[k] == UNSEEN)
    return tally


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _walk_column(own, met, dz):  # type: ignore[no-untyped-def]
    """Straight up or down, one voxel after the other."""
    n = len(own)
    for c in range(1, n - 1):
        k = n - 1 - c if dz > 0 else c
        met[k] = met[k + dz] if own[k] == UNSEEN else own[k]
