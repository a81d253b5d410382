"""Find outlier frames: their depth agrees with other frames far worse than the depth of nearly all does."""

from collections.abc import Mapping

import numpy as np

from kinectbench.core.artefacts.trajectory import Source
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.point_cells import far_apart

OUTLIER_REASON = "its depth lies farther from the frames around it than that of nearly all others"
ADVICE: dict[Source, str] = {
    "tracked": "turn and walk more slowly there",
    "refine": "turn and walk more slowly there",
    "trust": "the given poses are off there, as after a fast turn; `trajectory: refine` may bring them back",
}
# A frame is an outlier by its modified z-score: 0.6745 times its distance from the median, divided by the
# median of these distances (Iglewicz and Hoaglin 1993: above 3.5). Its residual must also be twice the
# median, because the spread may be tiny. Measured: frames of a fast turn have 3.6 to 4.5 times the median;
# 300 frames of three recordings without a fast turn have at most 1.35 times.
MODIFIED_Z, Z_OF_MEDIAN, OUTLIER_RATIO = 3.5, 0.6745, 2.0
# Depth is fused up to 8 m (`fuse.depth_range`): cameras farther apart than twice this show no common place.
FAR_APART_M = 16.0


def find_outliers(residual: Float64, judged: Bools) -> Bools:
    """Which frames (n,) agree far worse with their keyframes than nearly all frames do.

    A frame of a fast turn may pass registration although it is centimetres off. A residual within the noise
    never makes an outlier.

    Args:
        residual: (n,) residual of each frame to keyframes, divided by the expected noise; NaN: unknown.
        judged: (n,) bool, the frames to judge.
    """
    known = judged & np.isfinite(residual)
    if not known.any():
        return known
    median = np.median(residual[known])
    spread = np.median(np.abs(residual[known] - median))
    far = Z_OF_MEDIAN * (residual - median) > MODIFIED_Z * spread
    odd: Bools = known & far & (residual > np.maximum(OUTLIER_RATIO * median, 1.0))
    return odd


def outlier_warnings(reasons: Mapping[int, str], source: Source) -> list[str]:
    """Return a warning about frames left out as outliers, by {frame: why it has no pose}; [] if none."""
    frames = sorted(frame for frame, reason in reasons.items() if reason == OUTLIER_REASON)
    if not frames:
        return []
    return [f"left out: {_named(frames)}: {OUTLIER_REASON}; {ADVICE[source]}"]


def far_warnings(T_world_camera: Float64) -> list[str]:
    """Return a warning about cameras too far from most others to see the same scene; [] if there are none.

    Their poses cannot be checked, because no other frame sees the same place. Poses are (n, 4, 4), NaN where
    a frame has none.
    """
    posed = np.flatnonzero(has_pose(T_world_camera))
    positions = T_world_camera[posed, :3, 3]
    far = far_apart(positions, FAR_APART_M) if len(posed) else np.zeros(0, bool)
    if not far.any():
        return []
    away_m = np.linalg.norm(positions[far] - np.median(positions[~far], axis=0), axis=1).max()
    return [
        f"{away_m:.0f} m away from most others: {_named(posed[far].tolist())}: nothing checks such a pose; "
        "remove it from the trajectory if the camera was not there"
    ]


def _named(frames: list[int]) -> str:
    return f"{len(frames)} frames ({frames[0]} to {frames[-1]})" if len(frames) > 1 else f"frame {frames[0]}"
