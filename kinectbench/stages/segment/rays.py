"""What one first meets from a voxel that nobody saw: counts over its 26 neighbours' directions."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float32

# The state of a voxel.
UNSEEN, OUTSIDE, INSIDE, NEUTRAL = range(4)


@dataclass(frozen=True)
class Met:
    """How many directions first meet what from each UNSEEN voxel; uint8, zeros elsewhere.

    Attributes:
        inside: of all 26, that meet INSIDE.
        outside: of all 26, that meet OUTSIDE, or leave the grid.
        level_outside: the same of the 8 level ones.
        sky: 1 where straight up it does.
    """

    inside: NDArray[np.uint8]
    outside: NDArray[np.uint8]
    level_outside: NDArray[np.uint8]
    sky: NDArray[np.uint8]

    @property
    def enclosed(self) -> Float32:
        """Of the directions that meet one of the two, the share that meets INSIDE; 0 if none does."""
        share = np.zeros(self.inside.shape, np.float32)
        counted = self.inside + self.outside
        np.divide(self.inside, counted, out=share, where=self.inside > 0, dtype=np.float32)
        return share


def walk_out(state: NDArray[np.uint8]) -> Met:
    """Walk from each UNSEEN voxel through others of them until the first voxel that is not.

    Own rule; 26 sweeps, linear in voxels.

    Args:
        state: (nx, ny, nz) uint8 of UNSEEN, OUTSIDE (seen empty, neighbours), INSIDE (of the object) and
            NEUTRAL (below the floor).
    """
    return Met(*_walk_out(np.pad(state, 1, constant_values=OUTSIDE)))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _walk_out(state):  # type: ignore[no-untyped-def]
    """See `walk_out`; the state has a border of one voxel."""
    nx, ny, nz = state.shape[0] - 2, state.shape[1] - 2, state.shape[2] - 2
    inside, outside, level_outside, sky = (
        np.zeros((nx, ny, nz), np.uint8),
        np.zeros((nx, ny, nz), np.uint8),
        np.zeros((nx, ny, nz), np.uint8),
        np.zeros((nx, ny, nz), np.uint8),
    )
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
                _count(own, into, INSIDE, inside[i - 1, j - 1])
                _count(own, into, OUTSIDE, outside[i - 1, j - 1])
                if dz == 0:
                    _count(own, into, OUTSIDE, level_outside[i - 1, j - 1])
                elif dx == 0 and dy == 0 and dz > 0:
                    _count(own, into, OUTSIDE, sky[i - 1, j - 1])
    return inside, outside, level_outside, sky


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _count(own, met, code, count):  # type: ignore[no-untyped-def]
    for k in range(len(own)):
        count[k] += np.uint8(own[k] == UNSEEN) & np.uint8(met[k] == code)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _walk_column(own, met, dz):  # type: ignore[no-untyped-def]
    """Straight up or down, one voxel after the other."""
    n = len(own)
    for c in range(1, n - 1):
        k = n - 1 - c if dz > 0 else c
        met[k] = met[k + dz] if own[k] == UNSEEN else own[k]
