"""Checks of a given trajectory: its clock, its pose convention, its fit to the depth, its viewing arc."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.coverage import covered_arc_rad, middle_depth_m
from kinectbench.core.trajectory.pose_convention import PoseConvention
from kinectbench.doctor.covered import MUCH_BETTER, Covered, covered
from kinectbench.doctor.delays import clock_ns
from kinectbench.doctor.depth import depth_quantiles_m, is_likely
from kinectbench.doctor.finding import Finding, camera_line
from kinectbench.doctor.fit import (
    MOST_FITTING_M,
    FramePair,
    choose_pairs,
    disagreements,
    fits,
    frames_of,
    further_conventions,
    likely_conventions,
    pair_residual_m,
)
from kinectbench.doctor.lengths import Lengths, check_lengths, fit_lengths, stated_scale
from kinectbench.doctor.pose_delay import check_trajectory_delay, longest_gap_s, on_clock
from kinectbench.doctor.probe import Probe
from kinectbench.doctor.still import wrong_at_one_place
from kinectbench.stages.ingest.depth_codes import ROTATED_SCALES
from kinectbench.stages.ingest.readers.pose_files import TUM_ROWS, named_like_poses

# Another convention must lower the disagreement, or the residual of poses that fit as given, to this ratio.
BETTER = 0.87
# A convention with more changes must lower the disagreement of a simpler one to this ratio.
SIMPLER = 0.97
# Frame pairs that disagree more in every convention show different surfaces; fewer pairs are not judged.
HOPELESS, LEAST_PAIRS = 0.6, 3
# If no likely convention lowers the disagreement of a static camera to this ratio, further ones are tried.
CLEARLY_BETTER = 0.8
MOVED, NO_BETTER = 0.15, 0.9  # if the camera moved, poses that fit no better than a static one fit badly
# The residual is that of points near a surface, so it decides only if the poses as given have at least this
# share of the other convention's agreement (1 - disagreement). Measured: exact poses 0.9, wrong ones 0.15.
LEAST_SUPPORT = 0.5
# Chosen by hand (noise at 1 m: 0.03): by less a pair tells no convention from a static camera.
APART = 0.01
# Poses prove the depth scale if every other scale fits worse by more than this ratio. Chosen by hand.
OTHER_SCALE = 0.97
FACTORS = {1e9: "seconds read as nanoseconds", 1e6: "1000000 times too small", 1e3: "1000 times too small",
           1e-3: "milliseconds read as seconds", 1e-6: "microseconds read as seconds",
           1e-9: "nanoseconds read as seconds"}  # fmt: skip
# Stamps in another unit span at least this share of the recording. Chosen by hand.
LEAST_SPAN = 0.1
POSED_SHARE = 0.9
SMALL_ARC_DEG = 270.0
OWN_READING = "take `trajectory_reading` out of benchmark.yaml, and inspect again"


@dataclass(frozen=True)
class PoseFit:
    """The fit of given poses to the depth, in the best pose convention.

    Attributes:
        convention: the simplest convention that fits well.
        given: disagreement of the poses as given with the depth (`fit.disagreements`), mean over the pairs.
        best: disagreement of the poses in that convention.
        still: disagreement if the camera is taken to be static.
        moves: whether the poses fit better than a static camera: by disagreement, or clearly over the points
            that both cover.
        residual_m: median point-to-plane residual in that convention, metres.
        fits: whether the residual is within the depth noise.
        proven: whether the poses fit unchanged, clearly better than in any other unit and than a static
            camera, and no other depth scale or focal lengths fit much better. This proves that scale and
            intrinsics are right.
        pairs: the compared pairs of frames.
        T_world_camera: (m, 4, 4), poses of the probe's frames that have one, in that convention.
        arc_rad: the arc around the point that the cameras look at, radians; None if they do not look at one
            point.
        lengths: the factors on depth and focal lengths with which the poses fit best.
    """

    convention: PoseConvention
    given: float
    best: float
    still: float
    moves: bool
    residual_m: float
    fits: bool
    proven: bool
    pairs: tuple[FramePair, ...]
    T_world_camera: NDArray[np.float64]
    arc_rad: float | None
    lengths: Lengths


def posed_pairs(probe: Probe) -> tuple[NDArray[np.float64], tuple[FramePair, ...]] | None:
    """Return the given poses (n, 4, 4) of the probe's n frames, and the pairs of frames to compare.

    The poses are as given, in any convention; a frame without a pose has NaN. The result is None if no poses
    are given, or if there are too few pairs.
    """
    given = probe.recording.given_trajectory
    if given is None or not probe.frames:
        return None
    moved = on_clock(probe, given)
    poses = poses_at(moved, clock_ns(probe, probe.frames), longest_gap_s(moved))
    pairs = choose_pairs(probe, poses)
    return None if len(pairs) < LEAST_PAIRS else (poses, pairs)


def fit_trajectory(probe: Probe) -> PoseFit | None:
    """Find the convention in which the given poses fit the depth.

    Return None if no poses are given, or if too few pairs of frames can be compared.
    """
    posed = posed_pairs(probe)
    if posed is None:
        return None
    poses, pairs = posed
    known = np.isfinite(poses[:, 0, 0])
    standing = np.tile(np.eye(4), (len(poses), 1, 1))
    (unmoved,) = disagreements(pairs, standing[None])
    conventions = list(likely_conventions())
    table = _disagreements(conventions, pairs, poses)
    fitting = _fitting(table, unmoved)
    if not fitting.any() or table[:, fitting].mean(axis=1).min() > CLEARLY_BETTER * unmoved[fitting].mean():
        further = list(further_conventions())
        table = np.concatenate([table, _disagreements(further, pairs, poses)])
        conventions += further
        fitting = _fitting(table, unmoved)
    if fitting.sum() < LEAST_PAIRS:
        return None
    costs = table[:, fitting].mean(axis=1)
    usable = tuple(pair for pair, fits in zip(pairs, fitting, strict=True) if fits)
    points = covered(usable, np.stack([*(each.apply(poses) for each in conventions), standing]))
    still = float(unmoved[fitting].mean())
    chosen = _chosen(conventions, costs, still, points, usable, poses)
    read = conventions[chosen].apply(poses)
    best, residual_m = float(costs[chosen]), pair_residual_m(usable, read)
    scaled = [
        costs[0] < OTHER_SCALE * costs[i] or points.refutes(0, i)
        for i, convention in enumerate(conventions)
        if convention.unit_m != 1
    ]
    moves = bool(best <= NO_BETTER * still or points.refutes(chosen, len(conventions)))
    fit = fits(residual_m, usable)
    lengths = fit_lengths(usable, read) if chosen == 0 else Lengths(1.0, 1.0, 1.0)
    return PoseFit(
        convention=conventions[chosen],
        given=float(costs[0]),
        best=best,
        still=still,
        moves=moves,
        residual_m=residual_m,
        fits=fit,
        proven=fit and chosen == 0 and moves and all(scaled) and not lengths.implausible,
        pairs=usable,
        T_world_camera=read[known],
        arc_rad=covered_arc_rad(read[known], middle_depth_m(frame.depth_m for frame in probe.frames)),
        lengths=lengths,
    )


def _chosen(
    conventions: list[PoseConvention],
    costs: NDArray[np.float64],
    still: float,
    points: Covered,
    pairs: tuple[FramePair, ...],
    poses: NDArray[np.float64],
) -> int:
    """Return the index of the convention in which the poses fit the depth.

    Args:
        conventions: c conventions; the first leaves poses as given.
        costs: (c,) mean disagreement of the pairs in each convention.
        still: mean disagreement if the camera is static.
        points: errors of the pairs' points in each convention, and last of a static camera.
        pairs: the compared pairs of frames.
        poses: (n, 4, 4), poses as given.
    """
    chosen, static = _unrefuted(_simplest(conventions, costs), costs, points), len(conventions)
    read = conventions[chosen].apply(poses)
    left_m = pair_residual_m(pairs, read)
    given_m = pair_residual_m(pairs, poses)
    if not fits(given_m, pairs):
        return chosen
    # Nearly static cameras fit a floor or a wall, too: a convention that is no better shows nothing against
    # poses that fit.
    moves = points.refutes(chosen, static)
    other_unit = conventions[chosen].unit_m != 1
    if other_unit:  # a camera that turns at one place fits a wall, too
        turning = poses.copy()
        turning[:, :3, 3] = 0
        moves &= covered(pairs, np.stack([read, conventions[chosen].apply(turning)])).refutes(0, 1)
    if not moves and (costs[chosen] > NO_BETTER * still or other_unit):
        return 0
    # Disagreement counts surfaces that are hidden in the other frame, too: poses that fit as given stay so,
    # unless the surfaces lie clearly nearer to each other in the other convention, or few points decide.
    enough = 1 - costs[0] >= LEAST_SUPPORT * (1 - costs[chosen]) or not moves
    refuted = points.refutes(chosen, 0) and given_m >= MUCH_BETTER * left_m
    return 0 if enough and not refuted and left_m >= BETTER * given_m else chosen


def _fitting(table: NDArray[np.float64], unmoved: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which pairs (n,) decide the convention: those that fit in one, and separate one from no motion.

    Pairs that fit equally well if the camera is static, in all conventions, are left out if enough others
    remain.

    Args:
        table: (conventions, n), disagreements.
        unmoved: (n,), disagreements if the camera is static.
    """
    fitting = table.min(axis=0) < HOPELESS
    apart = (np.abs(table - unmoved) > APART).any(axis=0) | (unmoved > MOVED)
    return np.asarray(fitting & apart if (fitting & apart).sum() >= LEAST_PAIRS else fitting)


def _unrefuted(chosen: int, costs: NDArray[np.float64], points: Covered) -> int:
    """Return the convention to use instead of `chosen`: the one of lowest cost that refutes it, and so on."""
    left = set(range(len(costs)))
    while better := [i for i in sorted(left) if points.refutes(i, chosen)]:
        left.remove(chosen)
        chosen = min(better, key=lambda i: costs[i])
    return chosen


def shows_motion(fit: PoseFit) -> bool:
    """Whether the poses fit the depth, and turn the camera by more than half its field of view.

    Then the camera moves, even if most of its depth stays the same, as with a bare plane.
    """
    camera, views = fit.pairs[0].camera, fit.T_world_camera[:, :3, 2]
    return fit.fits and bool((views @ views[0]).min() < math.cos(math.atan(camera.width / 2 / camera.fx)))


def fits_no_better(fit: PoseFit) -> bool:
    """Whether the camera moved, but the poses fit the depth no better than a static camera would."""
    return fit.still > MOVED and not fit.moves


def _disagreements(
    conventions: list[PoseConvention], pairs: tuple[FramePair, ...], poses: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the disagreement of poses and depth in each convention for each pair: (conventions, pairs)."""
    paired = np.full_like(poses, np.nan)
    paired[frames_of(pairs)] = poses[frames_of(pairs)]
    return disagreements(pairs, np.stack([convention.apply(paired) for convention in conventions]))


def check_trajectory(probe: Probe, fit: PoseFit | None) -> Iterator[Finding]:
    """Report a given trajectory that is unreadable or whose times, convention, unit or clock are wrong.

    A depth scale or focal lengths that fit better are reported as well. Notes report a missing trajectory, a
    trajectory that could not be checked, and a viewing arc of less than 270 degrees.
    """
    given = probe.recording.given_trajectory
    if probe.recording.trajectory_error:
        advice = "correct it, or `trajectory: ignore`"
        yield Finding("trajectory_unreadable", "stops", probe.recording.trajectory_error, probe.where, advice)
        return
    if given is None:
        beside = named_like_poses(probe.recording.path)
        if beside and any(beside in line for line in probe.recording.warnings):
            beside = ""  # already reported
        what = f"no trajectory: the camera will be tracked{beside}"
        advice = f"write `trajectory.txt` {TUM_ROWS}"
        yield Finding("no_trajectory", "note", what, probe.where, advice if beside else "")
        return
    stamps_ns = probe.recording.stamps_ns
    unit = _time_unit(given.stamps_ns, stamps_ns)
    if unit is not None or given.stamps_ns[0] > stamps_ns[-1] or given.stamps_ns[-1] < stamps_ns[0]:
        yield _other_time(probe, given, unit)
        return
    inside = (stamps_ns >= given.stamps_ns[0]) & (stamps_ns <= given.stamps_ns[-1])
    if inside.mean() < POSED_SHARE:
        what = f"the given trajectory covers the time of {inside.mean():.0%} of the frames only"
        yield Finding("trajectory_short", "warning", what, probe.where, "the others get no pose")
    if fit is None:
        what = "too few frames with poses see the same surface: the given trajectory could not be checked"
        yield Finding("trajectory_unchecked", "note", what, probe.where)
        return
    wrong = not fit.fits if fit.convention.changes else fits_no_better(fit)
    if wrong and (at_one_place := list(wrong_at_one_place(probe))):
        yield from at_one_place
        return
    yield from _convention(probe, fit)
    late = list[Finding]()
    if not fit.convention.changes or fit.fits:
        late = list(check_trajectory_delay(probe, given, fit.convention, fit.pairs))
    # Poses with a clock offset also fit better with other lengths.
    yield from late or check_lengths(probe, fit.lengths)
    yield from _arc(probe, fit)


def _simplest(conventions: list[PoseConvention], costs: NDArray[np.float64]) -> int:
    """Return the index of the convention to use, by costs (n,): 0, the default, if none fits much better.

    Otherwise it is the simplest one among those whose cost is within 3 % of the lowest.
    """
    if costs.min() > BETTER * costs[0]:
        return 0
    good = np.flatnonzero(costs * SIMPLER <= costs.min())
    return int(min(good, key=lambda i: (conventions[i].changes, costs[i])))


def _time_unit(poses_ns: NDArray[np.int64], frames_ns: NDArray[np.int64]) -> float | None:
    """Return the factor (key of FACTORS) from pose stamps to frame stamps; None if none is needed or fits."""
    together = [
        int(((a >= b[0]) & (a <= b[-1])).sum()) for a, b in ((poses_ns, frames_ns), (frames_ns, poses_ns))
    ]
    if min(together) >= LEAST_PAIRS:
        return None
    (first, last), (start, end) = ((float(ns[0]), float(ns[-1])) for ns in (poses_ns, frames_ns))
    for factor in FACTORS:
        share = (last - first) * factor / max(end - start, 1.0)
        # If poses and frames start together, most of their spans must overlap.
        least = LEAST_SPAN if first > end or last < start else POSED_SHARE
        if first * factor <= end and last * factor >= start and least < share < 1 / least:
            return factor
    return None


def _other_time(probe: Probe, given: GivenTrajectory, unit: float | None) -> Finding:
    stamps_ns = probe.recording.stamps_ns
    first_s, last_s = (float(given.stamps_ns[i]) / 1e9 for i in (0, -1))
    start_s, end_s = (float(stamps_ns[i]) / 1e9 for i in (0, -1))
    much = "no" if first_s > end_s or last_s < start_s else "hardly any"
    what = (
        f"the poses ({first_s:.10g} to {last_s:.10g} s) share {much} time with the frames ({start_s:.10g} to "
        f"{end_s:.10g} s)"
    )
    if unit is not None:
        what = f"{what}: their stamps are {FACTORS[unit]}"
        return Finding("trajectory_time_unit", "stops", what, probe.where, f"multiply them by {unit:g}")
    line = camera_line("trajectory_delay_s", probe.recording.trajectory_delay_s + first_s - start_s)
    advice = f"if both begin together, {line}; or `trajectory: ignore`"
    return Finding("trajectory_time", "stops", what, probe.where, advice)


def _convention(probe: Probe, fit: PoseFit) -> Iterator[Finding]:
    if fit.convention.changes and not fit.fits:
        left = "(even so no surface falls on another)"
        if math.isfinite(fit.residual_m):
            left = f"({1000 * fit.residual_m:.0f} mm off, more than noise explains)"
        what = (
            "the given poses fit the depth in no convention that was tried, the nearest being: "
            f"{fit.convention.text()} {left}"
        )
        advice = "look at the poses' convention, the depth's scale and the intrinsics"
        if fit.residual_m <= MOST_FITTING_M:
            advice = "if they are meant so, write them again; else look at depth's scale and the intrinsics"
        yield Finding("trajectory_wrong", "stops", what, probe.where, f"{advice}; or `trajectory: ignore`")
    elif fit.convention.changes:
        what = (
            f"the given poses do not fit the depth as they are, but do if read as: {fit.convention.text()} "
            f"(residual {1000 * fit.residual_m:.1f} mm)"
        )
        line = fit.convention.setting()
        read_so = f"put `camera: {line}` into benchmark.yaml" if line else "write them again so"
        read_so = OWN_READING if probe.recording.trajectory_read else read_so
        name, advice = "trajectory_reading", f"{read_so}, or `trajectory: ignore`"
        if fit.convention.changes == 1 and fit.convention.unit_m != 1:
            _, median_m, far_m = depth_quantiles_m(probe).tolist()
            scale = stated_scale(probe.recording) * fit.convention.unit_m
            at_m = median_m / fit.convention.unit_m
            name = "depth_scale"
            advice = f"or with `depth_scale: {scale:g}`, by which the median of the depth is {at_m:.2f} m"
            by_code = getattr(probe.recording, "depth_code", "plain") == "rotated"
            if is_likely(median_m, far_m) and not (by_code and scale in ROTATED_SCALES):
                name, advice = "trajectory_scale", read_so
        if fit.convention.images == "mirrored":
            name, advice = "mirrored_images", "mirror depth and colour back, and cx with them"
        if fit.convention.images == "y_up":
            advice = (
                "give fy the other sign in intrinsics.json (ICL-NUIM's is negative), and no fy under "
                "`camera:`, or `trajectory: ignore`"
            )
        yield Finding(name, "stops", what, probe.where, advice)
    elif fits_no_better(fit):
        what = (
            "the given poses fit the depth no better than if the camera had stood still, in any "
            "convention that was tried"
        )
        advice = "they are of another recording, camera or clock: `trajectory: ignore`"
        yield Finding("trajectory_wrong", "stops", what, probe.where, advice)


def _arc(probe: Probe, fit: PoseFit) -> Iterator[Finding]:
    arc_rad = fit.arc_rad
    if arc_rad is None:
        what = "the cameras do not look at one thing: there is no arc around an object"
        yield Finding("arc", "note", what, probe.where, "go round one object for a full shape")
    elif math.degrees(arc_rad) < SMALL_ARC_DEG:
        what = f"the cameras see what they look at from an arc of {math.degrees(arc_rad):.0f} degrees"
        yield Finding("arc", "note", what, probe.where, "go round: sides never seen stay unknown")
