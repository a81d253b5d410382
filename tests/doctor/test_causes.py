"""One cause with several consequences is told in one line, and no other cause is blamed."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from wrong_recordings import change_images, rows_of, shortened

from kinectbench.doctor import Finding, inspect
from kinectbench.stages.ingest.readers import open_recording

CHAIR = Path(__file__).parents[2] / "recordings/chair_01"
OF_POSES = ("trajectory", "mirrored", "floor", "time_jump")


def found_in(folder: Path) -> list[Finding]:
    return [each for each in inspect(folder)[0].findings if each.severity != "note"]


def numbered(folder: Path, first: int) -> Path:
    """A folder of 40 numbered images; those of depth from 5 to 14 are numbered from `first` on instead."""
    tum = shortened(CHAIR, folder.with_name("tum"), 40)
    for name, out in (("depth", "depth"), ("rgb", "color")):
        (folder / out).mkdir(parents=True)
        for index, (_, file) in enumerate(rows_of(tum, name)):
            number = index - 5 + first if name == "depth" and 5 <= index < 15 else index
            shutil.copy(tum / file, folder / out / f"{number:04d}{Path(file).suffix}")
    for name in ("camera.json", "groundtruth.txt"):
        shutil.copy(tum / name, folder)
    return folder


def test_depth_files_of_other_names_than_the_colour_files_are_told(tmp_path: Path) -> None:
    (found,) = found_in(numbered(tmp_path / "r", 90))
    assert (found.name, found.severity) == ("names_differ", "stops")
    for words in ("10 of 40 depth frames have no colour", "10 colour images have no depth of their name",
                  "such as 0005 (0090 is depth without colour)", "poses do not fit"):  # fmt: skip
        assert words in found.what
    right = numbered(tmp_path / "right" / "r", 5)
    assert open_recording(right).warnings == ()
    assert not any(each.name.startswith(OF_POSES) for each in found_in(right))


@pytest.mark.parametrize("turn", [np.flipud, np.fliplr, lambda image: image[::-1, ::-1]])
def test_depth_that_is_turned_is_told_and_nothing_of_its_poses(tmp_path: Path, turn: object) -> None:
    folder = shortened(CHAIR, tmp_path / "r", 24)
    change_images("depth", turn)(folder)  # type: ignore[arg-type]
    found = found_in(folder)
    assert [each.name for each in found if each.name.startswith(("color_mirrored", *OF_POSES))] == [
        "color_mirrored"
    ]
    assert "depth is the one to correct" in found[0].what and found[0].severity == "stops"
