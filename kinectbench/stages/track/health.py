"""The health of a trajectory, without ground truth: the contents of health.json."""

from collections import Counter
from collections.abc import Iterable
from collections.abc import Sequence as Rows
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kinectbench.core.artefacts.stored import known
from kinectbench.core.artefacts.trajectory import (
    ConstraintCounts,
    Covisibility,
    FrameHealth,
    FrameState,
    LoopClosure,
    Recommendation,
    RejectedFrame,
    Source,
    TrajectoryHealth,
)
from kinectbench.core.images import relative_blur
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.trajectory.coverage import covered_arc_rad, covisibility, median_middle_depth_m
from kinectbench.core.types import Bools, Float64
from kinectbench.stages.track.check_given import GivenCheck
from kinectbench.stages.track.health_figures import (
    ConstraintCorrection,
    constraint_correction,
    jumps,
    lost_stretches,
    median,
    median_depths_m,
    motion,
    pose_sigma_m,
    sharpness,
)
from kinectbench.stages.track.pose_graph import growth
from kinectbench.stages.track.tracked import Constraint, Tracked
from kinectbench.stages.track.verdict import judge, recommend

# Share of loops that may themselves be wrong; and three standard deviations of the systematic error of a loop
# between equal views, metres. Chosen by hand.
MAY_BE_OFF, OWN_ERROR_M = 0.05, 0.003
# Largest number of keyframes for the covisibility, which is only reported; pairs of more would cost time.
COVISIBLE_KEYFRAMES = 60


def health(
    sequence: Sequence, source: Source, tracked: Tracked, warnings: Rows[str], given: GivenCheck | None = None
) -> TrajectoryHealth:
    """Compute health.json and its verdict; docs/keys.md lists the values, docs/tracking.md defines them.

    Args:
        sequence: the recording, n frames.
        source: where the poses come from: "trust" (the given poses), "refine" (the given poses, corrected),
            or "tracked" (without given poses).
        tracked: the tracker's result, without poses for frames that are left out.
        warnings: warnings for the user, one line each.
        given: the check of the given trajectory, if there is one; required for "trust".
    """
    case = _Case(sequence, source, tracked, given)
    shifts_m = case.shift_m[case.posed & np.isfinite(case.shift_m)]
    steps_m, closed = _steps(case)
    kinds: Counter[str] = Counter(constraint.kind for constraint in tracked.constraints)
    figures = TrajectoryHealth(
        source=source,
        verdict="",
        grade="not good",
        recommended=None if given is None else _recommended(given, case.posed),
        warnings=tuple(warnings),
        frames=len(case.posed),
        tracked=int(case.posed.sum()),
        lost=_indices(case.lost),
        lost_stretches=tuple(lost_stretches(sequence.stamps_ns, case.lost, tracked.reasons)),
        jumps=tuple(jumps(tracked.T_world_camera, sequence.stamps_ns)),
        relocalised=_indices(np.array(case.states) == "relocalised"),
        rejected=tuple(_rejected(case, frame) for frame in _indices(case.rejected)),
        degenerate=_indices(tracked.degenerate),
        unchecked=int((case.posed & ~case.checked).sum()),
        keyframes=tuple(tracked.keyframes.tolist()),
        median_shift_m=known(median(shifts_m)),
        max_shift_m=known(shifts_m.max()) if len(shifts_m) else None,
        median_residual_m=known(median(case.residual_m[case.posed])),
        held_out_residual_m=known(median(case.residual_m[case.held_out])),
        sensor_noise_m=known(median(tracked.noise_m[case.held_out])),
        path_length_m=round(float(steps_m.sum()), 3),
        open_path_m=round(float(steps_m[~closed].sum()), 3),
        open_gap_s=_open_gap_s(case, closed),
        arc_rad=_arc_rad(case),
        ties=ConstraintCounts(**kinds, refused=len(tracked.refused)),
        loop_correction_m=_loop_correction_m(case.loops),
        loops=tuple(_loop(each) for each in case.loops),
        refused_loops=tuple(_loop(each) for each in case.refused_loops),
        given=None if given is None else given.figures,
        readout_s=known(tracked.readout_s) if tracked.readout_s else None,
        color_delay_s=known(tracked.color_delay_s) if tracked.color_delay_s else None,
        covisibility=_covisibility(case),
        per_frame=_frame_rows(case),
    )
    grade, verdict = judge(figures)
    return figures.model_copy(update={"grade": grade, "verdict": verdict})


@dataclass(frozen=True)
class _Case:
    """The inputs of `health`, and intermediate values that it needs several times."""

    sequence: Sequence
    source: Source
    tracked: Tracked
    given: GivenCheck | None

    @cached_property
    def posed(self) -> Bools:
        return has_pose(self.tracked.T_world_camera)

    @cached_property
    def rejected(self) -> Bools:
        return np.zeros_like(self.posed) if self.given is None else self.given.frames.disagrees & ~self.posed

    @property
    def lost(self) -> Bools:
        return ~self.posed & ~self.rejected

    @property
    def states(self) -> list[FrameState]:
        """The state of each frame: tracked, relocalised, lost or rejected."""
        named = zip(self.tracked.states, self.posed, self.rejected, strict=True)
        return [state if posed else "rejected" if rejected else "lost" for state, posed, rejected in named]

    @cached_property
    def depths_m(self) -> dict[int, float]:
        constraints = (*self.tracked.constraints, *self.tracked.refused)
        return median_depths_m(
            self.sequence, [*self.tracked.keyframes.tolist(), *(constraint.b for constraint in constraints)]
        )

    def corrections(self, constraints: tuple[Constraint, ...]) -> list[ConstraintCorrection]:
        T, camera = self.tracked.T_world_camera, self.sequence.camera
        return [
            constraint_correction(constraint, T, camera, self.depths_m[constraint.b])
            for constraint in constraints
        ]

    @cached_property
    def kept(self) -> list[ConstraintCorrection]:
        return self.corrections(self.tracked.constraints)

    @property
    def loops(self) -> list[ConstraintCorrection]:
        return [each for each in self.kept if each.constraint.kind == "loop"]

    @property
    def refused_loops(self) -> list[ConstraintCorrection]:
        return self.corrections(
            tuple(constraint for constraint in self.tracked.refused if constraint.kind == "loop")
        )

    @property
    def trusted(self) -> GivenCheck | None:
        """The check of the given poses if these are the trajectory (source "trust"); else None."""
        return self.given if self.source == "trust" else None

    @cached_property
    def shift_m(self) -> Float64:
        """Possible error of each pose: (n,) metres; NaN where unknown."""
        if self.trusted:
            return self.trusted.frames.shift_m
        return pose_sigma_m(self.sequence, self.tracked, self.kept)

    @property
    def residual_m(self) -> Float64:
        return self.trusted.frames.residual_m if self.trusted else self.tracked.residual_m

    @cached_property
    def held_out(self) -> Bools:
        """Which frames (n,) have a pose but are no keyframes; all posed if none of them has a residual."""
        others = self.posed.copy()
        others[self.tracked.keyframes] = False
        return others if np.isfinite(self.residual_m[others]).any() else self.posed

    @property
    def checked(self) -> Bools:
        return np.isfinite(self.shift_m if self.trusted else self.residual_m)


def _indices(frames: Bools) -> tuple[int, ...]:
    return tuple(np.flatnonzero(frames).tolist())


def _rejected(case: _Case, frame: int) -> RejectedFrame:
    assert case.given is not None
    shift_m, agreeing = case.given.frames.shift_m[frame], case.tracked.inlier_share[frame]
    fit_elsewhere = f", where {100 * agreeing:.0f} % of it fits" if np.isfinite(agreeing) else ""
    return RejectedFrame(
        frame=frame,
        stamp_ns=int(case.sequence.stamps_ns[frame]),
        residual_m=known(case.given.frames.residual_m[frame]),
        shift_m=known(shift_m),
        turn_rad=known(case.given.frames.turn_rad[frame]),
        reason=f"its depth disagrees with its pose by {known(1000 * shift_m, 2)} mm{fit_elsewhere}",
    )


def _frame_rows(case: _Case) -> tuple[FrameHealth, ...]:
    """Return the row of health.json for each frame."""
    tracked, residual_m = case.tracked, case.residual_m
    speed_m_per_s, turn_rad_per_s = motion(tracked.T_world_camera, case.sequence.stamps_ns)
    blurred = relative_blur(sharpness(case.sequence, tracked.sharpness))
    return tuple(
        FrameHealth(
            frame=frame,
            state=state,
            residual_m=known(residual_m[frame]),
            shift_m=known(case.shift_m[frame]),
            inlier_share=known(tracked.inlier_share[frame], 4),
            speed_m_per_s=known(speed_m_per_s[frame], 4),
            turn_rad_per_s=known(turn_rad_per_s[frame], 4),
            blur=known(blurred[frame], 4),
        )
        for frame, state in enumerate(case.states)
    )


def _steps(case: _Case) -> tuple[Float64, Bools]:
    """Return each step's length from pose to pose, (m,) metres, and whether an accepted loop spans it (m,).

    A spanning loop constrains the poses before the step relative to those after it.
    """
    frames = np.flatnonzero(case.posed)
    positions = case.tracked.T_world_camera[frames][:, :3, 3]
    steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    closed = np.zeros(len(steps_m), dtype=bool)
    for each in case.loops:
        if each.accepted:
            first, last = sorted((each.constraint.a, each.constraint.b))
            closed |= (frames[:-1] >= first) & (frames[1:] <= last)
    return steps_m, closed


def _open_gap_s(case: _Case, closed: Bools) -> float | None:
    """Return the seconds of the longest gap of lost frames that no loop spans; None if there is none.

    The pose after such a gap comes from one registration across the gap, which nothing checks.
    """
    frames = np.flatnonzero(case.posed)
    lost_before = np.concatenate([[0], np.cumsum(case.lost)])
    open_gaps = (lost_before[frames[1:]] > lost_before[frames[:-1]]) & ~closed
    elapsed_s = np.diff(case.sequence.stamps_ns[frames]) / 1e9
    return round(float(elapsed_s[open_gaps].max()), 3) if open_gaps.any() else None


def _arc_rad(case: _Case) -> float | None:
    """Return the arc, radians, of the cameras around the point they look at; None if most look elsewhere."""
    frames = np.flatnonzero(case.posed)
    depth_m = median_middle_depth_m(case.sequence, frames)
    return covered_arc_rad(case.tracked.T_world_camera[frames], depth_m)


def _loop_correction_m(loops: Iterable[ConstraintCorrection]) -> float | None:
    """Return the rms correction of the accepted loops, metres; None if there are none.

    A loop between views that hardly overlap may itself be wrong by decimetres. So the largest 5 % of the
    corrections count only if they exceed the expected error of their own loop.
    """
    believed = [each for each in loops if each.accepted and np.isfinite(each.shift_m)]
    believed.sort(key=lambda each: -each.shift_m)
    few = int(MAY_BE_OFF * len(believed))
    counted = [
        each.shift_m
        for rank, each in enumerate(believed)
        if rank >= few or each.shift_m > OWN_ERROR_M * growth(each.constraint)
    ]
    return known(np.sqrt(np.mean(np.square(counted)))) if counted else None


def _loop(each: ConstraintCorrection) -> LoopClosure:
    return LoopClosure(
        a=each.constraint.a,
        b=each.constraint.b,
        residual_m=known(each.constraint.registration.residual_m),
        overlap=known(each.constraint.registration.overlap, 4),
        inlier_share=known(each.constraint.registration.inlier_share, 4),
        correction_m=known(each.shift_m),
        correction_rad=known(each.turn_rad),
        weight=known(each.constraint.weight, 4),
        believed=each.accepted,
    )


def _recommended(given: GivenCheck, posed: Bools) -> Recommendation:
    compared = np.isfinite(given.frames.shift_m)
    checked_share = float(compared.sum() / max(1, (compared | posed).sum()))
    rejected_share = float(given.frames.disagrees[compared].mean()) if compared.any() else 0.0
    return recommend(given.figures, checked_share, rejected_share)


def _covisibility(case: _Case) -> Covisibility:
    keyframes = case.tracked.keyframes[case.posed[case.tracked.keyframes]]
    if len(keyframes):
        chosen = np.linspace(0, len(keyframes) - 1, min(len(keyframes), COVISIBLE_KEYFRAMES))
        keyframes = keyframes[np.rint(chosen).astype(np.int64)]
    shares = covisibility(case.sequence, case.tracked.T_world_camera, keyframes)
    return Covisibility(keyframes=tuple(keyframes.tolist()), share=np.round(shares, 3).tolist())
