"""How far the frames' votes can be believed, from the surface that was measured well."""

import numpy as np
from numpy.typing import NDArray

AT_SURFACE_VOXELS = 0.6
# Where pixels are wide or poses are off, frames seem to see through any surface. By the share that sees
# through half of the well measured surface, what frames saw through counts in full, in part, or not at all.
# Chosen on simulated furniture at two resolutions and on a real kitchen.
USUALLY_SEEN_THROUGH, TRUST_IN_VOTES = [0.08, 0.11, 0.17], [1.0, 0.45, 0.0]


def seen_through_share(free: NDArray[np.integer], surface: NDArray[np.integer]) -> NDArray[np.float32]:
    """Of the frames with a vote on each voxel, the share that saw through it; 0 without votes.

    Args:
        free: votes for `free`.
        surface: votes for `surface`, of the same shape.
    """
    through = free.astype(np.float32)
    return np.asarray(through / np.maximum(through + surface, np.float32(1)), np.float32)


def trust_in_votes(
    tsdf: NDArray[np.float32],
    weight: NDArray[np.float32],
    seen_through: NDArray[np.float32],
    voxel_size_m: float,
) -> float:
    """What part of the votes is believed: less, the more frames see through good surface (own rule).

    Well measured is the half of the voxels at the surface that has more weight.

    Args:
        tsdf: signed distances of voxels, metres.
        weight: of the same shape; voxels without weight do not count.
        seen_through: of the same shape, `seen_through_share`.
        voxel_size_m: edge of a voxel.

    Returns:
        In [0, 1]; 0 without a surface.
    """
    near = (weight > 0) & (np.abs(tsdf) < AT_SURFACE_VOXELS * voxel_size_m)
    if not near.any():
        return 0.0
    well = near & (weight >= np.median(weight[near]))
    return float(np.interp(np.median(seen_through[well]), USUALLY_SEEN_THROUGH, TRUST_IN_VOTES))
