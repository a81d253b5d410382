"""The camera's trajectory with one pose per frame, NaN where there is none; and its files."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.trajectory import StoredDepthCalibration, TrajectoryHealth
from kinectbench.core.errors import RecordingError, StorageError
from kinectbench.core.geometry import NO_CALIBRATION, DepthCalibration
from kinectbench.core.geometry.rolling_shutter import RollingShutter, motions
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.trajectory_file import read_trajectory_file as read_tum
from kinectbench.core.trajectory.trajectory_file import trajectory_text
from kinectbench.core.types import Float64, Int64

TRAJECTORY_TXT = "trajectory.txt"
# Assumed error of a pose that no other frame checked: the largest plausible error. Given poses with a
# measured error of 25 mm are left out (`tracking.max_disagreement_m`). With 25 mm here, the alignment of a
# view with the object half-corrects a pose that is wrong by 85 mm and 4 degrees; with 20 mm it refuses the
# pose.
UNCHECKED_POSE_SIGMA_M = 0.02


@dataclass(frozen=True)
class Trajectory:
    """`T_world_camera` per frame of a sequence.

    Attributes:
        stamps_ns: (n,) int64, the sequence's depth stamps.
        T_world_camera: (n, 4, 4) float64; NaN where a frame has no usable pose.
        source: how the poses were obtained: "trust" (as given), "refine" (given, and refined) or "tracked".
        pose_sigma_m: (n,) standard deviation of each pose, as a shift of its points, metres; NaN if unknown.
            None if unknown for all frames.
        health: measures of quality that need no ground truth; None if not computed.
        depth_calibration: the correction of depth that was used to estimate or check the poses.
    """

    stamps_ns: Int64
    T_world_camera: Float64
    source: str
    pose_sigma_m: Float64 | None = None
    health: TrajectoryHealth | None = None
    depth_calibration: DepthCalibration = NO_CALIBRATION

    @property
    def good_frames(self) -> Int64:
        """Indices of the frames that have a pose, ascending."""
        return np.flatnonzero(np.isfinite(self.T_world_camera).all(axis=(1, 2)))

    @cached_property
    def shutter(self) -> RollingShutter | None:
        """The rolling shutter that tracking found: readout time, colour delay, camera motion.

        The motion is computed from the poses of this trajectory. None if neither a readout time nor a delay
        was found.
        """
        if self.health is None or not (self.health.readout_s or self.health.color_delay_s):
            return None
        one_world = np.zeros(len(self.stamps_ns), np.int64)
        motion = motions(self.T_world_camera, one_world, self.stamps_ns / 1e9)
        return RollingShutter(self.health.readout_s or 0.0, self.health.color_delay_s or 0.0, motion)

    def assumed_pose_sigma_m(self, frame: int) -> float:
        """Return `pose_sigma_m` of a frame, or the largest plausible error if it is unknown, metres."""
        sigma_m = np.nan if self.pose_sigma_m is None else float(self.pose_sigma_m[frame])
        return UNCHECKED_POSE_SIGMA_M if np.isnan(sigma_m) else sigma_m

    @cached_property
    def median_pose_sigma_m(self) -> float | None:
        """Median of `pose_sigma_m` over the frames for which it is known, metres; None if there are none."""
        if self.pose_sigma_m is None:
            return None
        sigma_m = self.pose_sigma_m[self.good_frames]
        checked_m = sigma_m[np.isfinite(sigma_m)]
        return float(np.median(checked_m)) if len(checked_m) else None


def write_trajectory(trajectory: Trajectory, folder: Path) -> None:
    """Write trajectory.txt (the good frames), depth_calibration.json and, if known, health.json.

    Its `pose_sigma_m` is stored only as part of health.json. The folder exists.
    """
    good = trajectory.good_frames
    posed = GivenTrajectory(trajectory.stamps_ns[good], trajectory.T_world_camera[good])
    (folder / TRAJECTORY_TXT).write_text(trajectory_text(posed), encoding="utf-8")
    if trajectory.health is not None:
        trajectory.health.write(folder)
    coefficients_per_m = trajectory.depth_calibration.coefficients_per_m.tolist()
    StoredDepthCalibration(coefficients_per_m=coefficients_per_m).write(folder)


def read_poses(folder: Path) -> GivenTrajectory:
    """Read trajectory.txt from a trajectory's folder.

    Raises:
        StorageError: the file is missing or damaged.
    """
    try:
        return read_tum(folder / TRAJECTORY_TXT)[0]
    except RecordingError as error:
        raise StorageError(
            f"{folder}: the trajectory is damaged ({error}); `kinectbench build --force` makes it again"
        ) from error


def read_trajectory(folder: Path, stamps_ns: Int64) -> Trajectory:
    """Read a stored trajectory for the frames with these stamps (n,).

    Raises:
        StorageError: the files are damaged, or belong to other frames.
    """
    posed, health = read_poses(folder), TrajectoryHealth.read(folder)
    # Earlier versions stored no calibration.
    stored = StoredDepthCalibration.read_if_there(folder)
    rows = np.searchsorted(stamps_ns, posed.stamps_ns)
    others = rows.max() >= len(stamps_ns) or (stamps_ns[rows] != posed.stamps_ns).any()
    if others or health.frames != len(stamps_ns):
        raise StorageError(
            f"{folder}: the stored trajectory is of other frames; `kinectbench build --force` makes it again"
        )
    T_world_camera = np.full((len(stamps_ns), 4, 4), np.nan)
    T_world_camera[rows] = posed.T_world_camera
    calibration = NO_CALIBRATION if stored is None else stored.calibration
    return Trajectory(stamps_ns, T_world_camera, health.source, health.pose_sigma_m(), health, calibration)
