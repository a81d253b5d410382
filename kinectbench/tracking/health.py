"""The health of a trajectory without a truth: the figures of health.json, all plain JSON values."""

from collections import Counter
from collections.abc import Sequence as Rows
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.sequence import Sequence
from kinectbench.tracking.corrections import TieCorrection, median_depths_m, pose_sigma_m, tie_correction
from kinectbench.tracking.coverage import covered_arc_rad, covisibility
from kinectbench.tracking.frame_health import frame_rows, lost_stretches, sharpness
from kinectbench.tracking.json_figures import degrees, median, mm, share
from kinectbench.tracking.tracked import Tie, Tracked
from kinectbench.tracking.verdict import Doubts, Evidence, Recommendation, Source, judge, recommend

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

COVISIBLE_KEYFRAMES = 60


@dataclass(frozen=True)
class GivenCheck:
    """How a given trajectory agrees with the depth; NaN where it is not known.

    Attributes:
        shift_m: (n,) how far each frame's points would move to agree with others, metres.
        turn_rad: (n,) by how much the camera would turn, radians.
        residual_m: (n,) median absolute point-to-plane residual as given, metres.
        rejected: (n,) bool, frames whose depth disagrees with the given pose.
        distant_shift_m: how far the points of frames far apart in time would move to agree, median, metres.
        distant_unmatched: share of such frames that ought to see the same place and fit nowhere near.
        largest_jump_m: of those that are named; 0 if there is none.
        given_distant_residual_m: point-to-plane residual between such frames with the given poses, metres.
        refined_distant_residual_m: the same with refined poses; where none are made, as registered in pairs.
        refined_apart_m: how far refined poses are from the given ones once both worlds are aligned, root mean
            square, metres; NaN where none are made.
    """

    shift_m: Float64
    turn_rad: Float64
    residual_m: Float64
    rejected: Bool
    distant_shift_m: float
    given_distant_residual_m: float
    refined_distant_residual_m: float
    distant_unmatched: float = np.nan
    largest_jump_m: float = 0.0
    refined_apart_m: float = np.nan


def health(
    sequence: Sequence,
    source: Source,
    tracked: Tracked,
    warnings: Rows[str],
    given: GivenCheck | None = None,
) -> dict[str, Any]:
    """The figures of health.json, and a verdict; docs/tracking.md says what each key is.

    Args:
        sequence: the recording, n frames.
        source: trust: the poses are the given ones; refine: these, corrected; tracked: found without.
        tracked: what the tracker found. Frames that are left out have no pose in it.
        warnings: for people, one line each.
        given: of the given trajectory, if there is one; trust needs it.
    """
    case = _Case(sequence, source, tracked, given)
    figures = {**_frame_figures(case), **_residual_figures(case), **_path_figures(case), **_tie_figures(case)}
    recommended = _recommended(case)
    grade, verdict = judge(_evidence(case, figures, recommended))
    return {
        "format_version": 1,
        "source": source,
        "verdict": verdict,
        "grade": grade,
        "recommended": recommended,
        "warnings": list(warnings),
        **figures,
        "given": None if given is None else _given_figures(given),
        "covisibility": _covisibility(case),
        "per_frame": frame_rows(
            sequence.stamps_ns,
            tracked,
            case.states,
            shift_m=case.shift_m,
            residual_m=case.residual_m,
            sharpness=sharpness(sequence, tracked.sharpness),
        ),
    }


@dataclass(frozen=True)
class _Case:
    """What is judged, and what several figures are taken from."""

    sequence: Sequence
    source: Source
    tracked: Tracked
    given: GivenCheck | None

    @cached_property
    def posed(self) -> Bool:
        return np.asarray(np.isfinite(self.tracked.T_world_camera).all(axis=(1, 2)))

    @cached_property
    def rejected(self) -> Bool:
        return np.zeros_like(self.posed) if self.given is None else self.given.rejected & ~self.posed

    @property
    def lost(self) -> Bool:
        return ~self.posed & ~self.rejected

    @property
    def states(self) -> list[str]:
        """Per frame: tracked, relocalised, lost or rejected."""
        named = zip(self.tracked.states, self.posed, self.rejected, strict=True)
        return [state if posed else "rejected" if rejected else "lost" for state, posed, rejected in named]

    @cached_property
    def depths_m(self) -> dict[int, float]:
        ties = (*self.tracked.ties, *self.tracked.refused)
        return median_depths_m(self.sequence, [*self.tracked.keyframes.tolist(), *(tie.b for tie in ties)])

    def corrections(self, ties: tuple[Tie, ...]) -> list[TieCorrection]:
        T, camera = self.tracked.T_world_camera, self.sequence.camera
        return [tie_correction(tie, T, camera, self.depths_m[tie.b]) for tie in ties]

    @cached_property
    def kept(self) -> list[TieCorrection]:
        return self.corrections(self.tracked.ties)

    @property
    def loops(self) -> list[TieCorrection]:
        return [each for each in self.kept if each.tie.kind == "loop"]

    @property
    def trusted(self) -> GivenCheck | None:
        """The check that speaks for the poses: only if they are the given ones."""
        return self.given if self.source == "trust" else None

    @cached_property
    def shift_m(self) -> Float64:
        """(n,) by how much each pose may be off; NaN where unknown."""
        return self.trusted.shift_m if self.trusted else pose_sigma_m(self.sequence, self.tracked, self.kept)

    @property
    def residual_m(self) -> Float64:
        return self.trusted.residual_m if self.trusted else self.tracked.residual_m

    @property
    def checked(self) -> Bool:
        return np.isfinite(self.shift_m if self.trusted else self.residual_m)


def _evidence(case: _Case, figures: dict[str, Any], recommended: Recommendation | None) -> Evidence:
    loops = figures["loops"]
    return Evidence(
        source=case.source,
        frames=figures["frames"],
        posed=figures["tracked"],
        rejected=len(figures["rejected"]),
        unchecked=figures["unchecked"],
        degenerate=len(set(figures["degenerate"]) - set(figures["lost"])),
        shift_mm=figures["median_shift_mm"],
        distant_shift_mm=mm(case.given.distant_shift_m) if case.given else None,
        distant_unmatched=case.given.distant_unmatched if case.given else np.nan,
        jump_mm=1000 * case.given.largest_jump_m if case.given else 0.0,
        loops=len(loops),
        believed_loops=sum(row["believed"] for row in loops),
        loop_correction_mm=figures["loop_correction_mm"],
        open_path_m=figures["open_path_m"],
        arc_deg=figures["arc_deg"],
        held_out_mm=figures["held_out_residual_mm"],
        noise_mm=figures["sensor_noise_mm"],
        recommended=recommended,
    )


def _frame_figures(case: _Case) -> dict[str, Any]:
    return {
        "frames": len(case.posed),
        "tracked": int(case.posed.sum()),
        "lost": np.flatnonzero(case.lost).tolist(),
        "lost_stretches": lost_stretches(case.sequence.stamps_ns, case.lost, case.tracked.reasons),
        "relocalised": [f for f, state in enumerate(case.states) if state == "relocalised"],
        "rejected": [_rejected_row(case, f) for f in np.flatnonzero(case.rejected).tolist()],
        "degenerate": np.flatnonzero(case.tracked.degenerate).tolist(),
        "unchecked": int((case.posed & ~case.checked).sum()),
        "keyframes": case.tracked.keyframes.tolist(),
    }


def _rejected_row(case: _Case, frame: int) -> dict[str, Any]:
    assert case.given is not None
    shift_mm, agreeing = mm(case.given.shift_m[frame]), case.tracked.inlier_share[frame]
    there = f", where {100 * agreeing:.0f} % of it fits" if np.isfinite(agreeing) else ""
    return {
        "frame": frame,
        "stamp_ns": int(case.sequence.stamps_ns[frame]),
        "residual_mm": mm(case.given.residual_m[frame]),
        "shift_mm": shift_mm,
        "turn_deg": degrees(case.given.turn_rad[frame]),
        "reason": f"its depth disagrees with its pose by {shift_mm} mm{there}",
    }


def _residual_figures(case: _Case) -> dict[str, Any]:
    """Residuals of the frames with a pose. Keyframes take part in the model that others are compared with."""
    others = case.posed.copy()
    others[case.tracked.keyframes] = False
    held_out = others if np.isfinite(case.residual_m[others]).any() else case.posed
    shifts_m = case.shift_m[case.posed & np.isfinite(case.shift_m)]
    return {
        "median_shift_mm": mm(median(shifts_m)),
        "max_shift_mm": mm(shifts_m.max()) if len(shifts_m) else None,
        "median_residual_mm": mm(median(case.residual_m[case.posed])),
        "held_out_residual_mm": mm(median(case.residual_m[held_out])),
        "sensor_noise_mm": mm(median(case.tracked.noise_m[held_out])),
    }


def _path_figures(case: _Case) -> dict[str, Any]:
    frames = np.flatnonzero(case.posed)
    T = case.tracked.T_world_camera[frames]
    steps_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    # A step is closed if a believed loop holds together what lies before and behind it.
    closed = np.zeros(len(steps_m), dtype=bool)
    for each in case.loops:
        if each.believed:
            first, last = sorted((each.tie.a, each.tie.b))
            closed |= (frames[:-1] >= first) & (frames[1:] <= last)
    arc_rad = covered_arc_rad(T)
    return {
        "path_length_m": round(float(steps_m.sum()), 3),
        "open_path_m": round(float(steps_m[~closed].sum()), 3),
        "arc_deg": None if arc_rad is None else degrees(arc_rad),
    }


def _tie_figures(case: _Case) -> dict[str, Any]:
    kinds = Counter(tie.kind for tie in case.tracked.ties)
    believed_m = [each.shift_m for each in case.loops if each.believed and np.isfinite(each.shift_m)]
    refused = case.corrections(tuple(tie for tie in case.tracked.refused if tie.kind == "loop"))
    return {
        "ties": {kind: kinds[kind] for kind in ("odometry", "covisible", "loop")}
        | {"refused": len(case.tracked.refused)},
        "loop_correction_mm": mm(np.sqrt(np.mean(np.square(believed_m)))) if believed_m else None,
        "loops": [_tie_row(each) for each in case.loops],
        "refused_loops": [_tie_row(each) for each in refused],
    }


def _tie_row(each: TieCorrection) -> dict[str, Any]:
    return {
        "a": each.tie.a,
        "b": each.tie.b,
        "residual_mm": mm(each.tie.residual_m),
        "overlap": share(each.tie.overlap),
        "inlier_share": share(each.tie.inlier_share),
        "correction_mm": mm(each.shift_m),
        "correction_deg": degrees(each.turn_rad),
        "weight": share(each.tie.weight),
        "believed": each.believed,
    }


def _recommended(case: _Case) -> Recommendation | None:
    given = case.given
    if given is None:
        return None
    known = np.isfinite(given.shift_m)
    return recommend(
        Doubts(
            checked_share=float(known.sum() / max(1, (known | case.posed).sum())),
            rejected_share=float(given.rejected[known].mean()) if known.any() else 0.0,
            shift_m=median(given.shift_m),
            distant_shift_m=given.distant_shift_m,
            distant_unmatched=given.distant_unmatched,
            largest_jump_m=given.largest_jump_m,
            refined_apart_m=given.refined_apart_m,
        )
    )


def _given_figures(given: GivenCheck) -> dict[str, Any]:
    return {
        "disagreeing": np.flatnonzero(given.rejected).tolist(),
        "median_shift_mm": mm(median(given.shift_m)),
        "distant_shift_mm": mm(given.distant_shift_m),
        "distant_unmatched": share(given.distant_unmatched),
        "largest_jump_mm": mm(given.largest_jump_m),
        "refined_apart_mm": mm(given.refined_apart_m),
        "distant_residual_mm": mm(given.given_distant_residual_m),
        "refined_distant_residual_mm": mm(given.refined_distant_residual_m),
    }


def _covisibility(case: _Case) -> dict[str, Any]:
    keyframes = case.tracked.keyframes[case.posed[case.tracked.keyframes]]
    if len(keyframes):
        chosen = np.linspace(0, len(keyframes) - 1, min(len(keyframes), COVISIBLE_KEYFRAMES))
        keyframes = keyframes[np.rint(chosen).astype(np.int64)]
    shares = covisibility(case.sequence, case.tracked.T_world_camera, keyframes)
    return {"keyframes": keyframes.tolist(), "share": np.round(shares, 3).tolist()}
