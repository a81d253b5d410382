"""What frames say about the voxels of a grid, and how far their votes can be believed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, Grid
from kinectbench.core.types import Float32

# A ray passes beside its pixel's middle by half a pixel, and by what its frame's pose is off.
POSE_SIGMAS = 3.0
# Where rays are wider than a voxel, frames seem to see through any surface. By their width in voxels, what
# frames saw through counts in full, in part, or not at all. Chosen on simulated furniture at two resolutions
# with a real kitchen's and a real cabinet's poses in view.
RAY_WIDTHS_VOXELS, TRUST_IN_VOTES = (0.8, 1.0, 1.4), (1.0, 0.45, 0.0)
# More frames than this share see through a voxel only where there is no surface: on a flat one noise makes
# that many do so, and all frames half a voxel in front of it.
USUAL_FREE_SHARE, USUAL_FREE_SHARE_PER_VOXEL = 0.1, 2.0
# How far the rest moves the surface inward, if all frames see through.
VOXELS_PER_FREE_SHARE = 40.0


@dataclass(frozen=True)
class Observation:
    """What the frames say about every voxel of a dense grid; arrays have the grid's shape.

    Attributes:
        grid: the voxels.
        tsdf: float32, metres, positive in front of the surface; 0 where weight is 0.
        weight: float32, 1/mm^2; 0 = never observed.
        free: uint16, frames that saw through.
        surface: uint16, frames that measured a surface there, or less than the truncation before it.
    """

    grid: Grid
    tsdf: Float32
    weight: Float32
    free: NDArray[np.uint16]
    surface: NDArray[np.uint16]


def merge(first: Observation, second: Observation) -> Observation:
    """What two disjoint sets of frames say together: weighted mean of the TSDFs, sums of the votes."""
    weight = first.weight + second.weight
    total = first.tsdf * first.weight + second.tsdf * second.weight
    tsdf = np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)
    return Observation(first.grid, tsdf, weight, first.free + second.free, first.surface + second.surface)


def seen_through_share(free: NDArray[np.integer], surface: NDArray[np.integer]) -> Float32:
    """Of the frames with a vote on each voxel, the share that saw through it; 0 without votes.

    Args:
        free: votes for `free`.
        surface: votes for `surface`, of the same shape: measured there, or just before it.
    """
    through = free.astype(np.float32)
    return np.asarray(through / np.maximum(through + surface, np.float32(1)), np.float32)


def pose_reach_m(usual_pose_sigma_m: float | None) -> float:
    """Three sigmas of a usual pose that was checked, metres; 0 if none was (None).

    Without any figure the largest plausible error would set the truncation, in which thin parts vanish even
    where the poses are right: with 75 mm, F at 5 mm of a simulated chair falls from 0.99 to 0.28.
    """
    return 0.0 if usual_pose_sigma_m is None else POSE_SIGMAS * usual_pose_sigma_m


def ray_width_m(camera: Camera, usual_pose_sigma_m: float | None, distance_m: float) -> float:
    """How wide the frames' rays are at a distance, metres: a pixel and three sigmas of the pose (own rule).

    Args:
        camera: of the depth images.
        usual_pose_sigma_m: by how much a usual pose may be off, metres; None if no pose was checked.
        distance_m: from the cameras.
    """
    return float(np.hypot(distance_m / camera.fx, pose_reach_m(usual_pose_sigma_m)))


def trust_in_votes(ray_width_m: float, voxel_size_m: float) -> float:
    """What part of the votes for `free` is believed, in [0, 1]: less, the wider the rays are (own rule)."""
    return float(np.interp(ray_width_m / voxel_size_m, RAY_WIDTHS_VOXELS, TRUST_IN_VOTES))


def without_fringe(
    tsdf: Float32,
    free: NDArray[np.integer],
    surface: NDArray[np.integer],
    voxel_size_m: float,
    trust: float = 1.0,
) -> Float32:
    """The TSDF, raised where more frames saw through than a surface there explains (own rule).

    The mean of projective distances makes edges and thin parts thick: to a voxel beside an edge, frames in
    which it lies just behind the part add a negative distance with full weight; those that look past the part
    have little weight there, next to a depth edge. Their votes count alike.

    Args:
        tsdf: signed distances, metres, positive in front of the surface.
        free: votes for `free`, of the same shape.
        surface: votes for `surface`, of the same shape.
        voxel_size_m: edge of a voxel.
        trust: what part of the votes is believed, `trust_in_votes`.
    """
    share = seen_through_share(free, surface)
    in_front = np.maximum(tsdf, np.float32(0)) / np.float32(voxel_size_m)
    excess = share - np.float32(USUAL_FREE_SHARE) - np.float32(USUAL_FREE_SHARE_PER_VOXEL) * in_front
    step = np.float32(trust * VOXELS_PER_FREE_SHARE * voxel_size_m)
    return np.asarray(tsdf + step * np.maximum(excess, np.float32(0)), np.float32)
