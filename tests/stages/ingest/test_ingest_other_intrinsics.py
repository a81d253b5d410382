"""7-Scenes' file names with another camera: where its intrinsics are, and what contradicts the images."""

import inspect
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import CX, CY, FX, FY, color_image, jpeg, png, write_folder, write_seven_scenes
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.engine.artefact import content_hash
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.bags.ros_recording import RosRecording
from kinectbench.stages.ingest.json_values import number_of, object_of
from kinectbench.stages.ingest.readers import FORMATS, open_recording, reader_of, source_files
from kinectbench.stages.ingest.recording import OF_SOME_FORMATS

SMALL = Camera(64, 48, FX, FY, CX, CY)
K = f"{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n"
IDENTITY = " ".join(str(float(i % 5 == 0)) for i in range(16))
SPELLINGS = {
    "3x3": K,
    "commas": K.replace(" ", ", "),
    "brackets": f"[[{FX}, 0, {CX}],\n [0, {FY}, {CY}],\n [0, 0, 1]]",
    "one row": K.replace("\n", " "),
    "3x4": f"{FX} 0 {CX} 0\n0 {FY} {CY} 0\n0 0 1 0\n",
    "4x4": f"{FX} 0 {CX} 0\n0 {FY} {CY} 0\n0 0 1 0\n0 0 0 1\n",
    "fx fy cx cy": f"{FX} {FY} {CX} {CY}\n",
    "comment": f"# of depth\n{K}",
}


def bare(tmp_path: Path) -> Path:
    """A recording in 7-Scenes' names, without intrinsics."""
    folder = write_seven_scenes(tmp_path / "scene" / "seq-01")
    (folder / "camera-intrinsics.txt").unlink()
    return folder


def kinect_sized(tmp_path: Path, code_for_none: int) -> Path:
    """The same in the size of a Kinect, holes marked by a code."""
    folder = bare(tmp_path)
    depth = np.full((480, 640), 1500, np.uint16)
    depth[:50] = code_for_none
    for file in folder.glob("*.depth.png"):
        file.write_bytes(png(depth))
    return folder


@pytest.mark.parametrize("above", [False, True])
@pytest.mark.parametrize(
    "name",
    [
        "intrinsics.K.txt",
        "camera-intrinsics.txt",
        "camera-intrinsics.color.txt",
        "camera-intrinsics.depth.txt",
    ],
)
def test_intrinsics_beside_or_above_the_frames_are_read(tmp_path: Path, name: str, above: bool) -> None:
    folder = bare(tmp_path)
    ((folder.parent if above else folder) / name).write_text(K)
    recording = open_recording(folder)
    assert (recording.camera, recording.warnings) == (SMALL, ())
    # Depth that is to be seen with colour's intrinsics lies on colour's pixels.
    assert recording.color_registered == ("color" in name)


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_spellings_of_a_matrix(tmp_path: Path, spelling: str) -> None:
    folder = bare(tmp_path)
    (folder / "intrinsics.K.txt").write_text(SPELLINGS[spelling])
    assert open_recording(folder).camera == SMALL


def test_a_change_above_the_folder_is_a_change_of_the_recording(tmp_path: Path) -> None:
    folder = bare(tmp_path)
    file = folder.parent / "camera-intrinsics.txt"
    file.write_text(K)
    assert file in source_files(folder)
    before = content_hash(source_files(folder), folder)
    file.write_text(K.replace("31.5", "30.5"))
    assert content_hash(source_files(folder), folder) != before
    # The folder's own intrinsics win, and those above no longer count.
    (folder / "intrinsics.K.txt").write_text(K)
    assert file not in source_files(folder)
    assert open_recording(folder).camera == SMALL


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (K.replace("31.5", "319.5"), r"principal point \(319.5, 23.5\) lies outside the 64x48"),
        (K.replace("60.0", "0.6").replace("61.0", "0.6"), r"focal length of 0.6 pixels .* of 178 degrees"),
        (K.replace("60.0", "60000"), "focal length of 60000 pixels .* of 0 degrees"),
        (K.replace("60.0", "-60"), "focal lengths -60, 61 are not positive"),
        (K.replace("60.0", "nan"), "is not a pinhole matrix"),
        (f"{FX} {FY} {CX}\n", "holds 3 numbers, not the 3x3 of a pinhole matrix"),
        ("fx fy cx cy\n", "line 1: 'fx' is not a number"),
        ("", "holds 0 numbers"),
    ],
)
def test_intrinsics_that_contradict_the_images_are_one_line(tmp_path: Path, text: str, message: str) -> None:
    folder = bare(tmp_path)
    (folder / "intrinsics.K.txt").write_text(text)
    with pytest.raises(RecordingError, match=rf"intrinsics\.K\.txt.*{message}") as caught:
        open_recording(folder)
    assert "\n" not in str(caught.value)


def test_the_settings_win_over_intrinsics_that_contradict_the_images(tmp_path: Path) -> None:
    folder = bare(tmp_path)
    (folder / "intrinsics.K.txt").write_text(K.replace("60.0", "0.6"))
    said = CameraSettings(fx=FX, fy=FY, cx=CX, cy=CY)
    assert open_recording(folder, said).camera == SMALL


def test_the_default_camera_is_said_to_be_assumed(tmp_path: Path) -> None:
    folder = kinect_sized(tmp_path, code_for_none=0)
    recording = open_recording(folder)
    assert recording.camera == Camera(640, 480, 585.0, 585.0, 320.0, 240.0)
    (warning,) = recording.warnings
    assert "are assumed (585, 585, 320, 240)" in warning and "intrinsics.K.txt" in warning
    assert "`camera:`" in warning
    # Whoever gives the camera knows, and in 7-Scenes itself it is no assumption.
    said = CameraSettings(fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    assert open_recording(folder, said).warnings == ()
    assert open_recording(kinect_sized(tmp_path / "own", code_for_none=65535)).warnings == ()


def info(depth_shift: str = "1000", width: int = 64) -> str:
    row = f"{FX} 0 {CX} 0 0 {FY} {CY} 0 0 0 1 0 0 0 0 1"
    return (
        f"m_versionNumber = 4\nm_sensorName = StructureSensor\nm_depthWidth = {width}\nm_depthHeight = 48\n"
        f"m_depthShift = {depth_shift}\nm_calibrationColorIntrinsic = 120 0 63 0 0 122 47 0 0 0 1 0 0 0 0 1\n"
        f"m_calibrationColorExtrinsic = {IDENTITY}\nm_calibrationDepthIntrinsic = {row}\n"
        f"m_calibrationDepthExtrinsic = {IDENTITY}\nm_frames.size = 5\n"
    )


@pytest.mark.parametrize("name", ["info.txt", "_info.txt"])
def test_the_info_of_scannets_tools_is_read(tmp_path: Path, name: str) -> None:
    folder = bare(tmp_path)
    for file in folder.glob("*.color.png"):
        large = np.repeat(np.repeat(color_image(0), 2, axis=0), 2, axis=1)
        file.with_name(file.name.replace(".png", ".jpg")).write_bytes(jpeg(large))
        file.unlink()
    (folder / name).write_text(info("4000"))
    recording = open_recording(folder)
    assert (recording.camera, recording.depth_scale, recording.warnings) == (SMALL, 4000.0, ())
    assert recording.color_calibration is not None and not recording.color_registered
    assert recording.color_calibration.camera == Camera(128, 96, 120.0, 122.0, 63.0, 47.0)
    (folder / name).write_text(info(width=640))
    with raises(RecordingError, "recording.bad-intrinsics", match="640x48"):
        open_recording(folder)
    for wrong in (info("0"), info("many"), info().replace("m_depthShift = 1000", "m_depthShift = -1")):
        (folder / name).write_text(wrong)
        with pytest.raises(RecordingError, match=name):
            open_recording(folder)


def test_poses_of_scannets_tools_are_moved_from_the_rig_to_depth(tmp_path: Path) -> None:
    folder = bare(tmp_path)
    before = open_recording(folder, CameraSettings(fx=FX, fy=FY, cx=31.5, cy=23.5)).given_trajectory
    assert before is not None
    place = np.eye(4)
    place[0, 3] = 0.05
    said = " ".join(f"{value:g}" for value in place.ravel())
    row = f"m_calibrationDepthExtrinsic = {IDENTITY}"
    (folder / "info.txt").write_text(info().replace(row, f"m_calibrationDepthExtrinsic = {said}"))
    given = open_recording(folder).given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera, before.T_world_camera @ place, atol=1e-3)
    assert np.abs(given.T_world_camera - before.T_world_camera).max() > 0.04


def test_no_camera_is_assumed_where_the_settings_give_it(tmp_path: Path) -> None:
    """A plain folder with Redwood's names and size."""
    for name in ("depth", "color"):
        (tmp_path / "r" / name).mkdir(parents=True)
    for i in range(3):
        name = f"{i + 1:07d}-{i * 33_333:012d}"
        (tmp_path / f"r/depth/{name}.png").write_bytes(png(np.full((480, 640), 1500, np.uint16)))
    assert "PrimeSense camera are taken" in " ".join(open_recording(tmp_path / "r").warnings)
    given = CameraSettings(fx=600.0, fy=601.0, cx=320.0, cy=240.0)
    recording = open_recording(tmp_path / "r", given)
    assert (recording.camera.fx, recording.warnings) == (600.0, ())


def test_a_setting_of_another_format_is_said_to_do_nothing(tmp_path: Path) -> None:
    given = CameraSettings(color_delay_s=0.01, swap_red_blue=True, sensor="NP1", mask_object=1)
    scenes = open_recording(write_seven_scenes(tmp_path / "s"), given)
    assert "`color_delay_s`, `mask_object`, `sensor`, `swap_red_blue` under" in scenes.warnings[-1]
    assert scenes.color_delay_s == 0.0
    folder = open_recording(write_folder(tmp_path / "f"), CameraSettings(color_delay_s=0.01))
    assert (folder.warnings, folder.color_delay_s) == ((), 0.01)


@pytest.mark.parametrize("name", FORMATS)
def test_the_settings_that_a_reader_uses_are_those_that_it_names(name: str) -> None:
    """By the text of its module; those of bags share a second one."""
    reader = reader_of(name)
    modules: list[type] = [reader, *([RosRecording] if issubclass(reader, RosRecording) else [])]
    text = "\n".join(Path(inspect.getfile(each)).read_text("utf-8") for each in modules)
    mentioned = {each for each in OF_SOME_FORMATS if f"settings.{each}" in text}
    # `pair_files` of a plain folder takes the settings.
    paired = {"color_delay_s"} if "pair_files(" in text else set()
    assert reader.uses == mentioned | paired


def test_another_info_is_none(tmp_path: Path) -> None:
    folder = bare(tmp_path)
    (folder / "info.txt").write_text("recorded in the kitchen")
    with raises(RecordingError, "recording.no-intrinsics"):
        open_recording(folder)


NO_NUMBERS = [
    "1e999",
    "-Infinity",
    "NaN",
    "9" * 400,
    "[" + "0," * 10_000 + "0]",
    '"' + "x" * 5000 + '"',
    "true",
]


@pytest.mark.parametrize("text", NO_NUMBERS, ids=range(len(NO_NUMBERS)))
def test_what_is_no_finite_number_is_told_in_one_short_line(text: str) -> None:
    with pytest.raises(RecordingError) as caught:
        number_of(object_of(f'{{"a": {text}}}', "here", "a")["a"], "here: 'a'")
    assert len(str(caught.value)) < 200 and str(caught.value).isprintable()
