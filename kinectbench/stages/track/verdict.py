"""Grade a trajectory as a basis for ground truth, with one sentence of reasons.

Without ground truth the error of the poses is unknown, and each statistic only hints at it. A grade promises
no accuracy in millimetres: recordings whose frames agree within 5 mm were off by 10 mm and more along their
path. All limits were chosen by hand.
"""

import math
from collections.abc import Iterator
from itertools import pairwise

from kinectbench.core.artefacts.trajectory import (
    GivenFigures,
    Grade,
    LoopClosure,
    Recommendation,
    TrajectoryHealth,
)

GRADES: tuple[Grade, ...] = ("good", "fair", "not good")
# Fewer poses cannot be graded.
MIN_POSES = 3
# Limits of good and of fair. Ratios are relative to the number of frames.
TRACKED_SHARE = (0.9, 0.7)
UNCHECKED_SHARE = (0.5, 1.0)  # no other frame overlaps enough to check the pose
REJECTED_SHARE = (0.1, 0.5)  # the depth contradicts the given pose
DEGENERATE_SHARE = (0.05, 0.3)  # a motion is not observable
SHIFT_M = (0.005, 0.010)  # median over the frames
# Between distant frames: either frame may contribute half of it.
DISTANT_SHIFT_M = (0.010, 0.020)
# A correction contains the errors of two poses and of the measurement between them.
LOOP_CORRECTION_M = (0.005, 0.010)
# A single loop that contradicts the rest may be wrong; many such loops mean that the rest is wrong.
ACCEPTED_LOOP_RATIO = (0.8, 0.5)
# Without loop closures a path may drift by 3 mm a metre, and no figure would show it.
OPEN_PATH_M = (1.5, 4.0)
# A single registration joins both sides of such a gap, and nothing checks it. Of 70 simulated scans two have
# gaps of 2.3 and 3.0 s, and are 0.8 m off; one with a gap of 1.0 s is 24 mm off. A visitor walks half a metre
# in 2 s.
OPEN_GAP_S = (0.5, 2.0)
# Real sensors have depth distortion as well: with correct poses the residual is 0.55 times the noise of a
# simulated Kinect, and 0.9 to 1.2 times that of real ones.
TIMES_NOISE = (2.0, 3.0)
# Some distant frames that should see the same place have too little structure, or hardly overlap.
UNMATCHED_SHARE = (0.4, 0.5)
# Refinement moves motion-capture poses by their own noise, and drifting poses by more.
REFINED_APART_M = 0.025
# Limits for consecutive keyframes that overlap and agree well, but are placed this far from their
# registration: of 70 simulated scans only one, which was 1 m off, has such a pair.
TORN_OVERLAP, TORN_INLIERS, TORN_M = 0.5, 0.95, 0.1
# Given poses drift if distant frames disagree by this many times as much as near frames, plus 5 mm.
TIMES_NEAR = 2.0


def judge(health: TrajectoryHealth) -> tuple[Grade, str]:
    """Return the grade, and the verdict: a line with the grade and the statistics that determined it.

    Args:
        health: the statistics; its own grade and verdict are ignored.
    """
    if health.tracked < MIN_POSES:
        reasons = [(2, f"{health.tracked} of {health.frames} frames have a pose")]
    else:
        reasons = list(_coverage(health))
        reasons += _given(health) if health.source == "trust" else _tracked(health)
    level = max(level for level, _ in reasons)
    why = ", ".join(text for each, text in reasons if each == level)
    grade = GRADES[level]
    return grade, f"{grade} for ground truth: {why}"


def recommend(given: GivenFigures, checked_share: float, rejected_share: float) -> Recommendation:
    """Recommend how to use a given trajectory.

    Ignore it if most frames disagree, or most cannot be compared. Refine it if near frames disagree by more
    than 10 mm, if more than a tenth of the frames disagrees, if it jumps, if it drifts, if many distant
    frames do not fit, or if refinement moves it by more than 25 mm. It drifts if distant frames disagree by
    more than twice as much as near frames plus 5 mm. If the distant disagreement is unknown, it drifts if
    near frames disagree by more than 5 mm. Otherwise trust it.

    Args:
        given: statistics of the given trajectory's check.
        checked_share: share of the frames with a given pose that could be compared with others; 0 to 1.
        rejected_share: share of the compared frames whose depth disagrees; 0 to 1.
    """
    if rejected_share > REJECTED_SHARE[1] or checked_share < 1 - UNCHECKED_SHARE[0]:
        return "ignore"
    near_m, distant_m = given.median_shift_m, given.distant_shift_m
    # If near frames could not be compared, the whole distant shift counts as drift.
    drift_m = near_m if distant_m is None else distant_m - TIMES_NEAR * (near_m or 0.0)
    signs = (
        (near_m, SHIFT_M[1]),
        (drift_m, SHIFT_M[0]),
        (rejected_share, REJECTED_SHARE[0]),
        (given.largest_jump_m, 0.0),
        (given.distant_unmatched, UNMATCHED_SHARE[0]),
        (given.refined_apart_m, REFINED_APART_M),
    )
    return "refine" if any(value is not None and value > limit for value, limit in signs) else "trust"


def _coverage(health: TrajectoryHealth) -> Iterator[tuple[int, str]]:
    yield (
        _at_least(health.tracked / health.frames, TRACKED_SHARE),
        f"{_percent(health.tracked, health.frames)} of the frames have a pose",
    )
    if rejected := len(health.rejected):
        level = _at_most(rejected / health.frames, REJECTED_SHARE)
        yield level, f"{_percent(rejected, health.frames)} of the frames disagree with their given pose"


def _given(health: TrajectoryHealth) -> Iterator[tuple[int, str]]:
    if health.median_shift_m is None:
        yield 2, "the poses could not be checked, the frames do not overlap"
        return
    level = _at_most(health.median_shift_m, SHIFT_M)
    yield level, f"frames agree within {_mm(health.median_shift_m)} (median)"
    if health.unchecked:
        level = _at_most(health.unchecked / health.tracked, UNCHECKED_SHARE)
        yield level, f"{_percent(health.unchecked, health.tracked)} of the poses could not be checked"
    for level, frames in _degenerate(health):
        yield min(1, level), f"{frames} show too plain a shape to check all of it"
    if health.given is not None:
        yield from _distant(health.given)
    if health.recommended == "refine":
        yield 1, "the given trajectory is worth refining"
    if health.recommended == "ignore":
        yield 2, "the given trajectory is better ignored"


def _distant(given: GivenFigures) -> Iterator[tuple[int, str]]:
    if given.distant_shift_m is not None:
        level = _at_most(given.distant_shift_m, DISTANT_SHIFT_M)
        yield level, f"distant frames agree within {_mm(given.distant_shift_m)} (median)"
    if given.distant_unmatched is not None and given.distant_unmatched > UNMATCHED_SHARE[0]:
        level = _at_most(given.distant_unmatched, UNMATCHED_SHARE)
        share = f"{100 * given.distant_unmatched:.0f} %"
        yield (level, f"{share} of the pairs of distant frames that ought to see the same place do not fit")
    if given.largest_jump_m:
        yield 2, f"the given trajectory jumps by {1000 * given.largest_jump_m:.0f} mm"


def _tracked(health: TrajectoryHealth) -> Iterator[tuple[int, str]]:
    if health.held_out_residual_m is None or health.sensor_noise_m is None:
        yield 2, "no frame could be predicted from others"
    else:
        ratio = health.held_out_residual_m / health.sensor_noise_m
        off = f"held-out depth is off by {_mm(health.held_out_residual_m)}"
        yield _at_most(ratio, TIMES_NOISE), f"{off}, {ratio:.1f} times the sensor's noise"
    if health.median_shift_m is not None:
        level = _at_most(health.median_shift_m, SHIFT_M)
        yield level, f"keyframes agree within {_mm(health.median_shift_m)} (median)"
    for level, frames in _degenerate(health):
        yield level, f"{frames} show too plain a shape to fix a motion"
    yield from _loops(health)


def _loops(health: TrajectoryHealth) -> Iterator[tuple[int, str]]:
    if health.loop_correction_m is not None:
        level = _at_most(health.loop_correction_m, LOOP_CORRECTION_M)
        yield level, f"loops close within {_mm(health.loop_correction_m)}"
    loops, accepted = len(health.loops), sum(row.believed for row in health.loops)
    if accepted < loops:
        level = _at_least(accepted / loops, ACCEPTED_LOOP_RATIO)
        yield level, f"{loops - accepted} of {loops} loops contradict the rest"
    # Given poses may jump from view to view.
    for jump in health.jumps if health.source == "tracked" else ():
        frames = f"between frames {jump.from_frame} and {jump.to_frame}"
        times = f"{jump.times_as_fast:.1f} times as fast as elsewhere"
        yield 2, f"{frames} the camera would move by {jump.moved_m:.1f} m, {times}"
    for row in _torn(health):
        off = f"their poses are {row.correction_m:.1f} m off"
        yield 2, f"frames {row.a} and {row.b} fit each other, but {off}"
    # A given trajectory that is refined also constrains the path.
    if health.source == "tracked" and health.open_path_m is not None:
        level = _at_most(health.open_path_m, OPEN_PATH_M)
        arc = ""
        if health.arc_rad is not None and not accepted:
            arc = f" (arc of {round(math.degrees(health.arc_rad), 2):.0f} degrees)"
        path = f"{health.open_path_m:.1f} m of path lie outside any loop{arc}"
        yield level, f"{path}, their drift is not known" if level else f"only {path}"
    if health.source == "tracked" and health.open_gap_s is not None:
        level = _at_most(health.open_gap_s, OPEN_GAP_S)
        gap = f"the camera is lost for {health.open_gap_s:.1f} s"
        yield level, f"{gap}, and no loop joins the path before and after"


def _torn(health: TrajectoryHealth) -> Iterator[LoopClosure]:
    """Yield refused registrations of consecutive keyframes that fit well but contradict the final poses."""
    following = set(pairwise(health.keyframes))
    for row in health.refused_loops:
        fits = (row.overlap or 0) >= TORN_OVERLAP and (row.inlier_share or 0) >= TORN_INLIERS
        if (row.a, row.b) in following and fits and (row.correction_m or 0) > TORN_M:
            yield row


def _degenerate(health: TrajectoryHealth) -> Iterator[tuple[int, str]]:
    """Yield severity (0 to 2) and share, in words, of the frames whose depth has an unobservable direction.

    Nothing is yielded if there are none. Only frames with a pose count.
    """
    without_pose = {*health.lost, *(each.frame for each in health.rejected)}
    if degenerate := len(set(health.degenerate) - without_pose):
        share = f"{_percent(degenerate, health.tracked)} of the frames"
        yield _at_most(degenerate / health.tracked, DEGENERATE_SHARE), share


def _mm(value_m: float) -> str:
    """Format metres as millimetres with one decimal, after rounding to two as in health.json."""
    return f"{round(1000 * value_m, 2):.1f} mm"


def _at_most(value: float, limits: tuple[float, float]) -> int:
    return 0 if value <= limits[0] else 1 if value <= limits[1] else 2


def _at_least(value: float, limits: tuple[float, float]) -> int:
    return _at_most(-value, (-limits[0], -limits[1]))


def _percent(part: int, whole: int) -> str:
    """Format a ratio in percent; 0 % and 100 % mean exactly none and all."""
    percent = 100 * part / whole
    return f"{min(max(percent, 0.1), 99.9):.1f} %" if 0 < part < whole else f"{percent:.0f} %"
