"""The probability that a voxel is inside the object, by first hits of rays, as simulated objects show."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float32
from kinectbench.stages.segment.solid.evidence import Rules, VoxelEvidence, rim_voxels

# The state of a voxel.
UNSEEN, OUTSIDE, INSIDE, NEUTRAL = range(4)
# Counted on one object of each of 23 families that may be looked at (seed 41, true poses with 1 mm of noise),
# each with the same weight. Boosted trees on 16 features of a voxel and its surroundings, trained without the
# family they are tested on, make no better solids: mean IoU .803, and .800 by such tables. The tables have
# the share of unknown voxels that are inside, by the share of 26 rays that meet the object: under a roof, and
# where the ray straight up leaves the object. They were counted by whether any of nine rays up leaves it, and
# without the four families that are drawn to deceive: with these the share is .46, not .57, under a roof from
# 21 rays on, and the space under a real cabinet was taken for air.
ENCLOSED = np.array([0, 9, 12, 14, 17, 19, 20, 21, 22, 23, 25, 26], np.float32) / 26
# Under a roof.
ROOFED_SHARE = np.array([0.0, 0.0, 0.02, 0.08, 0.12, 0.2, 0.4, 0.57, 0.57, 0.57, 0.57, 0.79], np.float32)
# From 20 rays on the share was .44 to .61, and .97 of the few voxels with 23 and more, the bottoms of
# buckets. It is set to undecided by hand, or the depth of an open bin would be taken for solid.
SKY_SHARE = np.array([0.0, 0.05, 0.11, 0.15, 0.2, 0.22, 0.49, 0.49, 0.49, 0.49, 0.49, 0.49], np.float32)
# For voxels right under the object that only the upper rim of a line of sight touches: by how many of eight
# level rays lead out.
RIM_SHARE = np.array([0.71, 0.5, 0.26, 0.2, 0.12, 0.07, 0.05, 0.03, 0.01], np.float32)
# For voxels seen only from below, counted where no camera fits below the object; and that of five families
# with a space open below.
UNDERSIDE_SHARE, OPEN_SHARE = np.float32(0.76), np.float32(0.48)
# The share of observed voxels that are inside, by their signed distance in voxels.
SIGNED_VOXELS = np.array(
    [-4, -3.25, -3, -2.5, -2, -1.5, -1, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 1, 2, 3], np.float32
)
# Counted at each of these distances.
SIGNED_INSIDE_SHARE = np.array(
    [0.94, 0.9, 0.885, 0.94, 0.96, 0.98, 0.985, 0.945, 0.83, 0.5, 0.045, 0.01, 0.003, 0.002, 0.001, 0.0],
    np.float32,
)


def inside_probability(evidence: VoxelEvidence, rules: Rules, voxel_m: float) -> Float32:
    """Return the probability that each unseen voxel is inside; 0 outside `unseen`.

    Args:
        evidence: the class of each voxel.
        rules: by which the solid is made.
        voxel_m: edge of a voxel, metres.
    """
    state = np.full(evidence.near_surface.shape, UNSEEN, np.uint8)
    state[evidence.near_surface | evidence.closed] = INSIDE
    state[evidence.free | evidence.excluded] = OUTSIDE
    # No camera sees the floor below the object: a ray down counts for nothing there.
    state[:, :, : evidence.contact.start] = NEUTRAL
    hits = cast_26_rays(state)
    shares = [np.interp(enclosed_shares(), ENCLOSED, share) for share in (ROOFED_SHARE, SKY_SHARE)]
    probability = np.zeros(state.shape, np.float32)
    met = (each.reshape(-1) for each in (probability, evidence.unseen, hits.sky, hits.inside, hits.outside))
    _look_up(np.array(shares, np.float32), *met)
    object_above = evidence.near_surface | evidence.closed | evidence.underside
    rim = np.zeros_like(object_above)
    for layers in range(1, rim_voxels(rules.limits, voxel_m) + 1):
        rim[:, :, :-layers] |= object_above[:, :, layers:]
    rim &= evidence.unknown & ~evidence.underside
    probability[rim] = RIM_SHARE[hits.level_outside[rim]]
    probability[evidence.underside] = OPEN_SHARE if rules.underside == "open" else UNDERSIDE_SHARE
    probability[evidence.closed] = 1
    return probability


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _look_up(shares, probability, unseen, sky, inside, outside):  # type: ignore[no-untyped-def]
    """Set `probability` (n,) where `unseen` (n,) to `shares` (2, 27, 27), by what each voxel's rays met."""
    for n in range(len(unseen)):
        if unseen[n]:
            probability[n] = shares[sky[n], inside[n], outside[n]]


def measured_probability(signed_m: NDArray[np.floating], voxel_size_m: float) -> Float32:
    """Return the probability that an observed voxel is inside, by its signed distance (metres)."""
    voxels = signed_m / np.float32(voxel_size_m)
    # Most observed voxels are far in front of a surface, where the share is its last value.
    near = voxels < SIGNED_VOXELS[-1]
    shares = np.full(voxels.shape, SIGNED_INSIDE_SHARE[-1])
    shares[near] = np.interp(voxels[near], SIGNED_VOXELS, SIGNED_INSIDE_SHARE)
    return shares


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
