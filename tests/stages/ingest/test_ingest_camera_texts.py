"""Intrinsics in texts of other programs: read under a usual name, else named with the line to give."""

import re
from pathlib import Path

import pytest
import yaml
from ingest_writers import CX, CY, FX, FY, HEIGHT, WIDTH, write_folder

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording

SMALL = Camera(WIDTH, HEIGHT, FX, FY, CX, CY)
K = [FX, 0.0, CX, 0.0, FY, CY, 0.0, 0.0, 1.0]
NAMES = f"width: {WIDTH}\nheight: {HEIGHT}\nfx: {FX}\nfy: {FY}\ncx: {CX}\ncy: {CY}\n"
ASSIGNED = f"fx = {FX}\nfy = {FY}\ncx = {CX}\ncy = {CY}\n"
REALSENSE = (
    f" Intrinsic of 'Depth'\n  Width:      \t{WIDTH}\n  Height:     \t{HEIGHT}\n  PPX:        \t{CX}\n"
    f"  PPY:        \t{CY}\n  Fx:         \t{FX}\n  Fy:         \t{FY}\n  Distortion: \tBrown Conrady\n"
)
PRINTED = f"[ {WIDTH}x{HEIGHT}  p[{CX} {CY}]  f[{FX} {FY}]  Inverse Brown Conrady [0 0 0 0 0] ]\n"
ECHO = f"header: \n  seq: 1\nheight: {HEIGHT}\nwidth: {WIDTH}\nD: [0.0, 0.0]\nK: {K}\nR: [1.0, 0.0]\n---\n"
ROS = f"image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: {K}\n"
XML = (
    '<?xml version="1.0"?>\n<opencv_storage>\n<camera_matrix type_id="opencv-matrix">\n  <rows>3</rows>\n'
    f"  <data>\n    {' '.join(map(str, K))}</data></camera_matrix>\n</opencv_storage>\n"
)
JSON = f'{{"fx": {FX}, "fy": {FY}, "cx": {CX}, "cy": {CY}}}'


def folder_with(tmp_path: Path, name: str, text: str) -> Path:
    folder = write_folder(tmp_path / "r")
    (folder / "camera_intrinsic.json").unlink()
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize("name", ["intrinsics.txt", "camera-intrinsics.txt", "camera.txt", "calibration.txt"])
@pytest.mark.parametrize("text", [NAMES, ASSIGNED, REALSENSE, PRINTED])
def test_values_behind_names_are_read(tmp_path: Path, name: str, text: str) -> None:
    assert open_recording(folder_with(tmp_path, name, text)).camera == SMALL


@pytest.mark.parametrize(
    ("text", "distorted"),
    [
        (PRINTED, False),
        (PRINTED.replace("[0 0 0 0 0]", "[0.15 -0.4 0.001 0 0.3]"), True),
        (PRINTED.replace("[0 0 0 0 0]", "[0 0 1e-3 0 0]"), True),
        (REALSENSE + "  Coeffs:     \t0  \t0  \t0  \t0  \t0  \n", False),
        (REALSENSE + "  Coeffs:     \t-0.05  \t0.06  \t0  \t0  \t0  \n", True),
        (NAMES + "k1: 0.0\nk2: 0\np1: 0.000\n", False),
        (ASSIGNED + "k1 = 0.0\nk2 = -0.2\n", True),
        (NAMES + "distortion: [0.0, 0.0, 0.1]\n", True),
    ],
)
def test_distortion_is_told(tmp_path: Path, text: str, distorted: bool) -> None:
    recording = open_recording(folder_with(tmp_path, "intrinsics.txt", text))
    assert recording.camera == SMALL
    assert any("its distortion is not taken away" in line for line in recording.warnings) == distorted


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("depth.cam.info.txt", NAMES),
        ("scan.info.txt", ASSIGNED),
        ("realsense.txt", REALSENSE),
        ("camera_info.txt", ECHO),
        ("depth/camera_info.yaml", ROS),
        ("config/camera.yaml", ROS),
        ("calib.xml", XML),
        ("depth_intrinsics.json", JSON),
    ],
)
def test_other_names_are_given_with_the_line(tmp_path: Path, name: str, text: str) -> None:
    folder = folder_with(tmp_path, name, text)
    with pytest.raises(RecordingError, match="does not say its intrinsics") as error:
        open_recording(folder)
    (line,) = re.findall(r" as `(camera: \{[^`]*\})`$", str(error.value))
    assert name in str(error.value)
    assert open_recording(folder, CameraSettings(**yaml.safe_load(line)["camera"])).camera == SMALL


def test_two_cameras_in_one_text_are_not_mixed(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, "intrinsics.txt", NAMES + NAMES.replace(str(FX), "90.0"))
    with pytest.raises(RecordingError, match="holds 'fx' more than once"):
        open_recording(folder)
    (folder / "intrinsics.txt").rename(folder / "scan.info.txt")
    with pytest.raises(RecordingError, match=r"they may stand in scan\.info\.txt"):
        open_recording(folder)


def test_a_matrix_is_read_and_not_the_comment_above_it(tmp_path: Path) -> None:
    text = f"# colour camera: fx=120 fy=120 cx=63.5 cy=47.5\n# depth:\n{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n"
    assert open_recording(folder_with(tmp_path, "intrinsics.txt", text)).camera == SMALL


@pytest.mark.parametrize("text", [NAMES.replace("\n", " # was fx: 60.5\n"), "# fx: 90\n" + NAMES])
def test_comments_are_no_second_camera(tmp_path: Path, text: str) -> None:
    assert open_recording(folder_with(tmp_path, "intrinsics.txt", text)).camera == SMALL


@pytest.mark.parametrize("width", ["1e999", "63.5", "-64", "0"])
def test_a_size_is_a_number_of_pixels(tmp_path: Path, width: str) -> None:
    folder = folder_with(tmp_path, "intrinsics.txt", NAMES.replace(f"width: {WIDTH}", f"width: {width}"))
    with pytest.raises(RecordingError, match="'width:' is not a number of pixels"):
        open_recording(folder)
