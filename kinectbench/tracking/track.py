"""The stage `track`: a pose for every frame, checked against the depth."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import TrackingSettings, TrajectoryMode
from kinectbench.errors import TrackingError
from kinectbench.sequence import Sequence
from kinectbench.tracking.agreement import Agreement, measure_agreement
from kinectbench.tracking.given import poses_at
from kinectbench.tracking.odometry import odometry
from kinectbench.tracking.trajectory import Trajectory

MIN_GOOD_FRAMES = 3
DRIFT_WARNING = (
    "no trajectory was given: poses are chained by frame-to-frame odometry, which drifts by centimetres; "
    "the ground truth may be wrong by as much"
)
REFINE_WARNING = "trajectory: refine is not offered by this version; the given trajectory is trusted as it is"


def track(
    sequence: Sequence,
    mode: TrajectoryMode | None,
    settings: TrackingSettings,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Give every frame a pose, and leave out the frames whose depth disagrees with it.

    Args:
        sequence: the recording.
        mode: trust or ignore a given trajectory; None: trust it if there is one.
        settings: what counts as disagreement.
        progress: called with (done, total).

    Raises:
        TrackingError: the given trajectory does not fit the frames, or too few frames have a pose.
    """
    trusted = mode in ("trust", "refine") or (mode is None and sequence.given_trajectory is not None)
    if not trusted:
        return _track_by_odometry(sequence, settings, progress)
    if sequence.given_trajectory is None:
        raise TrackingError(
            f"trajectory: {mode} asks for a given trajectory, but the recording has none; use ignore"
        )
    poses = poses_at(sequence.given_trajectory, sequence.stamps_ns, settings.max_stamp_gap_s)
    lost = np.flatnonzero(np.isnan(poses[:, 0, 0]))
    if len(lost) > len(sequence) - MIN_GOOD_FRAMES:
        raise TrackingError(_too_few_poses(sequence, len(sequence) - len(lost)))
    agreement = measure_agreement(sequence, poses, settings, progress)
    wrong = agreement.disagreeing(settings.max_disagreement_m)
    posed = len(sequence) - len(lost)
    if wrong.sum() > 0.5 * posed:
        raise TrackingError(
            f"the given trajectory does not fit the depth: {wrong.sum()} of {posed} frames disagree by more "
            f"than {settings.max_disagreement_m * 1000:.0f} mm; are the poses camera to world, in optical "
            "axes, on the frames' clock, and is depth_scale right? `trajectory: ignore` does without them"
        )
    used = poses.copy()
    used[wrong] = np.nan
    warnings = [REFINE_WARNING] if mode == "refine" else []
    unchecked = int(np.isnan(agreement.shift_m).sum()) - len(lost)
    if unchecked > 0.5 * posed:
        warnings.append(
            f"{unchecked} of {posed} poses could not be checked: too little of the frames overlaps; lower "
            "tracking.check_stride_px"
        )
    health = _health(sequence, poses, used, "trust", agreement, warnings)
    return Trajectory(sequence.stamps_ns, used, "trust", health)


def _track_by_odometry(
    sequence: Sequence, settings: TrackingSettings, progress: Callable[[int, int], None] | None
) -> Trajectory:
    poses, lost_from = odometry(sequence, progress)
    warnings = [DRIFT_WARNING]
    if lost_from is not None:
        warnings.append(
            f"odometry lost the camera at frame {lost_from}: that frame and all later ones are left out"
        )
    if np.isfinite(poses[:, 0, 0]).sum() < MIN_GOOD_FRAMES:
        raise TrackingError(
            f"odometry lost the camera at frame {lost_from}; give a trajectory, or record more slowly"
        )
    agreement = measure_agreement(sequence, poses, settings)
    return Trajectory(
        sequence.stamps_ns,
        poses,
        "odometry",
        _health(sequence, poses, poses, "odometry", agreement, warnings),
    )


def _health(
    sequence: Sequence,
    poses: NDArray[np.float64],
    used: NDArray[np.float64],
    source: str,
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
        "source": source,
        "verdict": _verdict(source, median_mm),
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


def _verdict(source: str, median_shift_mm: float | None) -> str:
    if source == "odometry":
        return "drift is likely: not good for ground truth unless checked by eye"
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


def _too_few_poses(sequence: Sequence, posed: int) -> str:
    given = sequence.given_trajectory
    ranges = [
        f"{stamps[0] / 1e9:.3f}-{stamps[-1] / 1e9:.3f} s"
        for stamps in (sequence.stamps_ns, given.stamps_ns if given else sequence.stamps_ns)
    ]
    problem = f"gives {posed} of {len(sequence)} frames a pose, and {MIN_GOOD_FRAMES} are needed"
    return (
        f"the given trajectory {problem if posed else 'shares no time with the frames'}: frames {ranges[0]}, "
        f"trajectory {ranges[1]}; use stamps of one clock, or `trajectory: ignore`"
    )
