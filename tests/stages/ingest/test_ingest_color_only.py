"""What is said where there is no depth, or depth in a layout that nobody knows."""

from pathlib import Path

import pytest
from ingest_writers import color_image, depth_image, jpeg, png

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.readers import open_recording


def images(folder: Path, count: int, suffix: str = ".jpg") -> None:
    folder.mkdir(parents=True)
    for i in range(count):
        data = jpeg(color_image(i)) if suffix == ".jpg" else png(color_image(i))
        (folder / f"{i:04d}{suffix}").write_bytes(data)


def refusal(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        open_recording(path)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("inside", ["", "rgb", "images", "left"])
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_folders_of_colour(tmp_path: Path, inside: str, suffix: str) -> None:
    images(tmp_path / "r" / inside, 6, suffix)
    said = refusal(tmp_path / "r")
    assert "no depth that is read (16-bit PNG, .npy, .npz, TIFF): record with a camera that" in said
    assert "holds 6 colour images" in said


@pytest.mark.parametrize("suffix", [".mp4", ".MOV", ".avi", ".webm"])
def test_videos(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"chair{suffix}"
    path.write_bytes(b"\0\0\0\x20ftypisom")
    assert "is a video, which holds colour only: record with a camera that measures depth" in refusal(path)


def test_a_stray_picture_is_no_recording(tmp_path: Path) -> None:
    images(tmp_path / "r", 1)
    assert "not a recording of a known format" in refusal(tmp_path / "r")


def test_depth_in_a_folder_of_another_name_is_pointed_at(tmp_path: Path) -> None:
    images(tmp_path / "r/rgb", 6)
    (tmp_path / "r/depth_raw").mkdir()
    (tmp_path / "r/depth_raw/0000.png").write_bytes(png(depth_image(0)))
    said = refusal(tmp_path / "r")
    assert "depth_raw/ holds 16-bit PNG images that look like depth" in said and "name their folder" in said


def test_a_tum_folder_without_its_depth(tmp_path: Path) -> None:
    images(tmp_path / "r/rgb", 6)
    (tmp_path / "r/rgb.txt").write_text("0 rgb/0000.jpg\n")
    assert "but no depth" in refusal(tmp_path / "r")
