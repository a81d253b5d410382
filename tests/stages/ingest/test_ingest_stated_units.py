"""The unit of depth that a camera's file states under one of many names, and four numbers of intrinsics."""

import json
from pathlib import Path

import pytest
from ingest_writers import CX, CY, FX, FY, write_folder, write_tum
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.intrinsics_files import find_intrinsics
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import FileRecording

MATRIX = [FX, 0, CX, 0, FY, CY, 0, 0, 1]
BY_KEY = {"fx": FX, "fy": FY, "cx": CX, "cy": CY}
ORB = "%YAML:1.0\n" + "".join(f"Camera.{key}: {value}\n" for key, value in BY_KEY.items())
SIXD = "".join(f"{n}:\n  cam_K: {MATRIX}\n  depth_scale: 0.2\n" for n in range(3))


def folder_with(tmp_path: Path, files: dict[str, object]) -> Path:
    folder = write_folder(tmp_path / "r")
    (folder / "camera_intrinsic.json").unlink()
    for name, content in files.items():
        (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return folder


@pytest.mark.parametrize(
    ("files", "scale", "note"),
    [
        ({"camera.yaml": f"{ORB}DepthMapFactor: 2000.0\n"}, 2000, ""),
        ({"camera.yaml": f"{ORB}RGBD.DepthMapFactor: 5000 # of TUM\n"}, 5000, ""),
        ({"camera.yaml": f"{ORB}DepthMapFactor: 1.0\n"}, 1000, "1 m is 1 units of depth, which is not used"),
        ({"camera.yaml": f"{ORB}depth_scale: 0.001\ndepth_scale: 0.002\n"}, 1000, "is no unit of depth"),
        ({"info.yml": SIXD}, 5000, "depth_scale 0.2 is taken for mm a unit"),
        ({"camera.json": BY_KEY | {"depth_units": 0.00025}}, 4000, "taken for metres a unit"),
        ({"camera.json": BY_KEY | {"depth_units": "mm"}}, 1000, "depth_units 'mm' is no unit of depth"),
        ({"camera.json": BY_KEY | {"DepthMapFactor": 2000}}, 2000, ""),
        ({"camera.json": BY_KEY | {"depth_factor": 4000, "depth_units": 0.001}}, 4000, "the first is taken"),
        ({"camera.json": BY_KEY, "meta.json": {"depth_scale": 0.0005}}, 2000, "meta.json: says that 1 m is"),
        ({"camera.json": BY_KEY, "orb.yaml": "DepthMapFactor: 5000\n"}, 5000, "orb.yaml: says that 1 m is"),
        ({"orb.yaml": ORB, "tum.yaml": f"{ORB}DepthMapFactor: 5000\n"}, 5000, ""),
        (
            {"camera.json": BY_KEY, "a.json": {"depth_scale": 2000}, "b.json": {"depth_scale": 4000}},
            1000,
            "1 m is 2000 by a.json and 4000 by b.json units of depth: none is taken",
        ),
        ({"camera.json": BY_KEY, "config.json": {"depth_scale": 1000.0}}, 1000, ""),
        # Settings of other programs, and lists of this one.
        ({"camera.json": BY_KEY, "net.json": {"depth_scale": 1.0}, "l.json": [1]}, 1000, ""),
        ({"camera.json": BY_KEY, "benchmark.yaml": "camera:\n  depth_scale: 4000\n"}, 1000, ""),
    ],
)
def test_a_stated_unit_of_depth_is_used_or_named(
    tmp_path: Path, files: dict[str, object], scale: float, note: str
) -> None:
    recording = open_recording(folder_with(tmp_path, files))
    assert recording.depth_scale == pytest.approx(scale)
    assert any(note in line for line in recording.warnings) if note else recording.warnings == ()


def test_the_settings_win_over_a_unit_in_another_file(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, {"camera.json": BY_KEY, "meta.json": {"depth_scale": 0.0005}})
    recording = open_recording(folder, CameraSettings(depth_scale=4000))
    assert (recording.depth_scale, recording.warnings) == (4000, ())


def test_files_of_one_camera_with_two_units_are_refused(tmp_path: Path) -> None:
    files: dict[str, object] = {f"{n}.yaml": f"{ORB}DepthMapFactor: {n}000\n" for n in (1, 5)}
    with raises(RecordingError, "recording.bad-intrinsics", match=r"5\.yaml: has another camera or unit"):
        open_recording(folder_with(tmp_path, files))


@pytest.mark.parametrize("name", ["sensors.yaml", "K.txt"])
def test_four_numbers_in_the_order_of_openloris(tmp_path: Path, name: str) -> None:
    # The numbers of its camera d400_color, halved.
    numbers = [305.725, 216.6, 305.745, 124.735]
    text = f"intrinsics: !!opencv-matrix\n   rows: 1\n   cols: 4\n   data: {numbers}\n"
    folder = folder_with(tmp_path, {name: text if name != "K.txt" else " ".join(map(str, numbers))})
    found, _ = find_intrinsics(folder, CameraSettings(), 1000)
    assert (found.fx, found.cx, found.fy, found.cy) == tuple(numbers)
    assert "its four numbers are read as fx 305.725, cx 216.6, fy 305.745" in found.notes[0]


def test_four_numbers_of_pixels_that_are_not_square_keep_their_order(tmp_path: Path) -> None:
    found, _ = find_intrinsics(folder_with(tmp_path, {"K.txt": "600 450 320 180"}), CameraSettings(), 1000)
    assert (found.fx, found.fy, found.cx, found.cy, found.notes) == (600, 450, 320, 180, ())


def test_the_lists_of_openloris_are_read(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "rgb.txt").rename(folder / "color.txt")
    recording = open_recording(folder)
    assert isinstance(recording, FileRecording) and recording.places[0].color is not None
    (folder / "depth").rename(folder / "aligned_depth")
    text = (folder / "depth.txt").read_text()
    (folder / "aligned_depth.txt").write_text(text.replace("depth/", "aligned_depth/"))
    recording = open_recording(folder)
    assert isinstance(recording, FileRecording)
    assert recording.places[0].depth.parent.name == "aligned_depth" and recording.places[0].color is not None
    assert any("aligned_depth.txt: is read, and not depth.txt" in line for line in recording.warnings)
