"""How far the frames' votes can be believed, from how wide a ray is."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera
from kinectbench.tracking.trajectory import Trajectory

# A ray passes beside its pixel's middle by half a pixel, and by what its frame's pose is off.
POSE_SIGMAS = 3.0
# Where rays are wider than a voxel, frames seem to see through any surface. By their width in voxels, what
# frames saw through counts in full, in part, or not at all. Chosen on simulated furniture at two resolutions
# with a real kitchen's and a real cabinet's poses in view.
RAY_WIDTHS_VOXELS, TRUST_IN_VOTES = [0.8, 1.0, 1.4], [1.0, 0.45, 0.0]
# More frames than this share see through a voxel only where there is no surface: on a flat one noise makes
# that many do so, and all frames half a voxel in front of it.
USUAL_FREE_SHARE, USUAL_FREE_SHARE_PER_VOXEL = 0.1, 2.0
# How far the rest moves the surface inward, if all frames see through.
VOXELS_PER_FREE_SHARE = 40.0


def seen_through_share(free: NDArray[np.integer], surface: NDArray[np.integer]) -> NDArray[np.float32]:
    """Of the frames with a vote on each voxel, the share that saw through it; 0 without votes.

    Args:
        free: votes for `free`.
        surface: votes for `surface`, of the same shape: measured there, or just before it.
    """
    through = free.astype(np.float32)
    return np.asarray(through / np.maximum(through + surface, np.float32(1)), np.float32)


def ray_width_m(camera: Camera, trajectory: Trajectory, distance_m: float) -> float:
    """How wide the frames' rays are at a distance, metres: a pixel and three sigmas of the pose (own rule).

    Args:
        camera: of the depth images.
        trajectory: knows by how much each pose may be off; it has a good frame.
        distance_m: from the cameras.
    """
    return float(np.hypot(distance_m / camera.fx, POSE_SIGMAS * trajectory.usual_pose_sigma_m))


def trust_in_votes(ray_width_m: float, voxel_size_m: float) -> float:
    """What part of the votes for `free` is believed, in [0, 1]: less, the wider the rays are (own rule)."""
    return float(np.interp(ray_width_m / voxel_size_m, RAY_WIDTHS_VOXELS, TRUST_IN_VOTES))


def without_fringe(
    tsdf: NDArray[np.float32],
    free: NDArray[np.integer],
    surface: NDArray[np.integer],
    voxel_size_m: float,
    trust: float = 1.0,
) -> NDArray[np.float32]:
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
