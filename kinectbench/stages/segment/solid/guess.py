"""The probability that a voxel is inside the object, as measured on simulated objects."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float32
from kinectbench.core.voxels.ray_hits import INSIDE, NEUTRAL, OUTSIDE, UNSEEN, cast_26_rays, enclosed_shares
from kinectbench.stages.segment.solid.evidence import Rules, VoxelEvidence, rim_voxels

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
