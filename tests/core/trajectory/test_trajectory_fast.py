"""Long trajectories: the poses and errors that plain loops give, in a bounded time."""

import numpy as np
import pytest
from bounds import within
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import invert_rigid, rigid, rotation_from_quaternion_xyzw
from kinectbench.core.trajectory.compare import compare_poses
from kinectbench.core.trajectory.trajectory_file import TimedPose, trajectory_from_poses


def walk(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two noisy copies of a walk (n, 4, 4) whose steps are of many lengths; in some it stands."""
    random = np.random.default_rng(seed)
    count = int(random.integers(3, 200))
    steps_m = random.normal(0, random.choice([0.01, 0.1, 0.5]), (count, 3))
    steps_m[random.random(count) < random.choice([0.0, 0.3])] = 0
    T = np.tile(np.eye(4), (2, count, 1, 1))
    T[:, :, :3, 3] = np.cumsum(steps_m, axis=0)
    T[0, :, :3, 3] += random.normal(0, 0.01, (count, 3))
    return T[0], T[1]


def errors_over_a_metre(T_estimate: np.ndarray, T_reference: np.ndarray) -> list[float]:
    """Pose by pose: the first of the poses that are closest to a metre of path ahead, within a tenth."""
    positions = T_reference[:, :3, 3]
    path_m = [0.0, *np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1)).tolist()]
    found = []
    for i in range(len(path_m) - 1):
        off_m = [abs(path_m[j] - path_m[i] - 1) for j in range(i + 1, len(path_m))]
        j = i + 1 + off_m.index(min(off_m))
        if min(off_m) <= 0.1:
            moved = [invert_rigid(T[i]) @ T[j] for T in (T_estimate, T_reference)]
            found.append(float(np.linalg.norm((invert_rigid(moved[1]) @ moved[0])[:3, 3])))
    return found


@pytest.mark.parametrize("seed", range(40))
def test_pieces_of_a_metre_are_those_of_a_search_over_all_poses(seed: int) -> None:
    estimate, reference = walk(seed)
    expected, found = errors_over_a_metre(estimate, reference), compare_poses(estimate, reference).rpe_metre_m
    if not expected:
        assert found is None
        return
    assert found is not None
    assert (found.mean, found.max) == pytest.approx((np.mean(expected), max(expected)), rel=1e-9)


def test_an_hour_of_poses_is_compared_in_seconds() -> None:
    T = np.tile(np.eye(4), (108_000, 1, 1))
    T[:, 0, 3] = 0.01 * np.arange(len(T))
    with within(5):
        assert compare_poses(T, T).rpe_metre_m is not None


def test_an_hour_of_poses_at_100_hz_is_checked_in_seconds() -> None:
    """The same to the bit as pose by pose."""
    rows = [
        TimedPose(i * 10**7, (0.001 * i % 1, 0.2, -(i % 7)), (0.1, 0.2, i % 11, 0.9), f"row {i}")
        for i in range(360_000)
    ]
    with within(5):
        trajectory, warnings = trajectory_from_poses(rows, "t.txt")
    assert warnings == [] and len(trajectory.T_world_camera) == 360_000
    for i in (0, 77, 359_999):
        expected = rigid(rotation_from_quaternion_xyzw(rows[i].quaternion_xyzw), rows[i].translation_m)
        np.testing.assert_array_equal(trajectory.T_world_camera[i], expected)


def test_the_first_wrong_row_is_named() -> None:
    good, nan = TimedPose(0, (0, 0, 0), (0, 0, 0, 1), "row 0"), float("nan")
    wrong = [
        (good._replace(translation_m=(0, nan, 0), where="row 1"), "row 1: the pose holds NaN"),
        (good._replace(translation_m=(0, 0, -1e308), where="row 2"), r"row 2: the pose is beyond 1e\+07 m"),
        (good._replace(quaternion_xyzw=(0, 0, 0, 0), where="row 3"), "row 3: the quaternion has length zero"),
    ]
    for first in range(3):
        rows = [good, *(row for row, _ in wrong[first:] + wrong[:first])]
        with raises(RecordingError, "recording.bad-poses", match=wrong[first][1]):
            trajectory_from_poses(rows, "t.txt")
