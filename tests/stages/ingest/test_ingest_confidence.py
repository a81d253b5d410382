"""confidence/ beside the depth/ of a plain folder, as RTAB-Map and other programs export it of a phone."""

from pathlib import Path

import numpy as np
import pytest
from ingest_writers import depth_image, png, write_folder

from kinectbench.doctor import inspect
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording

LEVELS = np.repeat(np.arange(3), [10, 10, 44])[None, :].repeat(48, axis=0)  # 0, 1, 2 by column


def with_confidence(folder: Path, values: list[int], levels: np.ndarray = LEVELS) -> Path:
    write_folder(folder)
    (folder / "confidence").mkdir()
    for i in range(4):
        image = np.array(values, np.uint8)[levels]
        (folder / f"confidence/{i}.png").write_bytes(png(image))
    return folder


@pytest.mark.parametrize("least", [0, 1, 2])
@pytest.mark.parametrize("values", [[0, 1, 2], [0, 50, 100], [0, 127, 255]])
def test_depth_of_low_confidence_is_none(tmp_path: Path, values: list[int], least: int) -> None:
    folder = with_confidence(tmp_path / "r", values)
    recording = open_recording(folder, CameraSettings(min_confidence=least))
    expected = np.where(least <= LEVELS, depth_image(3, 1000.0), 0)
    np.testing.assert_array_equal(recording.frame(3).depth, expected)
    assert ["left out" in line for line in recording.warnings] == [True] * (least != 0)


def test_inspect_names_the_limit(tmp_path: Path) -> None:
    folder = with_confidence(tmp_path / "r", [0, 50, 100])
    for settings, words in ((None, ["below 2"]), (CameraSettings(min_confidence=0), [])):
        lines = [each.what for each in inspect(folder, settings)[0].findings if each.name == "reader"]
        found = [line for line in lines if "confidence" in line]
        assert len(found) == len(words) and all(word in what for word, what in zip(words, found, strict=True))


def test_a_frame_without_confidence_or_with_a_damaged_one(tmp_path: Path) -> None:
    folder = with_confidence(tmp_path / "r", [0, 1, 2])
    (folder / "confidence/1.png").unlink()
    (folder / "confidence/0.png").write_bytes(b"no image")
    recording = open_recording(folder)
    np.testing.assert_array_equal(recording.frame(1).depth, depth_image(1, 1000.0))
    assert not recording.frame(2).depth[:, :20].any()


@pytest.mark.parametrize(
    ("values", "shrink", "words"),
    [([0, 1, 1], 1, "holds the values 0, 1, and"), ([3, 90, 200], 1, "3, 90, 200"), ([0, 1, 2], 2, "size")],
)
def test_other_images_are_not_taken_for_confidence(
    tmp_path: Path, values: list[int], shrink: int, words: str
) -> None:
    folder = with_confidence(tmp_path / "r", values, LEVELS[::shrink, ::shrink])
    recording = open_recording(folder)
    np.testing.assert_array_equal(recording.frame(1).depth, depth_image(1, 1000.0))
    assert [words in line for line in recording.warnings] == [True]


def test_confidence_of_other_names_is_reported(tmp_path: Path) -> None:
    folder = with_confidence(tmp_path / "r", [0, 1, 2])
    for file in (folder / "confidence").iterdir():
        file.rename(file.with_name(f"confidence_{file.name}"))
    (warning,) = open_recording(folder).warnings
    assert "its 4 images are not read" in warning
