"""Folders as other programs write them: their names, their intrinsics, their kinds of images."""

import io
import json
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import CX, CY, FX, FY, HEIGHT, WIDTH, depth_image, write_folder, write_tum
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.doctor import inspect
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import FileRecording

MATRIX = [FX, 0, CX, 0, FY, CY, 0, 0, 1]
CAMERA = (WIDTH, HEIGHT, FX, FY, CX, CY)
YAML = f"""%YAML:1.0
---
camera_name: "0"
image_width: {WIDTH}
image_height: {HEIGHT}
camera_matrix:
   rows: 3
   cols: 3
   data: {MATRIX}
distortion_coefficients:
   rows: 1
   cols: 5
   data: [ 0., 0., 0., 0., 0. ]
"""


def without_intrinsics(folder: Path) -> Path:
    write_folder(folder)
    (folder / "camera_intrinsic.json").unlink()
    return folder


def opened(folder: Path, settings: CameraSettings | None = None) -> FileRecording:
    recording = open_recording(folder, settings)
    assert isinstance(recording, FileRecording)
    return recording


def camera_of(recording: FileRecording) -> tuple[float, ...]:
    camera = recording.camera
    return (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


# --- intrinsics ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "text", "scale", "note"),
    [
        ("camera.json", {"cam_K": MATRIX, "depth_scale": 0.5}, 2000, "taken for mm a unit"),
        (
            "intrinsics.json",
            {"fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "w": WIDTH, "h": HEIGHT, "depth_scale": 0.00025},
            4000,
            "taken for metres a unit",
        ),
        ("cam_K.json", {"K": MATRIX}, 1000, ""),
        ("calibration.txt", f"{FX} {FY} {CX} {CY}\n", 1000, ""),
        ("calib/000000.yaml", YAML, 1000, ""),
        ("calib.yml", YAML.replace("[ 0.,", "[ 0.1,"), 1000, "its distortion is not taken away"),
        ("intrinsics.json", {"k": MATRIX}, 1000, ""),
        ("camera.json", {"camera_matrix": {"rows": 3, "data": MATRIX}}, 1000, ""),
        ("intrinsics.yaml", f"K: {MATRIX}\n", 1000, ""),
        ("intrinsics.yaml", f"camera:\n  k: [[{FX}, 0, {CX}],\n  [0, {FY}, {CY}],\n  [0, 0, 1]]\n", 1000, ""),
        (
            "camera.yaml",
            f"camera_matrix:\n- - {FX}\n  - 0.\n  - {CX}\n- [0, {FY}, {CY}]\n- [0, 0, 1]",
            1000,
            "",
        ),
        ("kalibr.yaml", f"cam0:\n  intrinsics: [{FX}, {FY}, {CX}, {CY}]  # fu fv\n  k: 3\n", 1000, ""),
        ("orb.yaml", f"Camera.fx: {FX}\nCamera.fy: {FY}\nCamera.cx: {CX}\nCamera.cy: {CY}\n", 1000, ""),
    ],
)
def test_intrinsics_by_other_programs(
    tmp_path: Path, name: str, text: object, scale: float, note: str
) -> None:
    folder = without_intrinsics(tmp_path / "r")
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text(text if isinstance(text, str) else json.dumps(text))
    recording = opened(folder)
    assert camera_of(recording) == CAMERA and recording.depth_scale == pytest.approx(scale)
    assert any(note in line for line in recording.warnings) if note else recording.warnings == ()


TWO = (("depth", 365.0), ("color", 540.0))
KEYS, CAMERA_NUMBERS = ("fx", "fy", "cx", "cy"), (FX, FY, CX, CY)


@pytest.mark.parametrize("text", ["K: {}\nD: [0.1, 0.2, 0, 0, 0]\n", "K: {}\nCamera.k1: 0.1\n"])
def test_a_distortion_beside_a_matrix_is_named(tmp_path: Path, text: str) -> None:
    folder = without_intrinsics(tmp_path / "r")
    (folder / "intrinsics.yaml").write_text(text.format(f"[{FX}, 0, {CX}, 0, {FY}, {CY}, 0, 0, 1]"))
    assert any("its distortion is not taken away" in line for line in open_recording(folder).warnings)


def test_files_of_one_camera_with_a_distortion_agree(tmp_path: Path) -> None:
    folder = without_intrinsics(tmp_path / "r")
    (folder / "calib").mkdir()
    for i in range(3):
        (folder / f"calib/{i}.yaml").write_text(YAML.replace("[ 0.,", "[ 0.1,"))
    recording = opened(folder)
    assert camera_of(recording) == CAMERA and "0.yaml: its distortion is" in recording.warnings[0]
    (folder / "calib/2.yaml").write_text(YAML.replace(f"{FX}", "61.5"))
    with raises(
        RecordingError,
        "recording.bad-intrinsics",
        match=r"2\.yaml: has another camera or unit .*0\.yaml",
    ):
        opened(folder)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"K: [{FX}, 0, {CX}, 0, {FY}", r"intrinsics\.yaml: 'K' holds 5 numbers, not the nine"),
        ("camera_matrix: {file: cam.npy}\n", r"does not say its intrinsics.*may stand in intrinsics\.yaml"),
        (f"fx: {FX}\nfy: {FY}\n", r"does not say its intrinsics.*may stand in intrinsics\.yaml"),
        ("k: 4\n", r"does not say its intrinsics \(fx, fy, cx, cy\).*may stand in intrinsics\.yaml"),
        # Of two cameras none is taken.
        (
            "depth: {cx: 1}\n" + "".join(f"{c}:\n  fx: {f}\n  fy: {f}\n  cx: 3\n  cy: 2\n" for c, f in TWO),
            r"intrinsics\.yaml: holds 'fx' more than once, with other numbers",
        ),
        (
            "".join(
                f"Camera{n}.{k}: {v + n}\n" for n in (1, 2) for k, v in zip(KEYS, CAMERA_NUMBERS, strict=True)
            ),
            r"holds 'fx' more than once",
        ),
        (
            f"cam0:\n  intrinsics: [{FX}, {FY}, {CX}, {CY}]\ncam1:\n  intrinsics: [{FX}, {FY}, 1, 2]\n",
            r"holds 'intrinsics' more than once",
        ),
    ],
)
def test_intrinsics_that_are_not_whole_are_named(tmp_path: Path, text: str, words: str) -> None:
    folder = without_intrinsics(tmp_path / "r")
    (folder / "intrinsics.yaml").write_text(text)
    with pytest.raises(RecordingError, match=words):
        open_recording(folder)
    diagnosis, _ = inspect(folder)
    assert diagnosis.stops and re.search(words, diagnosis.findings[0].what)


def test_the_lists_of_tum_with_a_calibration_of_eth3d(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "camera.json").unlink()
    (folder / "calibration.txt").write_text(f"{FX} {FY} {CX} {CY}\n")
    assert camera_of(opened(folder)) == CAMERA


def test_cameras_of_images_that_differ_are_refused(tmp_path: Path) -> None:
    folder = without_intrinsics(tmp_path / "r")
    (folder / "calib").mkdir()
    (folder / "calib" / "0.yaml").write_text(YAML)
    (folder / "calib" / "1.yaml").write_text(YAML.replace(str(FX), str(FX + 1)))
    with raises(RecordingError, "recording.bad-intrinsics", match=r"1\.yaml.*0\.yaml"):
        open_recording(folder)


@pytest.mark.parametrize("name", ["calibration.txt", "camera.txt", "calib/0.yaml"])
def test_what_is_no_intrinsics_does_not_stand_in_the_way(tmp_path: Path, name: str) -> None:
    """Other programs' files of those names, and cameras that contradict each other beside a person's word."""
    folder = without_intrinsics(tmp_path / "r")
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text(YAML if name.endswith("yaml") else "P0: 7.1 0 6.0\n")
    if name.endswith("yaml"):
        (folder / "calib" / "1.yaml").write_text(YAML.replace(str(FX), str(FX + 1)))
    else:
        with raises(RecordingError, "recording.no-intrinsics", match=f"in .*{re.escape(name)}"):
            open_recording(folder)
    assert camera_of(opened(folder, CameraSettings(fx=FX, fy=FY, cx=CX, cy=CY))) == CAMERA


def test_a_second_file_with_intrinsics_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "cam_K.txt").write_text(f"{FX} {FY} {CX} {CY}\n")
    (line,) = opened(folder).warnings
    assert "camera_intrinsic.json: is read, and not cam_K.txt beside it" in line


@pytest.mark.parametrize(("name", "is_depth"), [("aligned_depth", True), ("depth_view", False)])
def test_a_second_folder_of_depth_is_named(tmp_path: Path, name: str, is_depth: bool) -> None:
    folder = write_folder(tmp_path / "r")
    shutil.copytree(folder / ("depth" if is_depth else "color"), folder / name)
    said = opened(folder).warnings
    assert len(said) == is_depth and all("and not from aligned_depth/ beside it" in line for line in said)


def test_a_hostile_yaml_is_read_in_no_time(tmp_path: Path) -> None:
    folder = without_intrinsics(tmp_path / "r")
    for text in (
        "camera_matrix:" + "\n" * 60_000,
        "camera_matrix:\n" * 4_000,
        "camera_matrix:\n data: [" + "1 " * 30_000,
    ):
        (folder / "calib.yaml").write_text(text)
        started = time.process_time()
        with raises(RecordingError, "recording.bad-intrinsics", match="not say|'camera_matrix'"):
            open_recording(folder)
        assert time.process_time() - started < 2


def test_files_that_look_like_intrinsics_are_named(tmp_path: Path) -> None:
    folder = without_intrinsics(tmp_path / "r")
    (folder / "my_calib.npy").touch()
    with raises(RecordingError, "recording.no-intrinsics", match=r"my_calib\.npy"):
        open_recording(folder)


def test_a_camera_that_contradicts_itself_is_refused(tmp_path: Path) -> None:
    folder = without_intrinsics(tmp_path / "r")
    (folder / "camera.json").write_text(json.dumps({"cam_K": MATRIX, "fx": 2 * FX}))
    with raises(RecordingError, "recording.bad-intrinsics", match="'fx'"):
        open_recording(folder)


# --- images -------------------------------------------------------------------------------------------


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def tiff(array: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".tiff", array)[1])


@pytest.mark.parametrize(
    ("encode", "settings", "warned"),
    [
        (lambda metres: (".npy", npy(metres)), None, False),
        (lambda metres: (".npy", npy(np.where(metres > 0, metres, np.nan))), None, False),
        (lambda metres: (".tiff", tiff(np.where(metres > 0, metres, np.inf))), None, False),
        (lambda metres: (".npy", npy(metres[None])), None, False),
        (lambda metres: (".npy", npy(np.asfortranarray(metres.astype(np.float64)))), None, False),
        (lambda metres: (".npy", npy(1000 * metres)), None, True),
        (lambda metres: (".npy", npy(1000 * metres)), CameraSettings(depth_scale=1000), False),
        (lambda metres: (".tiff", tiff(metres)), None, False),
        (lambda metres: (".npy", npy(np.rint(1000 * metres).astype(np.uint16))), None, False),
        (lambda metres: (".tif", tiff(np.rint(1000 * metres).astype(np.uint16))), None, False),
    ],
)
def test_depth_that_is_no_png(
    tmp_path: Path,
    encode: Callable[[np.ndarray], tuple[str, bytes]],
    settings: CameraSettings | None,
    warned: bool,
) -> None:
    """Floats in metres or millimetres, and whole numbers; each within 1 mm."""
    folder = write_folder(tmp_path / "r")
    expected_m = []
    for i, image in enumerate(sorted((folder / "depth").iterdir())):
        expected_m.append(depth_image(i, 1000.0) / 1000)
        suffix, data = encode(expected_m[-1].astype(np.float32))
        image.with_suffix(suffix).write_bytes(data)
        image.unlink()
    recording = opened(folder, settings)
    for i, metres in enumerate(expected_m):
        np.testing.assert_allclose(recording.frame(i).depth / recording.depth_scale, metres, atol=0.0006)
    assert any("taken for millimetres" in line for line in recording.warnings) == warned


@pytest.mark.parametrize(("high", "low"), [(1, 0), (2, 1), (0, 2)])
def test_depth_in_two_channels_of_eight_bits(tmp_path: Path, high: int, low: int) -> None:
    """As NYU's hands store it (high byte green, low byte blue), and others."""
    folder = write_folder(tmp_path / "r")
    for i, image in enumerate(sorted((folder / "depth").iterdir())):
        depth = smooth(i)
        channels = np.zeros((*depth.shape, 3), np.uint8)
        channels[..., high], channels[..., low] = depth >> 8, depth & 255
        cv2.imwrite(str(image), channels)
    recording = opened(folder)
    for i in range(4):
        np.testing.assert_array_equal(recording.frame(i).depth, smooth(i))
    assert any("two 8-bit channels" in line for line in recording.warnings)


def smooth(i: int) -> np.ndarray:
    """A floor and a wall that sees far, in mm: (height, width) uint16."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return np.asarray(900 + 31 * i + 37 * v + 5 * u, np.uint16)


def test_a_picture_in_false_colours_is_not_taken_for_two_channels(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    for i, image in enumerate(sorted((folder / "depth").iterdir())):
        gray = np.clip(smooth(i) / 16, 0, 255).astype(np.uint8)
        cv2.imwrite(str(image), cv2.applyColorMap(gray, cv2.COLORMAP_JET))
    with raises(RecordingError, "recording.other-image", match="8-bit"):
        opened(folder).frame(0)


@pytest.mark.parametrize(
    ("depth", "color"),
    [
        ("{:06d}-depth.png", "{:06d}-color.jpg"),
        ("depth_{:d}.png", "rgb_{:d}.jpg"),
        ("run_Depth_{:d}.png", "run_Color_{:d}.jpg"),
        ("{:d}.depth.npy", "{:d}.color.jpg"),
    ],
)
def test_depth_and_colour_side_by_side(tmp_path: Path, depth: str, color: str) -> None:
    """As YCB-Video has them, and others; the word in the name tells which is which."""
    folder = write_folder(tmp_path / "r")
    for i in range(4):
        to = folder / depth.format(i + 9)
        if to.suffix == ".npy":
            to.write_bytes(npy(depth_image(i, 1000.0)))
        else:
            (folder / f"depth/{i}.png").rename(to)
        (folder / f"color/{i}.jpg").rename(folder / color.format(i + 9))
    for name in ("depth", "color"):
        for file in (folder / name).iterdir():
            file.unlink()
        (folder / name).rmdir()
    if depth.endswith(".npy"):
        with pytest.raises(RecordingError):  # a word beside arrays says too little
            open_recording(folder)
        return
    recording = opened(folder)
    assert recording.warnings == () and len(recording) == 4
    for i in range(4):
        frame = recording.frame(i)
        np.testing.assert_array_equal(frame.depth, depth_image(i, 1000.0))
        assert frame.color is not None and recording.places[i].color == folder / color.format(i + 9)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ([f"run_Depth_{i}.png" for i in range(6)], "6 images named depth, .* are pictures in 8 bits"),
        (["EXR_RGBD/depth/0.exr", "EXR_RGBD/rgb/0.jpg"], r"EXR_RGBD/depth/0\.exr: EXR images are not read"),
    ],
)
def test_depth_that_is_not_read_is_named(tmp_path: Path, files: list[str], words: str) -> None:
    for name in files:
        file = tmp_path / "r" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        file.write_bytes(bytes(cv2.imencode(".png", picture)[1]))
    with raises(RecordingError, "recording.unknown-format", match=words):
        open_recording(tmp_path / "r")


@pytest.mark.parametrize("suffix", [".npy", ".tiff"])
@pytest.mark.parametrize("kept", [3, 9, 60, 200])
def test_damaged_arrays_are_left_out(tmp_path: Path, suffix: str, kept: int) -> None:
    """Cut off anywhere, also in their heads; nothing is unpickled."""
    folder = write_folder(tmp_path / "r", stems=[str(i) for i in range(40)])
    for i, image in enumerate(sorted((folder / "depth").iterdir())):
        array = (depth_image(i % 4, 1000.0) / 1000).astype(np.float32)
        data = npy(array) if suffix == ".npy" else tiff(array)
        image.with_suffix(suffix).write_bytes(data[:kept] if i == 7 else data)
        image.unlink()
    recording = opened(folder)
    damaged = 0
    for index in range(len(recording)):
        try:
            recording.frame(index)
        except RecordingError:
            damaged += 1
    assert damaged == 1


def test_an_array_of_objects_is_refused(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    for image in sorted((folder / "depth").iterdir()):
        stream = io.BytesIO()
        np.save(stream, np.array([{"a": 1}], dtype=object), allow_pickle=True)
        image.with_suffix(".npy").write_bytes(stream.getvalue())
        image.unlink()
    with raises(RecordingError, "recording.no-frame"):
        open_recording(folder)


def test_depth_images_of_two_kinds_are_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "depth" / "9.npy").write_bytes(npy(depth_image(0, 1000.0)))
    assert any(
        "1 .npy (such as 9.npy) images beside the 4 .png (such as 0.png) are" in line
        for line in opened(folder).warnings
    )
