"""ScanNet's exported folders, SUN3D's sequences, and plain folders with a pose or a matrix in a file."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import CX, CY, FX, FY, HEIGHT, WIDTH, color_image, depth_image, jpeg, png, write_folder
from kinectbench_plugins.formats.scene_folders import rotated
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import format_of, open_recording
from kinectbench.stages.ingest.recording import FileRecording

K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
# Turned by 90 degrees about y.
ROTATION = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


def pose(index: int) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[0, 3] = ROTATION, 0.5 * index
    return T


def in_4x4(matrix: np.ndarray) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, :3] = matrix
    return whole


def scannet(folder: Path, numbers: Sequence[int] = (0, 20, 40, 100)) -> Path:
    """Every twentieth frame, as people export them; colour twice as large, 10 mm beside depth."""
    for name in ("depth", "color", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True)
    for i in numbers:
        (folder / f"depth/{i}.png").write_bytes(png(depth_image(i, 1000.0)))
        (folder / f"color/{i}.jpg").write_bytes(jpeg(np.repeat(np.repeat(color_image(i), 2, 0), 2, 1)))
        np.savetxt(folder / f"pose/{i}.txt", pose(i) if i != 40 else np.full((4, 4), -np.inf))
    color_K = np.array([[2 * FX, 0, 2 * CX + 0.5], [0, 2 * FY, 2 * CY + 0.5], [0, 0, 1]])
    place = np.eye(4)
    place[0, 3] = 0.01
    named = {"intrinsic_depth": in_4x4(K), "intrinsic_color": in_4x4(color_K)}
    for name, matrix in (named | {"extrinsic_depth": np.eye(4), "extrinsic_color": place}).items():
        np.savetxt(folder / f"intrinsic/{name}.txt", matrix)
    return folder


def sun3d(folder: Path, frames: int = 5) -> Path:
    """Depth 5 ms behind colour, rotated; colour has one image more, and two files of poses."""
    for name in ("depth", "image", "extrinsics"):
        (folder / name).mkdir(parents=True)
    rows = []
    for i in range(frames + 1):
        (folder / f"image/{i + 1:07d}-{i * 33_333:012d}.jpg").write_bytes(jpeg(color_image(i)))
        rows.append(pose(i)[:3])
        if i < frames:
            depth = png(rotated(depth_image(i, 1000.0)))
            (folder / f"depth/{i + 1:07d}-{i * 33_333 + 5000:012d}.png").write_bytes(depth)
    np.savetxt(folder / "extrinsics/20130512130736.txt", np.zeros((3, 4)))
    np.savetxt(folder / "extrinsics/20140808220511.txt", np.vstack(rows))
    np.savetxt(folder / "intrinsics.txt", K)
    return folder


def test_an_exported_scene(tmp_path: Path) -> None:
    recording = open_recording(scannet(tmp_path / "r"))
    camera, calibration = recording.camera, recording.color_calibration
    assert (recording.format, len(recording), recording.depth_scale) == ("scannet", 4, 1000.0)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX, FY, CX, CY)
    assert calibration is not None and calibration.camera.width == 2 * WIDTH
    np.testing.assert_allclose(calibration.T_color_depth[:3, 3], [-0.01, 0, 0], atol=1e-12)
    assert recording.frame(3).stamp_ns == 100 * 10**9
    np.testing.assert_array_equal(recording.frame(3).depth, depth_image(100, 1000.0))
    given = recording.given_trajectory
    assert given is not None and given.stamps_ns.tolist() == [0, 20 * 10**9, 100 * 10**9]
    np.testing.assert_allclose(given.T_world_camera[2], pose(100), atol=1e-12)
    (warning,) = recording.warnings
    assert "1 of 4 frames have no pose" in warning


def test_poses_are_moved_from_the_rig_to_depth(tmp_path: Path) -> None:
    folder = scannet(tmp_path / "r")
    place = np.eye(4)
    place[1, 3] = 0.25
    np.savetxt(folder / "intrinsic/extrinsic_depth.txt", place)
    given = open_recording(folder).given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[1], pose(20) @ place, atol=1e-12)


def test_the_smaller_release_has_its_intrinsics_beside_the_folders(tmp_path: Path) -> None:
    folder = scannet(tmp_path / "r")
    (folder / "intrinsic/intrinsic_depth.txt").rename(folder / "intrinsics_depth.txt")
    (folder / "intrinsic/intrinsic_color.txt").unlink()
    recording = open_recording(folder)
    assert (recording.format, recording.camera.fx, recording.color_calibration) == ("scannet", FX, None)
    assert not recording.color_registered


@pytest.mark.parametrize(
    ("file", "text", "why"),
    [
        ("intrinsic/intrinsic_depth.txt", "1 2 3", "holds 3 numbers, not the 3x3"),
        ("intrinsic/intrinsic_depth.txt", "5000 0 9 0 5000 9 0 0 1", "a field of view of 1 degrees"),
        ("intrinsic/extrinsic_color.txt", "1 2", "not the 4x4 of a matrix"),
    ],
)
def test_what_a_scene_says_wrong(tmp_path: Path, file: str, text: str, why: str) -> None:
    folder = scannet(tmp_path / "r")
    (folder / file).write_text(text)
    with pytest.raises(RecordingError, match=why) as error:
        open_recording(folder)
    assert "\n" not in str(error.value)


def test_a_broken_pose_leaves_the_frames(tmp_path: Path) -> None:
    folder = scannet(tmp_path / "r")
    (folder / "pose/20.txt").write_text("1 2 3\n")
    recording = open_recording(folder)
    assert len(recording) == 4 and "not the 4x4" in recording.trajectory_error


def test_a_sequence_of_sun3d(tmp_path: Path) -> None:
    recording = open_recording(sun3d(tmp_path / "r"))
    assert (recording.format, len(recording), recording.warnings) == ("sun3d", 5, ())
    assert recording.color_registered
    frame = recording.frame(2)
    assert frame.stamp_ns == (2 * 33_333 + 5000) * 1000
    np.testing.assert_array_equal(frame.depth, depth_image(2, 1000.0))
    given = recording.given_trajectory
    assert given is not None and given.stamps_ns.tolist() == [i * 33_333_000 for i in range(6)]
    np.testing.assert_allclose(given.T_world_camera[5], pose(5), atol=1e-12)


def test_depth_of_sun3d_that_was_put_right_already_is_left(tmp_path: Path) -> None:
    folder = sun3d(tmp_path / "r")
    for i, file in enumerate(sorted((folder / "depth").iterdir())):
        file.write_bytes(png(depth_image(i, 1000.0)))
    np.testing.assert_array_equal(open_recording(folder).frame(2).depth, depth_image(2, 1000.0))


@pytest.mark.parametrize("stream", ["depth", "image"])
def test_a_stamp_of_sun3d_that_repeats_leaves_the_others_on_one_clock(tmp_path: Path, stream: str) -> None:
    folder = sun3d(tmp_path / "r", 12)
    files = sorted((folder / stream).iterdir())
    files[7].rename(files[7].with_name(files[7].name[:8] + files[6].name[8:]))
    recording = open_recording(folder)
    (warning, *_) = recording.warnings
    assert f"{stream}: 1 images repeat an earlier stamp" in warning
    kept = [i for i in range(12) if (stream, i) != ("depth", 7)]
    assert recording.stamps_ns.tolist() == [(i * 33_333 + 5000) * 1000 for i in kept]
    assert isinstance(recording, FileRecording)
    colors = [place.color and int(place.color.stem[:7]) - 1 for place in recording.places]
    assert colors == [None if (stream, i) == ("image", 7) else i for i in kept]
    given = recording.given_trajectory
    assert given is not None and len(given.stamps_ns) == (13 if stream == "depth" else 12)
    np.testing.assert_allclose(given.T_world_camera[-1], pose(12), atol=1e-12)
    for file in (folder / "image").iterdir():
        file.rename(file.with_name(f"{file.name[:7]}.jpg"))
    with raises(RecordingError, "recording.unpaired", match="its names hold no times"):
        open_recording(folder)


def test_poses_of_another_number_are_no_poses(tmp_path: Path) -> None:
    folder = sun3d(tmp_path / "r")
    np.savetxt(folder / "extrinsics/20150101000000.txt", np.ones((9, 4)))
    recording = open_recording(folder)
    said = "holds 36 numbers, not 12 for each of the 6 colour (or 5 depth) images"
    assert recording.given_trajectory is None and said in recording.trajectory_error


@pytest.mark.parametrize("name", ["pose", "poses"])
def test_a_plain_folder_with_a_file_of_each_pose(tmp_path: Path, name: str) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / name).mkdir()
    for i in (0, 1, 3):
        np.savetxt(folder / name / f"{i}.txt", pose(i))
    recording = open_recording(folder)
    given = recording.given_trajectory
    assert recording.format == "folder" and given is not None
    assert given.stamps_ns.tolist() == [0, 10**9, 3 * 10**9]
    np.testing.assert_allclose(given.T_world_camera[2], pose(3), atol=1e-12)


@pytest.mark.parametrize("name", ["intrinsics.txt", "intrinsic.txt", "camera-intrinsics.txt", "cam_K.txt"])
def test_a_plain_folder_with_a_matrix_by_any_usual_name(tmp_path: Path, name: str) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "camera_intrinsic.json").unlink()
    with raises(RecordingError, "recording.no-intrinsics"):
        open_recording(folder)
    np.savetxt(folder / name, K)
    assert open_recording(folder).camera.fx == FX
    # Where there is JSON, too, that is read: it says the size of the images and the depth scale.
    said = {"width": WIDTH, "height": HEIGHT, "fx": 70, "fy": 70, "cx": CX, "cy": CY}
    (folder / "intrinsics.json").write_text(json.dumps(said))
    assert open_recording(folder).camera.fx == 70


def test_settings_win(tmp_path: Path) -> None:
    for make in (scannet, sun3d):
        folder = make(tmp_path / make.__name__)
        assert format_of(folder) == make.__name__
        recording = open_recording(folder, CameraSettings(fx=70.0, depth_scale=500.0))
        assert (recording.camera.fx, recording.camera.fy, recording.depth_scale) == (70.0, FY, 500.0)
