"""`publish --isolate`: one view of each object with held-back truth, without any data that reveal the truth.

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
from kinectbench.core.artefacts.views import PairRow, PairsFile, ViewRow
from kinectbench.core.geometry import Grid, invert_rigid
from kinectbench.core.types import MM_PER_M
from kinectbench.core.voxels.pair_file import INPUT_KEYS, Pair, PairInput
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.release.publish.held_back import DECIMALS
from kinectbench.release.publish.reconstruction_attack import PosedView
from kinectbench.settings.models import BenchmarkSettings

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

    The draw depends only on `views.seed` and the object's name and views, not on other objects.

    Args:
        settings: the benchmark's settings.
        build: the folder with a subfolder for each recording.
        recordings: ids of recordings whose truth is held back.
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
    """Return the input of a pair in the camera frame; `seen` is computed from the isolated view alone.

    Args:
        pair: the complete pair, of framing `view`.
        view: the isolated view.
    """
    values = {key: getattr(pair, key) for key in INPUT_KEYS}
    T_camera_grid = np.round(invert_rigid(pair.T_world_camera) @ pair.T_world_grid, DECIMALS) + 0.0  # no -0
    own = Grid(pair.grid.shape, pair.voxel_size_m, T_camera_grid)
    values |= {"T_world_camera": np.eye(4), "T_world_grid": T_camera_grid}
    values |= {"seen": seen_cells(view.depth_m, view.camera, np.eye(4), own)}
    return PairInput(**values)


def write_isolated_images(view: PosedView, color: Path | None, folder: Path) -> None:
    """Write the images of an isolated view: depth, mask, and colour that is black outside the mask.

    Args:
        view: the isolated view.
        color: its colour image. No colour is written if it is None or of another size than the depth.
        folder: the folder of the recording's views in the release.

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
