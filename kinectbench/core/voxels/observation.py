"""Measurements of frames at the voxels of a grid, and how far to trust them."""

from dataclasses import dataclass

import numba
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
    tsdf, weight = np.empty(first.tsdf.shape, np.float32), np.empty(first.tsdf.shape, np.float32)
    given = [np.ravel(each) for seen in (first, second) for each in (seen.tsdf, seen.weight)]
    _merge(tsdf.reshape(-1), weight.reshape(-1), *given, np.float32(first.grid.voxel_size_m))
    votes = _sum(first.free, second.free), _sum(first.surface, second.surface)
    return Observation(first.grid, tsdf, weight, *votes)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _merge(tsdf, weight, tsdf1, weight1, tsdf2, weight2, voxel_m):  # type: ignore[no-untyped-def]
    """Set `tsdf` and `weight` (n,) to those of two observations together; float32, without large copies."""
    for n in range(len(tsdf)):
        part1 = weight1[n] * _heard(tsdf1[n], voxel_m)
        part2 = weight2[n] * _heard(tsdf2[n], voxel_m)
        both = part1 + part2
        total = tsdf1[n] * part1 + tsdf2[n] * part2
        tsdf[n] = total / both if both > 0 else np.float32(0)
        weight[n] = both / _heard(tsdf[n], voxel_m)


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
    before, flat = np.empty(weight.shape, np.float32), [np.ravel(each) for each in (tsdf, weight)]
    _unlowered(before.reshape(-1), *flat, np.float32(voxel_size_m))
    return before


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _unlowered(before, tsdf, weight, voxel_m):  # type: ignore[no-untyped-def]
    for n in range(len(before)):
        before[n] = weight[n] / _heard(tsdf[n], voxel_m)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _heard(tsdf, voxel_m):  # type: ignore[no-untyped-def]
    """Return the factor, at most 1, by which fusion lowers weights at a distance `tsdf` (< 0: behind)."""
    f32 = np.float32
    behind_voxels = -tsdf / voxel_m - f32(HALF_DIAGONAL)
    faded = f32(1) - max(behind_voxels, f32(0)) / f32(FADING_VOXELS)
    return max(faded, f32(HIDDEN_SHARE))


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
    corrected, flat = np.empty(tsdf.shape, np.float32), [np.ravel(each) for each in (tsdf, free, surface)]
    step = np.float32(trust * VOXELS_PER_FREE_SHARE * voxel_size_m)
    _correct(corrected.reshape(-1), *flat, np.float32(voxel_size_m), step)
    return corrected


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _correct(corrected, tsdf, free, surface, voxel_m, step_m):  # type: ignore[no-untyped-def]
    """Set `corrected` (n,) to `tsdf` (n,), float32, as `without_fringe` describes; without large copies.

    `step_m` is how far the surface moves, metres, for a share of 1 of frames that see through.
    """
    f32 = np.float32
    usual, a_voxel, undecided = f32(USUAL_FREE_SHARE), f32(USUAL_FREE_SHARE_PER_VOXEL), f32(UNDECIDED_VOXELS)
    for n in range(len(tsdf)):
        through = f32(free[n])
        share = through / max(through + f32(surface[n]), f32(1))
        behind = max(tsdf[n] / voxel_m + undecided, f32(0))
        excess = share - usual - a_voxel * behind
        corrected[n] = tsdf[n] + step_m * max(excess, f32(0))
