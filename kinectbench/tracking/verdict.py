"""One sentence about a trajectory: what ground truth it is good for, and why. All limits are own rules.

A surface of 5 mm needs poses within about 3 mm, one of 10 mm poses within about 6 mm. No figure here is the
error of the poses, which nobody knows without a truth: each is a sign of it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

Grade = Literal["5 mm", "10 mm", "not good"]
Source = Literal["trust", "refine", "tracked"]
Recommendation = Literal["trust", "refine", "ignore"]

GRADES: tuple[Grade, ...] = ("5 mm", "10 mm", "not good")
MIN_POSES = 3
# What is good enough for 5 mm, and for 10 mm. Shares are of the frames.
TRACKED_SHARE = (0.9, 0.7)
UNCHECKED_SHARE = (0.5, 1.0)
REJECTED_SHARE = (0.1, 0.5)
DEGENERATE_SHARE = (0.05, 0.3)
SHIFT_MM = (5.0, 10.0)
# Between frames far apart in time: each of the two may be off by half of it.
DISTANT_SHIFT_MM = (10.0, 20.0)
# A correction holds the errors of two poses and of the measurement between them.
LOOP_CORRECTION_MM = (5.0, 10.0)
BELIEVED_LOOP_SHARE = (0.8, 0.5)
# Where no loop closes the path it may drift by 3 mm a metre, and nobody would know.
OPEN_PATH_M = (1.5, 4.0)
# Real sensors are warped as well: right poses leave 0.55 times the noise of a simulated Kinect, 0.9 to 1.2
# times that of real ones.
TIMES_NOISE = (2.0, 3.0)
# Of the frames far apart in time that ought to see the same place some are too plain, or hardly see it.
UNMATCHED_SHARE = (0.4, 0.5)
# Refining moves motion capture by its own noise, and drift by more.
REFINED_APART_M = 0.025
# Given poses drift if distant frames disagree by this many times what near ones do, and by 5 mm more.
TIMES_NEAR = 2.0


@dataclass(frozen=True)
class Evidence:
    """What a verdict stands on. None where it is not known.

    Attributes:
        source: where the poses come from.
        frames: of the recording.
        posed: frames with a pose.
        rejected: frames left out because their depth disagrees with the given pose.
        unchecked: frames with a pose that overlap too little with others to tell.
        degenerate: frames with a pose whose depth alone leaves a motion open.
        shift_mm: by how much poses are off, by what is measured between frames: median.
        distant_shift_mm: the same between frames far apart in time, of a given trajectory.
        distant_unmatched: share of those that ought to see the same place and fit nowhere near; NaN: unknown.
        jump_mm: the largest jump of a given trajectory, 0 if there is none.
        loops: places seen again, in the pose graph.
        believed_loops: of these, what the robust kernel left a weight of at least a half.
        loop_correction_mm: how far the believed loops disagree with the poses, rms.
        open_path_m: length of the path that lies outside every believed loop.
        arc_deg: walked around what is looked at.
        held_out_mm: residual of the frames that are no keyframes, median.
        noise_mm: what the sensor's noise alone would cause.
        recommended: what to do with the given trajectory.
    """

    source: Source
    frames: int
    posed: int
    rejected: int
    unchecked: int
    degenerate: int
    shift_mm: float | None
    distant_shift_mm: float | None
    distant_unmatched: float
    jump_mm: float
    loops: int
    believed_loops: int
    loop_correction_mm: float | None
    open_path_m: float
    arc_deg: float | None
    held_out_mm: float | None
    noise_mm: float | None
    recommended: Recommendation | None


def judge(evidence: Evidence) -> tuple[Grade, str]:
    """The grade, and the verdict: the grade in words, a colon, and the figures that it is due to."""
    if evidence.posed < MIN_POSES:
        reasons = [(2, f"{evidence.posed} of {evidence.frames} frames have a pose")]
    else:
        reasons = list(_coverage(evidence))
        reasons += _given(evidence) if evidence.source == "trust" else _tracked(evidence)
    level = max(level for level, _ in reasons)
    why = ", ".join(text for each, text in reasons if each == level)
    grade = GRADES[level]
    words = "not good for ground truth" if level == 2 else f"good for ground truth at {grade}"
    return grade, f"{words}: {why}"


@dataclass(frozen=True)
class Doubts:
    """What speaks against a given trajectory. NaN where it is not known.

    Attributes:
        checked_share: of the frames that have a given pose, those that could be compared with others; 0 to 1.
        rejected_share: of these, those whose depth disagrees; 0 to 1.
        shift_m: by how much frames disagree with those around them, median, metres.
        distant_shift_m: by how much frames far apart in time do, median, metres.
        distant_unmatched: of those that ought to see the same place, the share that fits nowhere near.
        largest_jump_m: metres, 0 if there is none.
        refined_apart_m: how far refined poses are from the given ones, root mean square, metres.
    """

    checked_share: float
    rejected_share: float
    shift_m: float
    distant_shift_m: float
    distant_unmatched: float
    largest_jump_m: float
    refined_apart_m: float


def recommend(doubts: Doubts) -> Recommendation:
    """What to do with a given trajectory.

    Ignore it if most frames disagree, or most cannot be compared. Refine it if a tenth disagrees, if it
    jumps, if it drifts (frames far apart in time disagree by more than twice what near ones do, and 5 mm;
    where that is not known: near ones by more than 5 mm), if many of these fit nowhere, or if refining moves
    it far.
    """
    if doubts.rejected_share > REJECTED_SHARE[1] or doubts.checked_share < 1 - UNCHECKED_SHARE[0]:
        return "ignore"
    plain_m = SHIFT_MM[0] / 1000
    drifts = doubts.distant_shift_m > TIMES_NEAR * doubts.shift_m + plain_m
    if math.isnan(doubts.distant_shift_m):
        drifts = doubts.shift_m > plain_m
    refine = (
        drifts
        or doubts.rejected_share > REJECTED_SHARE[0]
        or doubts.largest_jump_m > 0
        or doubts.distant_unmatched > UNMATCHED_SHARE[0]
        or doubts.refined_apart_m > REFINED_APART_M
    )
    return "refine" if refine else "trust"


def _coverage(e: Evidence) -> Iterator[tuple[int, str]]:
    yield (
        _at_least(e.posed / e.frames, TRACKED_SHARE),
        f"{_percent(e.posed, e.frames)} of the frames have a pose",
    )
    if e.rejected:
        level = _at_most(e.rejected / e.frames, REJECTED_SHARE)
        yield level, f"{_percent(e.rejected, e.frames)} of the frames disagree with their given pose"


def _given(e: Evidence) -> Iterator[tuple[int, str]]:
    if e.shift_mm is None:
        yield 2, "the poses could not be checked, the frames do not overlap"
        return
    yield _at_most(e.shift_mm, SHIFT_MM), f"frames agree within {e.shift_mm:.1f} mm (median)"
    if e.unchecked:
        level = _at_most(e.unchecked / e.posed, UNCHECKED_SHARE)
        yield level, f"{_percent(e.unchecked, e.posed)} of the poses could not be checked"
    if e.degenerate:
        level = min(1, _at_most(e.degenerate / e.posed, DEGENERATE_SHARE))
        yield (
            level,
            f"{_percent(e.degenerate, e.posed)} of the frames show too plain a shape to check all of it",
        )
    if e.distant_shift_mm is not None:
        level = _at_most(e.distant_shift_mm, DISTANT_SHIFT_MM)
        yield level, f"frames far apart in time agree within {e.distant_shift_mm:.1f} mm (median)"
    if e.distant_unmatched > UNMATCHED_SHARE[0]:
        level = _at_most(e.distant_unmatched, UNMATCHED_SHARE)
        share = f"{100 * e.distant_unmatched:.0f} %"
        yield level, f"{share} of the pairs far apart in time that ought to see the same place do not fit"
    if e.jump_mm:
        yield 2, f"the given trajectory jumps by {e.jump_mm:.0f} mm"
    if e.recommended == "refine":
        yield 1, "the given trajectory is worth refining"
    if e.recommended == "ignore":
        yield 2, "the given trajectory is better ignored"


def _tracked(e: Evidence) -> Iterator[tuple[int, str]]:
    if e.held_out_mm is None or e.noise_mm is None:
        yield 2, "no frame could be predicted from others"
    else:
        ratio = e.held_out_mm / e.noise_mm
        text = f"held-out depth is off by {e.held_out_mm:.1f} mm, {ratio:.1f} times the sensor's noise"
        yield _at_most(ratio, TIMES_NOISE), text
    if e.shift_mm is not None:
        yield _at_most(e.shift_mm, SHIFT_MM), f"keyframes agree within {e.shift_mm:.1f} mm (median)"
    if e.degenerate:
        level = _at_most(e.degenerate / e.posed, DEGENERATE_SHARE)
        yield level, f"{_percent(e.degenerate, e.posed)} of the frames show too plain a shape to fix a motion"
    yield from _loops(e)


def _loops(e: Evidence) -> Iterator[tuple[int, str]]:
    if e.loop_correction_mm is not None:
        level = _at_most(e.loop_correction_mm, LOOP_CORRECTION_MM)
        yield level, f"loops close within {e.loop_correction_mm:.1f} mm"
    if e.believed_loops < e.loops:
        level = _at_least(e.believed_loops / e.loops, BELIEVED_LOOP_SHARE)
        yield level, f"{e.loops - e.believed_loops} of {e.loops} loops contradict the rest"
    # A given trajectory that is refined holds the path together by itself.
    if e.source == "tracked":
        yield _open_path(e)


def _open_path(e: Evidence) -> tuple[int, str]:
    level = _at_most(e.open_path_m, OPEN_PATH_M)
    arc = "" if e.arc_deg is None or e.believed_loops else f" (arc of {e.arc_deg:.0f} degrees)"
    path = f"{e.open_path_m:.1f} m of path lie outside any loop{arc}"
    return level, f"{path}, their drift is not known" if level else f"only {path}"


def _at_most(value: float, limits: tuple[float, float]) -> int:
    return 0 if value <= limits[0] else 1 if value <= limits[1] else 2


def _at_least(value: float, limits: tuple[float, float]) -> int:
    return _at_most(-value, (-limits[0], -limits[1]))


def _percent(part: int, whole: int) -> str:
    """Rounded towards the middle: nothing short of all is called 100 %."""
    percent = 100 * part / whole
    return f"{min(max(percent, 0.1), 99.9):.1f} %" if 0 < part < whole else f"{percent:.0f} %"
