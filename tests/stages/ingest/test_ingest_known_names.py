"""Names of files and folders in another case are read; misspelled ones are named with the nearest."""

from pathlib import Path

import pytest
from ingest_writers import write_folder, write_tum
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.readers import open_recording


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


def test_two_names_that_differ_in_case_alone_are_ambiguous(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "camera.json").rename(folder / "Camera.json")
    (folder / "CAMERA.json").write_bytes((folder / "Camera.json").read_bytes())
    if len(list(folder.glob("*.json"))) == 1:
        pytest.skip("this file system does not tell them apart")
    with raises(RecordingError, "recording.no-intrinsics", match=r"(CAMERA|Camera)\.json holds the camera"):
        open_recording(folder)


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
