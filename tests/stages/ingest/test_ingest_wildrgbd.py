"""Scenes of WildRGB-D, written here from the data set's own page."""

import json
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import CX, CY, FX, FY, HEIGHT, WIDTH, color_image, depth_image, png
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import format_of, open_recording

# Turned by 90 degrees about y.
ROTATION = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
NUMBERS = (0, 1, 2, 10)


def wildrgbd(folder: Path) -> Path:
    for name in ("rgb", "depth", "masks"):
        (folder / name).mkdir(parents=True)
    rows = []
    for i in NUMBERS:
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[: i + 1] = 255
        (folder / f"depth/{i:05d}.png").write_bytes(png(depth_image(i, 1000.0)))
        (folder / f"rgb/{i:05d}.png").write_bytes(png(color_image(i)))
        (folder / f"masks/{i:05d}.png").write_bytes(png(mask))
        T = np.eye(4)
        T[:3, :3], T[0, 3] = ROTATION, 0.5 * i
        rows.append(" ".join([str(i), *(repr(v) for v in T.ravel().tolist())]))
    (folder / "cam_poses.txt").write_text("\n".join(rows) + "\n")
    # Column by column, as the data set has it.
    said = {"w": WIDTH, "h": HEIGHT, "K": [FX, 0, 0, 0, FY, 0, CX, CY, 1]}
    (folder / "metadata").write_text(json.dumps(said))
    return folder


def test_a_scene_with_its_masks(tmp_path: Path) -> None:
    recording = open_recording(wildrgbd(tmp_path / "r"))
    camera = recording.camera
    assert (recording.format, len(recording), recording.warnings) == ("wildrgbd", 4, ())
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX, FY, CX, CY)
    assert (recording.depth_scale, recording.color_registered) == (1000.0, True)
    frame = recording.frame(3)
    assert frame.stamp_ns == 10 * 10**9
    np.testing.assert_array_equal(frame.depth, depth_image(10, 1000.0))
    assert frame.mask is not None and frame.color is not None
    assert frame.mask.sum() == 11 * WIDTH and frame.mask[:11].all()
    given = recording.given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[3][:3, :3], ROTATION, atol=1e-12)
    np.testing.assert_allclose(given.T_world_camera[3][:3, 3], [5, 0, 0], atol=1e-12)


def test_images_with_endings_in_capitals_are_read(tmp_path: Path) -> None:
    folder = wildrgbd(tmp_path / "r")
    for file in list(folder.glob("*/*.png")):
        file.rename(file.with_suffix(".PNG"))
    recording = open_recording(folder)
    assert (recording.format, len(recording), recording.warnings) == ("wildrgbd", 4, ())
    assert all(recording.frame(index).mask is not None for index in range(4))


def test_parts_that_are_missing_or_too_many(tmp_path: Path) -> None:
    folder = wildrgbd(tmp_path / "r")
    (folder / "masks/00001.png").unlink()
    (folder / "rgb/00002.png").unlink()
    (folder / "depth/00000.png").unlink()
    recording = open_recording(folder)
    assert (len(recording), recording.frame(0).mask, recording.frame(1).color) == (3, None, None)
    assert recording.warnings == (
        f"{folder}: 1 of 3 depth frames have no colour of their name",
        f"{folder / 'cam_poses.txt'}: 1 poses are of frames without depth, and were left out",
    )
    (folder / "cam_poses.txt").unlink()
    assert format_of(folder) == "wildrgbd"
    assert open_recording(folder).given_trajectory is None
    for file in (folder / "depth").iterdir():
        file.unlink()
    with raises(RecordingError, "recording.no-depth", match=r"00000\.png"):
        open_recording(folder)


@pytest.mark.parametrize("mask", [np.zeros((HEIGHT // 2, WIDTH), np.uint8), None])
def test_a_mask_of_another_size_or_none_damages_its_frame_only(
    tmp_path: Path, mask: np.ndarray | None
) -> None:
    folder = wildrgbd(tmp_path / "r")
    (folder / "masks/00001.png").write_bytes(b"no image" if mask is None else png(mask))
    recording = open_recording(folder)
    with raises(DamagedImageError, "recording.damaged-image", match=r"masks/00001\.png: "):
        recording.frame(1)
    assert recording.frame(2).mask is not None


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("0 1 2 3", "is not a frame's number and the 16 numbers"),
        ("0.5 " + "1 " * 16, "is not a frame's number"),
        ("-1 " + "1 " * 16, "is not a frame's number"),
        ("0 " + "x " * 16, "cam_poses.txt"),
        ("0 " + "nan " * 16, "of 4 frames have no pose, or one that is not finite and rigid"),
        ("0 " + "1 " * 16, "of 4 frames have no pose, or one that is not finite and rigid"),
    ],
)
def test_poses_that_are_none(tmp_path: Path, row: str, why: str) -> None:
    folder = wildrgbd(tmp_path / "r")
    rows = (folder / "cam_poses.txt").read_text().splitlines()[1:]
    (folder / "cam_poses.txt").write_text("\n".join([row, *rows]) + "\n")
    recording = open_recording(folder)
    # Frames can be used without poses.
    assert len(recording) == 4
    said = recording.trajectory_error or " ".join(recording.warnings)
    assert why in said and "\n" not in said


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"K": [1, 2, 3]}, "'K' must hold nine numbers"),
        ({"K": [FX, 5, 0, 0, FY, 0, CX, CY, 1]}, "is not a pinhole matrix"),
        ({"K": None}, "'K' must hold nine numbers"),
        ({"w": "wide"}, "'w' must be a number"),
        ({"h": HEIGHT // 2}, "the intrinsics are for 64x24 images"),
    ],
)
def test_a_wrong_metadata(tmp_path: Path, change: dict[str, object], why: str) -> None:
    folder = wildrgbd(tmp_path / "r")
    said = json.loads((folder / "metadata").read_text())
    (folder / "metadata").write_text(json.dumps(said | change))
    with pytest.raises(RecordingError, match=why):
        open_recording(folder)
    (folder / "metadata").write_text("{")
    with raises(RecordingError, "recording.malformed", match="valid JSON"):
        open_recording(folder)


def test_settings_win(tmp_path: Path) -> None:
    recording = open_recording(wildrgbd(tmp_path / "r"), CameraSettings(fx=70.0, depth_scale=500.0))
    assert (recording.camera.fx, recording.camera.fy, recording.depth_scale) == (70.0, FY, 500.0)
