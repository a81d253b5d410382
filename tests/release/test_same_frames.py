"""One recording under two ids: refused in two splits, named in one; objects of one recording are allowed."""

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from raising import raises
from synthetic_release import RECORDINGS, synthetic_settings, write_build, write_json

from kinectbench.core.artefacts.sequence import SKETCH_DIGESTS, CameraFile
from kinectbench.core.errors import ReleaseError
from kinectbench.release.publish.publish import publish
from kinectbench.release.publish.same_frames import refuse_same_frames
from kinectbench.settings.models import BenchmarkSettings

TEST, TOO, VALIDATION = (recording[0] for recording in RECORDINGS[:3])
FLOOR = {"plane_world": [0, 0, 1, -0.7]}
BOX = {"center_m": [0, 0, 0.5], "size_m": [1, 2, 1], "yaw_rad": 0.0}


def settings(own: Mapping[str, Mapping[str, Any]] = {}) -> BenchmarkSettings:
    """The synthetic benchmark's, with settings of some recordings."""
    made = synthetic_settings().model_dump(mode="json")
    for recording in made["recordings"]:
        recording |= own.get(recording["id"], {})
    return BenchmarkSettings.model_validate(made)


def write_sources(folder: Path, frames: range, size: int = 100) -> None:
    """sources.json of these frames, and of intrinsics that all recordings share."""
    files: dict[str, Any] = {"camera.json": [90, 0, sha256(b"camera").hexdigest()]}
    for number in frames:
        files[f"depth/{number}.png"] = [size, 0, sha256(f"{number}".encode()).hexdigest()]
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "sources.json", files)


def write_sketch(folder: Path, frames: range) -> None:
    """camera.json of a sequence of these frames."""
    digests = sorted(sha256(f"{number}".encode()).hexdigest()[:16] for number in frames)
    head = CameraFile(
        format_version=2, width=4, height=3, fx=5.0, fy=5.0, cx=1.5, cy=1.0, depth_scale=1000.0,
        color_registered=True, depth_sketch=tuple(digests[:SKETCH_DIGESTS]),
    )  # fmt: skip
    (folder / "sequence").mkdir(parents=True, exist_ok=True)
    head.write(folder / "sequence")


def lines(build: Path, own: Mapping[str, Mapping[str, Any]] = {}) -> list[str]:
    return refuse_same_frames(settings(own), build, [TEST, TOO, VALIDATION])


@pytest.mark.parametrize(
    ("frames", "same"),
    [
        (range(200), True),  # a copy
        (range(90, 190), True),  # a part
        (range(90, 110), True),  # a small one
        (range(110, 310), False),  # fewer than half
        (range(1000, 1200), False),  # the intrinsics alone
    ],
)
def test_what_is_tested_was_not_learnt_from(frames: range, same: bool, tmp_path: Path) -> None:
    write_sources(tmp_path / TEST, range(200))
    write_sources(tmp_path / VALIDATION, frames)
    if same:
        with raises(ReleaseError, "release.object-in-two-splits"):
            lines(tmp_path)
    else:
        assert lines(tmp_path) == []
    # What boxes, floors, masks or the object of a mask choose in one recording are two objects.
    for own in ({"box": BOX}, {"floor": FLOOR}, {"segment_by": "turntable"}, {"camera": {"mask_object": 2}}):
        assert lines(tmp_path, {VALIDATION: own}) == []


def test_one_object_of_several_of_a_recording(tmp_path: Path) -> None:
    """The first has another box; the same box stands in two splits."""
    for name in (TEST, TOO, VALIDATION):
        write_sources(tmp_path / name, range(200))
    with raises(ReleaseError, "release.object-in-two-splits"):
        lines(tmp_path, {TOO: {"box": BOX}, VALIDATION: {"box": BOX}})


@pytest.mark.parametrize(
    ("frames", "same"),
    [
        (range(600), True),  # a bag of what the other has as images
        (range(0, 600, 2), True),  # every second frame
        (range(200, 230), True),  # a part
        (range(2980, 3040), False),  # a third of it
        (range(2700, 3600), False),  # fewer than half
        (range(4000, 4600), False),
        (range(0), False),  # nothing measured
    ],
)
def test_the_same_frames_in_other_files(frames: range, same: bool, tmp_path: Path) -> None:
    write_sources(tmp_path / TEST, range(600))
    write_sources(tmp_path / VALIDATION, range(9000, 9001))
    write_sketch(tmp_path / TEST, range(3000))
    write_sketch(tmp_path / VALIDATION, frames)
    if same:
        with raises(ReleaseError, "release.object-in-two-splits"):
            lines(tmp_path)
    else:
        assert lines(tmp_path) == []
    assert lines(tmp_path, {VALIDATION: {"box": BOX}}) == []


def test_a_recording_of_one_file(tmp_path: Path) -> None:
    for name, bag in ((TEST, 1), (TOO, 2), (VALIDATION, 1)):
        write_sources(tmp_path / name, range(bag, bag + 1), 10**9)
    with raises(ReleaseError, "release.object-in-two-splits"):
        lines(tmp_path)


def test_within_a_split_it_counts_twice(tmp_path: Path) -> None:
    for name in (TEST, TOO):
        write_sources(tmp_path / name, range(200))
    (line,) = lines(tmp_path)
    assert line.startswith(f"{TEST} and {TOO} hold the same frames and count as two objects")
    assert lines(tmp_path, {TOO: {"object": settings().by_id()[TEST].object}}) == []


def test_publish_refuses_it(tmp_path: Path) -> None:
    build = tmp_path / "build"
    write_build(build)
    for name in (TEST, VALIDATION):
        write_sources(build / name, range(200))
    with raises(ReleaseError, "release.object-in-two-splits"):
        publish(settings(), build, tmp_path / "benchmark", [TEST, VALIDATION])
    assert not (tmp_path / "benchmark").exists()
    write_sources(build / VALIDATION, range(500, 700))
    write_sources(build / TOO, range(200))
    summary = publish(settings(), build, tmp_path / "benchmark", [TEST, TOO, VALIDATION])
    (line,) = [each for each in summary.warnings if "hold the same frames" in each]
    assert line in (tmp_path / "benchmark" / "README.md").read_text(encoding="utf-8")
