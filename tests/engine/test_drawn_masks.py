"""A person's mask is applied to the image that it was drawn on, or refused; never to another one."""

import json
import shutil
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from raising import raises
from read_pictures import read_picture
from small_benchmark import YAML, Run, copied

from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.core.artefacts.trajectory import StoredDepthCalibration
from kinectbench.core.artefacts.views import RECORDED, DrawnOn, MasksFile, ViewRow, ViewsFile
from kinectbench.core.errors import SettingsError
from kinectbench.core.geometry import Camera
from kinectbench.core.geometry.depth import TERMS
from kinectbench.core.geometry.rigid import rigid_from_twist
from kinectbench.core.geometry.rolling_shutter import RollingShutter, motions
from kinectbench.core.sequence import Sequence
from kinectbench.core.upright import upright
from kinectbench.engine.drawn_images import image_digest
from kinectbench.engine.drawn_masks import DrawnMasks
from kinectbench.engine.stages import Job
from kinectbench.settings.file import load_benchmark
from kinectbench.stages.sample_views.masks import mask_name
from kinectbench.stages.sample_views.views import pictures_of

Command = Callable[..., Run]
MASKS = ("--set", "recordings.chair.masks=masks/chair")


COLOR = bytes(cv2.imencode(".jpg", np.zeros((4, 6, 3), np.uint8))[1])
PHOTO = COLOR[:2] + b"\xff\xe1\0\x0aExif\0\0MM" + COLOR[2:]


def sequence(*images: int, color: bytes = COLOR) -> Any:
    """Frames whose depth is one number each, in mm, and whose colour is one file."""

    def depth_mm(index: int) -> Any:
        return np.full((4, 6), images[index], np.uint16)

    frames = SimpleNamespace(depth_native=depth_mm, color_encoded=lambda index: (".jpg", color))
    found = type("Frames", (), {"__len__": lambda _: len(images), "frames": frames})()
    found.depth_m = lambda index: depth_mm(index).astype(np.float32) / 1000
    return found


def on_image(image: int, picture: str | None = None) -> DrawnOn:
    return DrawnOn(image=image_digest(sequence(image), 0), picture=picture)


def drawn_views(folder: Path, *views: tuple[int, int], color: bytes = b"") -> Path:
    """Views of these frames, whose depth is one number each, in mm, and whose colour is in this file."""
    folder.mkdir()
    for index, (_, depth_mm) in enumerate(views):
        assert cv2.imwrite(str(folder / f"{index:03d}.depth.png"), np.full((4, 6), depth_mm, np.uint16))
        if color:
            (folder / f"{index:03d}.color.jpg").write_bytes(color)
    rows = tuple(ViewRow(view=f"{index:03d}", frame=frame) for index, (frame, _) in enumerate(views))
    ViewsFile(views=rows, refused=()).write(folder)
    return folder


def drawn(folder: Path, on: dict[str, int | None]) -> DrawnMasks:
    """Masks of these names, drawn on images of these numbers; None: on what nobody knows."""
    folder.mkdir(exist_ok=True)
    for file in on:
        (folder / file).write_text(file)
    entries = {file: on_image(image) for file, image in on.items() if image is not None}
    return DrawnMasks("chair", folder, {file: mask_name(file) for file in on}, entries)  # type: ignore[misc]


def kept(folder: Path) -> dict[str, str]:
    """What each file in the folder was called when it was drawn."""
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != MasksFile.FILE}


def test_masks_of_frames_that_are_other_images_are_refused(tmp_path: Path) -> None:
    masks = drawn(tmp_path / "masks", {"frame_000001.png": 11, "frame_2.exclude.png": 12})
    masks.check_frames(sequence(10, 11, 12))
    with raises(SettingsError, "settings.stale-masks", match="frame_2.exclude.png; `kinectbench"):
        masks.check_frames(sequence(10, 11, 13))
    with raises(SettingsError, "settings.stale-masks", match=r"frame_2.exclude.png.*1\)"):
        masks.check_frames(sequence(10, 11))


def test_masks_beyond_the_last_frame_and_of_no_frame_are_named(command: Command, one: Path) -> None:
    shutil.rmtree(one / "build")
    for name in ("frame_000024.png", "frame_000003.include.png", "chair.png", "000003_mask.png"):
        draw(one, name)
    refused = command(one, "build", *MASKS)
    assert "the recording has frames 0 to 23, and no frame of frame_000024.png: name these" in refused.err
    assert refused.status == 1 and not (one / "build/chair/trajectory").exists()  # at once
    said = [line for line in refused.err.splitlines() if "name no frame: 000003_mask.png, chair.png" in line]
    assert len(said) == 1
    (one / "masks/chair/frame_000024.png").rename(one / "masks/chair/frame_000023.png")
    assert command(one, "track", *MASKS).status == 0


def test_a_mask_of_a_frame_without_a_build_is_that_frames_from_then_on(tmp_path: Path) -> None:
    unknown = drawn(tmp_path / "masks", {"frame_1.png": None})
    unknown.check_frames(sequence(10, 11))
    stored = MasksFile.read(tmp_path / "masks").drawn_on
    assert stored == {"frame_1.png": on_image(11)}
    again = replace(unknown, entries=stored)
    with raises(SettingsError, "settings.stale-masks", match="not drawn on what these frames are now"):
        again.check_frames(sequence(11, 10))


def test_a_mask_of_a_view_without_a_build_is_nobodys(tmp_path: Path) -> None:
    with raises(SettingsError, "settings.stale-masks", match="003.exclude.png"):
        drawn(tmp_path / "masks", {"003.exclude.png": None}).check_known()


def test_masks_whose_renaming_was_killed_are_not_dropped(tmp_path: Path) -> None:
    (tmp_path / "benchmark.yaml").write_text(YAML)
    settings = load_benchmark(tmp_path / "benchmark.yaml", ["recordings.chair.masks=masks"])
    job = Job(settings, settings.recordings[0], tmp_path)
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / ".frame_000001.png.carried").touch()
    with raises(SettingsError, "settings.stale-masks", match=r"1.*frame_000001.png.*.frame_000001.png.car"):
        DrawnMasks.of(job)


@pytest.mark.parametrize("file", ["frame_000001.png", "frame_1.exclude.png", "000.png"])
@pytest.mark.parametrize("other", [{"views": [(1, 902)]}, {"color": b"moved"}, {"color": b""}])
def test_a_mask_is_not_applied_to_another_picture_of_its_frame(
    file: str, other: dict[str, Any], tmp_path: Path
) -> None:
    """The frame is the same, as it was recorded; its view has other depth, other colour, or no colour."""

    def views(name: str, views: Any = ((1, 901),), color: bytes = b"colour") -> Path:
        return drawn_views(tmp_path / name, *views, color=color)

    frames = sequence(10, 11)
    first = drawn(tmp_path / "masks", {file: 11}).check_views(frames, views("first"))
    stored = MasksFile.read(tmp_path / "masks").drawn_on
    assert stored == first.entries and stored[file].picture
    again = replace(first, entries=stored)
    again.check_views(frames, views("same"))
    # Where its frame is no view the mask is not used; a frame's mask follows it to a view of another number.
    if file != "000.png":
        again.check_views(frames, views("none", views=[(0, 900)]))
        again.check_views(frames, views("later", views=[(0, 900), (1, 901)]))
    with raises(SettingsError, "settings.stale-masks", match="--set recordings.chair.masks=null`"):
        again.check_views(frames, views("other", **other))
    assert MasksFile.read(tmp_path / "masks").drawn_on == stored


def test_other_poses_make_another_picture_of_the_same_frame(tmp_path: Path) -> None:
    """A rolling shutter is undone by how the camera moves: a near half plane before a far one."""
    depth = np.where(np.arange(160) < 90, np.uint16(1000), np.uint16(3000)) * np.ones((120, 1), np.uint16)
    store = SimpleNamespace(depth_native=lambda index: depth, color_encoded=lambda index: None)
    camera, stamps_ns = Camera(160, 120, 140.0, 140.0, 79.5, 59.5), (np.arange(3) * 1e9 / 30).astype(np.int64)
    frames = Sequence(camera, 1000.0, stamps_ns, False, None, store)

    def views(name: str, yaw_rate: float) -> Path:
        """View 000 of frame 1 after the camera turned so fast, in rad/s."""
        folder = drawn_views(tmp_path / name, (1, 0))
        poses = np.array([rigid_from_twist(np.array([0, yaw_rate * k / 30, 0, 0, 0, 0])) for k in range(3)])
        shutter = RollingShutter(0.03, 0.0, motions(poses, np.zeros(3, np.int64), stamps_ns / 1e9))
        (folder / "000.depth.png").write_bytes(pictures_of(upright(frames, shutter), 1)["depth.png"])
        return folder

    masks = drawn(tmp_path / "masks", {"frame_1.png": None}).check_frames(frames)
    masks = masks.check_views(frames, views("first", 1.0))
    assert masks.check_views(frames, views("again", 1.0)) == masks
    with raises(SettingsError, "settings.stale-masks", match="drawn on other pictures"):
        masks.check_views(frames, views("faster", 1.5))


def test_a_mask_drawn_on_a_view_with_metadata_is_used_on_the_same_without(tmp_path: Path) -> None:
    masks, frames = drawn(tmp_path / "masks", {"frame_000001.png": 11}), sequence(10, 11, color=PHOTO)
    of_photo = masks.check_views(frames, drawn_views(tmp_path / "older", (1, 901), color=PHOTO))
    now = drawn_views(tmp_path / "now", (1, 901), color=COLOR)
    assert of_photo.check_views(frames, now) == of_photo
    with raises(SettingsError, "settings.stale-masks", match="drawn on other pictures"):
        of_photo.check_views(frames, drawn_views(tmp_path / "other", (1, 902), color=COLOR))


def test_an_older_masks_file_is_used_as_it_was(tmp_path: Path) -> None:
    """Its entries are images alone; what they are used on is their picture from then on."""
    masks = drawn(tmp_path / "masks", {"frame_000001.png": 11, "frame_000000.png": 10})
    older = json.dumps({file: on.image for file, on in masks.entries.items()})
    assert MasksFile.parse(older, "").drawn_on == masks.entries
    assert json.loads(MasksFile.of(masks.entries).text()) == json.loads(older)
    used = masks.check_views(sequence(10, 11), drawn_views(tmp_path / "views", (1, 901)))
    assert used.entries["frame_000001.png"].image == masks.entries["frame_000001.png"].image
    written = json.loads((tmp_path / "masks" / "masks.json").read_text())
    assert set(written["frame_000001.png"]) == {"image", "picture"}
    assert written["frame_000000.png"] == masks.entries["frame_000000.png"].image


@pytest.mark.parametrize("color", [COLOR, PHOTO], ids=["plain", "with metadata"])
@pytest.mark.parametrize("shown_mm", [11, 12])
def test_a_mask_of_a_frame_as_it_was_recorded_is_none_of_a_corrected_view(
    shown_mm: int, color: bytes, tmp_path: Path
) -> None:
    """Nor one of the view a mask of the frame; where nothing was corrected, both are the same picture."""
    frames = sequence(10, 11, color=color)
    views = drawn_views(tmp_path / "views", (1, shown_mm), color=color)
    fits = (
        nullcontext() if shown_mm == 11 else pytest.raises(SettingsError, match=r"its entry from masks\.json")
    )
    of_view = drawn(tmp_path / "of_view", {"frame_000001.png": 11}).check_views(frames, views)
    with fits:
        replace(of_view, of_recorded=True).check_frames(frames)
    unknown = drawn(tmp_path / "of_frame", {"frame_000001.png": None})
    of_frame = replace(unknown, of_recorded=True).check_frames(frames)
    assert of_frame.entries == {"frame_000001.png": on_image(11, RECORDED)}
    assert of_frame.check_views(frames, tmp_path / "none") == of_frame.check_frames(frames) == of_frame
    assert MasksFile.read(tmp_path / "of_frame").drawn_on == of_frame.entries
    with fits:
        replace(of_frame, of_recorded=False).check_frames(frames).check_views(frames, views)


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
    assert stored == {moved.get(file, file): on for file, on in masks.entries.items()}


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
        mask = read_picture(views / f"{row.view}.mask.png", cv2.IMREAD_GRAYSCALE)
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
    assert [*json.loads(entry)["000.exclude.png"]] == ["image", "picture"]
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


def test_a_mask_does_not_move_to_another_picture_of_its_frame(command: Command, one: Path) -> None:
    """The depth has another correction than when it was drawn; what the line says mends it."""
    before = pixels(one)
    first = next(iter(before))
    draw(one, f"frame_{first}.exclude.png")
    assert command(one, "sample-views", *MASKS).status == 0
    trajectory = one / "build" / "chair" / "trajectory"
    StoredDepthCalibration(coefficients_per_m=[0.001, *[0.0] * (len(TERMS) - 1)]).write(trajectory)
    manifest = Manifest.read(trajectory)
    file = StoredDepthCalibration.FILE
    sizes = {**manifest.files, file: (trajectory / file).stat().st_size}
    manifest.model_copy(update={"files": sizes}).write(trajectory)
    refused = command(one, "sample-views", "--force", *MASKS)
    assert refused.status == 1 and "drawn on other pictures" in refused.err
    assert pixels(one)[first] == 0
    without = ("--set", "recordings.chair.masks=null")
    assert " ".join(without) in refused.err and command(one, "sample-views", "chair", *without).status == 0
    (one / "masks" / "chair" / "masks.json").unlink()
    assert command(one, "sample-views", *MASKS).status == 0
    assert pixels(one)[first] == 0


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
