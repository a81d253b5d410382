"""index.html of a release: every object with pictures, quality and warnings, in one file without scripts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench._version import __version__
from kinectbench.core import images
from kinectbench.core.artefacts.benchmark import RecordingInfo
from kinectbench.core.artefacts.targets import SPLITS, Target
from kinectbench.core.pages import png_uri, render_page
from kinectbench.core.types import Bools, Float64, Rgb
from kinectbench.core.voxels.pair_file import BLOCK, read_input, read_pair, unpack
from kinectbench.release.contents import PREVIEW
from kinectbench.release.publish.card import quality_words
from kinectbench.settings.models import BenchmarkSettings

VIEWS = 3
DEPTH_WIDTH_PX = 320
PAPER = (243, 242, 238)
CLAY = (205, 186, 160)
BLUE = (118, 160, 205)
UNKNOWN = (228, 214, 170)
# Towards the light: right, down and towards the viewer.
LIGHT = (-0.45, -0.6, 0.66)
BLUR_CELLS = 2


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
    shown = {
        "settings": settings,
        "parts": parts,
        "counts": [(split, count) for split, count in counts if count],
        "pairs": len(targets),
        "warnings": warnings,
        "held_back": ", ".join(held_back),
        "package_version": __version__,
    }
    (folder / PREVIEW).write_text(render_page("release/publish/preview.html", shown), encoding="utf-8")


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
    return png_uri(encoded.tobytes())


def seen_from_the_front(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """A grid (x right, y down, z forward) as the camera looks at it: (ny, nx, 3) uint8 RGB."""
    return _shaded(cells.transpose(1, 0, 2), color)


def seen_from_the_right(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """The same from the camera's right: (ny, nz, 3) uint8 RGB; the camera is on the left."""
    return _shaded(cells[::-1].transpose(1, 2, 0), color)


def upright_slice(partial: Bools, full: Bools, known: Bools) -> Rgb:
    """A cut along the view through the middle of the shape: (ny, nz, 3) uint8 RGB; the camera is on the left.

    The solid is clay, what the view saw of it blue, and what nobody knows yellow.
    """
    filled = np.flatnonzero(full.any(axis=(1, 2)))
    middle = int(filled[0] + filled[-1]) // 2 if len(filled) else len(full) // 2
    picture = np.broadcast_to(np.array(PAPER, np.uint8), (*full.shape[1:], 3)).copy()
    picture[~known[middle]] = UNKNOWN
    picture[full[middle]] = CLAY
    # A layer of single cells would hardly show.
    near = np.asarray(partial[max(0, middle - 1) : middle + 2].any(axis=0))
    picture[_grown(near)] = BLUE
    return picture


def enlarged(picture: Rgb) -> Rgb:
    """A picture of 64-cells at the size of one of 256-cells."""
    return picture.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)


def _shaded(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """(rows, columns, away from the viewer) as a shaded relief."""
    covered = np.asarray(cells.any(axis=2))
    depth = np.where(covered, cells.argmax(axis=2), 0).astype(np.float64)
    smooth = _blurred(depth, covered)
    down, right = np.zeros_like(smooth), np.zeros_like(smooth)
    down[1:-1] = (smooth[2:] - smooth[:-2]) / 2
    right[:, 1:-1] = (smooth[:, 2:] - smooth[:, :-2]) / 2
    # An edge before something far is no steep slope.
    down, right = (np.where(np.abs(slope) < 6, slope, 0.0) for slope in (down, right))
    facing = (LIGHT[0] * right + LIGHT[1] * down + LIGHT[2]) / np.sqrt(right * right + down * down + 1)
    far = depth / cells.shape[2]
    shade = np.clip((0.55 + 0.6 * np.clip(facing, 0, 1)) * (1.08 - 0.4 * far), 0, 1.2)[..., None]
    picture = np.where(covered[..., None], shade * np.array(color, np.float64), np.array(PAPER, np.float64))
    return np.clip(picture, 0, 255).astype(np.uint8)


def _blurred(depth: Float64, covered: Bools) -> Float64:
    """Mean depth over the covered cells around each cell, so that the relief has no steps."""
    total, count = np.where(covered, depth, 0.0), covered.astype(np.float64)
    for axis in (0, 1):
        total, count = _summed(total, axis), _summed(count, axis)
    return np.where(covered, total / np.maximum(count, 1), 0.0)


def _summed(values: Float64, axis: int) -> Float64:
    """Sum over a cell and its neighbours along an axis."""
    width = [(BLUR_CELLS, BLUR_CELLS) if a == axis else (0, 0) for a in (0, 1)]
    padded = np.pad(values, width)
    size = values.shape[axis]
    result = np.zeros_like(values)
    for shift in range(2 * BLUR_CELLS + 1):
        result += padded[shift : shift + size] if axis == 0 else padded[:, shift : shift + size]
    return result


def _grown(mask: Bools) -> Bools:
    """A mask and its four neighbours."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    grown[:, 1:] |= mask[:, :-1]
    grown[:, :-1] |= mask[:, 1:]
    return grown
