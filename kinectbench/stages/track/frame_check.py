"""Check whether each frame's depth agrees with nearby frames under the given poses.

Registration to other frames leaves a correct pose in place and moves a wrong one. Drift moves distant frames
relative to each other, but hardly consecutive frames: see `disagreement.distant_constraints`.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import invert_rigid
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.trajectory.coverage import in_order_of_time
from kinectbench.core.types import Bools, Float64, Int64, Progress
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.track.disagreement import (
    Disagreement,
    agrees_as_well,
    check_pose,
    disagreement,
    residuals_m,
)
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.odometry import is_accepted
from kinectbench.stages.track.outliers import find_outliers
from kinectbench.stages.track.registration import Registration, measure, register, registration_score, search

# Number of frames, evenly spread, that all frames are compared with.
COMPARED_FRAMES = 60
# A frame is checked again if its shift exceeds half the limit and this many times the median shift.
RECHECK_TIMES = 2.0
# A frame that disagrees is compared with this many agreeing frames before it and after it.
NEXT_IN_TIME = 3
# Smallest inlier ratio at any pose; a frame below it shows a different scene.
MIN_INLIERS = 0.65
# Typical quality is this percentile over the frames, minus these margins.
TYPICAL_PERCENTILE, INLIER_SLACK, CORRELATION_SLACK = 10, 0.03, 0.1
# A pose found by search is accepted if its score exceeds that of the given pose by this much.
CLEARLY_BETTER = 0.05


@dataclass(frozen=True)
class FrameCheck:
    """The agreement of a recording's frames under given poses; NaN if unknown.

    Attributes:
        compared: (k,) indices of the reference frames; each frame was compared with the most similar of them.
        shift_m: (n,) median displacement of each frame's points by the motion that makes the frame agree with
            others, metres.
        turn_rad: (n,) rotation angle of that motion, radians.
        residual_m: (n,) median absolute point-to-plane residual at the given pose, metres.
        noise_m: (n,) the residual expected from a Kinect's depth noise at the median depth, metres.
        inlier_share: (n,) inlier ratio of the frame's points after registration.
        degenerate: (n,) bool, the depth has an unobservable direction of motion.
        disagrees: (n,) bool, the certain shift exceeds its limit, or fewer than 65 % of the points fit.
        outlier: (n,) bool, within the limits, but agrees far worse than nearly all frames.
        blind: (n,) bool, the frame has a given pose, but no depth to compare.
        jumps: (frame after the jump, size in metres) of each jump of the trajectory.
    """

    compared: Int64
    shift_m: Float64
    turn_rad: Float64
    residual_m: Float64
    noise_m: Float64
    inlier_share: Float64
    degenerate: Bools
    disagrees: Bools
    outlier: Bools
    blind: Bools
    jumps: tuple[tuple[int, float], ...]


def check_frames(
    maps: MapCache, T_given: Float64, settings: TrackingSettings, progress: Progress | None = None
) -> FrameCheck:
    """Compare every frame that has a pose with frames of similar views.

    A frame that disagrees is compared again with agreeing frames before and after it in time, so that one
    wrong frame does not make its correct neighbours disagree. Agreement with either side is enough, because a
    frame next to a jump agrees with one side only. If the frames are not in the order of time, they are
    compared again with the most similar views instead, and there are no jumps.

    Args:
        maps: maps of the recording, n frames.
        T_given: (n, 4, 4), NaN where a frame has no given pose.
        settings: stride of the points, number of similar views, and the limit for disagreement.
        progress: called with (frames compared, frames with a pose).
    """
    posed = np.flatnonzero(has_pose(T_given))
    compared = posed[evenly(len(posed), COMPARED_FRAMES)]
    checker = _Checker(maps, T_given, settings, compared)
    for done, frame in enumerate(posed.tolist(), start=1):
        checker.compare(frame)
        if done > 1 and checker.ordered:
            checker.step(int(posed[done - 2]), frame)
        if progress:
            progress(done, len(posed))
    checker.recheck(posed)
    return checker.result(posed)


class _Checker:
    """Collects the values of `FrameCheck`, frame by frame."""

    def __init__(self, maps: MapCache, T_given: Float64, settings: TrackingSettings, compared: Int64) -> None:
        n = len(T_given)
        self.maps, self.T, self.compared = maps, T_given, compared
        self.ordered = in_order_of_time(T_given)
        self.every, self.neighbours = settings.check_stride_px, settings.check_neighbours
        self.max_shift_m = settings.max_disagreement_m
        self.found: dict[int, Disagreement] = {}
        self.residual_m, self.noise_m, self.step_m = (np.full(n, np.nan) for _ in range(3))
        self.blind = np.zeros(n, bool)

    def compare(self, frame: int) -> None:
        """Compare a frame with the reference frames whose views are the most similar."""
        self.blind[frame] = len(self.maps[frame][0].points) == 0
        near = nearest_views(self.T, frame, self.compared)[: self.neighbours].tolist()
        checked = self._check(frame, near, coarsest=0) if near else None
        if checked is None:
            return
        self.found[frame] = checked
        self.residual_m[frame] = self._residual_m(frame, near)
        # A residual is the difference of two noisy measurements.
        self.noise_m[frame] = np.sqrt(2) * np.median(self.maps[frame][0].points[:, 6])

    def step(self, before: int, frame: int) -> None:
        """Compare a frame with the previous frame, to find jumps."""
        checked = self._across(before, frame, coarsest=1)
        if checked is not None:
            self.step_m[frame] = checked.certain_shift_m

    def recheck(self, posed: Int64) -> None:
        """Compare again the frames that moved far, fit worse than usual, or were not compared.

        `posed` (k,) are the indices of all frames with a pose.
        """
        # The first check runs at the finest level, which recovers only part of a large shift.
        median_m = np.median([checked.shift_m for checked in self.found.values()] or [0.0])
        recheck_above_m = max(self.max_shift_m / 2, RECHECK_TIMES * median_m)
        wrong = [
            f for f, each in self.found.items() if self._disagrees(each) or each.shift_m > recheck_above_m
        ]
        sound = self._sound(wrong)
        if len(sound) < 2:
            return
        typical = _TypicalQuality.of(
            checked.registration for f, checked in self.found.items() if f not in set(wrong)
        )
        atypical = [f for f, checked in self.found.items() if not typical.includes(checked.registration)]
        missing = np.setdiff1d(posed, list(self.found)).tolist()
        # If most frames are wrong, searching for other poses is pointless.
        few = len(wrong) + len(missing) < 0.5 * len(posed)
        for frame in sorted({*wrong, *atypical, *missing}):
            first = [self.found[frame]] if frame in self.found else []
            sides = self._both_sides(frame, sound)
            answers = sides or first if frame in set(wrong) else sides + first
            answers.sort(key=lambda each: (not typical.includes(each.registration), each.shift_m))
            best = answers[0] if answers else None
            if few and (best is None or not typical.includes(best.registration)):
                best = self._elsewhere(frame, sound, best)
            if best is not None:
                self.found[frame] = best

    def _residual_m(self, frame: int, others: list[int]) -> float:
        """Return a frame's median residual to others at the given poses, metres; NaN without overlap."""
        residuals = np.concatenate(
            [
                residuals_m(self.maps[frame], self.maps[k][0], T, 2 * self.every)
                for k, T in zip(others, self._starts(frame, others), strict=True)
            ]
        )
        return float(np.median(residuals)) if len(residuals) else np.nan

    def _sound(self, wrong: list[int]) -> Int64:
        """Return the reference frames that were compared, without the frames `wrong`."""
        return self.compared[np.isin(self.compared, list(self.found)) & ~np.isin(self.compared, wrong)]

    def _sides(self, frame: int, sound: Int64) -> list[list[int]]:
        """Return the last three of the frames `sound` before a frame, and the first three after it.

        Empty lists are left out. If the frames are not in the order of time, there is one list: the three
        frames with the most similar views.
        """
        sides = [sound[sound < frame][-NEXT_IN_TIME:], sound[sound > frame][:NEXT_IN_TIME]]
        if not self.ordered:
            sides = [nearest_views(self.T, frame, sound)[:NEXT_IN_TIME]]
        return [side.tolist() for side in sides if len(side)]

    def _both_sides(self, frame: int, sound: Int64) -> list[Disagreement]:
        """Register a frame to the frames of each list of `_sides`; leave out registrations that fail."""
        checks = [self._check(frame, side, coarsest=2) for side in self._sides(frame, sound)]
        return [each for each in checks if each is not None]

    def outlier(self, disagrees: Bools) -> Bools:
        """Return which frames (n,) are within the limits, but agree far worse than nearly all others.

        The residual of each candidate is measured again: once to the frames before it, once to those after.
        The smaller value replaces `residual_m`: a wrong frame makes its correct neighbours look worse,
        and next to a jump only one side agrees. Without common points on either side, the old value stays.
        """
        odd = find_outliers(self.residual_m / self.noise_m, ~disagrees)
        sound = self._sound(np.flatnonzero(odd | disagrees).tolist())
        for frame in np.flatnonzero(odd).tolist():
            again_m = [self._residual_m(frame, side) for side in self._sides(frame, sound)]
            known_m = [each for each in again_m if np.isfinite(each)]
            self.residual_m[frame] = min(known_m, default=self.residual_m[frame])
        return odd & find_outliers(self.residual_m / self.noise_m, ~disagrees)

    def _elsewhere(self, frame: int, sound: Int64, best: Disagreement | None) -> Disagreement | None:
        """Search for a pose at which a frame fits clearly better than at its given pose; else return `best`.

        The fit is to one of the frames `sound`: the nearest in time or, if the frames are not in the order of
        time, the one with the most similar view. The search starts at the frame's given pose; in the order of
        time, it also starts at the pose of the other frame. `best` is the result so far.
        """
        others = sound[sound != frame]
        if self.ordered:
            near = int(others[np.argmin(np.abs(others - frame))])
        else:
            near = int(nearest_views(self.T, frame, sound)[0])
        source, T_given = self.maps[frame], self._starts(frame, [near])[0]
        starts = (T_given, np.eye(4)) if self.ordered else (T_given,)
        best_fit = max((search(source, self.maps[near], T) for T in starts), key=registration_score)
        if agrees_as_well(measure(source, [self.maps[near]], [T_given], self.every), best_fit):
            return best
        as_given = self._check(frame, [near], coarsest=1)
        known = 0.0 if as_given is None else registration_score(as_given.registration)
        return (
            disagreement(source, T_given, best_fit)
            if registration_score(best_fit) > known + CLEARLY_BETTER
            else best
        )

    def _across(self, before: int, frame: int, coarsest: int) -> Disagreement | None:
        """Register a frame to an earlier frame, from its given pose or, if that fails, from zero motion."""
        checked = self._check(frame, [before], coarsest)
        if checked is not None and is_accepted(checked.registration):
            return checked
        source, T_given = self.maps[frame], self._starts(frame, [before])[0]
        still = register(source, [self.maps[before]], [np.eye(4)], 2, every=self.every)
        return disagreement(source, T_given, still) if is_accepted(still) else checked

    def _check(self, frame: int, others: list[int], coarsest: int) -> Disagreement | None:
        targets = [self.maps[k] for k in others]
        # With several targets half of the points are enough.
        every = self.every if len(others) == 1 else 2 * self.every
        starts = self._starts(frame, others)
        return check_pose(self.maps[frame], targets, starts, coarsest, every, self.max_shift_m)

    def _starts(self, frame: int, others: list[int]) -> list[Float64]:
        return [invert_rigid(self.T[k]) @ self.T[frame] for k in others]

    def _disagrees(self, checked: Disagreement) -> bool:
        return checked.certain_shift_m > self.max_shift_m or checked.registration.inlier_share < MIN_INLIERS

    def jumps(self, kept: Int64) -> tuple[tuple[int, float], ...]:
        """Return the jumps (frame after the jump, size in metres) along the frames `kept` (k,).

        A jump is a single wrong step that registrations across it confirm. Two wrong steps in a row are no
        jump: they come from one wrong frame.
        """
        rows = np.arange(1, len(kept))
        off = np.concatenate([[False], self.step_m[kept[rows]] > self.max_shift_m, [False]])
        steps = []
        for row in rows[off[1:-1] & ~off[:-2] & ~off[2:]].tolist():
            across = [
                (a, b)
                for a, b in ((row - 1, row), (row - 2, row), (row - 1, row + 1))
                if a >= 0 and b < len(kept)
            ]
            checks = [self._across(int(kept[a]), int(kept[b]), coarsest=2) for a, b in across]
            shifts_m = [0.0 if each is None else each.certain_shift_m for each in checks]
            if min(shifts_m) > self.max_shift_m:
                steps.append((int(kept[row]), float(np.median(shifts_m))))
        return tuple(steps)

    def result(self, posed: Int64) -> FrameCheck:
        """Find outliers and jumps, and assemble the result for all n frames.

        Args:
            posed: (k,) indices of the frames with a pose; jumps are sought along those that agree.
        """
        n = len(self.T)
        shift_m, turn_rad, inlier_share = (np.full(n, np.nan) for _ in range(3))
        degenerate, disagrees = np.zeros(n, bool), np.zeros(n, bool)
        for frame, checked in self.found.items():
            shift_m[frame], turn_rad[frame] = checked.shift_m, checked.turn_rad
            inlier_share[frame] = checked.registration.inlier_share
            degenerate[frame], disagrees[frame] = checked.registration.degenerate, self._disagrees(checked)
        outlier = self.outlier(disagrees)
        return FrameCheck(
            compared=self.compared,
            shift_m=shift_m,
            turn_rad=turn_rad,
            residual_m=self.residual_m,
            noise_m=self.noise_m,
            inlier_share=inlier_share,
            degenerate=degenerate,
            disagrees=disagrees,
            outlier=outlier,
            blind=self.blind,
            jumps=self.jumps(posed[~(disagrees | outlier)[posed]]),
        )


@dataclass(frozen=True)
class _TypicalQuality:
    """The inlier ratio and the intensity correlation that nearly all registrations of the recording reach."""

    inlier_share: float
    correlation: float

    @classmethod
    def of(cls, registrations: Iterable[Registration]) -> "_TypicalQuality":
        """Return the quality that nine of ten registrations reach, minus a margin."""
        figures = [(each.inlier_share, each.intensity_correlation) for each in registrations]
        inliers, correlation = np.array(figures or [(0.0, np.nan)]).T
        known = correlation[np.isfinite(correlation)]
        return cls(
            float(np.percentile(inliers, TYPICAL_PERCENTILE)) - INLIER_SLACK,
            float(np.percentile(known, TYPICAL_PERCENTILE)) - CORRELATION_SLACK if len(known) else -1.0,
        )

    def includes(self, registration: Registration) -> bool:
        return (
            registration.inlier_share >= self.inlier_share
            and not registration.intensity_correlation < self.correlation
        )


def nearest_views(T: Float64, frame: int, among: Int64) -> Int64:
    """Return the frames `among` (k,), without `frame`, the most similar view first.

    The dissimilarity of two views is the distance of the cameras, metres, plus the angle between their
    optical axes, radians.
    """
    others = among[among != frame]
    apart_m = np.linalg.norm(T[others, :3, 3] - T[frame, :3, 3], axis=1)
    cosine = T[others, :3, 2] @ T[frame, :3, 2]
    order = np.argsort(apart_m + np.arccos(np.clip(cosine, -1, 1)), kind="stable")
    return np.asarray(others[order])
