"""Read and write trajectories in TUM text format (`t tx ty tz qx qy qz qw`, camera to world)."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinectbench.core.errors import GivenPosesError, RecordingError
from kinectbench.core.geometry import closest_rotation, quaternion_xyzw_from_rotation, rigid
from kinectbench.core.geometry import rotation_from_quaternion_xyzw as rotation_from_xyzw
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import counted_ns, first_by_stamp, format_stamp, parse_stamp_ns
from kinectbench.core.trajectory.text_rows import parse_floats, text_rows
from kinectbench.core.types import Float64

HEADER = "# timestamp tx ty tz qx qy qz qw (camera to world)\n"
# Recorded rotation matrices have small errors; a matrix farther than this from SO(3) is no rotation.
RIGID_TOLERANCE = 0.05
# Limit of positions that are read; coordinates relative to the centre of the Earth stay below. A build needs
# nearer ones (`stages.track`).
FARTHEST_M = 1e7


class TimedPose(NamedTuple):
    """One pose of a file: stamp (ns), translation (m), quaternion, and the file and line for messages."""

    stamp_ns: int
    translation_m: tuple[float, ...]
    quaternion_xyzw: tuple[float, ...]
    where: str


def read_given(
    read: Callable[[], tuple[GivenTrajectory | None, list[str]]],
) -> tuple[GivenTrajectory | None, list[str], str]:
    """Call a reader of given poses; turn its error into a reason, because frames are usable without poses.

    Args:
        read: returns the trajectory and warnings.

    Returns:
        The trajectory or None, warnings, and why the trajectory cannot be used, or "".
    """
    try:
        return *read(), ""
    except RecordingError as error:
        return None, [], str(error)


def read_trajectory_file(path: Path, frames: int | None = None) -> tuple[GivenTrajectory, list[str]]:
    """Read a TUM trajectory file, camera to world, and sort it by stamps.

    Args:
        path: the file.
        frames: for a recording without times, its number of frames: row i is the pose of frame i; else None.

    Returns:
        The trajectory and warnings.

    Raises:
        RecordingError: the file cannot be read, is too large or has no row, a row is not a stamp in seconds
            and seven finite numbers, a position is beyond 10^7 m, a quaternion has length zero, or there are
            not as many rows as frames.
    """
    rows = []
    for where, row in text_rows(path):
        words = row.replace(",", " ").split()
        if len(words) != 8:
            raise GivenPosesError(
                f"{where}: holds {len(words)} values, not the 8 of 't tx ty tz qx qy qz qw'"
            )
        stamp_ns = parse_stamp_ns(words[0], where)
        numbers = parse_floats(words[1:], where)
        rows.append(TimedPose(stamp_ns, tuple(numbers[:3]), tuple(numbers[3:]), where))
    if frames is not None and len(rows) != frames:
        raise RecordingError(
            f"{path}: holds {len(rows)} poses for {frames} frames whose stamps are no times: which pose is "
            "of which frame cannot be determined; write one for each frame, in their order",
            what="pose-count",
        )
    if frames is not None:
        rows = [row._replace(stamp_ns=ns) for row, ns in zip(rows, counted_ns(frames), strict=True)]
    trajectory, warnings = trajectory_from_poses(rows, str(path))
    if any(after.stamp_ns < before.stamp_ns for before, after in pairwise(rows)):
        warnings.append(f"{path}: its rows are in no order of time: each pose is taken by its stamp")
    return trajectory, warnings


def trajectory_from_poses(rows: Sequence[TimedPose], name: str) -> tuple[GivenTrajectory, list[str]]:
    """Check timed poses (camera to world), and sort them by stamps; of equal stamps the first is kept.

    Returns:
        The trajectory and warnings.

    Raises:
        RecordingError: a value is not finite or too large, a quaternion has length zero, or there is no row.
    """
    if not rows:
        raise GivenPosesError(f"{name}: the trajectory is empty; remove it or export it again")
    values = np.array([(*row.translation_m, *row.quaternion_xyzw) for row in rows])
    _refuse_values(rows, values)
    order, warnings = first_by_stamp([row.stamp_ns for row in rows], name, "poses")
    T_world_camera = np.tile(np.eye(4), (len(order), 1, 1))
    T_world_camera[:, :3, :3] = rotation_from_xyzw(values[order, 3:])
    T_world_camera[:, :3, 3] = values[order, :3]
    return GivenTrajectory(np.array([rows[i].stamp_ns for i in order], np.int64), T_world_camera), warnings


def _refuse_values(rows: Sequence[TimedPose], values: Float64) -> None:
    """Raise an error for the first row that is no valid pose; values (n, 7): translation, quaternion."""
    unknown = np.asarray(~np.isfinite(values).all(axis=1))
    largest = np.abs(np.where(unknown[:, None], 0, values)).max(axis=1)
    far = largest > FARTHEST_M
    without_length = np.linalg.norm(np.where((unknown | far)[:, None], 1, values)[:, 3:], axis=1) < 1e-6
    wrong = np.asarray(unknown | far | without_length)
    if not wrong.any():
        return
    first = int(np.argmax(wrong))
    why = "the quaternion has length zero; remove this row"
    if unknown[first]:
        why = "the pose holds NaN or infinity; remove this row"
    elif far[first]:
        why = f"the pose is beyond {FARTHEST_M:g} m; give metres"
    raise GivenPosesError(f"{rows[first].where}: {why}")


def trajectory_text(trajectory: GivenTrajectory) -> str:
    """Write a trajectory as TUM text: stamps with nine decimals, poses with full precision."""
    rows = [HEADER]
    for stamp_ns, T in zip(trajectory.stamps_ns.tolist(), trajectory.T_world_camera, strict=True):
        numbers = [*T[:3, 3].tolist(), *quaternion_xyzw_from_rotation(T[:3, :3]).tolist()]
        rows.append(" ".join([format_stamp(stamp_ns), *(repr(number) for number in numbers)]) + "\n")
    return "".join(rows)


def rigid_or_none(matrix: Float64) -> Float64 | None:
    """Project a recorded (4, 4) matrix onto the rigid transforms; None if it is far from them."""
    # The comparison is false for NaN, too.
    if not np.abs(matrix).max() <= FARTHEST_M or np.linalg.det(matrix[:3, :3]) <= 0:
        return None
    rotation = closest_rotation(matrix[:3, :3])
    apart = max(np.abs(rotation - matrix[:3, :3]).max(), np.abs(matrix[3] - [0, 0, 0, 1]).max())
    return rigid(rotation, matrix[:3, 3]) if apart <= RIGID_TOLERANCE else None


def trajectory_from_matrices(
    stamps_ns: Sequence[int], matrices: Sequence[Float64 | None], name: str
) -> tuple[GivenTrajectory | None, list[str]]:
    """Make a trajectory from the frames that have a usable (4, 4) camera-to-world matrix.

    Args:
        stamps_ns: stamp of each frame, strictly increasing.
        matrices: recorded matrix of each frame; None if there is none.
        name: the recording, for messages.

    Returns:
        The trajectory (None if no matrix is usable), and warnings, unless no frame has a matrix.
    """
    if all(matrix is None for matrix in matrices):
        return None, []
    usable = [None if matrix is None else rigid_or_none(matrix) for matrix in matrices]
    kept = [(stamp, T) for stamp, T in zip(stamps_ns, usable, strict=True) if T is not None]
    lost = len(usable) - len(kept)
    if not kept:
        return None, [f"{name}: none of the {lost} poses is usable; the trajectory is ignored"]
    warnings = []
    if lost:
        first = next(stamp for stamp, T in zip(stamps_ns, usable, strict=True) if T is None)
        warnings.append(
            f"{name}: {lost} of {len(usable)} frames have no pose, or one that is not finite and rigid "
            f"(first at {format_stamp(first)} s)"
        )
    stamps = np.array([stamp for stamp, _ in kept], np.int64)
    return GivenTrajectory(stamps, np.stack([T for _, T in kept])), warnings
