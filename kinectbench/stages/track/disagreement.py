"""Disagreement between the depth of frames and their given poses.

Drift of a given trajectory appears between distant frames that see the same place.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import invert_rigid, rotation_angle_rad, transform_points, twist_from_rigid
from kinectbench.core.geometry.gauss_newton import projective_residuals
from kinectbench.core.types import Float64
from kinectbench.stages.track.covisibility import covisible, keyframe_thumbnail
from kinectbench.stages.track.frame_maps import FrameMaps, Level, MapCache
from kinectbench.stages.track.odometry import ENOUGH_INLIERS, is_accepted
from kinectbench.stages.track.registration import PLACED, Registration, measure, register
from kinectbench.stages.track.tracked import Constraint

# The part of a shift up to this many standard deviations may be an error of the registration.
SIGMAS = 3.0
# Frames that overlap less than this are not compared.
MIN_OVERLAP = 0.05
# A given pose counts as good as the registered one if nearly as many points agree, nearly as closely, with
# similar colours. Along a flat face a registration may slide by a metre and fit as well. The margins were
# checked with correct poses of box-like objects in no order of time, and with poses of known errors.
AS_MANY, AS_CLOSE, WELL_BELOW_NOISE, AS_SIMILAR = 0.03, 1.1, 0.5, 0.1
# Points used to measure how far a motion moves the visible surface.
MOVED_POINTS = 1000
# Residuals: largest distance along the ray between a point and its measurement, and the smallest cosine
# between their normals.
GATE_M, MIN_FACING = 0.1, 0.5
# Largest number of registered pairs, in total and per frame; pairs farthest apart in time come first.
MAX_PAIRS, PAIRS_PER_FRAME = 120, 0.3
# Smallest distance in time of two distant frames, as a ratio of the recording's length.
MIN_APART = 1 / 6
# Frames with a smaller predicted shared view are not registered.
MIN_SHARED_VIEW = 0.3
# Larger shifts are checked again; registrations of correct poses have far smaller shifts.
RECHECKED_SHIFT_M = 0.05
# With fewer pairs no ratio is reported.
MIN_TRIED = 8
# Fewer residuals have no reliable median.
MIN_RESIDUALS = 100


@dataclass(frozen=True)
class Disagreement:
    """The motion that would make a frame agree with others.

    Attributes:
        registration: registration of the frame to the first of the others, started at its given pose.
        shift_m: median displacement of the frame's points, metres.
        certain_shift_m: the part of the shift beyond three standard deviations of the registration, metres.
        turn_rad: rotation of the camera, radians.
    """

    registration: Registration
    shift_m: float
    certain_shift_m: float
    turn_rad: float


def check_pose(
    source: FrameMaps,
    targets: Sequence[FrameMaps],
    T_targets_source: Sequence[Float64],
    coarsest: int,
    every: int,
    recheck_above_m: float = 0.0,
) -> Disagreement | None:
    """Register a frame to others, starting at its given pose, and return how far it moved.

    The result is None if the overlap is below 5 %, or if there are fewer than 100 inliers. If the frame moves
    by more than `recheck_above_m` but fits as well at its given pose, it has only slid along a surface; the
    result is then no shift and no turn.

    Args:
        source: the frame.
        targets: one or more other frames, fixed relative to each other.
        T_targets_source: (4, 4) for each target, by the given poses.
        coarsest: level to start at. Level 0 finds less than half of a shift of 100 mm, level 2 all of it.
        every: stride of the points used.
        recheck_above_m: above this shift, metres, the fit at the given pose is measured as well.
    """
    registration = register(source, targets, T_targets_source, coarsest, PLACED, every)
    if registration.overlap < MIN_OVERLAP or registration.signal_to_noise == 0:
        return None
    moved = disagreement(source, T_targets_source[0], registration)
    if moved.shift_m > recheck_above_m:
        as_given = measure(source, targets, T_targets_source, every)
        if agrees_as_well(as_given, registration):
            return Disagreement(as_given, 0.0, 0.0, 0.0)
    return moved


def agrees_as_well(as_given: Registration, registration: Registration) -> bool:
    """Whether a frame fits others at its given pose nearly as well as at the registered one.

    The overlaps are not compared: frames from two sides of an object overlap little and still fit. At the
    given pose the overlap must be at least 5 %, and the inlier ratio 90 %.
    """
    close_m = max(AS_CLOSE * registration.residual_m, WELL_BELOW_NOISE * as_given.noise_m)
    return (
        as_given.overlap >= MIN_OVERLAP
        and as_given.inlier_share >= max(ENOUGH_INLIERS, registration.inlier_share - AS_MANY)
        and as_given.residual_m <= close_m
        and not as_given.intensity_correlation < registration.intensity_correlation - AS_SIMILAR
    )


def disagreement(source: FrameMaps, T_target_source: Float64, registration: Registration) -> Disagreement:
    """Return the difference between a registration and the frame's given pose.

    The certain part of the shift follows from the registration's information matrix. It is zero along an
    unobservable direction.

    Args:
        source: the frame.
        T_target_source: (4, 4), by the given poses.
        registration: registration of the frame to the same target.
    """
    off = invert_rigid(T_target_source) @ registration.T_target_source
    points = source[0].points[:, :3].astype(np.float64)
    points = points[:: max(1, len(points) // MOVED_POINTS)]
    shift_m = float(np.median(np.linalg.norm(transform_points(off, points) - points, axis=1)))
    twist = twist_from_rigid(off)
    over_sigma = np.sqrt(max(float(twist @ registration.information @ twist), 1e-12))
    certain_shift_m = shift_m * max(0.0, 1 - SIGMAS / float(over_sigma))
    return Disagreement(registration, shift_m, certain_shift_m, float(rotation_angle_rad(off[:3, :3])))


def residuals_m(source: FrameMaps, target: Level, T_target_source: Float64, every: int) -> Float64:
    """Return absolute point-to-plane distances (m,), metres, of points that lie on a surface of the target.

    A point counts if, at its pixel, the target's depth is within 0.1 m of the point's depth, and its normal
    within 60 degrees. These distances measure a pose error, because they are not truncated at the noise level
    as a registration's residuals are. `target` is the finest level of the other frame.
    """
    points, T = source[0].points[::every], np.ascontiguousarray(T_target_source)
    residuals: Float64 = projective_residuals(
        points, points[:, 3:], target.depth_m, target.normals, target.camera.intrinsics, T, GATE_M, MIN_FACING
    )
    return np.abs(residuals[np.isfinite(residuals)])


def distant_constraints(
    maps: MapCache, T_given: Float64, frames: NDArray[np.int64], every: int
) -> tuple[tuple[Constraint, ...], Float64, float]:
    """Register pairs of distant frames that, by the given poses, see the same place.

    Frames are distant if they are at least a sixth of the recording apart.

    Args:
        maps: maps of the recording, n frames.
        T_given: (n, 4, 4), NaN where a frame has no given pose.
        frames: (k,) indices of the frames to pair, ascending; all have poses.
        every: stride of the points used.

    Returns:
        The m accepted registrations, as loop constraints; for each, the median displacement of frame b's
        points from the given pose, (m,) metres; and the share of the tried pairs that neither register nor
        fit at the given poses, NaN for fewer than eight tried pairs.
    """
    apart = MIN_APART * len(T_given)
    seen = covisible([keyframe_thumbnail(maps[frame]) for frame in frames.tolist()], T_given[frames])
    pairs = [(int(frames[i]), int(frames[j])) for share, i, j in seen if share >= MIN_SHARED_VIEW]
    pairs = sorted(((a, b) for a, b in pairs if b - a >= apart), key=lambda pair: (pair[0] - pair[1], pair))
    constraints, shifts_m, unfit = [], [], 0
    tried = pairs[: min(MAX_PAIRS, int(PAIRS_PER_FRAME * len(T_given)))]
    for a, b in tried:
        T_a_b = invert_rigid(T_given[a]) @ T_given[b]
        checks = (
            check_pose(maps[b], [maps[a]], [T_a_b], coarsest, every, RECHECKED_SHIFT_M) for coarsest in (1, 2)
        )
        accepted = next((each for each in checks if each and is_accepted(each.registration)), None)
        if accepted is not None:
            constraints.append(Constraint(a, b, accepted.registration, "loop"))
            shifts_m.append(accepted.shift_m)
        elif not _fits(measure(maps[b], [maps[a]], [T_a_b], every)):
            unfit += 1
    unmatched = unfit / len(tried) if len(tried) >= MIN_TRIED else np.nan
    return tuple(constraints), np.array(shifts_m), unmatched


def _fits(as_given: Registration) -> bool:
    """Whether a pair fits at the given poses: enough overlap and inliers, and a residual within the noise."""
    return (
        as_given.overlap >= MIN_OVERLAP
        and as_given.inlier_share >= ENOUGH_INLIERS
        and as_given.residual_m <= as_given.noise_m
    )


def distant_residual_m(
    maps: MapCache, constraints: tuple[Constraint, ...], every: int, T_world_camera: Float64 | None = None
) -> float:
    """Return the median, over the constraints, of the median absolute residual of b's points in a, metres.

    Constraints with fewer than 100 residuals, or without poses, are left out; NaN if none is left. Poses are
    (n, 4, 4), NaN where a frame has none; None: the constraints' own are used.
    """
    medians = []
    for each in constraints:
        T_a_b = each.T_a_b
        if T_world_camera is not None:
            T_a_b = invert_rigid(T_world_camera[each.a]) @ T_world_camera[each.b]
        if np.isfinite(T_a_b).all():
            distances_m = residuals_m(maps[each.b], maps[each.a][0], T_a_b, every)
            medians += [float(np.median(distances_m))] if len(distances_m) >= MIN_RESIDUALS else []
    return float(np.median(medians)) if medians else np.nan
