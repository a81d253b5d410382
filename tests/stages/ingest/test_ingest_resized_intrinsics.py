"""Intrinsics of images of another size: the message has the values of the depth images, as one line."""

import json
import re
from pathlib import Path

import cv2
import pytest
import yaml
from ingest_writers import CX, CY, FX, FY, HEIGHT, WIDTH, png, write_folder

from kinectbench.core.errors import RecordingError
from kinectbench.doctor import inspect
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.intrinsics import Intrinsics, ratio_by_centre
from kinectbench.stages.ingest.readers import open_recording


def folder_for(tmp_path: Path, ratio: float, **stated: object) -> Path:
    """A recording whose intrinsics are those of images `ratio` times as large."""
    folder = write_folder(tmp_path / "r")
    pixels = {"fx": FX * ratio, "fy": FY * ratio}
    pixels |= {"cx": (CX + 0.5) * ratio - 0.5, "cy": (CY + 0.5) * ratio - 0.5}
    (folder / "camera_intrinsic.json").write_text(json.dumps(pixels | stated))
    return folder


def offered(text: str) -> CameraSettings:
    """The settings that a message offers."""
    (line,) = re.findall(r"`(camera: \{.*?\})`", text)
    return CameraSettings(**yaml.safe_load(line)["camera"])


def is_right(folder: Path, text: str) -> bool:
    """Whether the recording opens with the offered settings, and these are the right ones."""
    camera = open_recording(folder, offered(text)).camera
    return [camera.fx, camera.fy, camera.cx, camera.cy] == pytest.approx([FX, FY, CX, CY], rel=1e-5)


@pytest.mark.parametrize("ratio", [0.5, 1.5, 3.0])
def test_a_stated_size_that_is_not_the_images_gives_the_scaled_values(tmp_path: Path, ratio: float) -> None:
    size = {"width": round(WIDTH * ratio), "height": round(HEIGHT * ratio)}
    folder = folder_for(tmp_path, ratio, **size)
    with pytest.raises(RecordingError, match="if they differ in size only, scaled to these") as caught:
        open_recording(folder)
    assert is_right(folder, str(caught.value))


def test_images_of_no_height_have_no_scale() -> None:
    stated = Intrinsics(width=WIDTH, height=HEIGHT, fx=FX, fy=FY, cx=CX, cy=CY)
    with pytest.raises(RecordingError) as caught:
        stated.camera((WIDTH, 0), Path("r"))
    assert "scaled to these" not in str(caught.value)


def test_a_principal_point_outside_the_images_gives_the_scaled_values(tmp_path: Path) -> None:
    folder = folder_for(tmp_path, 3.0)
    with pytest.raises(RecordingError, match=r"as of 192x144; if so, scaled to these") as caught:
        open_recording(folder)
    assert is_right(folder, str(caught.value))


@pytest.mark.parametrize("ratio", [0.5, 1.5])
def test_inspect_gives_the_scaled_values(tmp_path: Path, ratio: float) -> None:
    folder = folder_for(tmp_path, ratio)
    diagnosis, _ = inspect(folder)
    (found,) = (each for each in diagnosis.findings if each.name == "intrinsics_resolution")
    assert found.severity == "stops" and is_right(folder, found.advice)


def resized(tmp_path: Path, fx: float, fy: float) -> Path:
    """A recording of 512x384 beside intrinsics whose principal point is that of 640x480."""
    folder = write_folder(tmp_path / "r")
    for file in folder.glob("*/*.*g"):
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        file.write_bytes(png(cv2.resize(image, (512, 384), interpolation=cv2.INTER_NEAREST)))
    stated = {"fx": fx, "fy": fy, "cx": 319.5, "cy": 239.5}
    (folder / "camera_intrinsic.json").write_text(json.dumps(stated))
    return folder


def test_a_principal_point_a_little_off_both_axes_is_a_warning(tmp_path: Path) -> None:
    diagnosis, _ = inspect(resized(tmp_path, fx=525, fy=525))
    (found,) = (each for each in diagnosis.findings if each.name == "intrinsics_resolution")
    assert found.severity == "warning" and offered(found.advice).fx == pytest.approx(420)


def test_images_of_another_shape_give_no_values(tmp_path: Path) -> None:
    folder = folder_for(tmp_path, 2.0, width=2 * WIDTH, height=2 * WIDTH)
    with pytest.raises(RecordingError, match=r"under `camera:` in benchmark\.yaml$"):
        open_recording(folder)


@pytest.mark.parametrize(
    ("cx", "cy", "size_px", "ratio"),
    [
        (639.2, 361.0, (848, 480), 848 / 1280),  # a RealSense's depth beside intrinsics of its largest images
        (715.0, 962.0, (192, 256), 256 / 1920),  # a phone's, upright
        (634.0, 350.0, (640, 360), 0.5),
        (322.0, 238.0, (640, 480), None),
        (366.0, 205.0, (640, 400), None),
        (320.0, 240.0, (640, 288), None),  # rows are cut off
        (319.5, 239.5, (512, 384), 0.8),
        (255.0, 192.0, (640, 480), 1.25),
        (280.0, 210.0, (640, 480), None),  # of no common sensor
    ],
)
def test_the_ratio_of_sizes_is_that_of_common_sensors(
    cx: float, cy: float, size_px: tuple[int, int], ratio: float | None
) -> None:
    found = ratio_by_centre(cx, cy, size_px)
    assert found == (None if ratio is None else pytest.approx(ratio))


def test_a_warning_hides_no_other_finding(tmp_path: Path) -> None:
    folder = resized(tmp_path, fx=525, fy=1050)
    names = {each.name: each for each in inspect(folder)[0].findings}
    assert (
        "(fx 525, fy 1050, cx 319.5, cy 239.5) may be those of 640x480" in names["intrinsics_resolution"].what
    )
    assert "aspect" in names


@pytest.mark.parametrize(("cx", "cy"), [(-0.5, 100.0), (100.0, -0.5), (-0.5, -0.5), (-3.0, -3.0)])
def test_a_principal_point_left_of_or_above_the_image_has_no_ratio(cx: float, cy: float) -> None:
    assert ratio_by_centre(cx, cy, (640, 480)) is None
