"""The camera's trajectory: one pose per frame, or the reason why there is none."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry.depth_calibration import NO_CALIBRATION, DepthCalibration


@dataclass(frozen=True)
class Trajectory:
    """`T_world_camera` per frame of a sequence.

    Attributes:
        stamps_ns: (n,) int64, the sequence's depth stamps.
        T_world_camera: (n, 4, 4) float64; NaN where a frame has no usable pose.
        source: "trust", "refine" or "tracked": where the poses come from.
        health: figures about it, plain JSON values, as stored in health.json.
        depth_calibration: of the recording's depth, as the poses were found or checked with it.
    """

    stamps_ns: NDArray[np.int64]
    T_world_camera: NDArray[np.float64]
    source: str
    health: Mapping[str, Any] = field(default_factory=dict)
    depth_calibration: DepthCalibration = NO_CALIBRATION

    @property
    def good_frames(self) -> NDArray[np.int64]:
        """Indices of the frames that have a pose, ascending."""
        return np.flatnonzero(np.isfinite(self.T_world_camera).all(axis=(1, 2)))

    @cached_property
    def _shifts_mm(self) -> Mapping[int, float | None]:
        return {row["frame"]: row["shift_mm"] for row in self.health.get("per_frame", [])}

    def pose_sigma_m(self, frame: int) -> float:
        """By how much a frame's pose may be off, metres: how far its depth would move it; 0 if unknown."""
        return (self._shifts_mm.get(frame) or 0.0) / 1000

    @cached_property
    def usual_pose_sigma_m(self) -> float:
        """Median of `pose_sigma_m` over the good frames, metres; there must be one."""
        return float(np.median([self.pose_sigma_m(int(frame)) for frame in self.good_frames]))
