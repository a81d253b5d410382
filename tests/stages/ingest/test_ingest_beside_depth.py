"""Files beside the depth images: small arrays, other kinds of images, and JSON files with two cameras."""

import json
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import depth_image, write_folder
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.image_names import counting_key, several_series
from kinectbench.stages.ingest.readers import open_recording

COLOR = {"width": 64, "height": 48, "fx": 60.5, "fy": 61.0, "ppx": 31.25, "ppy": 23.0}
DEPTH = {"fx": 70.0, "fy": 70.0, "cx": 32.0, "cy": 24.0}
SHOWN = "color_intrinsics as `camera: {fx: 60.5, fy: 61, cx: 31.25, cy: 23}`"


@pytest.mark.parametrize("suffix", ["png", "npy"])
def test_small_arrays_are_no_depth_images(tmp_path: Path, suffix: str) -> None:
    """Matrices of a calibration, which come first by their names."""
    folder = write_folder(tmp_path / "r")
    for name in ("R", "t"):
        np.save(folder / f"depth/0_{name}.npy", np.eye(3))
    for i in range(4):
        if suffix == "npy":
            (folder / f"depth/{i}.png").unlink()
            np.save(folder / f"depth/{i}.npy", depth_image(i, 1000.0))
    recording = open_recording(folder)
    assert (len(recording), recording.warnings) == (4, ())
    np.testing.assert_array_equal(recording.frame(3).depth, depth_image(3, 1000.0))


@pytest.mark.parametrize(("pngs", "arrays", "kind"), [(4, 3, ".png"), (4, 4, ".png"), (3, 4, ".npy")])
def test_of_two_kinds_that_with_most_files_is_read(tmp_path: Path, pngs: int, arrays: int, kind: str) -> None:
    folder = write_folder(tmp_path / "r", [str(i) for i in range(pngs)])
    for i in range(arrays):
        np.save(folder / f"depth/{i}.npy", depth_image(i, 1000.0))
    recording = open_recording(folder)
    assert len(recording) == max(pngs, arrays) and str(recording.frame(0).name).endswith(kind)
    assert "keep one kind" in recording.warnings[0]


def without_intrinsics(folder: Path, content: object) -> Path:
    write_folder(folder)
    (folder / "camera_intrinsic.json").unlink()
    (folder / "intrinsics.json").write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize(
    ("depth", "shown"),
    [
        (DEPTH, "raw_depth as `camera: {fx: 70, fy: 70, cx: 32, cy: 24}`"),
        (
            {"K": [[70, 0, 32], [0, 71, 24], [0, 0, 1]]},
            "raw_depth as `camera: {fx: 70, fy: 71, cx: 32, cy: 24}`",
        ),
        (
            {"cam_K": [70, 0, 0, 0, 71, 0, 32, 24, 1]},
            "raw_depth as `camera: {fx: 70, fy: 71, cx: 32, cy: 24}`",
        ),
    ],
)
def test_each_camera_of_a_file_with_two_is_printed(tmp_path: Path, depth: object, shown: str) -> None:
    cameras = {"color_intrinsics": COLOR, "raw_depth": depth, "extrinsics": {"rotation": [1.0] * 9}}
    folder = without_intrinsics(tmp_path / "r", cameras)
    words = (
        "intrinsics.json holds cameras color_intrinsics and raw_depth: give that of depth, or that of colour"
    )
    with raises(RecordingError, "recording.no-intrinsics", match=words) as error:
        open_recording(folder)
    assert f": {SHOWN}, {shown}" in str(error.value)


def test_one_camera_under_a_name_and_none(tmp_path: Path) -> None:
    for name, content, words in (
        ("a", {"color_intrinsics": COLOR}, "holds the camera color_intrinsics: .*as `camera: "),
        ("b", {"x": {"fx": 1.0}, "y": {"K": "text"}, "z": 3}, "they may stand in intrinsics.json"),
        ("d", {"x": {**DEPTH, "fx": 0.0}, "y": {"K": [1] * 9}}, "they may stand in intrinsics.json"),
        ("e", {"x": {**DEPTH, "cx": 1e300}}, "they may stand in intrinsics.json"),
        ("c", {"x": {**DEPTH, "fx": float("nan")}, "y": []}, "they may stand in intrinsics.json"),
    ):
        with raises(RecordingError, "recording.no-intrinsics", match=words):
            open_recording(without_intrinsics(tmp_path / name, content))


def test_a_camera_is_printed_though_a_transforms_json_is_beside_it(tmp_path: Path) -> None:
    folder = without_intrinsics(tmp_path / "r", {})
    (folder / "intrinsics.json").rename(folder / "transforms.json")
    (folder / "depth_intrinsics.json").write_text(json.dumps(DEPTH))
    with raises(RecordingError, "recording.no-intrinsics", match="as `camera: {fx: 70, fy: 70, cx: 32"):
        open_recording(folder)


def test_cameras_of_two_files_are_printed(tmp_path: Path) -> None:
    folder = without_intrinsics(tmp_path / "r", {})
    (folder / "intrinsics.json").unlink()
    for name, camera in (("color", COLOR), ("depth", DEPTH)):
        (folder / f"{name}_intrinsics.json").write_text(json.dumps(camera))
    words = (
        "color_intrinsics.json and depth_intrinsics.json hold cameras color_intrinsics and depth_intrinsics"
    )
    with raises(RecordingError, "recording.no-intrinsics", match=words) as error:
        open_recording(folder)
    assert "depth_intrinsics as `camera: {fx: 70, fy: 70, cx: 32, cy: 24}`" in str(error.value)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("{:06d}-meta.mat", "the files of each frame, such as 000000-meta.mat"),
        ("cameras/{:04d}.json", "the files of each frame, such as cameras/0000.json"),
        ("sparse/0/cameras{}.txt", "they may stand in sparse/0/cameras0.txt"),
        ("transforms.json", "transforms.json may have them, and poses: write a depth_file_path into each"),
        ("masks/{}.json", r"does not say its intrinsics \(fx, fy, cx, cy\)[^;]*$"),
        ("pose/{:06d}.txt", r"does not say its intrinsics \(fx, fy, cx, cy\)[^;]*$"),
        ("camera_poses/{:06d}.json", r"does not say its intrinsics \(fx, fy, cx, cy\)[^;]*$"),
        ("frame-{:06d}.pose.txt", r"does not say its intrinsics \(fx, fy, cx, cy\)[^;]*$"),
    ],
)
def test_other_files_that_may_hold_intrinsics_are_named(tmp_path: Path, name: str, words: str) -> None:
    folder = without_intrinsics(tmp_path / "r", {})
    (folder / "intrinsics.json").unlink()
    for i in range(5):
        (folder / name.format(i)).parent.mkdir(parents=True, exist_ok=True)
        (folder / name.format(i)).touch()
    with raises(RecordingError, "recording.no-intrinsics", match=words):
        open_recording(folder)


def test_a_video_beside_depth_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "rgb.mp4").touch()
    assert not any("no colour" in line for line in open_recording(folder).warnings)
    (folder / "color").rename(tmp_path / "away")
    (line,) = open_recording(folder).warnings
    assert "no colour is read; rgb.mp4 is a video: write its frames to color/" in line
    for name in ("depth_preview.mp4", "turntable_depth.avi", "disparity.mp4", ".hidden.mp4"):
        (folder / name).touch()
    assert open_recording(folder).warnings == (line,)
    (folder / "side.mov").touch()
    (line,) = open_recording(folder).warnings
    assert "no colour is read; rgb.mp4, side.mov are videos: write that of colour's frames to" in line


@pytest.mark.parametrize(
    "form",
    ["cam{}_{:04d}", "{1:04d}_cam{0}", "83621206012{}_{}", "{1}-kinect_0{0}", "RS{}_{}", "{1:03d}_sn-{0}"],
)
def test_two_cameras_in_one_folder_are_named(tmp_path: Path, form: str) -> None:
    names = [form.format(camera, i) for camera in range(2) for i in range(5)]
    (line,) = open_recording(write_folder(tmp_path / "r", names)).warnings
    assert "the names of depth are 2 series" in line and "give each its own folder" in line
    assert all(form.format(camera, 0) in line for camera in range(2))


@pytest.mark.parametrize("words", [("left", "right"), ("a", "b"), ("_master", "_sub")])
def test_two_words_in_one_folder_are_named(tmp_path: Path, words: tuple[str, str]) -> None:
    names = [f"{i:04d}{word}" for word in words for i in range(5)]
    (line,) = open_recording(write_folder(tmp_path / "r", names)).warnings
    assert "the names of depth are 2 series" in line


@pytest.mark.parametrize(
    "names",
    [
        [f"12-{30 + i // 60}-{i % 60:02d}" for i in range(240)],
        [f"frame_{i // 5}_{i % 5 * 200}" for i in range(40)],
        [f"{i // 5}-{i % 5 * 200000000}" for i in range(40)],
        [f"part{i // 50:02d}_{i % 50:03d}" for i in range(200)],
        [f"el{e}_az{a:03d}" for e in (10, 30, 45) for a in range(0, 360, 10)],
        [f"{a:03d}_{e}" for a in range(0, 360, 10) for e in (10, 30, 45)],
        [f"r{row}_c{column}" for row in range(6) for column in range(6)],
    ],
)
def test_numbers_that_restart_are_no_cameras(names: list[str]) -> None:
    assert several_series(sorted(names, key=counting_key)) == []


@pytest.mark.parametrize("form", ["frame_{:04d}", "scan_1_{:03d}", "1305031102_{:06d}", "{0}-{0:012d}"])
def test_one_camera_is_no_series(tmp_path: Path, form: str) -> None:
    names = [form.format(i * 33333 if "06d" in form else i) for i in range(12)]
    assert not any("series" in line for line in open_recording(write_folder(tmp_path / "r", names)).warnings)


@pytest.mark.parametrize(
    ("name", "said"), [("colours", 1), ("RGB_images", 1), ("img", 1), ("depth_images", 0), ("rgb", 0)]
)
def test_a_folder_that_looks_like_colour_is_named(tmp_path: Path, name: str, said: int) -> None:
    folder = write_folder(tmp_path / "r", stems=[str(i) for i in range(6)])
    (folder / "color").rename(folder / name)
    lines = [line for line in open_recording(folder).warnings if "no colour is read" in line]
    assert len(lines) == said
    assert all(f"{name}/0.jpg and 5 more: rename the folder to color/" in line for line in lines)
