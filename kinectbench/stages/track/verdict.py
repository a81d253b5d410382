"""One sentence about a trajectory: what ground truth it is good for, and why. All limits are own rules.

No figure here is the error of the poses, which nobody knows without a truth: each is a sign of it. So a grade
promises no millimetres: recordings whose frames agree within 5 mm were 10 mm off along their path, and more.
"""

import math
from collections.abc import Iterator

from kinectbench.core.artefacts.trajectory import GivenFigures, Grade, Recommendation, TrajectoryHealth

GRADES: tuple[Grade, ...] = ("good", "fair", "not good")
MIN_POSES = 3
# What is good, and what is fair. Shares are of the frames.
TRACKED_SHARE = (0.9, 0.7)
UNCHECKED_SHARE = (0.5, 1.0)
REJECTED_SHARE = (0.1, 0.5)
DEGENERATE_SHARE = (0.05, 0.3)
SHIFT_M = (0.005, 0.010)
# Between distant frames: each of the two may be off by half of it.
DISTANT_SHIFT_M = (0.010, 0.020)
# A correction holds the errors of two poses and of the measurement between them.
LOOP_CORRECTION_M = (0.005, 0.010)
BELIEVED_LOOP_SHARE = (0.8, 0.5)
# Where no loop closes the path it may drift by 3 mm a metre, and nobody would know.
OPEN_PATH_M = (1.5, 4.0)
# Real sensors are warped as well: right poses leave 0.55 times the noise of a simulated Kinect, 0.9 to 1.2
# times that of real ones.
TIMES_NOISE = (2.0, 3.0)
# Of the distant frames that ought to see the same place some are too plain, or hardly see it.
UNMATCHED_SHARE = (0.4, 0.5)
# Refining moves motion capture by its own noise, and drift by more.
REFINED_APART_M = 0.025
# Given poses drift if distant frames disagree by this many times what near ones do, and by 5 mm more.
TIMES_NEAR = 2.0


def judge(health: TrajectoryHealth) -> tuple[Grade, str]:
    """The grade, and the verdict: the grade in words, a colon, and the figures that it is due to.

    Args:
        health: its own grade and verdict do not count.
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
    """What to do with a given trajectory.

    Ignore it if most frames disagree, or most cannot be compared. Refine it if frames agree so badly that
    its poses are not good for ground truth as they are, if a tenth of the frames disagrees, if it jumps, if
    it drifts (distant frames disagree by more than twice what near ones do, and 5 mm; where that is not
    known: near ones by more than 5 mm), if many of these fit nowhere, or if refining moves it far.

    Args:
        given: its figures.
        checked_share: of the frames that have a given pose, those that could be compared with others; 0 to 1.
        rejected_share: of these, those whose depth disagrees; 0 to 1.
    """
    if rejected_share > REJECTED_SHARE[1] or checked_share < 1 - UNCHECKED_SHARE[0]:
        return "ignore"
    near_m, distant_m = given.median_shift_m, given.distant_shift_m
    # Where near frames could not be compared, nothing speaks against a distant shift: all of it is drift.
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
        yield (
            level,
            f"{share} of the pairs of distant frames that ought to see the same place do not fit",
        )
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
    loops, believed = len(health.loops), sum(row.believed for row in health.loops)
    if believed < loops:
        level = _at_least(believed / loops, BELIEVED_LOOP_SHARE)
        yield level, f"{loops - believed} of {loops} loops contradict the rest"
    # A given trajectory that is refined holds the path together by itself.
    if health.source == "tracked" and health.open_path_m is not None:
        level = _at_most(health.open_path_m, OPEN_PATH_M)
        arc = ""
        if health.arc_rad is not None and not believed:
            arc = f" (arc of {round(math.degrees(health.arc_rad), 2):.0f} degrees)"
        path = f"{health.open_path_m:.1f} m of path lie outside any loop{arc}"
        yield level, f"{path}, their drift is not known" if level else f"only {path}"


def _degenerate(health: TrajectoryHealth) -> Iterator[tuple[int, str]]:
    """How many frames with a pose have depth that leaves a motion open, if any."""
    if degenerate := len(set(health.degenerate) - set(health.lost)):
        share = f"{_percent(degenerate, health.tracked)} of the frames"
        yield _at_most(degenerate / health.tracked, DEGENERATE_SHARE), share


def _mm(value_m: float) -> str:
    """Millimetres to a tenth, of what the file holds to a hundredth."""
    return f"{round(1000 * value_m, 2):.1f} mm"


def _at_most(value: float, limits: tuple[float, float]) -> int:
    return 0 if value <= limits[0] else 1 if value <= limits[1] else 2


def _at_least(value: float, limits: tuple[float, float]) -> int:
    return _at_most(-value, (-limits[0], -limits[1]))


def _percent(part: int, whole: int) -> str:
    """Rounded towards the middle: nothing short of all is called 100 %."""
    percent = 100 * part / whole
    return f"{min(max(percent, 0.1), 99.9):.1f} %" if 0 < part < whole else f"{percent:.0f} %"
