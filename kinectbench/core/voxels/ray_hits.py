"""First hits of rays from unseen voxels, counted over 26 directions."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float32

# The state of a voxel.
UNSEEN, OUTSIDE, INSIDE, NEUTRAL = range(4)


@dataclass(frozen=True)
class RayHits:
    """Counts of the first hits of rays in 26 directions from each UNSEEN voxel; uint8, 0 at other voxels.

    Attributes:
        inside: number of rays that hit INSIDE.
        outside: number of rays that hit OUTSIDE, or leave the grid.
        level_outside: the same as `outside`, of the 8 level rays only.
        sky: 1 where the ray straight up hits OUTSIDE, or leaves the grid.
    """

    inside: NDArray[np.uint8]
    outside: NDArray[np.uint8]
    level_outside: NDArray[np.uint8]
    sky: NDArray[np.uint8]

    @property
    def enclosed(self) -> Float32:
        """The share inside / (inside + outside) of each voxel; 0 if both are 0."""
        return enclosed_shares()[self.inside, self.outside]


def enclosed_shares() -> Float32:
    """Return a table (27, 27) float32 with i / (i + j) at [i, j], 0 at [0, 0]: i hits inside, j outside."""
    inside, outside = np.indices((27, 27), np.float32)
    return np.asarray(inside / np.maximum(inside + outside, np.float32(1)), np.float32)


def cast_26_rays(state: NDArray[np.uint8]) -> RayHits:
    """Cast rays from each UNSEEN voxel in 26 directions, to the first voxel in another state.

    It takes 26 sweeps over the grid, and is linear in voxels.

    Args:
        state: (nx, ny, nz) uint8: UNSEEN, OUTSIDE (seen empty, or another object), INSIDE (of the object) or
            NEUTRAL (below the floor).
    """
    return RayHits(*_cast_26_rays(np.pad(state, 1, constant_values=OUTSIDE)))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _cast_26_rays(state):  # type: ignore[no-untyped-def]
    """Return the arrays of `RayHits`; `state` has an extra border of one OUTSIDE voxel on each side."""
    nx, ny, nz = state.shape[0] - 2, state.shape[1] - 2, state.shape[2] - 2
    inside, outside, level_outside, sky = (
        np.zeros((nx, ny, nz), np.uint8),
        np.zeros((nx, ny, nz), np.uint8),
        np.zeros((nx, ny, nz), np.uint8),
        np.zeros((nx, ny, nz), np.uint8),
    )
    hits = state.copy()
    for direction in range(27):
        dx, dy, dz = direction // 9 - 1, direction // 3 % 3 - 1, direction % 3 - 1
        if direction == 13:
            continue
        # Visit the neighbour in the direction before the voxel itself.
        for a in range(nx):
            i = nx - a if dx > 0 else a + 1
            for b in range(ny):
                j = ny - b if dy > 0 else b + 1
                own, into = state[i, j, 1 : nz + 1], hits[i, j, 1 : nz + 1]
                if dx == 0 and dy == 0:
                    _walk_column(state[i, j], hits[i, j], dz)
                else:
                    source = hits[i + dx, j + dy, 1 + dz : nz + 1 + dz]
                    for k in range(nz):
                        into[k] = source[k] if own[k] == UNSEEN else own[k]
                _count_hits(own, into, INSIDE, inside[i - 1, j - 1])
                _count_hits(own, into, OUTSIDE, outside[i - 1, j - 1])
                if dz == 0:
                    _count_hits(own, into, OUTSIDE, level_outside[i - 1, j - 1])
                elif dx == 0 and dy == 0 and dz > 0:
                    _count_hits(own, into, OUTSIDE, sky[i - 1, j - 1])
    return inside, outside, level_outside, sky


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _count_hits(own, hits, code, count):  # type: ignore[no-untyped-def]
    for k in range(len(own)):
        count[k] += np.uint8(own[k] == UNSEEN) & np.uint8(hits[k] == code)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _walk_column(own, hits, dz):  # type: ignore[no-untyped-def]
    """Write to `hits` each voxel's first hit upwards (dz = 1) or downwards (-1); `own`: a column's states."""
    n = len(own)
    for c in range(1, n - 1):
        k = n - 1 - c if dz > 0 else c
        hits[k] = hits[k + dz] if own[k] == UNSEEN else own[k]
