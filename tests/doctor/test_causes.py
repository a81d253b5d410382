"""One cause with several consequences is told in one line, and no other cause is blamed."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from wrong_recordings import change_images, change_poses, rows_of, shortened, write_rows

from kinectbench.core.geometry import invert_rigid
from kinectbench.doctor import Finding, inspect, pose_delay
from kinectbench.doctor.during_build import likely_cause
from kinectbench.stages.ingest.pairing import NamesDiffer, pair_images
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
    (found,) = found_in(numbered(tmp_path / "a; b" / "r", 90))
    assert (found.name, found.severity) == ("names_differ", "stops")
    for words in ("a; b/r: 10 of 40 depth frames", "10 colour images have no depth of their name",
                  "such as 0005 (0090 is depth without colour)", "poses do not fit"):  # fmt: skip
        assert words in found.what
    right = numbered(tmp_path / "right" / "r", 5)
    assert open_recording(right).warnings == ()
    assert not any(each.name.startswith(OF_POSES) for each in found_in(right))


def test_frames_that_each_stream_lost_hide_no_fault(tmp_path: Path) -> None:
    """Foreign poses stay what is wrong, though each stream has a frame that the other lacks."""
    folder = numbered(tmp_path / "a; b" / "r", 5)
    (folder / "depth" / "0007.png").unlink()
    (folder / "color" / next(file.name for file in (folder / "color").glob("0013.*"))).unlink()
    rows = rows_of(folder, "groundtruth")
    rows = [[row[0], *other[1:]] for row, other in zip(rows, rows[::-1], strict=True)]
    write_rows(folder, "groundtruth", rows[:7] + rows[8:])
    found = found_in(folder)
    assert "names_differ" not in {each.name for each in found}
    assert "trajectory_wrong" in {each.name for each in found}
    (reader,) = [each for each in found if each.name == "reader" and "0013 is depth" in each.what]
    assert "1 colour images have no depth of their name, such as 0007" in reader.what


@pytest.mark.parametrize(
    ("depth", "color", "differ"),
    [
        ([*range(30), *range(90, 100)], range(40), True),
        ([*range(7), *range(8, 100)], [*range(13), *range(14, 100)], False),
        ([*range(7), *range(8, 100)], range(99), False),  # the last colour image is lost, too
        ([*range(7), *range(8, 100)], range(60), False),  # colour ends early
        (range(20), range(8, 28), False),  # each stream counts its own frames
        (range(40), range(30), False),
    ],
)
def test_names_differ_only_where_that_is_proved(
    depth: Sequence[int], color: Sequence[int], differ: bool
) -> None:
    names = ([f"{number:04d}" for number in stream] for stream in (depth, color))
    (warning,) = pair_images(*names, delay_s=0, where="/data/a; b/r")[0].warnings
    assert isinstance(warning, NamesDiffer) == differ and warning.startswith("/data/a; b/r: ")


@pytest.mark.parametrize("turn", [np.flipud, np.fliplr, lambda image: image[::-1, ::-1]])
def test_depth_that_is_turned_is_told_and_nothing_of_its_poses(tmp_path: Path, turn: object) -> None:
    folder = shortened(CHAIR, tmp_path / "r", 24)
    change_images("depth", turn)(folder)  # type: ignore[arg-type]
    found = found_in(folder)
    assert [each.name for each in found if each.name.startswith(("color_mirrored", *OF_POSES))] == [
        "color_mirrored"
    ]
    assert "depth is the one to correct" in found[0].what and found[0].severity == "stops"
    assert "depth is the one to correct" in likely_cause(open_recording(folder))[0]


def test_poses_that_fit_otherwise_than_turned_do_not_blame_the_depth(tmp_path: Path) -> None:
    folder = shortened(CHAIR, tmp_path / "r", 24)
    change_images("rgb", np.fliplr)(folder)
    change_poses(invert_rigid)(folder)
    colour, reading = sorted(found_in(folder), key=lambda each: each.name)
    assert (colour.name, reading.name) == ("color_mirrored", "trajectory_reading")
    assert colour.severity == "warning" and "depth is the one" not in colour.what
    assert "world to camera" in reading.what


@pytest.mark.parametrize("fit", [True, False])
def test_poses_that_fit_at_another_time_are_late_and_not_of_another_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fit: bool
) -> None:
    """If they only fit better so, another cause remains."""
    folder = shortened(CHAIR, tmp_path / "r", 40)
    rows = [[f"{float(row[0]) + 0.4:.6f}", *row[1:]] for row in rows_of(folder, "groundtruth")]
    write_rows(folder, "groundtruth", rows)
    if not fit:
        monkeypatch.setattr(pose_delay, "fits", lambda residual_m, pairs: False, raising=False)
    found = [each for each in found_in(folder) if each.name.startswith("trajectory")]
    late = [("trajectory_delay", "stops")]
    both = [("trajectory_wrong", "stops"), ("trajectory_delay", "warning")]
    assert [(each.name, each.severity) for each in found] == (late if fit else both)
    assert found[-1].advice.startswith(
        ("put `camera: {trajectory_delay_s: 0.39", "put `camera: {trajectory_delay_s: 0.40")
    )
