"""nerfstudio's transforms.json with depth and Polycam's raw data, written here from their own pages."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ingest_writers import depth_image, jpeg, png, write_folder
from raising import raises
from read_pictures import decoded_picture
from test_ingest_phones_bop import BIG, ROTATION, SMALL, big_color, confidence

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError, OddImageError
from kinectbench.stages.ingest.plausibility import check_size
from kinectbench.stages.ingest.readers import format_of, open_recording

# Of colour 4 times as large as depth, (0.5, 0.5) the centre of its first pixel.
SHARED = {"w": BIG[0], "h": BIG[1], "fl_x": 240.0, "fl_y": 244.0, "cx": 128.0, "cy": 96.0}


def pose(index: int) -> list[list[float]]:
    """At x = 0.5 * index, OpenGL's axes: x right, y up, z back."""
    T = np.eye(4)
    T[:3, :3] = ROTATION @ np.diag([1, -1, -1])
    T[0, 3] = 0.5 * index
    return T.tolist()


def transforms(
    folder: Path,
    shared: dict[str, Any] | None = None,
    frame: dict[str, Any] | None = None,
    of_one: dict[str, Any] | None = None,
) -> Path:
    """Frames 0, 2, 10 listed from the last to the first; `of_one` changes the first that is listed."""
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True)
    rows = []
    for i in (10, 2, 0):
        (folder / f"depth/d_{i}.png").write_bytes(png(depth_image(i, 1000.0)))
        (folder / f"images/d_{i}.jpg").write_bytes(jpeg(big_color(i % 6)))
        row = {"file_path": f"./images/d_{i}.jpg", "depth_file_path": f"./depth/d_{i}.png"}
        rows.append(row | {"transform_matrix": pose(i)} | (frame or {}))
    rows[0] |= of_one or {}
    kept = [{key: value for key, value in row.items() if value is not None} for row in rows]
    said = SHARED | {"frames": kept} | (shared or {})
    (folder / "transforms.json").write_text(json.dumps(said))
    return folder


def test_transforms_with_depth(tmp_path: Path) -> None:
    recording = open_recording(transforms(tmp_path / "r"))
    camera = recording.camera
    assert (recording.format, len(recording), recording.warnings) == ("nerfstudio", 3, ())
    assert recording.up_world is None
    assert (camera.width, camera.fx, camera.fy, camera.cx, camera.cy) == (64, *SMALL)
    assert (recording.depth_scale, recording.color_registered) == (1000.0, True)
    # In the order people count, not in that of the file.
    for place, i in enumerate((0, 2, 10)):
        frame = recording.frame(place)
        assert frame.stamp_ns == place * 10**9
        np.testing.assert_array_equal(frame.depth, depth_image(i, 1000.0))
        assert frame.color is not None
        bgr = decoded_picture(frame.color[1], 1).astype(int)
        assert np.abs(bgr - big_color(i % 6)[::4, ::4]).max() < 12
    given = recording.given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[2][:3, :3], ROTATION, atol=1e-12)
    np.testing.assert_allclose(given.T_world_camera[2][:3, 3], [5, 0, 0], atol=1e-12)


def test_names_of_windows(tmp_path: Path) -> None:
    file = transforms(tmp_path / "r") / "transforms.json"
    file.write_text(file.read_text().replace("./depth/", "depth\\\\").replace("./images/", "images\\\\"))
    recording = open_recording(file.parent)
    assert (len(recording), recording.warnings) == (3, ())
    np.testing.assert_array_equal(recording.frame(1).depth, depth_image(2, 1000.0))
    assert recording.frame(1).color is not None


def test_names_of_colour_without_a_suffix(tmp_path: Path) -> None:
    """As instant-ngp and data sets of Blender have them."""
    folder = transforms(tmp_path / "r")
    text = (folder / "transforms.json").read_text()
    (folder / "transforms.json").write_text(text.replace(".jpg", ""))
    recording = open_recording(folder)
    assert (recording.color_registered, recording.warnings) == (True, ())
    (folder / "images/d_2.jpg").unlink()
    (line,) = open_recording(folder).warnings
    assert "1 of its colour images are not there, such as './images/d_2'" in line


@pytest.mark.parametrize("of_height", [True, False])
def test_an_angle_of_view_is_a_focal_length(tmp_path: Path, of_height: bool) -> None:
    angle_x, angle_y = (2 * np.arctan(side / 2 / focal) for side, focal in zip(BIG, (240, 244), strict=True))
    shared = dict.fromkeys(SHARED) | {"camera_angle_x": angle_x}
    camera = open_recording(
        transforms(tmp_path / "r", shared | ({"camera_angle_y": angle_y} if of_height else {}))
    ).camera
    fx, fy, cx, cy = SMALL
    expected = (fx, fy if of_height else fx, cx, cy)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx(expected)
    with raises(RecordingError, "recording.bad-intrinsics", match="no angle of view between 0 and pi"):
        open_recording(transforms(tmp_path / "s", shared | {"camera_angle_x": 4.0}))


def test_every_frame_can_have_its_own_intrinsics(tmp_path: Path) -> None:
    gone = dict.fromkeys(SHARED)
    same = open_recording(transforms(tmp_path / "a", gone, SHARED))
    assert (same.camera.fx, same.camera.cx, same.warnings) == (SMALL[0], SMALL[2], ())
    # As a phone that focuses.
    near = open_recording(transforms(tmp_path / "b", gone, SHARED, {"fl_x": 245.0}))
    assert near.camera.fx == SMALL[0]
    assert "differ by 5.0 pixels" in near.warnings[0]
    with raises(RecordingError, "recording.two-cameras", match="by 60 pixels"):
        open_recording(transforms(tmp_path / "c", gone, SHARED, {"fl_x": 300.0}))
    with raises(RecordingError, "recording.two-cameras", match="several"):
        open_recording(transforms(tmp_path / "d", gone, SHARED, {"w": 640, "h": 480}))


@pytest.mark.parametrize(
    ("key", "unit"), [("depth_unit_scale_factor", 0.0002), ("integer_depth_scale", 0.01)]
)
def test_units_of_depth(tmp_path: Path, key: str, unit: float) -> None:
    assert open_recording(transforms(tmp_path / "r", {key: unit})).depth_scale == pytest.approx(1 / unit)
    warned = open_recording(tmp_path / "r", CameraSettings(depth_scale=1000.0))
    assert (warned.depth_scale, len(warned.warnings)) == (1000.0, 1)


def test_an_applied_scale_is_taken_back(tmp_path: Path) -> None:
    given = open_recording(transforms(tmp_path / "r", {"applied_scale": 2.0})).given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[2][:3, 3], [2.5, 0, 0], atol=1e-12)


def test_lens_distortion_is_taken_out_of_depth_and_colour(tmp_path: Path) -> None:
    plain = open_recording(transforms(tmp_path / "a"))
    bent = open_recording(transforms(tmp_path / "b", {"camera_model": "OPENCV", "k1": -0.2, "p1": 0.01}))
    K, D = plain.camera.K, np.array([-0.2, 0.0, 0.01, 0.0])
    found, raw = bent.frame(1).depth, plain.frame(1).depth
    # Where each pinhole pixel lies in the image that was recorded, by OpenCV's own projection.
    rays = np.dstack([*np.meshgrid(np.arange(64.0), np.arange(48.0)), np.ones((48, 64))])
    rays = rays.reshape(-1, 3) @ np.linalg.inv(K).T
    at = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, D)[0].reshape(48, 64, 2)
    u, v = np.rint(at[..., 0]).astype(int), np.rint(at[..., 1]).astype(int)
    sure = (np.abs(at - np.floor(at) - 0.5) > 0.1).all(axis=2) & (u >= 1) & (u < 63) & (v >= 1) & (v < 47)
    assert sure.mean() > 0.4
    np.testing.assert_array_equal(found[sure], raw[v[sure], u[sure]])
    assert (found != raw).mean() > 0.3
    one, other = bent.frame(1).color, plain.frame(1).color
    assert one is not None and other is not None and one[1] != other[1]


def test_colour_alone_is_refused_in_one_line(tmp_path: Path) -> None:
    folder = transforms(tmp_path / "r", frame={"depth_file_path": None})
    for file in (folder / "depth").iterdir():
        file.unlink()
    (folder / "depth").rmdir()
    assert format_of(folder) == "nerfstudio"
    with raises(RecordingError, "recording.no-depth", match="3") as e:
        open_recording(folder)
    assert "\n" not in str(e.value)


def test_a_plain_folder_with_a_transforms_json_of_colour_is_a_plain_folder(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "transforms.json").write_text(json.dumps(SHARED | {"frames": [{"file_path": "color/0.jpg"}]}))
    assert format_of(folder) == "folder"


def test_parts_of_transforms_that_are_missing(tmp_path: Path) -> None:
    folder = transforms(tmp_path / "a", of_one={"depth_file_path": None})
    recording = open_recording(folder)
    assert len(recording) == 2
    assert "1 frames have no depth_file_path" in recording.warnings[0]
    (folder / "images/d_2.jpg").unlink()
    assert open_recording(folder).frame(1).color is None
    (folder / "depth/d_2.png").unlink()
    with raises(DamagedImageError, "recording.damaged-image", match="missing"):
        open_recording(folder).frame(1)
    without = open_recording(transforms(tmp_path / "b", frame={"transform_matrix": None}))
    assert (without.given_trajectory, without.trajectory_error, without.warnings) == (None, "", ())
    silent = transforms(tmp_path / "c", {"fl_x": None})
    with raises(RecordingError, "recording.no-intrinsics"):
        open_recording(silent)
    given = CameraSettings(fx=60.0, fy=61.0, cx=31.5, cy=23.5)
    assert open_recording(silent, given).camera.fx == 60.0


@pytest.mark.parametrize(
    ("shared", "frame", "why"),
    [
        ({"frames": {}, "by": "depth_file_path"}, {}, "'frames' must be a list"),
        ({"frames": [1], "by": "depth_file_path"}, {}, "'frames' must be a list"),
        ({"fl_x": "wide"}, {}, "'fl_x' must be a number"),
        ({"fl_x": -240.0}, {}, "a focal length is not positive"),
        ({"w": 0}, {}, "which is another shape"),
        ({"w": 300}, {}, "the intrinsics are for 300x192 images, but the depth images are 64x48"),
        ({"camera_model": "OPENCV_FISHEYE"}, {}, "cameras of the model OPENCV_FISHEYE are not read"),
        ({"k4": 0.1}, {}, "k4 is not 0, which is not read"),
        ({}, {"depth_file_path": "../other/d.png"}, "does not name a file inside"),
        ({}, {"depth_file_path": "/etc/passwd"}, "does not name a file inside"),
        ({}, {"depth_file_path": 7}, "does not name a file inside"),
        ({}, {"file_path": "../other.jpg"}, "does not name a file inside"),
        ({"depth_unit_scale_factor": 0}, {}, "its depth scale must be above 0"),
        ({"depth_unit_scale_factor": "mm"}, {}, "its depth scale must be a number"),
    ],
)
def test_a_wrong_transforms_json(
    tmp_path: Path, shared: dict[str, Any], frame: dict[str, Any], why: str
) -> None:
    folder = transforms(tmp_path / "r", shared, frame)
    with pytest.raises(RecordingError, match=why) as error:
        open_recording(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e300])
def test_poses_of_transforms_that_are_none(tmp_path: Path, value: float) -> None:
    T = pose(0)
    T[0][0] = value
    recording = open_recording(transforms(tmp_path / "a", of_one={"transform_matrix": T}))
    assert recording.given_trajectory is not None and len(recording.given_trajectory.stamps_ns) == 2
    assert "1 of 3 frames have no pose, or one that is not finite and rigid" in recording.warnings[0]
    broken = open_recording(transforms(tmp_path / "b", of_one={"transform_matrix": [1, 2]}))
    assert "'transform_matrix' must be four rows of four numbers" in broken.trajectory_error
    nothing = open_recording(transforms(tmp_path / "c", {"applied_scale": 0}))
    assert "'applied_scale' must be above 0" in nothing.trajectory_error


STAMPS_US = (1_671_000_000_000_000, 1_671_000_000_100_000, 1_671_000_000_200_000)


def polycam(folder: Path, change: dict[str, Any] | None = None, *, corrected: bool = True) -> Path:
    inside = folder / "keyframes"
    kinds = ("", "corrected_") if corrected else ("",)
    for name in ("depth", "confidence", *(f"{k}{n}" for k in kinds for n in ("images", "cameras"))):
        (inside / name).mkdir(parents=True)
    for i, stamp_us in enumerate(STAMPS_US):
        (inside / f"depth/{stamp_us}.png").write_bytes(png(depth_image(i, 1000.0)))
        levels = np.array([0, 127, 255], np.uint8)[confidence()]
        (inside / f"confidence/{stamp_us}.png").write_bytes(png(levels))
        for kind in kinds:
            T = np.array(pose(i))
            # ARKit's own poses are a little off.
            T[1, 3] = 0.0 if kind else 0.25
            said = {"fx": 240.0, "fy": 244.0, "cx": 127.5, "cy": 95.5, "width": BIG[0], "height": BIG[1]}
            said |= {f"t_{row}{column}": T[row, column] for row in range(3) for column in range(4)}
            said |= {"blur_score": 100.0, "timestamp": stamp_us} | (change or {})
            (inside / f"{kind}cameras/{stamp_us}.json").write_text(json.dumps(said))
            (inside / f"{kind}images/{stamp_us}.jpg").write_bytes(jpeg(big_color(i if kind else 5)))
    return folder


@pytest.mark.parametrize("least", [0, 1, 2])
def test_polycams_raw_data(tmp_path: Path, least: int) -> None:
    recording = open_recording(polycam(tmp_path / "r"), CameraSettings(min_confidence=least))
    camera = recording.camera
    assert (recording.format, len(recording), recording.warnings) == ("polycam", 3, ())
    assert recording.up_world == (0, 1, 0)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == SMALL
    assert recording.stamps_ns.tolist() == [stamp * 1000 for stamp in STAMPS_US]
    frame = recording.frame(2)
    np.testing.assert_array_equal(frame.depth, np.where(confidence() >= least, depth_image(2, 1000.0), 0))
    assert frame.color is not None
    bgr = decoded_picture(frame.color[1], 1).astype(int)
    assert np.abs(bgr - big_color(2)[::4, ::4]).max() < 12
    given = recording.given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[2][:3, :3], ROTATION, atol=1e-12)
    np.testing.assert_allclose(given.T_world_camera[2][:3, 3], [1, 0, 0], atol=1e-12)


def test_polycam_without_optimised_poses(tmp_path: Path) -> None:
    recording = open_recording(polycam(tmp_path / "r", corrected=False))
    assert "has no corrected_cameras; ARKit's own poses are taken" in recording.warnings[0]
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.T_world_camera[0][1, 3] == 0.25


def test_parts_of_polycam_that_are_missing_or_wrong(tmp_path: Path) -> None:
    folder = polycam(tmp_path / "a")
    inside = folder / "keyframes"
    # Poses that were optimised are never mixed with those that were not.
    (inside / f"corrected_cameras/{STAMPS_US[1]}.json").unlink()
    recording = open_recording(folder)
    assert recording.given_trajectory is not None and len(recording.given_trajectory.stamps_ns) == 2
    assert "1 of 3 frames have no pose" in recording.warnings[0]
    (inside / f"confidence/{STAMPS_US[0]}.png").write_bytes(png(np.zeros((4, 4), np.uint8)))
    with raises(DamagedImageError, "recording.damaged-image", match="depth image"):
        open_recording(folder).frame(0)
    for file in (inside / "depth").iterdir():
        file.unlink()
    with raises(RecordingError, "recording.no-depth", match="depth image"):
        open_recording(folder)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"fx": "wide"}, "'fx' must be a number"),
        ({"fx": 0.0}, "a focal length is not positive"),
        ({"width": 100}, "which is another shape"),
        ({"height": None}, "'height' must be a number"),
    ],
)
def test_a_wrong_camera_of_polycam(tmp_path: Path, change: dict[str, Any], why: str) -> None:
    with pytest.raises(RecordingError, match=why):
        open_recording(polycam(tmp_path / "r", change))


def test_poses_of_polycam_that_are_none(tmp_path: Path) -> None:
    recording = open_recording(polycam(tmp_path / "a", {"t_03": float("nan")}))
    assert recording.given_trajectory is None
    assert "none of the 3 poses is usable" in recording.warnings[0]
    broken = open_recording(polycam(tmp_path / "b", {"t_12": "x"}))
    assert "t_00 to t_23 must be numbers" in broken.trajectory_error


@pytest.mark.parametrize("k1", [0.0, -0.2])
def test_a_frame_of_another_size_is_refused(tmp_path: Path, k1: float) -> None:
    folder = transforms(tmp_path / "r", {"camera_model": "OPENCV", "k1": k1})
    (folder / "depth/d_2.png").write_bytes(png(depth_image(2, 1000.0).repeat(2, axis=0).repeat(2, axis=1)))
    recording = open_recording(folder)
    with pytest.raises(OddImageError, match="depth is 128x96, but the first frame's is 64x48"):
        check_size(recording.frame(1), recording)
