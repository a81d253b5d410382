"""Measurements of frames at the voxels of a grid, and how far to trust them."""

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
# If more than this share of frames see through a voxel, it is no surface. Nearer to it than a voxel
# behind, distances are to decide, and the share grows. Chosen with 0.1 to 0.3 on simulated furniture, seeds
# 40 to 43: a larger value erodes undersides less, but leaves more in front of surfaces seen by few frames.
USUAL_FREE_SHARE, USUAL_FREE_SHARE_PER_VOXEL = 0.15, 0.5
UNDECIDED_VOXELS = 1.0
# How far the rest moves the surface inward, if all frames see through.
VOXELS_PER_FREE_SHARE = 40.0
# Weight of a frame that saw a voxel hidden behind a surface: full up to half a voxel's diagonal (or 1.5
# standard deviations) behind the surface, this share of it from this many voxels farther on. What is hidden
# may be solid or air: with full weight, such frames make everything thinner than the truncation thicker. Each
# side of a panel of 16 mm lay 1.9 mm too far out with exact depth and true poses, and lies 0.1 mm off now.
HALF_DIAGONAL, FADING_VOXELS, HIDDEN_SHARE = 0.87, 0.5, 0.001


@dataclass(frozen=True)
class Observation:
    """Measurements of frames at every voxel of a dense grid; arrays have the grid's shape.

    Attributes:
        grid: the voxels.
        tsdf: float32, metres, positive in front of the surface; 0 where weight is 0.
        weight: float32, 1/mm^2, the frames' weights in `tsdf`, but not lowered behind surfaces (see
            `evident_weight`); 0 = never observed.
        free: uint16, number of frames that saw through the voxel; 65,535: as many or more.
        surface: uint16, number of frames that measured a surface at the voxel, or in front of it by less than
            the truncation distance; 65,535: as many or more.
    """

    grid: Grid
    tsdf: Float32
    weight: Float32
    free: NDArray[np.uint16]
    surface: NDArray[np.uint16]


def merge(first: Observation, second: Observation) -> Observation:
    """Merge observations of one grid from two disjoint sets of frames.

    The TSDF is the weighted mean; `free` and `surface` are sums, at most 65,535.
    """
    voxel_m = first.grid.voxel_size_m
    parts = [seen.weight * _heard_share(seen.tsdf, voxel_m) for seen in (first, second)]
    weight = parts[0] + parts[1]
    total = first.tsdf * parts[0] + second.tsdf * parts[1]
    tsdf = np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)
    votes = _sum(first.free, second.free), _sum(first.surface, second.surface)
    return Observation(first.grid, tsdf, evident_weight(tsdf, weight, voxel_m), *votes)


def _sum(first: NDArray[np.uint16], second: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return the sum of two arrays of one shape, at most 65,535."""
    room = np.iinfo(np.uint16).max - first
    return first + np.minimum(second, room)


def evident_weight(tsdf: Float32, weight: Float32, voxel_size_m: float) -> Float32:
    """Return the weights before fusion lowered them behind surfaces, 1/mm^2.

    Args:
        tsdf: fused signed distances, metres.
        weight: of the same shape, the summed weights of these distances, 1/mm^2.
        voxel_size_m: edge of a voxel, metres.
    """
    return np.asarray(weight / _heard_share(tsdf, voxel_size_m), np.float32)


def _heard_share(tsdf: Float32, voxel_size_m: float) -> Float32:
    """Return the factor, at most 1, by which fusion lowers weights at distances `tsdf` (< 0: behind)."""
    behind_voxels = -tsdf / np.float32(voxel_size_m) - np.float32(HALF_DIAGONAL)
    faded = np.float32(1) - np.maximum(behind_voxels, np.float32(0)) / np.float32(FADING_VOXELS)
    return np.asarray(np.maximum(faded, np.float32(HIDDEN_SHARE)), np.float32)


def seen_through_share(free: NDArray[np.integer], surface: NDArray[np.integer]) -> Float32:
    """Return free / (free + surface) of each voxel; 0 if both are 0.

    Args:
        free: number of frames that saw through the voxel.
        surface: number of frames that measured a surface there or just in front; of the same shape.
    """
    through = free.astype(np.float32)
    return np.asarray(through / np.maximum(through + surface, np.float32(1)), np.float32)


def pose_reach_m(median_pose_sigma_m: float | None) -> float:
    """Return three times the median pose error, metres; 0 if no pose was checked (None).

    Assuming the largest plausible error instead of 0 would widen the truncation so much that thin parts
    vanish even where the poses are right: with 75 mm, F at 5 mm of a simulated chair falls from 0.99 to 0.28.
    """
    return 0.0 if median_pose_sigma_m is None else POSE_SIGMAS * median_pose_sigma_m


def ray_width_m(camera: Camera, median_pose_sigma_m: float | None, distance_m: float) -> float:
    """Return a ray's width, metres: root of the sum of squares of a pixel's width and thrice the pose error.

    Args:
        camera: camera of the depth images.
        median_pose_sigma_m: median error of the poses, metres; None if no pose was checked.
        distance_m: distance from the cameras, metres.
    """
    return float(np.hypot(distance_m / camera.fx, pose_reach_m(median_pose_sigma_m)))


def trust_in_votes(ray_width_m: float, voxel_size_m: float) -> float:
    """Return how far to trust `Observation.free`, 0 to 1: less if rays are many voxels wide."""
    return float(np.interp(ray_width_m / voxel_size_m, RAY_WIDTHS_VOXELS, TRUST_IN_VOTES))


def without_fringe(
    tsdf: Float32,
    free: NDArray[np.integer],
    surface: NDArray[np.integer],
    voxel_size_m: float,
    trust: float = 1.0,
) -> Float32:
    """Return the TSDF without artefacts at edges: it is increased where many frames saw through a voxel.

    At an underside seen at a grazing angle, for example, few frames measure a surface. Frames in which the
    voxel is hidden outweigh these few frames, although their weight decays. Frames that see through the voxel
    are evidence that it is free, however small their weight.

    Args:
        tsdf: signed distances, metres, positive in front of the surface.
        free: number of frames that saw through each voxel.
        surface: number of frames that measured a surface there or just in front.
        voxel_size_m: edge of a voxel, metres.
        trust: factor of the correction, 0 to 1, from `trust_in_votes`.
    """
    share = seen_through_share(free, surface)
    behind = np.maximum(tsdf / np.float32(voxel_size_m) + np.float32(UNDECIDED_VOXELS), np.float32(0))
    excess = share - np.float32(USUAL_FREE_SHARE) - np.float32(USUAL_FREE_SHARE_PER_VOXEL) * behind
    step = np.float32(trust * VOXELS_PER_FREE_SHARE * voxel_size_m)
    return np.asarray(tsdf + step * np.maximum(excess, np.float32(0)), np.float32)
