"""Poses that lie in a text file of each frame: pose/N.txt, a 4x4 matrix, camera to world."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.text_rows import read_matrix
from kinectbench.core.trajectory.trajectory_file import trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.stages.ingest.recording import FrameFiles

POSE_FOLDERS = ("pose", "poses")


def pose_folder(path: Path) -> Path | None:
    """The recording's folder with a text file of each pose, or None."""
    folders = (path / name for name in POSE_FOLDERS)
    return next((folder for folder in folders if folder.is_dir() and any(folder.glob("*.txt"))), None)


def read_pose_folder(
    path: Path, files: Sequence[FrameFiles], T_camera_depth: Float64 | None = None
) -> tuple[GivenTrajectory | None, list[str]]:
    """Read the pose of each frame that has one; one that is not finite is of a frame that was lost.

    Args:
        path: the recording.
        files: its frames, stamps strictly increasing.
        T_camera_depth: (4, 4), depth camera to the camera that the poses are of, metres; None: the same.

    Returns:
        The trajectory of the depth camera, or None if no frame has a usable pose; and warnings.

    Raises:
        RecordingError: a file does not hold 16 numbers.
    """
    folder = pose_folder(path)
    if folder is None:
        return None, []
    place = np.eye(4) if T_camera_depth is None else T_camera_depth
    matrices = [_read(folder / f"{frame.depth.stem}.txt", place) for frame in files]
    return finite_trajectory([frame.stamp_ns for frame in files], matrices, str(path))


def finite_trajectory(
    stamps_ns: Sequence[int], matrices: Sequence[Float64 | None], name: str
) -> tuple[GivenTrajectory | None, list[str]]:
    """`trajectory_from_matrices`; no trajectory and no warning if every frame was lost."""
    if not any(matrix is not None and np.isfinite(matrix).all() for matrix in matrices):
        return None, []
    return trajectory_from_matrices(stamps_ns, matrices, name)


def _read(file: Path, T_camera_depth: Float64) -> Float64 | None:
    if not file.is_file():
        return None
    T = read_matrix(file, 4)
    return np.asarray(T @ T_camera_depth) if np.isfinite(T).all() else T
