"""index.html of a release: every object with pictures, quality and warnings, in one file without scripts."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from kinectbench import __version__
from kinectbench.config import BenchmarkSettings
from kinectbench.release.layout import PREVIEW
from kinectbench.release.metadata import RecordingInfo
from kinectbench.release.preview_pictures import (
    BLUE,
    CLAY,
    enlarged,
    seen_from_the_front,
    seen_from_the_right,
    upright_slice,
)
from kinectbench.release.quality_words import quality_words
from kinectbench.release.release import SPLITS, Target
from kinectbench.report import images
from kinectbench.voxels.pair_file import read_pair, unpack
from kinectbench.voxels.pair_input import read_input

VIEWS = 3
DEPTH_WIDTH_PX = 320


@dataclass(frozen=True)
class Shown:
    """One view: pictures as `data:` addresses with their captions."""

    view: str
    pictures: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Part:
    """One recording on the page."""

    name: str
    info: RecordingInfo
    held_back: bool
    figures: tuple[tuple[str, str], ...]
    views: tuple[Shown, ...]


def write_preview(
    folder: Path,
    settings: BenchmarkSettings,
    targets: Sequence[Target],
    infos: Mapping[str, RecordingInfo],
    warnings: Sequence[str],
    held_back: Sequence[str],
) -> None:
    """Write index.html of a release whose pairs and views are there already.

    Raises:
        PairError: a pair is damaged.
        StorageError: a picture is damaged.
    """
    parts = [_part(folder, name, info, targets, info.split in held_back) for name, info in infos.items()]
    counts = [(split, sum(target.split == split for target in targets)) for split in SPLITS]
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    text = environment.from_string(_packaged("kinectbench.release", "preview.html")).render(
        settings=settings,
        parts=parts,
        counts=[(split, count) for split, count in counts if count],
        pairs=len(targets),
        warnings=warnings,
        held_back=", ".join(held_back),
        package_version=__version__,
        style=Markup(_packaged("kinectbench.report", "page.css")),
    )
    (folder / PREVIEW).write_text(text, encoding="utf-8")


def _part(folder: Path, name: str, info: RecordingInfo, targets: Sequence[Target], held_back: bool) -> Part:
    here = [target for target in targets if target.recording == name]
    chosen = sorted({int(i) for i in np.linspace(0, len(here) - 1, VIEWS).round()})
    figures = tuple(quality_words(info.quality).items())
    shown = tuple(_shown(folder, here[index], held_back) for index in chosen)
    return Part(name, info, held_back, figures, shown)


def _shown(folder: Path, target: Target, held_back: bool) -> Shown:
    """Depth with the mask, what was seen, and the truth where it is published."""
    pair_input = read_input(folder / target.file)
    # The input as it is, each of its cells as 4 x 4 pixels.
    partial = unpack(pair_input.partial)
    pictures = [
        ("depth and mask", _depth(folder / "views" / target.recording, target.view)),
        ("partial, as seen", _png(enlarged(seen_from_the_front(partial, BLUE)))),
        ("partial, from the right", _png(enlarged(seen_from_the_right(partial, BLUE)))),
    ]
    if not held_back:
        pair = read_pair(folder / target.file)
        full, known = unpack(pair.full), unpack(pair.known)
        pictures[2:] = [
            ("full, as seen", _png(seen_from_the_front(full, CLAY))),
            ("full, from the right", _png(seen_from_the_right(full, CLAY))),
            ("slice", _png(upright_slice(unpack(pair.partial_256), full, known))),
        ]
    return Shown(target.view, tuple(pictures))


def _depth(views: Path, view: str) -> str:
    """The depth image with the mask's outline, thinned to a small picture."""
    depth_mm = images.read_gray(views / f"{view}.depth.png")
    mask = images.read_gray(views / f"{view}.mask.png") > 0
    step = max(1, round(depth_mm.shape[1] / DEPTH_WIDTH_PX))
    small = images.depth_picture(depth_mm[::step, ::step])
    return _png(images.overlay_mask(small, mask[::step, ::step]))


def _png(picture: NDArray[np.uint8]) -> str:
    """RGB (height, width, 3) as a `data:` address."""
    import cv2

    encoded = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1]
    return "data:image/png;base64," + base64.b64encode(encoded.tobytes()).decode()


def _packaged(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")
