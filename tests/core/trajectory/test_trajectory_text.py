"""Stamps, text rows and trajectory files."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import closest_rotation, rigid
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import check_unit, first_by_stamp, format_stamp, parse_stamp_ns
from kinectbench.core.trajectory.trajectory_file import (
    read_trajectory_file,
    trajectory_from_matrices,
    trajectory_text,
)


def test_stamps_are_exact() -> None:
    assert parse_stamp_ns("1305031107.130308", "") == 1_305_031_107_130_308_000
    assert parse_stamp_ns("1305031107.123456789", "") == 1_305_031_107_123_456_789
    assert parse_stamp_ns("1.305031107e9", "") == 1_305_031_107_000_000_000
    assert parse_stamp_ns("0", "") == parse_stamp_ns("1e-999999999", "") == 0
    assert parse_stamp_ns("9223372036.8547758074", "") == 2**63 - 1


@pytest.mark.parametrize(
    "text",
    [
        *("nan", "inf", "1e30", "-1e18", "abc", "", "12:30", "1e999999999", "13_05"),
        *("9223372036.8547758079", "9223372036.8547758075", "-9223372036.854775808"),  # 2^63 when rounded
    ],
)
def test_what_is_no_stamp(text: str) -> None:
    with raises(RecordingError, "recording.bad-stamp", match=r"f\.txt, line 3.*not"):
        parse_stamp_ns(text, "f.txt, line 3")


@given(st.integers(-(10**18), 2**62))
def test_stamp_round_trip(stamp_ns: int) -> None:
    assert parse_stamp_ns(format_stamp(stamp_ns), "") == stamp_ns


def test_first_by_stamp() -> None:
    said = "f.txt: 2 rows repeat an earlier stamp and were left out"
    assert first_by_stamp([5, 3, 5, 4, 3], "f.txt", "rows") == ([1, 3, 0], [said])
    assert first_by_stamp([5, 3], "f.txt", "rows") == ([1, 0], [])


def write(path: Path, *rows: str) -> Path:
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


def test_unsorted_and_repeated_poses(tmp_path: Path) -> None:
    file = write(tmp_path / "t.txt", "# c", "2 1 0 0 0 0 0 1", "", "1.5 0 0 0 0 0 0.6 0.8", "2 1 0 0 0 0 0 1")
    trajectory, warnings = read_trajectory_file(file)
    assert trajectory.stamps_ns.tolist() == [1_500_000_000, 2_000_000_000]
    assert warnings == [
        f"{file}: 1 poses repeat an earlier stamp and were left out",
        f"{file}: its rows are in no order of time: each pose is taken by its stamp",
    ]
    np.testing.assert_allclose(
        trajectory.T_world_camera[0, :2, :2], [[0.28, -0.96], [0.96, 0.28]], atol=1e-15
    )
    np.testing.assert_allclose(trajectory.T_world_camera[1, :3, 3], [1, 0, 0])


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1 nan 0 0 0 0 0 1", "line 2: the pose holds NaN or infinity"),
        ("1 inf 0 0 0 0 0 1", "line 2: the pose holds NaN or infinity"),
        ("1 0 0 -1e308 0 0 0 1", r"line 2: the pose is beyond 1e\+07 m; give metres"),
        ("1 0 0 0 0 0 0 0", "line 2: the quaternion has length zero"),
        ("1 0 0 0 0 0 1", "line 2: holds 7 values, not the 8"),
        ("1 0 0 zero 0 0 0 1", "line 2: 'zero' is not a number"),
        ("1 0 0 1_0 0 0 0 1", "line 2: '1_0' is not a number"),
        ("noon 0 0 0 0 0 0 1", "line 2: 'noon' is not a time stamp"),
    ],
)
def test_bad_rows_are_named(tmp_path: Path, row: str, message: str) -> None:
    with pytest.raises(RecordingError, match=f"t.txt, {message}"):
        read_trajectory_file(write(tmp_path / "t.txt", "0 0 0 0 0 0 0 1", row))


def test_files_that_are_no_trajectory(tmp_path: Path) -> None:
    with raises(RecordingError, "recording.bad-poses", match="trajectory is empty"):
        read_trajectory_file(write(tmp_path / "t.txt", "# nothing"))
    (tmp_path / "b.txt").write_bytes(b"\xff\xfe\x00")
    with raises(RecordingError, "recording.malformed", match=r"b\.txt"):
        read_trajectory_file(tmp_path / "b.txt")


def test_round_trip_is_exact(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rotations = closest_rotation(rng.normal(size=(50, 3, 3)))
    T = np.stack([rigid(r, rng.normal(size=3)) for r in rotations])
    stamps_ns = np.sort(rng.integers(0, 2**60, 50))
    (tmp_path / "t.txt").write_text(trajectory_text(GivenTrajectory(stamps_ns, T)))
    again, warnings = read_trajectory_file(tmp_path / "t.txt")
    assert warnings == []
    np.testing.assert_array_equal(again.stamps_ns, stamps_ns)
    np.testing.assert_array_equal(again.T_world_camera[:, :3, 3], T[:, :3, 3])
    np.testing.assert_allclose(again.T_world_camera, T, rtol=0, atol=1e-12)


def test_matrices_that_are_no_poses_are_dropped() -> None:
    mirrored, scaled, nan = np.diag([1.0, 1, -1, 1]), np.diag([2.0, 2, 2, 1]), np.full((4, 4), np.nan)
    trajectory, warnings = trajectory_from_matrices(
        [0, 1, 2, 3, 4], [np.eye(4), mirrored, scaled, nan, None], "r"
    )
    assert trajectory is not None
    assert trajectory.stamps_ns.tolist() == [0]
    assert warnings == [
        "r: 4 of 5 frames have no pose, or one that is not finite and rigid (first at 0.000000001 s)"
    ]
    assert trajectory_from_matrices([0], [nan], "r")[0] is None


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("1305031107130", "milliseconds"),
        ("1305031107130.25", "milliseconds"),
        ("1305031107130308", "microseconds"),
        ("1305031107130308000", "nanoseconds"),
    ],
)
def test_a_stamp_in_another_unit_is_named(text: str, unit: str) -> None:
    with raises(RecordingError, "recording.bad-stamp", match=f"1.*'{text}'.*{unit}"):
        parse_stamp_ns(text, "r.txt, line 1")


def test_steps_of_stamps_tell_their_unit() -> None:
    step_ns = 33_333_333
    assert check_unit([i * step_ns for i in range(9)], "r") == []
    assert check_unit([i * 1500 * 10**6 for i in range(9)], "r") == []  # keyframes
    (warning,) = check_unit([i * step_ns * 1000 for i in range(9)], "r")
    assert "images are 33.3333 s apart; if the stamps are milliseconds" in warning
    for factor, unit in ((10**6, "microseconds"), (10**9, "nanoseconds")):
        with raises(RecordingError, "recording.bad-stamp", match=f"like {unit}"):
            check_unit([i * step_ns * factor for i in range(9)], "r")
