"""StrayScanner, 3D Scanner App and BOP folders, written here from their layouts."""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ingest_writers import START_NS, STEP_NS, depth_image, jpeg, png, seconds
from raising import raises
from read_pictures import decoded_picture, read_picture

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError, decode_color_bgr
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

BIG = (256, 192)  # 4 times the depth images
K_BIG = np.array([[240.0, 0, 127.5], [0, 244.0, 95.5], [0, 0, 1]])
# (c + 0.5) / 4 - 0.5
SMALL = (60.0, 61.0, 31.5, 23.5)
# Turned by 90 degrees about y, moved along x.
QUATERNION_XYZW = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]
ROTATION = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


def confidence() -> np.ndarray:
    """Low in the first columns, then middle, then high."""
    image = np.full((48, 64), 2, np.uint8)
    image[:, :10], image[:, 10:20] = 0, 1
    return image


def big_color(index: int) -> np.ndarray:
    """Blocks of one colour over each depth pixel."""
    v, u = np.mgrid[:48, :64]
    small = np.dstack([np.full_like(u, 40 * index), 4 * u, 5 * v]).astype(np.uint8)
    return np.kron(small, np.ones((4, 4, 1), np.uint8)).astype(np.uint8)


def stray(folder: Path, *, video: bool = True, frames: int = 4) -> Path:
    for name in ("depth", "confidence"):
        (folder / name).mkdir(parents=True)
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for i in range(frames):
        (folder / f"depth/{i:06d}.png").write_bytes(png(depth_image(i, 1000.0)))
        (folder / f"confidence/{i:06d}.png").write_bytes(png(confidence()))
        numbers = ", ".join(str(v) for v in [0.5 * i, 0, 0, *QUATERNION_XYZW])
        rows.append(f"{seconds(START_NS + i * STEP_NS)}, {i:06d}, {numbers}")
    (folder / "odometry.csv").write_text("\n".join(rows) + "\n")
    np.savetxt(folder / "camera_matrix.csv", K_BIG, delimiter=", ")
    if video:
        writer = cv2.VideoWriter(str(folder / "rgb.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30, BIG)
        for i in range(frames):
            writer.write(big_color(i))
        writer.release()
    return folder


def test_stray_scanner(tmp_path: Path) -> None:
    recording = open_recording(stray(tmp_path / "r"))
    camera = recording.camera
    assert (recording.format, len(recording), recording.warnings) == ("stray", 4, ())
    assert recording.up_world == (0, 1, 0)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == SMALL
    assert recording.color_registered
    assert recording.stamps_ns.tolist() == [START_NS + i * STEP_NS for i in range(4)]
    for i in (3, 0, 1, 2):  # at random, and in a row
        frame = recording.frame(i)
        expected = np.where(confidence() == 2, depth_image(i, 1000.0), 0)
        np.testing.assert_array_equal(frame.depth, expected)
        assert frame.color is not None
        bgr = decoded_picture(frame.color[1], 1).astype(int)
        # Video loses some; frames differ by 40 in blue.
        assert np.abs(bgr - big_color(i)[::4, ::4]).mean() < 6
        assert abs(bgr[..., 0].mean() - 40 * i) < 8
    given = recording.given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[2][:3, :3], ROTATION, atol=1e-12)
    np.testing.assert_allclose(given.T_world_camera[2][:3, 3], [1.0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_arrays_of_early_stray_scanner(tmp_path: Path, kind: type) -> None:
    """Whole numbers are mm, floats metres; confidence stays PNG."""
    folder = stray(tmp_path / "r")
    expected = [np.where(confidence() == 2, depth_image(i, 1000.0), 0) for i in range(4)]
    for i in range(4):
        (folder / f"depth/{i:06d}.png").unlink()
        stored = depth_image(i, 1000.0) if kind is np.uint16 else depth_image(i, 1000.0) / np.float32(1000)
        np.save(folder / f"depth/{i:06d}.npy", stored.astype(kind))
    recording = open_recording(folder)
    assert recording.warnings == ()
    for i in range(4):
        metres = recording.frame(i).depth / recording.depth_scale
        np.testing.assert_allclose(metres, expected[i] / 1000, atol=2e-4)


def test_colour_of_another_shape_is_no_colour_of_the_same_camera(tmp_path: Path) -> None:
    """Turned upright or cut: its intrinsics, squeezed to depth's size, would be of no camera."""
    folder = stray(tmp_path / "a", video=False)
    writer = cv2.VideoWriter(str(folder / "rgb.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30, BIG[::-1])
    for i in range(4):
        writer.write(np.ascontiguousarray(np.rot90(big_color(i))))
    writer.release()
    with raises(RecordingError, "recording.bad-intrinsics", match="192x256.*another shape"):
        open_recording(folder)
    folder = scanner_app(tmp_path / "b")
    (folder / "frame_00003.jpg").write_bytes(jpeg(big_color(3)[:144]))
    with raises(DamagedImageError, "recording.other-image", match="256x144.*another shape"):
        open_recording(folder).frame(3)
    (folder / "frame_00000.jpg").write_bytes(jpeg(big_color(3)[:144]))
    with raises(RecordingError, "recording.bad-intrinsics", match="256x144.*another shape"):
        open_recording(folder)


@pytest.mark.parametrize("least", [0, 1, 2])
def test_confidence_becomes_holes(tmp_path: Path, least: int) -> None:
    frame = open_recording(stray(tmp_path / "r"), CameraSettings(min_confidence=least)).frame(1)
    expected = np.where(confidence() >= least, depth_image(1, 1000.0), 0)
    np.testing.assert_array_equal(frame.depth, expected)


def test_stray_scanner_with_a_part_missing(tmp_path: Path) -> None:
    folder = stray(tmp_path / "r", video=False)
    (folder / "depth/000009.png").write_bytes(png(depth_image(0)))
    recording = open_recording(folder)
    # Without a video its usual size, 1920x1440, tells the scale.
    assert recording.camera.fx == pytest.approx(8.0)
    assert not recording.color_registered
    assert "1 depth images have no row" in recording.warnings[0]
    assert "there will be no colour" in recording.warnings[1]
    (folder / "rgb.mp4").write_bytes(b"no video")
    assert open_recording(folder).frame(0).color is None
    short = stray(tmp_path / "s", frames=6)
    cut = stray(tmp_path / "t", frames=2)
    (short / "rgb.mp4").write_bytes((cut / "rgb.mp4").read_bytes())
    with raises(DamagedImageError, "recording.damaged-image", match="frame 4; the"):
        open_recording(short).frame(4)
    (folder / "odometry.csv").write_text("timestamp, x\n")
    with raises(RecordingError, "recording.malformed", match="column frame"):
        open_recording(folder)


def scanner_app(folder: Path, change: dict[str, Any] | None = None) -> Path:
    folder.mkdir()
    T = np.eye(4)
    # Optical axes x right, y down, z forward; ARKit's x right, y up, z back.
    T[:3, :3] = ROTATION @ np.diag([1, -1, -1])
    for i in range(4):
        T[0, 3] = 0.5 * i
        (folder / f"depth_{i:05d}.png").write_bytes(png(depth_image(i, 1000.0)))
        (folder / f"conf_{i:05d}.png").write_bytes(png(confidence()))
        if i != 2:
            (folder / f"frame_{i:05d}.jpg").write_bytes(jpeg(big_color(i)))
        said = {
            "intrinsics": K_BIG.ravel().tolist(),
            "cameraPoseARFrame": T.ravel().tolist(),
            "time": 7.5 + i,
        }
        (folder / f"frame_{i:05d}.json").write_text(json.dumps(said | (change or {})))
    return folder


def test_scanner_app(tmp_path: Path) -> None:
    recording = open_recording(scanner_app(tmp_path / "r"))
    camera = recording.camera
    assert (recording.format, len(recording), recording.warnings) == ("scanner_app", 4, ())
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == SMALL
    assert recording.stamps_ns.tolist() == [7_500_000_000 + i * 10**9 for i in range(4)]
    np.testing.assert_array_equal(
        recording.frame(3).depth, np.where(confidence() == 2, depth_image(3, 1000.0), 0)
    )
    assert recording.frame(2).color is None
    color = recording.frame(3).color
    assert color is not None
    bgr = decoded_picture(color[1], 1).astype(int)
    assert np.abs(bgr - big_color(3)[::4, ::4]).max() < 12
    given = recording.given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[3][:3, :3], ROTATION, atol=1e-12)
    assert given.T_world_camera[3][0, 3] == 1.5


def test_a_wrong_json_of_scanner_app(tmp_path: Path) -> None:
    with raises(RecordingError, "recording.malformed", match="'intrinsics'"):
        open_recording(scanner_app(tmp_path / "r", {"intrinsics": [1, 2]}))
    # Frames can be used without poses.
    broken = open_recording(scanner_app(tmp_path / "s", {"cameraPoseARFrame": "x"}))
    assert broken.given_trajectory is None
    assert "must hold 16" in broken.trajectory_error


def test_gravity_is_kept_where_the_format_has_it(tmp_path: Path) -> None:
    write_sequence(open_recording(scanner_app(tmp_path / "phone")), tmp_path / "a")
    up_world = read_sequence(tmp_path / "a").up_world
    assert up_world is not None and up_world.tolist() == [0, 1, 0]
    write_sequence(open_recording(bop(tmp_path / "bop")), tmp_path / "b")
    assert read_sequence(tmp_path / "b").up_world is None
    assert "up_world" not in json.loads((tmp_path / "b" / "camera.json").read_text())


def bop(folder: Path, *, objects: tuple[int, ...] = (5,)) -> Path:
    for name in ("depth", "rgb", "mask_visib"):
        (folder / name).mkdir(parents=True)
    cameras, poses = {}, {}
    for i in (1, 2, 30):
        (folder / f"depth/{i:06d}.png").write_bytes(png(depth_image(i, 10_000.0)))
        (folder / f"rgb/{i:06d}.png").write_bytes(png(big_color(1)[::4, ::4]))
        # The camera at x = i m, turned.
        t_mm = -ROTATION.T @ [1000.0 * i, 0, 0]
        cameras[str(i)] = {
            "cam_K": [60.0, 0, 31.5, 0, 61.0, 23.5, 0, 0, 1],
            "depth_scale": 0.1,
            "cam_R_w2c": ROTATION.T.ravel().tolist(),
            "cam_t_w2c": t_mm.tolist(),
        }
        poses[str(i)] = [{"obj_id": number} for number in objects]
        for place, number in enumerate(objects):
            mask = np.zeros((48, 64), np.uint8)
            mask[:number] = 255
            (folder / f"mask_visib/{i:06d}_{place:06d}.png").write_bytes(png(mask))
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    (folder / "scene_gt.json").write_text(json.dumps(poses))
    return folder


def test_bop_scene_with_masks(tmp_path: Path) -> None:
    recording = open_recording(bop(tmp_path / "r"))
    assert (recording.format, len(recording), recording.warnings) == ("bop", 3, ())
    assert (recording.depth_scale, recording.camera.fx, recording.color_registered) == (10_000.0, 60.0, True)
    frame = recording.frame(2)
    assert frame.stamp_ns == 30 * 10**9
    np.testing.assert_array_equal(frame.depth, depth_image(30, 10_000.0))
    assert frame.mask is not None
    assert frame.mask.sum() == 5 * 64 and frame.mask[:5].all()
    given = recording.given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[2][:3, :3], ROTATION, atol=1e-12)
    np.testing.assert_allclose(given.T_world_camera[2][:3, 3], [30, 0, 0], atol=1e-9)


def test_bop_scene_with_several_objects_or_cameras(tmp_path: Path) -> None:
    folder = bop(tmp_path / "r", objects=(5, 9, 9))
    recording = open_recording(folder)
    assert recording.frame(0).mask is None
    assert "has the objects 5, 9; no masks are read" in recording.warnings[0]
    mask = open_recording(folder, CameraSettings(mask_object=9)).frame(0).mask
    assert mask is not None
    assert mask.sum() == 9 * 64
    with raises(RecordingError, "recording.no-object", match=r"`mask_object: 4`.*5.*9"):
        open_recording(folder, CameraSettings(mask_object=4))
    cameras = json.loads((folder / "scene_camera.json").read_text())
    cameras["2"]["cam_K"][0] = 70.0
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    with raises(RecordingError, "recording.two-cameras", match="image 2 .* image 1: 1 and 30, 2 have"):
        open_recording(folder)


def test_only_cameras_of_bop_images_on_disk_count(tmp_path: Path) -> None:
    """Some images of a scene, beside the whole scene's scene_camera.json, which has three cameras."""
    folder = bop(tmp_path / "r")
    cameras = json.loads((folder / "scene_camera.json").read_text())
    for number in range(31, 80):
        cameras[str(number)] = cameras["1"] | {"cam_K": [90.0, 0, 31.9 + number // 50, 0, 90.0, 9.3, 0, 0, 1]}
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    recording = open_recording(folder)
    assert (len(recording), recording.camera.cx) == (3, 31.5)
    assert "49 of its 52 images have no file in depth/" in recording.warnings[0]
    for number in (40, 41, 60):
        cameras[str(number)]["cam_K"][0] = 90.0 + number // 50
        shutil.copy(folder / "depth/000001.png", folder / f"depth/{number:06d}.png")
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    words = "image 40 has another camera than image 1: 1-30, 40-41, 60 have different cameras: give one group"
    with raises(RecordingError, "recording.two-cameras", match=words):
        open_recording(folder)


CUT = {1: (0, 0), 2: (8, 3), 30: (4, 6)}


def cut(folder: Path, whole: Path) -> Path:
    """The same scene with each image cut out elsewhere, 48 x 40 pixels, and its principal point with it."""
    shutil.copytree(whole, folder)
    cameras = json.loads((folder / "scene_camera.json").read_text())
    for number, (x, y) in CUT.items():
        cameras[str(number)]["cam_K"][2] -= x
        cameras[str(number)]["cam_K"][5] -= y
        for file in folder.glob(f"*/{number:06d}*.png"):
            image = read_picture(file, cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(file), image[y : y + 40, x : x + 48])
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    return folder


def test_bop_images_that_were_cut_out_are_moved_to_one_principal_point(tmp_path: Path) -> None:
    """As T-LESS' training images: depth, colour and mask; each pixel where the whole image has it."""
    whole = open_recording(bop(tmp_path / "whole"))
    recording = open_recording(cut(tmp_path / "cut", tmp_path / "whole"))
    assert "up to 8, 6 px apart: they are moved to one" in recording.warnings[0]
    camera = recording.camera
    assert (camera.width, camera.height, camera.cx, camera.cy) == (56, 46, 31.5, 23.5)
    for index, (x, y) in enumerate(CUT.values()):
        found, expected = recording.frame(index), whole.frame(index)
        inside = np.zeros((46, 56), bool)
        inside[y : y + 40, x : x + 48] = True
        np.testing.assert_array_equal(found.depth, np.where(inside, expected.depth[:46, :56], 0))
        assert found.mask is not None and expected.mask is not None
        np.testing.assert_array_equal(found.mask, inside & expected.mask[:46, :56])
        assert found.color is not None and expected.color is not None
        colors = [decode_color_bgr(each.color[1], "x") for each in (found, expected) if each.color]
        np.testing.assert_array_equal(colors[0], np.where(inside[..., None], colors[1][:46, :56], 0))
    given, true = recording.given_trajectory, whole.given_trajectory
    assert given is not None and true is not None
    np.testing.assert_array_equal(given.T_world_camera, true.T_world_camera)


def test_ray_distances_of_images_that_are_moved(tmp_path: Path) -> None:
    rays = CameraSettings(depth_code="ray_distance")
    whole = open_recording(bop(tmp_path / "whole"), rays)
    recording = open_recording(cut(tmp_path / "cut", tmp_path / "whole"), rays)
    for index, (x, y) in enumerate(CUT.values()):
        found, expected = (each.frame(index).depth[y : y + 40, x : x + 48] for each in (recording, whole))
        np.testing.assert_array_equal(found, expected)
        assert (found < depth_image(list(CUT)[index], 10_000.0)[y : y + 40, x : x + 48]).mean() > 0.9


@pytest.mark.parametrize("key", ["cam_K", "depth_scale"])
def test_bop_numbers_that_are_too_large(tmp_path: Path, key: str) -> None:
    folder = bop(tmp_path / "r")
    cameras = json.loads((folder / "scene_camera.json").read_text())
    cameras["2"][key] = 10**400 if key == "depth_scale" else [10**400] * 9
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    with raises(RecordingError, "recording.bad-intrinsics", match="image 2"):
        open_recording(folder)


@pytest.mark.parametrize(("place", "change"), [(2, 0.4), (5, -0.2), (4, 3.0)])
def test_bop_images_of_other_cameras_are_refused(tmp_path: Path, place: int, change: float) -> None:
    """Principal points that differ by a part of a pixel, or other focal lengths."""
    folder = cut(tmp_path / "cut", bop(tmp_path / "whole"))
    cameras = json.loads((folder / "scene_camera.json").read_text())
    cameras["30"]["cam_K"][place] += change
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    with raises(RecordingError, "recording.two-cameras", match="than image 1.*whole pixels"):
        open_recording(folder)
