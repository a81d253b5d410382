"""A contact sheet of built objects: colour view, mask, partial, our solid, true solid, errors in colour.

BUILD holds `build/<name>/` as `ground_truth.py --build BUILD` leaves it; a recording with a truth beside it
(`<name>.truth`) in RECORDINGS shows its truth and the errors, another one does not.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from kinectbench.core.geometry import TriangleMesh, invert_rigid
from kinectbench.core.images import read_gray
from kinectbench.core.pictures import CLAY, PAPER, Viewpoint, viewpoints_around
from kinectbench.core.types import Rgb
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.lab.evaluate.build import read_build, register
from kinectbench.lab.evaluate.charts import LOOKS_DEG, SIZE_PX, render_errors
from kinectbench.lab.evaluate.solid import canonical_cube, compare_on
from kinectbench.lab.evaluate.surface import Surface
from kinectbench.lab.simulate.truth import is_truth, read_truth

TITLES = ("colour", "mask", "partial (64^3)", "our solid", "true solid", "outside | missing", "slice")
TITLE_PX = 22
MISSING, EXTRA, RIGHT = (66, 110, 190), (205, 70, 60), (190, 190, 185)
SCALE_M = 0.01


def row(name: str, build_folder: Path, truth_folder: Path) -> list[Rgb]:
    """The pictures of one object."""
    built = read_build(build_folder)
    assert built.model is not None and built.views is not None and built.pair_names
    view = built.pair_names[len(built.pair_names) // 2]
    views = build_folder / "views"
    color = cv2.imread(str(views / f"{view}.color.jpg"))
    mask = read_gray(views / f"{view}.mask.png") > 0
    color_rgb = (
        color[..., ::-1] if color is not None else np.repeat((mask * 255).astype(np.uint8)[..., None], 3, 2)
    )
    shaded = (
        np.where(mask[..., None], color_rgb, (color_rgb // 4))
        if color_rgb.shape[:2] == mask.shape
        else color_rgb
    )
    partial = unpack(built.pair(view).partial)
    front = np.where(partial.any(axis=2), 255 - 2 * partial.argmax(axis=2), 0).astype(np.uint8).T
    pictures = [_fit(color_rgb), _fit(shaded), _fit(np.repeat(front[..., None], 3, axis=2))]
    if not is_truth(truth_folder):
        mesh = built.model.shape.mesh.transformed(built.model.floor.T_floor_world)
        return [*pictures, _plain(mesh, viewpoints_around(mesh.vertices, LOOKS_DEG)[0])]
    truth = read_truth(truth_folder)
    registration = register(built, truth)
    T_object_world = invert_rigid(truth.T_world_object)
    ours = built.model.shape.mesh.transformed(T_object_world @ registration.T_truth_built)
    true = truth.mesh_world.transformed(T_object_world)
    look = viewpoints_around(true.vertices, LOOKS_DEG)[0]
    signed = render_errors(ours, Surface(true), look, True, _diverging)
    solids = compare_on(canonical_cube(truth), built.model, truth, registration)
    wrong = solids.true ^ solids.built
    # The slice with most wrong cells.
    at = int(np.argmax(wrong.sum(axis=(0, 2))))
    cut = np.full((*wrong[:, at].shape, 3), PAPER, np.uint8)
    for color_of, cells in (
        (RIGHT, solids.true & solids.built),
        (EXTRA, solids.built & ~solids.true),
        (MISSING, solids.true & ~solids.built),
    ):
        cut[cells[:, at]] = color_of
    return [*pictures, _plain(ours, look), _plain(true, look), signed, _fit(cut.transpose(1, 0, 2)[::-1])]


def sheet(names: list[str], root: Path, recordings: Path) -> Rgb:
    """All objects, a row each, with titles."""
    width = len(TITLES) * SIZE_PX
    lines = [_titles([*TITLES], width)]
    for name in names:
        cells = row(name, root / "build" / name, recordings / f"{name}.truth")
        empty = np.full((SIZE_PX, SIZE_PX, 3), PAPER, np.uint8)
        lines += [_titles([name], width), np.hstack([*cells, *[empty] * (len(TITLES) - len(cells))])]
    return np.vstack(lines)


def _plain(mesh: TriangleMesh, look: Viewpoint) -> Rgb:
    clay = np.array(CLAY) / 255
    return render_errors(mesh, Surface(mesh), look, False, lambda error_m: np.tile(clay, (len(error_m), 1)))


def _diverging(error_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(colormaps["coolwarm"](0.5 + error_m / (2 * SCALE_M)))[:, :3]


def _fit(image: Rgb) -> Rgb:
    """Into a square of SIZE_PX, whole."""
    high, wide = image.shape[:2]
    scale = SIZE_PX / max(high, wide)
    small = cv2.resize(
        np.ascontiguousarray(image), (round(wide * scale), round(high * scale)), interpolation=cv2.INTER_AREA
    )
    square = np.full((SIZE_PX, SIZE_PX, 3), PAPER, np.uint8)
    top, left = (SIZE_PX - small.shape[0]) // 2, (SIZE_PX - small.shape[1]) // 2
    square[top : top + small.shape[0], left : left + small.shape[1]] = small
    return square


def _titles(words: list[str], width: int) -> Rgb:
    strip = np.full((TITLE_PX, width, 3), PAPER, np.uint8)
    for k, word in enumerate(words):
        cv2.putText(
            strip, word, (k * SIZE_PX + 6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (40, 40, 40), 1, cv2.LINE_AA
        )
    return strip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("build", type=Path)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("out", type=Path, help="a PNG file")
    parser.add_argument("names", nargs="+", help="of the recordings")
    options = parser.parse_args()
    image = sheet(options.names, options.build, options.recordings)
    cv2.imwrite(str(options.out), image[..., ::-1])


if __name__ == "__main__":
    main()
