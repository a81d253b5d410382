"""Read poses from text: one file for all frames (TUM, RTAB-Map, KITTI, matrices), or one per frame."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinectbench.core import GivenPosesError, RecordingError, printable
from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.core.sequence import GivenTrajectory, counts_frames
from kinectbench.core.trajectory.stamps import NS_PER_S, are_of_today
from kinectbench.core.trajectory.text_rows import PUNCTUATION, parse_floats, read_numbers, text_rows
from kinectbench.core.trajectory.trajectory_file import read_trajectory_file, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.stages.ingest.image_names import FRAME_NUMBER, frame_numbers
from kinectbench.stages.ingest.intrinsics_files import names_like
from kinectbench.stages.ingest.known_names import first_named, in_any_case, in_order, is_like_poses, visible
from kinectbench.stages.ingest.named_matrices import (
    LEAST_POSED,
    named_matrices,
    poses_by_frame,
    taken_for_poses,
)
from kinectbench.stages.ingest.readers.redwood_log import read_log
from kinectbench.stages.ingest.recording import FrameFiles

# Names of files with all poses, the first existing one is read: RTAB-Map and others, TUM, ICL and Replica.
POSE_FILES = ("poses.txt", "groundtruth.txt", "traj.txt", "camera_poses.txt")
# Number of values in a row: position and quaternion, alone or with stamp and id; matrix without and with its
# last row.
WITHOUT_STAMP, WITH_ID, KITTI, MATRIX = 7, 9, 12, 16
# A file of this name is read only if it has a pose for each frame: it may be the pose of something else.
LOOSE_POSES = "pose.txt"
# Rounded quaternions have a length of 1 within this (chosen by hand).
MOST_OFF_UNIT = 0.05
TUM_ROWS = "as TUM has it: t tx ty tz qx qy qz qw, camera to world"
POSE_FOLDERS = ("pose", "poses")


def named_like_poses(path: Path) -> str:
    """Return the end of an error message that names files which look like poses; "" if there are none."""
    return names_like(path, is_like_poses, "not read, by name poses:", by_folder=True)


def unread_poses(path: Path) -> list[str]:
    """Return a warning on files that look like poses, for a folder without readable poses; [] if none do."""
    beside = named_like_poses(path)
    return (
        [f"{path}: no trajectory is read{beside}; write it as `trajectory.txt`, {TUM_ROWS}"] if beside else []
    )


def named_poses(
    path: Path, beside: Sequence[Path], stamps_ns: Sequence[int], stems: Sequence[str]
) -> tuple[GivenTrajectory | None, list[str]]:
    """Read poses from pose.txt, or under the names of the frames in a file, if there are no others.

    `beside` are at least the visible texts and JSON files. The frames' stamps increase strictly; `stems` are
    the names of depth images without suffix.

    Returns:
        The trajectory (None if there are no such poses), and warnings.
    """
    loose = in_any_case(path, LOOSE_POSES)
    if loose.is_file():
        with suppress(RecordingError):
            trajectory, warnings = read_pose_file(loose, stamps_ns, stems)
            if trajectory is not None and _covers(trajectory, stamps_ns):
                return trajectory, warnings
    named = poses_by_frame(beside, stems)
    if named is None:
        return None, unread_poses(path)
    matrices, files = named
    trajectory, warnings = finite_trajectory(stamps_ns, matrices, str(files[0]))
    if trajectory is None:
        return None, [
            f"{files[0]}: no matrix under the name of a frame is a pose of finite numbers",
            *warnings,
        ]
    return trajectory, [taken_for_poses(files), *warnings]


def _covers(trajectory: GivenTrajectory, stamps_ns: Sequence[int]) -> bool:
    """Whether half of the frames are in the time of a trajectory of at least two poses."""
    first, last = trajectory.stamps_ns[0], trajectory.stamps_ns[-1]
    inside = sum(bool(first <= stamp_ns <= last) for stamp_ns in stamps_ns)
    return bool(last > first) and inside >= LEAST_POSED * len(stamps_ns)


def pose_file(path: Path, beside: Sequence[Path]) -> Path | None:
    """Return the recording's one file with the poses of all frames; None if there is no such file.

    ICL-NUIM's file has the suffix .freiburg, as in livingRoom2n.gt.freiburg. `beside` are at least the
    visible files with this suffix.
    """
    others = [file for file in beside if file.suffix.lower() == ".freiburg"]
    return first_named(path, POSE_FILES) or (others[0] if len(others) == 1 else None)


def read_pose_file(
    file: Path, stamps_ns: Sequence[int], stems: Sequence[str]
) -> tuple[GivenTrajectory | None, list[str]]:
    """Read a file with the poses of all frames, camera to world.

    A row of TUM belongs to the frame with its stamp. If the frames' own stamps are only counted, and there
    are as many rows as frames, rows and frames are matched in order. A row of RTAB-Map with an id belongs to
    the frame with that number. Rows without stamps (7 values), and matrices (12 or 16 values in a row, or in
    rows of four), are in the order of frames; with a number above each matrix, they belong to the frames with
    these indices, from 0. The frames' stamps increase strictly; `stems` are the names of depth images without
    suffix.

    Returns:
        The trajectory (None if no pose is usable), and warnings.

    Raises:
        RecordingError: a row has other content, or the frame of a pose is ambiguous.
    """
    rows = text_rows(file)
    lengths = {len(row.translate(PUNCTUATION).split()) for _, row in rows}
    if lengths in ({1, 4}, {3, 4}):
        return trajectory_from_matrices(stamps_ns, read_log(file, len(stems)), str(file))
    if lengths == {4}:
        rows = _joined(rows, file)
        lengths = {len(row.split()) for _, row in rows}
    if lengths == {WITH_ID}:
        return trajectory_from_matrices(stamps_ns, _by_id(rows, stems), str(file))
    if lengths in ({KITTI}, {MATRIX}):
        _check_count(file, len(rows), len(stems))
        return trajectory_from_matrices(stamps_ns, [_matrix(row, where) for where, row in rows], str(file))
    if lengths == {WITHOUT_STAMP}:
        _check_count(file, len(rows), len(stems))
        matrices = [_without_stamps(row, where) for where, row in rows]
        trajectory, warnings = finite_trajectory(stamps_ns, matrices, str(file))
        return trajectory, [
            f"{file}: its rows have no stamps: they are taken in the order of frames",
            *warnings,
        ]
    trajectory, warnings = read_trajectory_file(file)
    frames_ns = np.array(stamps_ns, np.int64)
    if not counts_frames(frames_ns) or len(rows) != len(stems):
        return trajectory, warnings
    numbered = counts_frames(trajectory.stamps_ns)
    if numbered and (len(trajectory.stamps_ns) < len(rows) or set(trajectory.stamps_ns) == set(frames_ns)):
        return trajectory, warnings
    if numbered:
        # One counts from 0 and the other from 1: equal numbers would give each frame its neighbour's pose.
        shift = int(trajectory.stamps_ns[0] - frames_ns[0]) // NS_PER_S
        message = f"{file}: its numbers are {shift:+d} off those of the frames: rows are taken in their order"
        warnings = [*warnings, message]
    elif len(trajectory.stamps_ns) < len(rows) or not are_of_today(trajectory.stamps_ns.tolist()):
        # The stamps repeat, or may be steps since the previous frame: only the order of rows is usable.
        trajectory, warnings = read_trajectory_file(file, len(stems))
    return GivenTrajectory(frames_ns, trajectory.T_world_camera), warnings


def with_y_down(given: GivenTrajectory, path: Path) -> tuple[GivenTrajectory, str]:
    """Mirror y of cameras and world in poses of cameras whose y axis points up (`Intrinsics.y_up`).

    Returns:
        The mirrored poses, and a warning.
    """
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    note = (
        f"{path}: fy is negative: the camera's y axis points up, as ICL-NUIM's: fy is read as positive, and "
        "y is mirrored in given poses, and so in the world"
    )
    return replace(given, T_world_camera=mirror @ given.T_world_camera @ mirror), note


def _check_count(file: Path, poses: int, frames: int) -> None:
    if poses != frames:
        raise RecordingError(
            f"{file}: holds {poses} poses for {frames} frames: which pose is of which frame cannot be "
            "determined; write one for each frame, in their order",
            what="pose-count",
        )


def _without_stamps(row: str, where: str) -> Float64 | None:
    """Return the matrix (4, 4) of a row `tx ty tz qx qy qz qw`; None of a lost frame, NaN or all 0.

    Raises:
        RecordingError: its last four values are no unit quaternion, but angles, for example.
    """
    numbers = np.array(parse_floats(row.translate(PUNCTUATION).split(), where))
    length = np.linalg.norm(numbers[3:])
    if not np.isfinite(numbers).all() or length == 0:
        return None
    if abs(length - 1) > MOST_OFF_UNIT:
        raise GivenPosesError(
            f"{where}: its seven values are no 'tx ty tz qx qy qz qw': the last four are no unit quaternion; "
            f"write them {TUM_ROWS}"
        )
    return rigid(rotation_from_quaternion_xyzw(numbers[None, 3:])[0], numbers[:3])


def _by_id(rows: Sequence[tuple[str, str]], stems: Sequence[str]) -> list[Float64 | None]:
    """Return each frame's matrix, from the row whose id is the frame's number; None if no row has this id."""
    poses = {}
    for where, row in rows:
        words = row.replace(",", " ").split()
        if not FRAME_NUMBER.fullmatch(words[-1]):
            raise GivenPosesError(f"{where}: its last value is no id of a frame")
        numbers = parse_floats(words[1:-1], where)
        if not np.linalg.norm(numbers[3:]) > 0:
            raise GivenPosesError(f"{where}: the quaternion has length zero; remove this row")
        rotation = rotation_from_quaternion_xyzw(np.array([numbers[3:]]))[0]
        poses[int(words[-1])] = rigid(rotation, np.array(numbers[:3]))
    numbered = [int(stem) if FRAME_NUMBER.fullmatch(stem) else -1 for stem in stems]
    return [poses.get(number) for number in numbered]


def _joined(rows: Sequence[tuple[str, str]], file: Path) -> list[tuple[str, str]]:
    """Join rows of four values into one row per matrix: three rows, or four with the last 0 0 0 1."""
    values = [parse_floats(row.translate(PUNCTUATION).split(), where) for where, row in rows]
    side = 4 if len(values) > 3 and all(row == [0, 0, 0, 1] for row in values[3::4]) else 3
    if len(rows) % side:
        raise GivenPosesError(
            f"{file}: holds {len(rows)} rows of four numbers, no whole number of matrices: write 4x4 "
            "matrices below each other, the last row of each 0 0 0 1, or 3x4 matrices"
        )
    texts = [row.translate(PUNCTUATION) for _, row in rows]
    return [(rows[i][0], " ".join(texts[i : i + side])) for i in range(0, len(rows), side)]


def _matrix(row: str, where: str) -> Float64:
    return _of_rows(parse_floats(row.translate(PUNCTUATION).split(), where))


def _of_rows(numbers: Sequence[float]) -> Float64:
    """Return the matrix (4, 4) of 16 values, or of 12 without its last row."""
    last = [] if len(numbers) == MATRIX else [0.0, 0.0, 0.0, 1.0]
    return np.array([*numbers, *last]).reshape(4, 4)


def pose_folder(path: Path) -> Path | None:
    """Return the recording's folder with one text or array per pose; None if there is no such folder."""
    folders = in_order(path, POSE_FOLDERS)
    return next((folder for folder in folders if _pose_files(folder)), None)


def _pose_files(folder: Path) -> list[Path]:
    """Return a folder's texts, or its arrays if it has no texts."""
    texts, arrays = visible(folder, "*.txt"), visible(folder, "*.npy")
    return texts or (arrays if arrays and _is_pose(arrays[0]) else [])


def _is_pose(array: Path) -> bool:
    """Whether an .npy file holds a 3x4 or 4x4 matrix; keypoints of a person are poses, too."""
    return any(matrix.shape != (3, 3) for _, matrix in named_matrices(array))


def read_pose_folder(
    path: Path, files: Sequence[FrameFiles], T_camera_depth: Float64 | None = None
) -> tuple[GivenTrajectory | None, list[str]]:
    """Read the pose of each frame from its own file; a pose that is not finite means that tracking was lost.

    A file belongs to the depth image of its name; if none does, to that of its number, as depth_0001.png and
    pose_0001.txt. If not all have a partner so, a warning counts those without.

    Args:
        path: the recording.
        files: files of the frames, stamps strictly increasing.
        T_camera_depth: (4, 4), depth camera to the camera of the poses, metres; None: the same camera.

    Returns:
        The trajectory of the depth camera (None if no frame has a usable pose), and warnings.

    Raises:
        RecordingError: a file contains neither 16 numbers nor 12, the matrix without its last row.
    """
    folder = pose_folder(path)
    if folder is None:
        return None, []
    place = np.eye(4) if T_camera_depth is None else T_camera_depth
    suffix = _pose_files(folder)[0].suffix
    poses = [in_any_case(folder, f"{frame.depth.stem}{suffix}") for frame in files]
    said = list[str]()
    if not any(pose.is_file() for pose in poses):
        poses, said = _poses_by_number(folder, [frame.depth.stem for frame in files])
    if not poses:
        return None, said
    matrices = [read_pose_matrix(pose, place) for pose in poses]
    trajectory, warnings = finite_trajectory([frame.stamp_ns for frame in files], matrices, str(path))
    return trajectory, [*said, *warnings]


def _poses_by_number(folder: Path, stems: Sequence[str]) -> tuple[list[Path], list[str]]:
    """Return the path of each frame's pose by the number in its name, and a warning if some have no partner.

    There are no paths if the numbers do not match: both must begin with the same number, or one may count
    from 0, and the other from 1; and all frames must have a pose, or all poses a frame.
    """
    files = _pose_files(folder)
    of_frames, of_files = frame_numbers(stems), frame_numbers([file.stem for file in files])
    advice = "name each as its depth image is named"
    refused = f"{folder}: {len(files)} files of poses are of no frame, such as {printable(files[0].name)}"
    if of_frames is None or of_files is None:
        return [], [f"{refused}: {advice}"]
    by_number = dict(zip(of_files, files, strict=True))
    posed, frames = by_number.keys(), set(of_frames)
    if min(posed) != min(frames):
        begin = f"their numbers begin with {min(posed)}, those of depth with {min(frames)}"
        return [], [f"{refused}: {begin}: {advice}"]
    if not (posed <= frames or posed >= frames):
        return [], [f"{refused}: {advice}"]
    matched = [by_number.get(number, folder / "none") for number in of_frames]
    if posed == frames:
        return matched, []
    said = f"{len(posed & frames)} poses are matched by the number in their names, and "
    said += f"{len(posed - frames)} are of no frame; if numbers count other things, {advice}"
    return matched, [f"{folder}: {said}"]


def finite_trajectory(
    stamps_ns: Sequence[int], matrices: Sequence[Float64 | None], name: str
) -> tuple[GivenTrajectory | None, list[str]]:
    """Return the trajectory of matrices (4, 4), camera to world (None if none is finite), and warnings."""
    if not any(matrix is not None and np.isfinite(matrix).all() for matrix in matrices):
        return None, []
    return trajectory_from_matrices(stamps_ns, matrices, name)


def read_pose_matrix(file: Path, T_camera_depth: Float64) -> Float64 | None:
    """Read a camera's pose from a file and convert it to the depth camera's pose (4, 4).

    The result is None if the file is missing.

    Raises:
        RecordingError: the file contains neither 16 numbers nor 12, without the last row.
    """
    if not file.is_file():
        return None
    if file.suffix.lower() == ".npy":
        numbers = [value for _, matrix in named_matrices(file) for value in matrix.ravel().tolist()]
    else:
        numbers = read_numbers(file)
    if len(numbers) not in (KITTI, MATRIX):
        raise GivenPosesError(
            f"{file}: holds {len(numbers)} numbers, not the 4x4 of a matrix: write 16 numbers, the matrix "
            "row by row, camera to world"
        )
    T = _of_rows(numbers)
    return np.asarray(T @ T_camera_depth) if np.isfinite(T).all() else T
