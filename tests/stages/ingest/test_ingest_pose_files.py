"""Files with the poses of all frames, as other programs write them."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import write_folder, write_tum

from kinectbench.core.types import Float64
from kinectbench.doctor import inspect
from kinectbench.stages.ingest.readers import open_recording as opened


def poses() -> Float64:
    """(4, 4, 4): cameras side by side."""
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, 0, 3] = [0.0, 0.1, 0.2, 0.3]
    return T


def in_rows(matrix: Float64) -> str:
    return "\n".join(" ".join(map(str, row)) for row in matrix)


def with_id(order: list[int]) -> str:
    """RTAB-Map's rows, times of its own and ids of frames."""
    rows = [f"{1341841279.5 + i} {0.1 * i} 0 0 0 0 0 1 {i}" for i in order]
    return "\n".join(["#timestamp x y z qx qy qz qw id", *rows])


@pytest.mark.parametrize(
    ("name", "text", "known"),
    [
        ("poses.txt", with_id([0, 1, 2, 3]), [0, 1, 2, 3]),
        ("poses.txt", with_id([3, 1]), [1, 3]),
        ("traj.txt", "\n".join(" ".join(map(str, T.ravel())) for T in poses()), [0, 1, 2, 3]),
        ("poses.txt", "\n".join(" ".join(map(str, T[:3].ravel())) for T in poses()), [0, 1, 2, 3]),
        (
            "groundtruth.txt",
            "\n".join(f"{1305031102.1 + 0.033 * i} {0.1 * i} 0 0 0 0 0 1" for i in range(4)),
            [0, 1, 2, 3],
        ),
        ("poses.txt", "\n\n".join(in_rows(T) for T in poses()), [0, 1, 2, 3]),
        ("poses.txt", "\n".join(in_rows(T[:3]) for T in poses()), [0, 1, 2, 3]),
        ("poses.txt", "\n".join(str(T) for T in poses()), [0, 1, 2, 3]),  # as NumPy prints them
        ("poses.txt", "\n".join(f"{i}\n{in_rows(T)}" for i, T in enumerate(poses())), [0, 1, 2, 3]),
        ("traj.txt", "\n".join(f"{i} {i} 0\n{in_rows(T)}" for i, T in enumerate(poses())), [0, 1, 2, 3]),
    ],
)
def test_poses_by_other_programs(tmp_path: Path, name: str, text: str, known: list[int]) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / name).write_text(text + "\n")
    recording = opened(folder)
    assert recording.given_trajectory is not None and not recording.trajectory_error
    np.testing.assert_array_equal(recording.given_trajectory.stamps_ns, recording.stamps_ns[known])
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera, poses()[known], atol=1e-12)


@pytest.mark.parametrize(("first", "words"), [(0, ""), (1, "its numbers are +1 off those of the frames")])
def test_poses_counted_from_one_are_of_the_frames_counted_from_zero(
    tmp_path: Path, first: int, words: str
) -> None:
    folder = write_folder(tmp_path / "r")
    rows = [f"{first + i} {0.1 * i} 0 0 0 0 0 1" for i in range(4)]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    recording = opened(folder)
    assert recording.given_trajectory is not None
    np.testing.assert_array_equal(recording.given_trajectory.stamps_ns, recording.stamps_ns)
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera, poses(), atol=1e-12)
    assert any(words in line for line in recording.warnings) if words else recording.warnings == ()


@pytest.mark.parametrize(("first_s", "by_stamp"), [(1305031102.1, True), (0.033, False)])
def test_rows_in_no_order_are_taken_by_stamps_of_today(
    tmp_path: Path, first_s: float, by_stamp: bool
) -> None:
    """Small stamps may be steps since the frame before: of these only the rows' order tells."""
    folder = write_folder(tmp_path / "r")
    order = [2, 0, 3, 1]
    rows = [f"{first_s + 0.033 * i} {0.1 * i} 0 0 0 0 0 1" for i in order]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    recording = opened(folder)
    assert recording.given_trajectory is not None
    expected = poses() if by_stamp else poses()[order]
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera, expected, atol=1e-12)
    said = [
        line for line in recording.warnings if "no order of time: each pose is taken by its stamp" in line
    ]
    assert len(said) == by_stamp


@pytest.mark.parametrize("read", ["trajectory.txt", "trajectory.log", "poses.txt"])
def test_a_second_file_with_poses_is_named(tmp_path: Path, read: str) -> None:
    folder = write_folder(tmp_path / "r")
    rows = "".join(f"{i} {0.1 * i} 0 0 0 0 0 1\n" for i in range(4))
    log = "".join(f"{i} {i} 0\n{in_rows(T)}\n" for i, T in enumerate(poses()))
    for name in (read, "groundtruth.txt"):
        (folder / name).write_text(log if name.endswith("log") else rows)
    assert any(f"{read}: is read, and not groundtruth.txt" in line for line in opened(folder).warnings)


@pytest.mark.parametrize("write", [write_folder, write_tum])
@pytest.mark.parametrize(
    "name", ["camera_poses.csv", "ground_truth.txt", "gt.txt", "cam2world.npy", "lowres_wide.traj"]
)
def test_files_that_look_like_poses_are_named_once(
    tmp_path: Path, write: Callable[[Path], Path], name: str
) -> None:
    folder = write(tmp_path / "r")
    (folder / "groundtruth.txt").unlink(missing_ok=True)
    assert not any("by name poses" in line for line in opened(folder).warnings)
    (folder / name).touch()
    (line,) = (line for line in opened(folder).warnings if "poses" in line)
    assert f"no trajectory is read; not read, by name poses: {name}; write it as" in line
    said = [found.what for found in inspect(folder)[0].findings if name in found.what]
    assert said == [line]


def test_colmaps_model_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "sparse/0").mkdir(parents=True)
    (folder / "sparse/0/images.bin").touch()
    (line,) = opened(folder).warnings
    assert "not read, by name poses: sparse/0/images.bin" in line


def test_a_folder_of_poses_that_is_not_read_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "pose").mkdir()
    for i in range(4):
        (folder / f"pose/{i:06d}.json").write_text("{}")
    (folder / "extrinsics").mkdir()
    (folder / "extrinsics" / "20150118.txt").touch()  # SUN RGB-D's tilt of the camera
    (line,) = opened(folder).warnings
    assert "extrinsics" not in line and "not read, by name poses: pose/000000.json, pose/000001.json" in line


def with_numbered_poses(tmp_path: Path, form: str, numbers: Sequence[int]) -> Path:
    """A recording of depth_0 to depth_3, with poses in files whose names have these numbers."""
    folder = write_folder(tmp_path / "r", [f"depth_{i}" for i in range(4)])
    (folder / "pose").mkdir()
    for i in numbers:
        (folder / "pose" / form.format(i)).write_text(in_rows(poses()[i % 4]))
    return folder


@pytest.mark.parametrize(
    ("form", "numbers", "said"),
    [
        ("pose_{:04d}.txt", range(4), ""),
        ("frame-{:06d}.pose.txt", range(4), ""),
        ("{:06d}.txt", (0, 2, 3), "3 poses are matched by the number in their names, and 0 are of no frame"),
        (
            "pose_{:04d}.txt",
            range(40),
            "4 poses are matched by the number in their names, and 36 are of no frame",
        ),
    ],
)
def test_poses_of_other_names_than_depth_are_matched_by_number(
    tmp_path: Path, form: str, numbers: Sequence[int], said: str
) -> None:
    folder = with_numbered_poses(tmp_path, form, numbers)
    recording, known = opened(folder), [i for i in numbers if i < 4]
    assert recording.warnings == () if not said else said in recording.warnings[0]
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.stamps_ns.tolist() == recording.stamps_ns[known].tolist()
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera, poses()[known], atol=1e-12)


@pytest.mark.parametrize(
    ("form", "numbers", "said"),
    [
        ("pose_{:04d}.txt", range(1, 5), "their numbers begin with 1, those of depth with 0"),
        ("pose_{:04d}.txt", range(1, 4), "their numbers begin with 1, those of depth with 0"),
        ("pose_{:04d}.txt", (10, 20), "their numbers begin with 10, those of depth with 0"),
        ("pose_{:04d}.txt", (0, 2, 5), "3 files of poses are of no frame, such as pose_0000.txt"),
        ("first.txt", (0,), "1 files of poses are of no frame, such as first.txt"),
    ],
)
def test_poses_whose_numbers_are_not_those_of_depth_are_named(
    tmp_path: Path, form: str, numbers: Sequence[int], said: str
) -> None:
    folder = with_numbered_poses(tmp_path, form, numbers)
    recording = opened(folder)
    (line,) = recording.warnings
    assert recording.given_trajectory is None and said in line
    assert line.endswith("name each as its depth image is named")


def test_a_pose_without_its_last_row_is_read_from_a_file_of_its_own(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "pose").mkdir()
    for i, T in enumerate(poses()):
        (folder / f"pose/{i:06d}.txt").write_text(in_rows(T[:3]))
    for depth in sorted((folder / "depth").iterdir()):
        depth.rename(depth.with_name(f"{int(depth.stem):06d}.png"))
    recording = opened(folder)
    assert recording.given_trajectory is not None and not recording.trajectory_error
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera, poses(), atol=1e-12)
    (folder / "pose/000002.txt").write_text("0 0 0 0 0 0 1\n")
    assert "holds 7 numbers, not the 4x4 of a matrix: write 16 numbers, the matrix row" in str(
        opened(folder).trajectory_error
    )


def test_poses_that_are_no_whole_matrices_are_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "poses.txt").write_text("\n".join(in_rows(T) for T in poses()).rsplit("\n", 2)[0] + "\n")
    assert "holds 14 rows of four numbers" in opened(folder).trajectory_error


def test_poses_of_fewer_frames_in_no_order_are_refused(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "traj.txt").write_text("\n".join(" ".join(map(str, T.ravel())) for T in poses()[:3]) + "\n")
    assert "holds 3 poses for 4 frames" in opened(folder).trajectory_error


@pytest.mark.parametrize("said", ["", "2024-01-01 started 3\n", "12 frames dropped\n", "\0\xff"])
def test_another_programs_log_is_no_trajectory(tmp_path: Path, said: str) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "capture.log").write_text(said)
    alone = opened(folder)
    assert (alone.given_trajectory, alone.trajectory_error, alone.warnings) == (None, "", ())
    (folder / "poses.txt").write_text(with_id([0, 1, 2, 3]))
    given = opened(folder)
    assert given.given_trajectory is not None and len(given.given_trajectory.stamps_ns) == 4
    assert given.warnings == ()


@pytest.mark.parametrize("row", ["{} -1 -1", "{}", "{} 0 0.93"])
@pytest.mark.parametrize("begin", ["", "\ufeff"])
def test_a_log_of_any_name_may_have_other_words_behind_the_frame(
    tmp_path: Path, row: str, begin: str
) -> None:
    folder = write_folder(tmp_path / "r")
    blocks = "".join(f"{row.format(i)}\n{in_rows(T)}\n" for i, T in enumerate(poses()))
    (folder / "pose.log").write_text(begin + blocks)
    given = opened(folder).given_trajectory
    assert given is not None and len(given.stamps_ns) == 4


@pytest.mark.parametrize("name", ["trajectory.log", "scan.log"])
def test_a_log_of_redwood_is_found_beside_another_programs(tmp_path: Path, name: str) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "capture.log").write_text("started\n")
    (folder / name).write_text(
        "# camera to world\n" + "".join(f"{i} {i} 4\n{in_rows(T)}\n" for i, T in enumerate(poses()))
    )
    given = opened(folder).given_trajectory
    assert given is not None and len(given.stamps_ns) == 4
