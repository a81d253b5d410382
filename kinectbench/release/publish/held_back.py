"""Make the public files of recordings whose truth is held back.

With `publish --isolate`, one view of each object is published, without any data that reveal the truth.
Several views of an object can be registered with each other, and so reveal its shape. So everything that
depends on other views or on the camera's pose is left out, too: the floor, the pose, the background, the mask
where the view has no depth, frame numbers, timestamps, hashes and settings.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

import numpy as np

from kinectbench.core import SettingsError, images, listed, write_below
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.views import PairRow, PairsFile, ViewRow, ViewsFile
from kinectbench.core.geometry import Grid, invert_rigid
from kinectbench.core.types import MM_PER_M, Float64
from kinectbench.core.voxels.pair_file import INPUT_KEYS, Pair, PairInput
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.release.publish.reconstruction_attack import PosedView
from kinectbench.settings.models import BenchmarkSettings

# Statements of a person that reveal the truth: the object's size, a review, and whether its underside is
# solid.
SAID_OF_TRUTH = ("box", "review", "underside")
VIEW_KEYS = ("view", "K", "width", "height", "pair")
STEEP = 1e-6
# Matrices are rounded, because the last bits of a product differ between processors.
DECIMALS = 12


def without_truth(pair: Pair, T_floor_world: Float64) -> PairInput:
    """Return the input of a pair, transformed to a world frame that this view has for itself (`own_world`).

    In a common world frame, the views of an object together would reveal its shape.

    Args:
        pair: the complete pair.
        T_floor_world: (4, 4) of the recording, metres.
    """
    T_own_world = own_world(T_floor_world @ pair.T_world_camera) @ T_floor_world
    values = {key: getattr(pair, key) for key in INPUT_KEYS}
    for key in ("T_world_grid", "T_world_camera"):
        values[key] = np.round(T_own_world @ values[key], DECIMALS) + 0.0  # no -0
    return PairInput(**values)


def own_world(T_floor_camera: Float64) -> Float64:
    """Return T_own_floor (4, 4), from the floor frame to a view's own world frame; z is up in both.

    In the own frame, the camera is above the origin and looks along x. If it looks straight down, the top of
    its image points along x.
    """
    forward, image_up = T_floor_camera[:2, 2], -T_floor_camera[:2, 1]
    along = forward if np.hypot(*forward) > STEEP else image_up
    cosine, sine = along / np.hypot(*along)
    T = np.eye(4)
    T[:2, :2] = [[cosine, sine], [-sine, cosine]]
    T[:2, 3] = -T[:2, :2] @ T_floor_camera[:2, 3]
    return T


def own_floor(floor: FloorFile) -> FloorFile:
    """Return floor.json in a view's own world frame: the floor is z = 0, and other planes are left out."""
    kept = floor.model_copy(
        update={"plane_world": np.array([0.0, 0.0, 1.0, 0.0]), "T_floor_world": np.eye(4)}
    )
    return FloorFile(**{key: getattr(kept, key) for key in kept.model_fields_set - {"candidates"}})


def own_views(views: ViewsFile) -> ViewsFile:
    """Return views.json reduced to views with a pair, and to their `VIEW_KEYS`: no frames, poses or shares.

    Refused views and warnings are left out, too.
    """
    rows = tuple(ViewRow(**{key: getattr(row, key) for key in VIEW_KEYS}) for row in views.views if row.pair)
    return views.model_copy(update={"views": rows, "refused": (), "warnings": ()})


Row = TypeVar("Row", PairRow, ViewRow)
# Name of every isolated view: the original name would tell its place in the order of sampling.
VIEW = "000"
# Keys of an isolated view's recording that are published.
SETTINGS_KEYS = ("id", "object", "category", "split", "license", "source")
# Quality of the colour image, which is encoded again. Chosen by hand.
JPEG_QUALITY = 95


@dataclass(frozen=True)
class Isolated:
    """The result of choosing one view for each object with held-back truth.

    Attributes:
        views: {recording: name that its published view has in the build}.
        left_out: ids of the other recordings of these objects, and of recordings without a pair.
    """

    views: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    def lines(self) -> Iterator[str]:
        """Yield a line that names the left-out recordings, for the publisher; nothing if there are none."""
        if self.left_out:
            yield (
                f"--isolate: {listed(self.left_out)} left out: one view of an object is published, which is "
                "of another recording, or there is no pair"
            )


def refuse_framing(settings: BenchmarkSettings) -> None:
    """Raise an error if size and place of a pair's cube reveal the hidden part of the object.

    Raises:
        SettingsError: the framing is `object`.
    """
    if settings.pairs.framing != "view":
        raise SettingsError(
            "--isolate: with pairs.framing 'object', size and place of a pair's cube reveal the shape; "
            "set `pairs: {framing: view}` in benchmark.yaml (or `--set pairs.framing=view`)"
        )


def isolate(settings: BenchmarkSettings, build: Path, recordings: Collection[str]) -> Isolated:
    """Draw one view of each object; all views with a pair, in all its recordings, have equal probability.

    The draw depends only on `views.seed` and the object's name and views, not on other objects. The truth of
    the `recordings` is held back.
    """
    by_id, candidates = settings.by_id(), dict[str, list[tuple[str, str]]]()
    for name in sorted(recordings):
        views = sorted(row.view for row in PairsFile.read(build / name / "pairs").pairs)
        candidates.setdefault(by_id[name].object_name, []).extend((name, view) for view in views)
    chosen = dict[str, str]()
    for thing, of_thing in candidates.items():
        if of_thing:
            number = int.from_bytes(sha256(f"{settings.views.seed} {thing}".encode()).digest())
            recording, view = of_thing[number % len(of_thing)]
            chosen[recording] = view
    return Isolated(chosen, tuple(name for name in sorted(recordings) if name not in chosen))


def only_view(rows: Sequence[Row], view: str) -> tuple[Row, ...]:
    """Return only the row whose name in the build is `view`, renamed to the public name `VIEW`."""
    return tuple(row.model_copy(update={"view": VIEW}) for row in rows if row.view == view)


def isolated_view(view: PosedView) -> PosedView:
    """Return the view restricted to the object: no depth outside the mask, and no mask without depth.

    The original mask also covers pixels without depth: it is made from the object, which is fused from all
    views.
    """
    mask = view.mask & (view.depth_m > 0)
    return replace(view, depth_m=np.where(mask, view.depth_m, np.float32(0)), mask=mask)


def isolated_input(pair: Pair, view: PosedView) -> PairInput:
    """Return the input of a pair of framing `view` in the camera frame; `seen` is of the view alone."""
    values = {key: getattr(pair, key) for key in INPUT_KEYS}
    T_camera_grid = np.round(invert_rigid(pair.T_world_camera) @ pair.T_world_grid, DECIMALS) + 0.0  # no -0
    own = Grid(pair.grid.shape, pair.voxel_size_m, T_camera_grid)
    values |= {"T_world_camera": np.eye(4), "T_world_grid": T_camera_grid}
    values |= {"seen": seen_cells(view.depth_m, view.camera, np.eye(4), own)}
    return PairInput(**values)


def write_isolated_images(view: PosedView, color: Path | None, folder: Path) -> None:
    """Write the images of an isolated view: depth, mask, and colour that is black outside the mask.

    No colour is written if it is None or of another size than the depth.

    Raises:
        StorageError: the colour image is damaged.
    """
    depth_mm = np.rint(view.depth_m * MM_PER_M).astype(np.uint16)
    write_below(folder / f"{VIEW}.depth.png", images.png(depth_mm))
    write_below(folder / f"{VIEW}.mask.png", images.png(view.mask.astype(np.uint8) * 255))
    pixels = None if color is None else images.read_color(color)
    if pixels is not None and pixels.shape[:2] == view.mask.shape:
        alone = np.where(view.mask[..., None], pixels, np.uint8(0))
        write_below(folder / f"{VIEW}.color.jpg", images.jpeg(alone, JPEG_QUALITY))


def isolated_line(isolated: Sequence[str]) -> str:
    """Return the text in the card and the datasheet about the isolated recordings."""
    return (
        f"Of each object whose truth is held back one view is published, named {VIEW}. It is drawn by "
        "`views.seed`, and shows the object without its background. Its cube is fitted to it alone. Nothing "
        "else is published of these recordings: no pose, floor, stamp, hash, setting of a stage or picture. "
        f"They are {listed(isolated)}."
    )
