"""Write index.html of a release, one file that shows its objects with pictures, quality and warnings.

The page of a large release lists all recordings, but shows only some of them, evenly spread, with the
pictures of one view each. Scripts in the page turn the objects and search the list.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinectbench._version import __version__
from kinectbench.core import listed
from kinectbench.core.artefacts.benchmark import RecordingInfo, ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.targets import SPLITS, Target, by_recording
from kinectbench.core.even_choice import spread
from kinectbench.core.geometry import read_own_ply
from kinectbench.core.images import data_uri, png
from kinectbench.core.listing import SHOWN, Listing
from kinectbench.core.pages import png_uri, render_page
from kinectbench.core.turntable import FRAMES, QUALITY, turntable
from kinectbench.core.types import Bools, Float64, Rgb
from kinectbench.core.voxels.pair_file import BLOCK, Pair, read_input, read_pair, unpack
from kinectbench.release.contents import CATEGORIES, OBJECT_FILES
from kinectbench.release.publish.card import category_words, quality_words
from kinectbench.release.publish.object_glb import colored_scene
from kinectbench.release.publish.previews import depth_with_mask
from kinectbench.settings.models import BenchmarkSettings

VIEWS = 3
# Largest number of warnings at the page's head; a large release has one for each recording.
MOST_WARNINGS = 8
LISTED = ("recording", "object", "category", "split", "verdict", "estimated IoU", "pairs", "passed over")
FILTERS = (2, 3, 4)
PAPER = (243, 242, 238)
CLAY = (205, 186, 160)
BLUE = (118, 160, 205)
UNKNOWN = (228, 214, 170)
# Direction towards the light: right, down and towards the viewer.
LIGHT = (-0.45, -0.6, 0.66)
BLUR_CELLS = 2
# Stands for every picture where a page is written without them.
NO_PICTURE = "data:"
CAPTIONS = ("depth and mask", "partial, as seen", "full, as seen", "full, from the right", "slice")
CAPTIONS_HELD_BACK = ("depth and mask", "partial, as seen", "partial, from the right")


def preview_text(
    info: ReleaseInfo,
    settings: BenchmarkSettings,
    targets: Sequence[Target],
    warnings: Sequence[str],
    folder: Path | None = None,
    build: Path | None = None,
) -> str:
    """Return the text of index.html; no isolated recording is pictured.

    Args:
        info: content of benchmark.json.
        settings: the benchmark's settings.
        targets: every pair.
        warnings: the release's warnings, one line each.
        folder: the release's folder; None: `NO_PICTURE` stands for each picture.
        build: folder with scene meshes, which give objects their colours if colour is published.

    Raises:
        PairError: a pair is damaged.
        StorageError: a picture is damaged.
    """
    of_recording, infos = by_recording(targets), info.recordings
    large = len(infos) > SHOWN
    names = spread([name for name in infos if not info.isolates(name)], SHOWN)
    views = 1 if large else VIEWS
    scenes = build if settings.publish.color else None
    parts = [
        _part(folder, scenes, name, infos[name], of_recording[name], info.hides(name), views)
        for name in names
    ]
    warnings_shown = warnings[:MOST_WARNINGS] if large else warnings
    counts = [(split, sum(target.split == split for target in targets)) for split in SPLITS]
    shown = {
        "settings": settings,
        "recordings": len(infos),
        "listed": _listed(infos, names) if large else None,
        "parts": parts,
        "counts": [(split, count) for split, count in counts if count],
        "pairs": len(targets),
        "warnings": warnings_shown,
        "more_warnings": len(warnings) - len(warnings_shown),
        "categories": sorted({each.category for each in infos.values()}),
        "held_back": ", ".join(info.held_back),
        "isolated": listed([name for name in info.isolated if info.isolates(name)]),
        "frames": FRAMES,
        "turns": any(part["turntable"] for part in parts),
        "package_version": __version__,
    }
    return render_page("release/publish/preview.html", shown)


def _listed(infos: Mapping[str, RecordingInfo], shown: Sequence[str]) -> Listing:
    """Return the list of all recordings; those in `shown`, which have pictures on the page, are linked."""
    rows = [
        (
            name,
            info.object,
            info.category,
            info.split,
            info.quality.verdict or "",
            info.quality.estimated_iou_words(2) or "",
            str(info.pairs),
            str(info.refused),
        )
        for name, info in infos.items()
    ]
    links = {name: f"#r{number}" for number, name in enumerate(shown, start=1)}
    return Listing(LISTED, FILTERS, rows, links, "all of them are in README.md")


def _part(
    folder: Path | None,
    scenes: Path | None,
    name: str,
    info: RecordingInfo,
    here: Sequence[Target],
    held_back: bool,
    views: int,
) -> dict[str, object]:
    """Return the values for a recording's section of the page.

    `here` has the recording's pairs; `views` of them, evenly spread, are shown with pictures.
    """
    if folder is None:
        turned = None if held_back else NO_PICTURE
    else:
        turned = _turntable(folder / "objects" / name, scenes and scenes / name)
    chosen = sorted({int(i) for i in np.linspace(0, len(here) - 1, views).round()})
    return {
        "name": name,
        "info": info,
        "held_back": held_back,
        "turntable": turned,
        "figures": quality_words(info.quality).items(),
        "views": [(here[index].view, _pictures(folder, here[index], held_back)) for index in chosen],
    }


def _turntable(objects: Path, built: Path | None) -> str | None:
    """Return pictures of the object from all sides, in one strip: a `data:` URL; None if it has no mesh."""
    if not (objects / OBJECT_FILES[0]).is_file():
        return None
    mesh = read_own_ply(objects / OBJECT_FILES[0])
    if not len(mesh.faces):
        return None
    T_floor_world, scene = FloorFile.read(objects).T_floor_world, colored_scene(built)
    colored = scene and scene.transformed(T_floor_world)
    return data_uri(turntable(mesh.transformed(T_floor_world), colored), QUALITY)


def _pictures(folder: Path | None, target: Target, held_back: bool) -> list[tuple[str, str]]:
    """Return (caption, `data:` URL) of each picture of a pair: depth with mask, partial, public truth."""
    captions = CAPTIONS_HELD_BACK if held_back else CAPTIONS
    pictures = [NO_PICTURE] * len(captions) if folder is None else _drawn(folder, target, held_back)
    return list(zip(captions, pictures, strict=True))


def _drawn(folder: Path, target: Target, held_back: bool) -> list[str]:
    """Return a `data:` URL of each picture of a pair, in the order of the captions."""
    pair = (read_input if held_back else read_pair)(folder / target.file)
    # The input itself; each of its cells is 4 x 4 pixels.
    partial = unpack(pair.partial)
    drawn = [
        depth_with_mask(folder / "views" / target.recording, target.view),
        enlarged(seen_from_the_front(partial, BLUE)),
    ]
    if isinstance(pair, Pair):
        full, known = unpack(pair.full), unpack(pair.known)
        drawn += [seen_from_the_front(full, CLAY), seen_from_the_right(full, CLAY)]
        drawn.append(_upright_slice(unpack(pair.partial_256), full, known))
    else:
        drawn.append(enlarged(seen_from_the_right(partial, BLUE)))
    return [_png(picture) for picture in drawn]


def _png(picture: NDArray[np.uint8]) -> str:
    return png_uri(png(picture[..., ::-1]))


def seen_from_the_front(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """Draw a grid (x right, y down, z forward) as the camera sees it: (ny, nx, 3) uint8 RGB."""
    return _shaded(cells.transpose(1, 0, 2), color)


def seen_from_the_right(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """Draw a grid (x right, y down, z forward) from the camera's right, z to the right: (ny, nz, 3) RGB."""
    return _shaded(cells[::-1].transpose(1, 2, 0), color)


def _upright_slice(partial: Bools, full: Bools, known: Bools) -> Rgb:
    """Draw a vertical slice through the middle of a shape, (ny, nz, 3) uint8 RGB; the camera is on the left.

    Cells of `full` are clay-coloured, cells of `partial` blue. Empty cells are yellow if they are not known.
    """
    filled = np.flatnonzero(full.any(axis=(1, 2)))
    middle = int(filled[0] + filled[-1]) // 2 if len(filled) else len(full) // 2
    picture = np.broadcast_to(np.array(PAPER, np.uint8), (*full.shape[1:], 3)).copy()
    picture[~known[middle]] = UNKNOWN
    picture[full[middle]] = CLAY
    # A layer of one cell would hardly be visible.
    near = partial[max(0, middle - 1) : middle + 2].any(axis=0)
    picture[ndimage.binary_dilation(near)] = BLUE
    return picture


def enlarged(picture: Rgb) -> Rgb:
    """Return a picture of a 64^3 grid, enlarged to the size of a picture of a 256^3 grid."""
    return picture.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)


def _shaded(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """Draw cells as a shaded relief, uint8 RGB; their axes are rows, columns, and away from the viewer."""
    covered = np.asarray(cells.any(axis=2))
    depth = _nearest(cells)
    smooth = _blurred(depth, covered)
    down, right = np.zeros_like(smooth), np.zeros_like(smooth)
    down[1:-1] = (smooth[2:] - smooth[:-2]) / 2
    right[:, 1:-1] = (smooth[:, 2:] - smooth[:, :-2]) / 2
    # A depth edge is not shaded as a steep slope.
    down, right = (np.where(np.abs(slope) < 6, slope, 0.0) for slope in (down, right))
    facing = (LIGHT[0] * right + LIGHT[1] * down + LIGHT[2]) / np.sqrt(right * right + down * down + 1)
    far = depth / cells.shape[2]
    shade = np.clip((0.55 + 0.6 * np.clip(facing, 0, 1)) * (1.08 - 0.4 * far), 0, 1.2)[..., None]
    picture = np.where(covered[..., None], shade * np.array(color, np.float64), np.array(PAPER, np.float64))
    return np.clip(picture, 0, 255).astype(np.uint8)


def _nearest(cells: Bools) -> Float64:
    """Return (rows, columns), the index of the first set cell along the last axis; 0 if none is set.

    It loops over layers if that axis is not contiguous in memory: argmax then takes 14 times as long (54 ms
    instead of 4 ms for 256^3 cells).
    """
    if cells.strides[2] == min(cells.strides, key=abs):
        return np.where(cells.any(axis=2), cells.argmax(axis=2), 0).astype(np.float64)
    nearest = np.zeros(cells.shape[:2])
    for index in reversed(range(cells.shape[2])):
        np.copyto(nearest, index, where=cells[..., index])
    return nearest


def _blurred(depth: Float64, covered: Bools) -> Float64:
    """Return the depth averaged over the covered neighbours of each cell, so that the relief has no steps."""
    around = np.ones((2 * BLUR_CELLS + 1,) * 2)
    total = ndimage.convolve(np.where(covered, depth, 0.0), around, mode="constant")
    count = ndimage.convolve(covered.astype(np.float64), around, mode="constant")
    return np.where(covered, total / np.maximum(count, 1), 0.0)


# Every second of 256 cells is shown: 128 pixels, 2 kB as a JPEG of this quality. A page of ten thousand
# objects takes 40 of the 64 MB that a page may have.
STEP, OBJECT_QUALITY = 2, 75


def category_texts(
    info: ReleaseInfo, settings: BenchmarkSettings, targets: Sequence[Target], folder: Path | None = None
) -> Iterator[tuple[str, str]]:
    """Yield (file, text) of each category's page. Isolated recordings are listed without a picture.

    Without the release's folder, `NO_PICTURE` stands for each picture.

    Raises:
        PairError: a pair is damaged.
    """
    of_recording, infos = by_recording(targets), info.recordings
    for category in sorted({each.category for each in infos.values()}):
        shown: list[dict[str, Any]] = [
            {
                "name": name,
                "info": each,
                "held_back": (hidden := info.hides(name)),
                "picture": None if info.isolates(name) else _picture(folder, of_recording[name][0], hidden),
                "words": category_words(each),
            }
            for name, each in sorted(infos.items())
            if each.category == category
        ]
        objects = len({part["info"].object for part in shown})
        page = {"settings": settings, "category": category, "parts": shown, "objects": objects}
        yield f"{CATEGORIES}/{category}.html", render_page("release/publish/category.html", page)


def _picture(folder: Path | None, target: Target, held_back: bool) -> str:
    """Draw the full shape as the camera of `target` sees it; if truth is held back, only the partial."""
    if folder is None:
        return NO_PICTURE
    path = folder / target.file
    if held_back:
        drawn = enlarged(seen_from_the_front(unpack(read_input(path).partial), BLUE))
    else:
        drawn = seen_from_the_front(unpack(read_pair(path).full), CLAY)
    return data_uri(drawn[::STEP, ::STEP], OBJECT_QUALITY)
