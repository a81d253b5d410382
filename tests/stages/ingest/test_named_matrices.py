"""Cameras and poses that stand under names in a text, a JSON file or an array beside the images."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from bounds import within
from ingest_writers import FX, png, write_folder, write_tum
from ingest_writers import depth_image as depth
from raising import raises

from kinectbench.core import RecordingError
from kinectbench.stages.ingest.named_matrices import named_matrices, poses_by_frame
from kinectbench.stages.ingest.readers import open_recording

POSES = np.tile(np.eye(4), (4, 1, 1))
POSES[:, 0, 3] = 0.1 * np.arange(4)
STEMS = ("0000", "0001", "0002", "0003")
K = [[FX, 0.0, 20.0], [0.0, FX, 15.0], [0.0, 0.0, 1.0]]
# As the Amazon Picking Challenge has it, shortened.
TITLED = """# Objects: ["kleenex_tissue_box"]

# Color camera intrinsic matrix
 6.1519e+02\t0.0\t2.98e+02\t
 0.0 6.1519e+02 2.475e+02
 0.0 0.0 1.0

# Depth camera intrinsic matrix
 477.58 0 314.18
 0 477.58 245.88
 0 0 1
"""


def rows(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(map(str, row)) for row in matrix)


def given(path: Path) -> np.ndarray:
    recording = open_recording(path)
    assert not recording.trajectory_error
    assert recording.given_trajectory is not None, recording.warnings
    return recording.given_trajectory.T_world_camera


def test_poses_beside_the_camera_in_one_json_file(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", STEMS)
    (folder / "camera_intrinsic.json").unlink()
    stored = {"K": K} | {name: T.tolist() for name, T in zip(STEMS, POSES, strict=True)}
    (folder / "camera.json").write_text(json.dumps(stored))
    np.testing.assert_array_equal(given(folder), POSES)
    assert any("under the name of each frame" in line for line in open_recording(folder).warnings)


@pytest.mark.parametrize("inside", ["pose", "T_wc"])
def test_poses_below_the_names_of_frames(tmp_path: Path, inside: str) -> None:
    folder = write_folder(tmp_path / "r", STEMS)
    named = zip(STEMS, POSES, strict=True)
    content = {"frames": {name: {inside: T[:3].tolist(), "K": K} for name, T in named}}
    (folder / "frames.json").write_text(json.dumps(content))
    np.testing.assert_array_equal(given(folder), POSES)


def test_two_matrices_of_a_frame_are_not_told_apart(tmp_path: Path) -> None:
    content = {name: {"left": T.tolist(), "right": T.tolist()} for name, T in zip(STEMS, POSES, strict=True)}
    (tmp_path / "frames.json").write_text(json.dumps(content))
    assert poses_by_frame([tmp_path / "frames.json"], STEMS) is None


def test_poses_of_few_frames_are_none(tmp_path: Path) -> None:
    (tmp_path / "frames.json").write_text(json.dumps({"0000": np.eye(4).tolist()}))
    assert poses_by_frame([tmp_path / "frames.json"], STEMS) is None
    assert poses_by_frame([tmp_path / "frames.json"], STEMS[:1]) is None


@pytest.mark.parametrize(
    "content",
    [
        {name: {"obj_pose": T.tolist()} for name, T in zip(STEMS, POSES, strict=True)},
        {name: np.eye(4).tolist() for name in STEMS},
        {name: {"intrinsics": T.tolist()} for name, T in zip(STEMS, POSES, strict=True)},
    ],
)
def test_matrices_of_something_else_are_no_poses(tmp_path: Path, content: dict[str, object]) -> None:
    (tmp_path / "frames.json").write_text(json.dumps(content))
    assert poses_by_frame([tmp_path / "frames.json"], STEMS) is None


def test_short_numbers_name_frames_only_if_all_have_a_pose(tmp_path: Path) -> None:
    """Six cameras of a rig are not the first six of twelve frames."""
    rig = {"cameras": {str(i): POSES[i % 4].tolist() for i in range(6)}}
    (tmp_path / "rig.json").write_text(json.dumps(rig))
    assert poses_by_frame([tmp_path / "rig.json"], [str(i) for i in range(12)]) is None
    assert poses_by_frame([tmp_path / "rig.json"], [str(i) for i in range(6)]) is not None


def test_a_second_file_of_poses_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", STEMS)
    for name, shift in (("a.json", 0.0), ("b.json", 5.0)):
        moved = {stem: (T + shift * np.eye(4, k=3)).tolist() for stem, T in zip(STEMS, POSES, strict=True)}
        (folder / name).write_text(json.dumps(moved))
    np.testing.assert_array_equal(given(folder), POSES)
    assert any("and not from b.json" in line for line in open_recording(folder).warnings)


def test_named_matrices_that_are_no_poses_are_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", STEMS)
    content = {name: [[None] * 4] * 4 for name in STEMS}
    (folder / "frames.json").write_text(json.dumps(content))
    recording = open_recording(folder)
    assert recording.given_trajectory is None
    assert any("no matrix under the name of a frame is a pose" in line for line in recording.warnings)


def test_a_long_text_of_numbers_is_read_in_no_time(tmp_path: Path) -> None:
    (tmp_path / "imu.txt").write_text("# acc\n" + "1 2 3\n" * 1_000_000)
    with within(3):
        assert named_matrices(tmp_path / "imu.txt") == []


def test_a_text_with_titles(tmp_path: Path) -> None:
    """Without a file of intrinsics that is read, both cameras are named, and no other is assumed."""
    folder = tmp_path / "scene-0000"
    folder.mkdir()
    for i in range(4):
        (folder / f"frame-00000{i}.depth.png").write_bytes(png(np.full((480, 640), 1000 + i, np.uint16)))
    with_poses = "\n".join(f"# camera pose for frame-00000{i}\n{rows(T)}\n" for i, T in enumerate(POSES))
    (folder / "cam.info.txt").write_text(f"{TITLED}\n{with_poses}")
    both = "Color camera intrinsic matrix as .*fx: 615.19.*Depth camera intrinsic matrix as .*fx: 477.58"
    with raises(RecordingError, "recording.no-intrinsics", match=both):
        open_recording(folder)
    # A rotation hides no camera, nor does the number of words in a title.
    (folder / "cam.info.txt").write_text(
        "# Depth intrinsic\n477 0 314\n0 477 245\n0 0 1\n# R\n0 1 0\n1 0 0\n0 0 1\n"
    )
    with raises(RecordingError, "recording.no-intrinsics", match="Depth intrinsic as .*fx: 477"):
        open_recording(folder)
    (folder / "cam.info.txt").write_text(f"{TITLED}\n{with_poses}")
    (folder / "camera-intrinsics.txt").write_text("500 0 320 0 500 240 0 0 1")
    np.testing.assert_array_equal(given(folder), POSES)


def test_named_poses_of_a_rig_are_moved_to_depth(tmp_path: Path) -> None:
    """As those in files of their own."""
    folder = tmp_path / "scene"
    folder.mkdir()
    for i, T in enumerate(POSES):
        (folder / f"frame-00000{i}.depth.png").write_bytes(png(np.full((480, 640), 1000 + i, np.uint16)))
        (folder / f"frame-00000{i}.pose.txt").write_text(rows(T))
    numbers = "1 0 0 0.05 0 1 0 0 0 0 1 0 0 0 0 1"
    intrinsic = "500 0 320 0 0 500 240 0 0 0 1 0 0 0 0 1"
    info = f"m_calibrationDepthIntrinsic = {intrinsic}\nm_calibrationDepthExtrinsic = {numbers}\n"
    (folder / "_info.txt").write_text(f"m_depthWidth = 640\nm_depthHeight = 480\n{info}")
    alone = given(folder)
    assert alone[0, 0, 3] != 0
    for i in range(4):
        (folder / f"frame-00000{i}.pose.txt").unlink()
    named = {f"frame-00000{i}": T.tolist() for i, T in enumerate(POSES)}
    (folder / "poses.json").write_text(json.dumps(named))
    np.testing.assert_allclose(given(folder), alone)


def test_a_stored_array_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", STEMS)
    (folder / "camera_intrinsic.json").unlink()
    np.save(folder / "camera-intrinsics.npy", np.array(K))
    with raises(RecordingError, "recording.no-intrinsics", match="camera-intrinsics.npy holds the camera"):
        open_recording(folder)


def test_a_pose_in_an_array_for_each_frame(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", STEMS)
    (folder / "pose").mkdir()
    for name, T in zip(STEMS, POSES, strict=True):
        np.save(folder / f"pose/{name}.npy", T[:3])
    np.testing.assert_array_equal(given(folder), POSES)
    np.save(folder / "pose/0002.npy", np.zeros(7))
    assert "0002.npy: holds 0 numbers, not the 4x4" in open_recording(folder).trajectory_error
    for name in STEMS:  # keypoints of a person
        np.save(folder / f"pose/{name}.npy", np.zeros((17, 3)))
    recording = open_recording(folder)
    assert recording.given_trajectory is None and not recording.trajectory_error


def test_rows_without_stamps(tmp_path: Path) -> None:
    """They are of the frames in order, if there are as many; pose.txt with other content is only named."""
    folder = write_folder(tmp_path / "r", STEMS)
    lines = [f"{x} 0 0 0 0 0 1" for x in POSES[:, 0, 3]]
    (folder / "pose.txt").write_text("\n".join(lines))
    np.testing.assert_array_equal(given(folder), POSES)
    (folder / "pose.txt").write_text("\n".join(lines[:1]))
    recording = open_recording(folder)
    assert recording.given_trajectory is None and not recording.trajectory_error
    assert any("not read, by name poses: pose.txt" in line for line in recording.warnings)
    (folder / "pose.txt").write_text("1 0 0 0 0 0 0 1")
    assert open_recording(folder).given_trajectory is None
    shutil.move(folder / "pose.txt", folder / "poses.txt")
    (folder / "poses.txt").write_text("\n".join([*lines[:3], "nan nan nan nan nan nan nan"]))
    np.testing.assert_array_equal(given(folder), POSES[:3])
    (folder / "poses.txt").write_text("\n".join(f"{x} 1 0 0 0.1 0.2 0.3" for x in range(4)))
    assert "no unit quaternion" in open_recording(folder).trajectory_error
    (folder / "poses.txt").write_text(lines[0])
    assert "holds 1 poses for 4 frames" in open_recording(folder).trajectory_error


@pytest.mark.parametrize("content", [b"", b"\x80\x04K.", b"\x93NUMPY\x01\x00v\x00{'descr'", b"{" * 5000])
@pytest.mark.parametrize("suffix", [".json", ".npy", ".txt"])
def test_damaged_files_hold_no_matrices(tmp_path: Path, content: bytes, suffix: str) -> None:
    (tmp_path / f"camera{suffix}").write_bytes(content)
    assert named_matrices(tmp_path / f"camera{suffix}") == []


def test_depth_written_by_opencv_as_text_is_named(tmp_path: Path) -> None:
    (tmp_path / "depthMatrices").mkdir()
    (tmp_path / "Frames").mkdir()
    for i in range(6):
        (tmp_path / f"Frames/{i}.png").write_bytes(png(np.zeros((48, 64, 3), np.uint8)))
        numbers = ", ".join(map(str, depth(i, 1000.0).ravel()))
        head = "%YAML:1.0\ndepth: !!opencv-matrix\n   rows: 48\n   cols: 64\n   dt: w\n"
        (tmp_path / f"depthMatrices/{i}.yml").write_text(f"{head}   data: [ {numbers} ]\n")
    with raises(RecordingError, "recording.unknown-format", match=r"6 \.yml files.*cv2\.FileStorage"):
        open_recording(tmp_path)


def test_the_benchmark_s_own_intrinsics_are_offered(tmp_path: Path) -> None:
    """TUM's recordings hold none; where another file may hold them, that is named instead."""
    folder = write_tum(tmp_path / "r")
    (folder / "camera.json").unlink()
    for file in (folder / "depth").iterdir():
        file.write_bytes(png(np.full((480, 640), 5000, np.uint16)))
    with raises(RecordingError, "recording.no-intrinsics", match=r"freiburg3 `\{fx: 535.4, fy: 539.2"):
        open_recording(folder)
    (folder / "calib.ini").write_text("?")
    with raises(RecordingError, "recording.no-intrinsics", match="they may stand in calib.ini$"):
        open_recording(folder)
