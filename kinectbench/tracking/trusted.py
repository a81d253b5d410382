"""A given trajectory that is trusted: each frame's depth is asked whether it agrees."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import TrackingSettings
from kinectbench.errors import TrackingError
from kinectbench.sequence import Sequence
from kinectbench.tracking.agreement import Agreement, measure_agreement
from kinectbench.tracking.trajectory import Trajectory


def trusted(
    sequence: Sequence,
    T_given: NDArray[np.float64],
    settings: TrackingSettings,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Keep the given poses, but for those that the depth contradicts.

    Args:
        sequence: the recording.
        T_given: (n, 4, 4), NaN where there is none.
        settings: what counts as disagreement.
        progress: called with (done, total).

    Raises:
        TrackingError: most frames disagree.
    """
    lost = np.flatnonzero(np.isnan(T_given[:, 0, 0]))
    agreement = measure_agreement(sequence, T_given, settings, progress)
    wrong = agreement.disagreeing(settings.max_disagreement_m)
    posed = len(sequence) - len(lost)
    if wrong.sum() > 0.5 * posed:
        raise TrackingError(
            f"the given trajectory does not fit the depth: {wrong.sum()} of {posed} frames disagree by more "
            f"than {settings.max_disagreement_m * 1000:.0f} mm; are the poses camera to world, in optical "
            "axes, on the frames' clock, and is depth_scale right? `trajectory: ignore` does without them"
        )
    used = T_given.copy()
    used[wrong] = np.nan
    warnings = []
    unchecked = int(np.isnan(agreement.shift_m).sum()) - len(lost)
    if unchecked > 0.5 * posed:
        warnings.append(
            f"{unchecked} of {posed} poses could not be checked: too little of the frames overlaps; lower "
            "tracking.check_stride_px"
        )
    health = _health(sequence, T_given, used, agreement, warnings)
    return Trajectory(sequence.stamps_ns, used, "trust", health)


def _health(
    sequence: Sequence,
    poses: NDArray[np.float64],
    used: NDArray[np.float64],
    agreement: Agreement,
    warnings: list[str],
) -> dict[str, Any]:
    """The figures of health.json, and a verdict in words."""
    posed, kept = np.isfinite(poses[:, 0, 0]), np.isfinite(used[:, 0, 0])
    rejected = [
        {
            "frame": int(frame),
            "stamp_ns": int(sequence.stamps_ns[frame]),
            "residual_mm": _mm(agreement.residual_m[frame]),
            "shift_mm": _mm(agreement.shift_m[frame]),
            "turn_deg": round(float(np.degrees(agreement.turn_rad[frame])), 2),
            "reason": f"its depth disagrees with its pose by {_mm(agreement.shift_m[frame])} mm",
        }
        for frame in np.flatnonzero(posed & ~kept)
    ]
    shift_m = agreement.shift_m[kept & np.isfinite(agreement.shift_m)]
    median_mm = _mm(np.median(shift_m)) if len(shift_m) else None
    centres = used[kept][:, :3, 3]
    return {
        "format_version": 1,
        "source": "trust",
        "verdict": _verdict(median_mm),
        "warnings": warnings,
        "frames": len(sequence),
        "tracked": int(kept.sum()),
        "lost": [int(frame) for frame in np.flatnonzero(~posed)],
        "rejected": rejected,
        "median_shift_mm": median_mm,
        "max_shift_mm": _mm(shift_m.max()) if len(shift_m) else None,
        "median_residual_mm": _mm(np.nanmedian(agreement.residual_m[kept])) if len(shift_m) else None,
        "unchecked": int((kept & np.isnan(agreement.shift_m)).sum()),
        "path_length_m": round(float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum()), 3),
        "per_frame": [
            {
                "frame": int(f),
                "residual_mm": _mm(agreement.residual_m[f]),
                "shift_mm": _mm(agreement.shift_m[f]),
            }
            for f in np.flatnonzero(posed)
        ],
    }


def _verdict(median_shift_mm: float | None) -> str:
    if median_shift_mm is None:
        return "could not be checked: the frames do not overlap"
    for limit_mm in (5, 10):
        if median_shift_mm <= limit_mm:
            return (
                f"good for ground truth at {limit_mm} mm: frames agree within {median_shift_mm} mm (median)"
            )
    return f"coarse: frames agree within {median_shift_mm} mm (median) only"


def _mm(value_m: float | np.floating[Any]) -> float | None:
    return None if np.isnan(value_m) else round(float(value_m) * 1000, 1)
