"""How a Trajectory is stored: trajectory.txt (TUM text), health.json and depth_calibration.json."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import RecordingError, StorageError
from kinectbench.geometry.depth_calibration import NO_CALIBRATION, TERMS, DepthCalibration
from kinectbench.ingest.trajectory_file import read_trajectory as read_tum
from kinectbench.ingest.trajectory_file import trajectory_text
from kinectbench.sequence import GivenTrajectory
from kinectbench.tracking.trajectory import Trajectory
from kinectbench.workspace import pretty_json

CALIBRATION = "depth_calibration.json"


def write_trajectory(trajectory: Trajectory, folder: Path) -> None:
    """Write the poses of the good frames (t = depth stamp in s) and the health figures."""
    good = trajectory.good_frames
    posed = GivenTrajectory(trajectory.stamps_ns[good], trajectory.T_world_camera[good])
    (folder / "trajectory.txt").write_text(trajectory_text(posed))
    (folder / "health.json").write_text(pretty_json(trajectory.health))
    (folder / CALIBRATION).write_text(
        pretty_json(
            {
                "formula": "1 / true depth = 1 / depth + sum of coefficient * P_i(x) * P_j(y); P: Legendre, "
                "x = (2 u + 1) / width - 1, y = (2 v + 1) / height - 1",
                "terms": TERMS,
                "coefficients_per_m": trajectory.depth_calibration.coefficients_per_m.tolist(),
            }
        )
    )


def read_trajectory(folder: Path, stamps_ns: NDArray[np.int64]) -> Trajectory:
    """Read a stored trajectory back for the frames with these stamps (n,).

    Raises:
        StorageError: the files do not belong to these frames, or are damaged.
    """
    try:
        posed, _ = read_tum(folder / "trajectory.txt")
        health = json.loads((folder / "health.json").read_text())
        source = health["source"]
        calibration = _read_calibration(folder / CALIBRATION)
    except (OSError, ValueError, KeyError, TypeError, RecordingError) as error:
        raise StorageError(
            f"{folder}: the trajectory is damaged ({error}); `kinectbench build --force` makes it again"
        ) from error
    rows = np.searchsorted(stamps_ns, posed.stamps_ns)
    if rows.max() >= len(stamps_ns) or (stamps_ns[rows] != posed.stamps_ns).any():
        raise StorageError(
            f"{folder}: the stored trajectory is of other frames; `kinectbench build --force` makes it again"
        )
    poses = np.full((len(stamps_ns), 4, 4), np.nan)
    poses[rows] = posed.T_world_camera
    return Trajectory(stamps_ns, poses, source, health, calibration)


def _read_calibration(path: Path) -> DepthCalibration:
    """None where there is no such file: earlier versions wrote none."""
    if not path.is_file():
        return NO_CALIBRATION
    content = json.loads(path.read_text())
    coefficients = np.array(content["coefficients_per_m"], np.float64)
    if content["terms"] != [list(term) for term in TERMS] or coefficients.shape != (len(TERMS),):
        raise ValueError(f"{path.name} has other terms")
    if not np.isfinite(coefficients).all():
        raise ValueError(f"{path.name} has coefficients that are no numbers")
    return DepthCalibration(coefficients)
