"""Names of files and folders in another case are read; misspelled ones are named with the nearest."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import HEIGHT, WIDTH, png, write_folder, write_tum
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.intrinsics_files import LIKE_INTRINSICS
from kinectbench.stages.ingest.known_names import first_file, first_named, in_any_case, visible
from kinectbench.stages.ingest.readers import find_recordings, open_recording
from kinectbench.stages.ingest.readers.folder_images import color_images
from kinectbench.stages.ingest.readers.phone_images import ConfidenceRecording
from kinectbench.stages.ingest.recording import FrameFiles, with_masks


@pytest.mark.parametrize(
    ("format_name", "names"),
    [
        ("tum", {"depth.txt": "Depth.txt", "rgb.txt": "RGB.txt"}),
        ("tum", {"groundtruth.txt": "GroundTruth.TXT", "camera.json": "Camera.json"}),
        ("folder", {"depth": "Depth", "color": "COLOR", "camera_intrinsic.json": "Camera_Intrinsic.JSON"}),
    ],
)
def test_names_in_another_case_are_read(tmp_path: Path, format_name: str, names: dict[str, str]) -> None:
    write = write_tum if format_name == "tum" else write_folder
    plain, renamed = write(tmp_path / "plain"), write(tmp_path / "renamed")
    for name, other in names.items():
        (renamed / name).rename(renamed / other)
    expected, found = open_recording(plain), open_recording(renamed)
    assert found.format == expected.format == format_name
    assert (found.camera, found.warnings) == (expected.camera, expected.warnings)
    assert (found.given_trajectory is None) == (expected.given_trajectory is None)
    assert all(found.frame(index).color for index in range(len(expected)))


@pytest.mark.parametrize("name", ["scan.LOG", "living.gt.FREIBURG", "Pose/{}.TXT"])
def test_poses_in_files_in_capitals_are_read(tmp_path: Path, name: str) -> None:
    folder = write_folder(tmp_path / "r")
    matrix = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    poses = {".LOG": f"{{0}} {{0}} {{0}}\n{matrix}", ".FREIBURG": "{0} 0 0 0 0 0 0 1\n", ".TXT": matrix}
    for index in range(4):
        file = folder / name.format(index)
        file.parent.mkdir(exist_ok=True)
        with file.open("a") as rows:
            rows.write(poses[file.suffix].format(index))
    given = open_recording(folder).given_trajectory
    assert given is not None and len(given.stamps_ns) == 4


def test_files_of_each_frame_and_of_the_camera_in_capitals_are_read(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "camera_intrinsic.json").unlink()
    for name, value in (("Calib", 0), ("masks", 1), ("confidence", 2)):
        (folder / name).mkdir()
        (folder / name / "1.PNG").write_bytes(png(np.full((HEIGHT, WIDTH), value, np.uint8)))
    (folder / "Calib" / "CAMERA.YAML").write_text("fx: 50\nfy: 51\ncx: 31\ncy: 23\n")
    found = open_recording(folder)
    assert (found.camera.fx, found.camera.fy) == (50, 51)
    assert found.frame(1).mask is not None
    assert isinstance(found, ConfidenceRecording) and found.confidence[1] is not None
    assert not [line for line in found.warnings if "of no frame" in line]


def test_two_names_that_differ_in_case_alone_are_ambiguous(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "camera.json").rename(folder / "Camera.json")
    (folder / "CAMERA.json").write_bytes((folder / "Camera.json").read_bytes())
    if len(list(folder.glob("*.json"))) == 1:
        pytest.skip("this file system does not tell them apart")
    with raises(
        RecordingError, "recording.no-intrinsics", match=r"CAMERA\.json and Camera\.json hold cameras"
    ):
        open_recording(folder)


def test_an_exact_name_comes_before_another_case_of_an_earlier_one(tmp_path: Path) -> None:
    for name in ("1.PNG", "1.jpg"):
        (tmp_path / name).touch()
    for names in (["1.png", "1.jpg"], ["1.jpg", "1.png"]):
        assert first_file(tmp_path / name for name in names) == tmp_path / "1.jpg"
    (tmp_path / "1.jpg").unlink()
    assert first_file([tmp_path / "1.png", tmp_path / "1.jpg"]) == tmp_path / "1.PNG"


@pytest.mark.parametrize("turn", range(4))
def test_files_are_listed_in_one_order_whatever_the_disk_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turn: int
) -> None:
    there = ["1.png", "1.npy", "1.PNG", "1.NPY"]
    order = [tmp_path / name for name in (*there[turn:], *there[:turn])]
    monkeypatch.setattr(
        "kinectbench.stages.ingest.known_names.listed_paths",
        lambda folder, wanted: (file for file in order if wanted(file.name)),
    )
    names = [file.name for file in visible(tmp_path, "*.npy", "*.png")]
    assert names == ["1.NPY", "1.npy", "1.PNG", "1.png"]  # of one stem, the last is kept


def test_misspelled_names_are_told_with_the_nearest(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "depth.txt").rename(folder / "depths.txt")
    (folder / "masks").mkdir()
    assert any(
        "depths.txt is not read: rename it to depth.txt" in line for line in open_recording(folder).warnings
    )
    (folder / "masks").rename(folder / "mask")
    assert any("mask/ is not read: rename it to masks/" in line for line in open_recording(folder).warnings)
    (folder / "depth").rename(folder / "depths")
    with raises(
        RecordingError, "recording.unknown-format", match="; depths/ is not read: rename it to depth/ if"
    ):
        open_recording(folder)
    (folder / "depths").rename(folder / "depth")
    (folder / "camera.json").rename(folder / "cam.json")
    with raises(RecordingError, "recording.no-intrinsics", match=r"cam\.json holds the camera cam"):
        open_recording(folder)


def test_gravity_and_unit_are_read_of_files_in_another_case(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    camera = json.loads((folder / "camera.json").read_text())
    (folder / "camera.json").unlink()
    del camera["depth_factor"]
    (folder / "Camera.JSON").write_text(json.dumps({**camera, "accelerometer_axes": "depth"}))
    (folder / "Unit.JSON").write_text('{"depth_scale": 1000}')
    stamps = [line.split()[0] for line in (folder / "depth.txt").read_text().splitlines()[1:]]
    (folder / "Accelerometer.txt").write_text("".join(f"{stamp} 0 -9.81 0\n" for stamp in stamps))
    recording = open_recording(folder)
    assert recording.up_cameras
    assert recording.depth_scale == 1000


def test_an_unread_file_of_intrinsics_in_another_case_is_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "Camera.JSON").write_bytes((folder / "camera_intrinsic.json").read_bytes())
    assert [line for line in open_recording(folder).warnings if "and not Camera.JSON beside it" in line]


def test_masks_are_looked_up_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, looked = write_folder(tmp_path / "r"), list[Path]()
    files = [FrameFiles(0, file, None) for file in sorted((folder / "depth").iterdir())]
    (folder / "Masks").mkdir()

    def counted(parent: Path, name: str) -> Path:
        looked.append(parent)
        return in_any_case(parent, name)

    monkeypatch.setattr("kinectbench.stages.ingest.recording.in_any_case", counted)
    assert len(with_masks(files, folder)) == 4
    assert looked == [folder]


@pytest.mark.parametrize("write", [write_tum, write_folder])
def test_masks_in_another_case_are_used(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    folder = write(tmp_path / "r")
    (folder / "Masks").mkdir()
    for name in ("1.png", "none.png"):
        (folder / "Masks" / name).write_bytes(png(np.zeros((HEIGHT, WIDTH), np.uint8)))
    recording = open_recording(folder)
    assert recording.frame(1).mask is not None
    assert [line for line in recording.warnings if "Masks: 1 mask is of no frame, such as none.png" in line]


def test_other_depth_in_another_case_is_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    shutil.copytree(folder / "depth", folder / "Aligned_Depth")
    assert [line for line in open_recording(folder).warnings if "not from Aligned_Depth/ beside it" in line]


def test_a_name_as_given_comes_before_all_in_another_case(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", color="rgb")
    (folder / "Color").mkdir()
    (folder / "Color" / "0.jpg").write_bytes((folder / "rgb" / "0.jpg").read_bytes())
    assert color_images(folder).files[0].parent.name == "rgb"
    (folder / "a").mkdir()
    for name in ("Trajectory.txt", "trajectory.log", "Depth.txt", "camera.json"):
        (folder / "a" / name).touch()
    known = ("trajectory.txt", "trajectory.log")
    assert first_named(folder / "a", known) == folder / "a" / "trajectory.log"


def test_a_picture_in_a_folder_named_like_depth_hides_no_recordings(tmp_path: Path) -> None:
    one, two = (write_folder(tmp_path / "root" / name) for name in ("one", "two"))
    (tmp_path / "root" / "Depth").mkdir()
    (tmp_path / "root" / "Depth" / "preview.png").write_bytes((one / "depth" / "0.png").read_bytes())
    assert [path for path, _ in find_recordings(tmp_path / "root")] == [one, two]


@pytest.mark.parametrize(
    ("name", "like"),
    [
        *((name, False) for name in ("cam_traj.txt", "campaign.csv", "intro.txt", "scam.json")),
        *((name, True) for name in ("cam.json", "cam0.yaml", "cam-k.txt", "cam0_info.yaml", "intr.txt")),
        *((name, True) for name in ("left-cam_1.xml", "my_intrinsics.csv", "Calibration.ini", "K.txt")),
    ],
)
def test_names_that_look_like_intrinsics(name: str, *, like: bool) -> None:
    assert bool(LIKE_INTRINSICS.fullmatch(name)) == like


def test_what_is_named_as_misspelled(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    for name in ("._rgb.txt", ".mask", "rgbd.txt", "rgb.txt.old"):
        (folder / name).touch()
    assert not [line for line in open_recording(folder).warnings if "is not read" in line]
    (folder / "rgb.txt").rename(folder / "color.txt")
    assert not [line for line in open_recording(folder).warnings if "is not read" in line]
    (folder / "color.txt").rename(folder / "colour.txt")
    (folder / "rgbd.txt").unlink()
    (told,) = [line for line in open_recording(folder).warnings if "is not read" in line]
    assert "colour.txt is not read: rename it to color.txt if it is that" in told


def test_names_that_clash_are_told(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "depth").rename(folder / "Depth")
    shutil.copytree(folder / "Depth", folder / "DEPTH", dirs_exist_ok=True)
    if not {"Depth", "DEPTH"} <= {entry.name for entry in folder.iterdir()}:
        pytest.skip("this file system does not tell them apart")
    clash = "; DEPTH and Depth differ in case alone: rename the right one to depth"
    with raises(RecordingError, "recording.unknown-format", match=clash):
        open_recording(folder)


@pytest.mark.parametrize(
    ("write", "name"),
    [
        *((write_folder, name) for name in ("masks", "depth", "color", "camera_intrinsic.json", "poses.txt")),
        *((write_tum, name) for name in ("masks", "rgb.txt", "groundtruth.txt", "camera.json")),
    ],
)
def test_an_unread_twin_of_a_name_as_given_is_told(
    tmp_path: Path, write: Callable[[Path], Path], name: str
) -> None:
    folder, twin = write(tmp_path / "r"), name.capitalize()
    for each in (name, twin):
        if "." not in each:
            (folder / each).mkdir(exist_ok=True)
        elif not (folder / each).exists():
            (folder / each).write_text("".join(f"{index} 0 0 0 0 0 0 1\n" for index in range(4)))
    if len([entry for entry in folder.iterdir() if entry.name.lower() == name]) == 1:
        pytest.skip("this file system does not tell them apart")
    (told,) = [line for line in open_recording(folder).warnings if twin in line]
    assert told == f"{folder}: {twin} is not read beside {name}: rename it, or move it away"


def test_of_a_folder_with_too_many_names_none_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even one that happens to be listed early."""
    few, many = tmp_path / "few", tmp_path / "many"
    for folder, names in ((few, "ab"), (many, "abc")):
        folder.mkdir()
        for name in names:
            (folder / name).touch()
    monkeypatch.setattr("kinectbench.stages.ingest.known_names.LOOKED_AT", 2)
    assert [in_any_case(few, name).name for name in "AB"] == ["a", "b"]
    assert [in_any_case(many, name).name for name in "ABC"] == ["A", "B", "C"]
