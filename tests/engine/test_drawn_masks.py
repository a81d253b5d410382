"""A person's mask is applied to the image that it was drawn on, or refused; never to another one."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from small_benchmark import YAML, Run, copied

from kinectbench.core.artefacts.views import MasksFile, ViewsFile
from kinectbench.core.errors import SettingsError
from kinectbench.engine.drawn_masks import DrawnMasks, image_digest
from kinectbench.engine.stages import Job
from kinectbench.settings.file import load_benchmark
from kinectbench.stages.sample_views.masks import mask_name

Command = Callable[..., Run]
MASKS = ("--set", "recordings.chair.masks=masks/chair")


def sequence(*images: int) -> Any:
    """Frames whose depth is one number each."""
    frames = SimpleNamespace(depth_native=lambda index: np.full((4, 6), images[index], np.uint16))
    return type("Frames", (), {"__len__": lambda _: len(images), "frames": frames})()


def drawn(folder: Path, on: dict[str, int | None]) -> DrawnMasks:
    """Masks of these names, drawn on images of these numbers; None: on what nobody knows."""
    folder.mkdir(exist_ok=True)
    for file in on:
        (folder / file).write_text(file)
    entries = {file: image_digest(sequence(image), 0) for file, image in on.items() if image is not None}
    return DrawnMasks("chair", folder, {file: mask_name(file) for file in on}, entries)  # type: ignore[misc]


def kept(folder: Path) -> dict[str, str]:
    """What each file in the folder was called when it was drawn."""
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != MasksFile.FILE}


def test_masks_of_frames_that_are_other_images_are_refused(tmp_path: Path) -> None:
    masks = drawn(tmp_path / "masks", {"frame_000001.png": 11, "frame_2.exclude.png": 12})
    masks.check_frames(sequence(10, 11, 12))
    with pytest.raises(
        SettingsError, match=r"frame_2.exclude.png; `kinectbench segment chair --carry-masks`"
    ):
        masks.check_frames(sequence(10, 11, 13))
    with pytest.raises(SettingsError, match=r"frame_2.exclude.png \(the last frame is 1\)"):
        masks.check_frames(sequence(10, 11))


def test_a_mask_of_a_frame_without_a_build_is_that_frames_from_then_on(tmp_path: Path) -> None:
    unknown = drawn(tmp_path / "masks", {"frame_1.png": None})
    unknown.check_frames(sequence(10, 11))
    stored = MasksFile.read(tmp_path / "masks").drawn_on
    assert stored == {"frame_1.png": image_digest(sequence(11), 0)}
    again = replace(unknown, entries=stored)
    with pytest.raises(SettingsError, match="not drawn on what these frames are now"):
        again.check_frames(sequence(11, 10))


def test_a_mask_of_a_view_without_a_build_is_nobodys(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"003.exclude.png: nobody knows .* frame_<index>.exclude.png"):
        drawn(tmp_path / "masks", {"003.exclude.png": None}).check_known()


def test_masks_whose_renaming_was_killed_are_not_dropped(tmp_path: Path) -> None:
    (tmp_path / "benchmark.yaml").write_text(YAML)
    settings = load_benchmark(tmp_path / "benchmark.yaml", ["recordings.chair.masks=masks"])
    job = Job(settings, settings.recordings[0], tmp_path)
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / ".frame_000001.png.carried").touch()
    with pytest.raises(SettingsError, match=r"renamed 1 masks; .* frame_000001.png to .frame_000001.png.car"):
        DrawnMasks.of(job)


X1 = "frame_000001.exclude.png"
F0, F1, F2 = (f"frame_00000{number}.png" for number in range(3))


@pytest.mark.parametrize(
    ("on", "now", "moved", "left"),
    [
        # A frame less at the front: each takes the name that the next one has yet.
        ({F1: 1, F2: 2}, (1, 2), {F1: F0, F2: F1}, ()),
        # Two that change places.
        ({F0: 1, F1: 0}, (0, 1), {F0: F1, F1: F0}, ()),
        # Named by views; by another number of digits.
        ({"003.exclude.png": 1, "frame_1.png": 1}, (0, 1), {"003.exclude.png": X1, "frame_1.png": F1}, ()),
        # Two of one image stay, and so does what wanted the name of one of them.
        ({"003.png": 1, F1: 1, "004.png": 0}, (0, 1), {"004.png": F0}, ("003.png",)),
        ({"003.png": 2, "004.png": 2, F0: 2, F2: 0}, (0, 1, 2), {}, ("003.png", "004.png", F0, F2)),
        # An image that is gone; one that nobody knows; what is alike stays where it is.
        ({"003.png": 7, "004.png": None, F1: 0}, (0, 0), {}, ("003.png", "004.png")),
    ],
)
def test_masks_are_carried_to_the_frames_that_are_their_images(
    on: dict[str, int | None],
    now: tuple[int, ...],
    moved: dict[str, str],
    left: tuple[str, ...],
    tmp_path: Path,
) -> None:
    masks = drawn(tmp_path / "masks", on)
    done = masks.carry(sequence(*now))
    assert dict(done.moved) == moved
    assert kept(tmp_path / "masks") == {moved.get(file, file): file for file in on}
    assert {Path(line.split(": ")[0]).name for line in done.left} == set(left)
    stored = MasksFile.read(tmp_path / "masks").drawn_on
    assert stored == {moved.get(file, file): digest for file, digest in masks.entries.items()}


# --- of a build


@pytest.fixture
def one(small: Path, tmp_path: Path) -> Path:
    """A copy of the benchmark with the chair only, and a folder for its masks."""
    root = copied(small, tmp_path / "one", "recordings/chair", "build/chair")
    lines = (small / "benchmark.yaml").read_text().splitlines()
    (root / "benchmark.yaml").write_text("\n".join(line for line in lines if "id: table" not in line))
    (root / "masks" / "chair").mkdir(parents=True)
    return root


def draw(root: Path, name: str) -> None:
    """All of the image."""
    assert cv2.imwrite(str(root / "masks" / "chair" / name), np.full((120, 160), 255, np.uint8))


def pixels(root: Path) -> dict[int, int]:
    """Pixels of each view's mask, by its frame; as views.json says, and as its picture has."""
    views = root / "build" / "chair" / "views"
    found = {}
    for row in ViewsFile.read(views).views:
        mask = cv2.imread(str(views / f"{row.view}.mask.png"), cv2.IMREAD_GRAYSCALE)
        assert row.pixels == int((np.asarray(mask) > 0).sum())
        found[int(row.frame or 0)] = row.pixels
    return found


def test_a_mask_named_by_a_view_stays_with_its_image(command: Command, one: Path) -> None:
    before = pixels(one)
    first, *others = before
    draw(one, "000.exclude.png")  # drawn before benchmark.yaml names the folder
    assert command(one, "build").status == 0
    # Another draw makes 000 another frame: refused, and the views stay what they were.
    other = (*MASKS, "--set", "views.seed=1")
    refused = command(one, "build", *other)
    assert refused.status == 1
    assert "000.exclude.png (000 is frame " in refused.err and "segment chair --carry-masks" in refused.err
    assert pixels(one) == before
    # It is tried again, not told from memory: masks.json is no part of what the stage is made from.
    entry = (one / "masks" / "chair" / "masks.json").read_text()
    assert set(json.loads(entry)) == {"000.exclude.png"}
    assert command(one, "build", *MASKS).status == 0
    assert pixels(one) == {**before, first: 0}
    carried = command(one, "segment", "--carry-masks", *MASKS)
    assert (carried.status, carried.out) == (
        0,
        f"chair: 000.exclude.png is now frame_{first:06d}.exclude.png\n",
    )
    assert command(one, "build", *MASKS).status == 0
    assert pixels(one) == {**before, first: 0}
    # Where its frame is another view, the mask goes with it; where it is none, that is told.
    again = command(one, "build", *other)
    assert again.status == 0
    for frame, count in pixels(one).items():
        assert (count == 0) is (frame == first)
    assert ("not used, as their frames are no views" in again.err) is (first not in pixels(one))
    assert others


def test_a_mask_does_not_move_to_another_recording(command: Command, one: Path) -> None:
    draw(one, "frame_000004.png")
    assert command(one, "build", *MASKS).status == 0
    recording = one / "recordings" / "chair"
    rows = (recording / "depth.txt").read_text().splitlines(keepends=True)
    first = next(index for index, row in enumerate(rows) if not row.startswith("#"))
    (recording / "depth.txt").write_text("".join(rows[:first] + rows[first + 1 :]))
    refused = command(one, "build", *MASKS)
    assert refused.status == 1 and "not drawn on what these frames are now: frame_000004.png" in refused.err
    carried = command(one, "segment", "--carry-masks", "--json", *MASKS)
    (row,) = json.loads(carried.out)
    assert row == {"recording": "chair", "moved": {"frame_000004.png": "frame_000003.png"}, "left": []}
    assert command(one, "build", *MASKS).status == 0


def test_a_mask_of_a_view_without_a_build_is_refused_before_anything_is_made(
    command: Command, one: Path
) -> None:
    shutil.rmtree(one / "build")
    draw(one, "000.png")
    refused = command(one, "build", *MASKS)
    assert refused.status == 1 and "nobody knows which image it was drawn on" in refused.err
    assert not (one / "build" / "chair" / "sequence").exists()
    left = command(one, "segment", "--carry-masks", *MASKS)
    assert left.status == 3 and "look at it, and name it by its frame" in left.err
