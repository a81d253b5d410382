"""Contact sheets of what `known.py` built, drawn by its `--sheets`: a row an object, its figures above it.

From the left: a frame of the recording; the true solid; the built one; its error in colour (blue: missing,
red: too much, full colour at 20 mm); what nobody saw (orange: of the built solid; violet: the border of air
that is unknown), with arrows from where a camera would see it; the upright slice with most wrong cells (blue:
missing, red: too much, yellow: unknown).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from known_rows import NotBuilt, Row, Task, measure_row
from matplotlib import colormaps

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import TriangleMesh, invert_rigid, transform_points
from kinectbench.core.geometry.mesh import isosurface
from kinectbench.core.images import shrunk
from kinectbench.core.pictures import (
    CLAY,
    LIGHT,
    PAPER,
    Viewpoint,
    cast,
    cast_pieces,
    ray_starts,
    render,
    viewpoints_around,
)
from kinectbench.core.types import Bools, Float64, Rgb
from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.lab.evaluate.build import Build, BuildRegistration, read_build, register_build
from kinectbench.lab.evaluate.charts import slice_colors
from kinectbench.lab.evaluate.solid import EvaluatedSolids, canonical_cube, compare_on
from kinectbench.lab.evaluate.surface import ReferenceSurface
from kinectbench.lab.simulate.truth import Truth, read_truth
from kinectbench.report.recording import arrows_to, draw_arrow
from kinectbench.stages.ingest.sequence_folder import read_sequence
from kinectbench.stages.segment.object_model import ObjectModel

TITLES = ("a frame", "true solid", "built solid", "too much | missing", "unknown", "slice")
SIZE_PX, SUPERSAMPLING, TITLE_PX, ROWS = 260, 2, 22, 8
# From above a person's height: so one looks into an opening.
LOOK_DEG = (-50.0, 38.0)
SCALE_M = 0.02
# What nobody saw of the solid, and the border of air that nobody saw; how strongly the latter covers.
ARROW_SHARE = 0.5
UNSEEN_RGB, BORDER_RGB, COVER = np.array([240.0, 140, 30]), np.array([130.0, 80, 200]), 0.5


@dataclass(frozen=True)
class Place:
    """An object's build and truth in the frame of the true object, z up, and where it is looked at from."""

    build: Build
    model: ObjectModel
    truth: Truth
    registration: BuildRegistration
    look: Viewpoint

    @property
    def T_object_built(self) -> Float64:
        """(4, 4), from the build's world to the true object's frame."""
        return np.asarray(invert_rigid(self.truth.T_world_object) @ self.registration.T_truth_built)

    @property
    def built(self) -> TriangleMesh:
        """The built closed mesh."""
        return self.model.shape.mesh.transformed(self.T_object_built)

    @property
    def true(self) -> TriangleMesh:
        """The true solid's."""
        return self.truth.mesh_world.transformed(invert_rigid(self.truth.T_world_object))


def place(build_folder: Path, truth_folder: Path) -> Place:
    """Read what was built of an object, and its truth."""
    build, truth = read_build(build_folder), read_truth(truth_folder)
    assert build.model is not None
    vertices = transform_points(invert_rigid(truth.T_world_object), truth.mesh_world.vertices)
    look = viewpoints_around(vertices, [LOOK_DEG])[0]
    return Place(build, build.model, truth, register_build(build, truth), look)


def pictures(at: Place, build_folder: Path) -> list[Rgb]:
    """The row of an object, a square picture each."""
    cube = canonical_cube(at.truth)
    return [
        frame_picture(at, build_folder),
        render(at.true, at.look, SIZE_PX),
        render(at.built, at.look, SIZE_PX),
        error_picture(at),
        unknown_picture(at),
        slice_picture(compare_on(cube, at.model, at.truth, at.registration)),
    ]


def frame_picture(at: Place, build_folder: Path) -> Rgb:
    """The colour of the frame whose camera looks most as the other pictures do, cut out around the object."""
    sequence = read_sequence(build_folder / "sequence")
    shown = np.flatnonzero(at.registration.shown)
    cameras = (
        invert_rigid(at.truth.T_world_object) @ at.truth.T_world_camera[at.registration.true_frame[shown]]
    )
    frame = int(shown[np.argmax(cameras[:, :3, 2] @ at.look.R_frame_view[:, 2])])
    color_rgb = sequence.color_rgb(frame)
    mask = at.truth.mask(int(at.registration.true_frame[frame]))
    if color_rgb is None or not mask.any():
        return np.full((SIZE_PX, SIZE_PX, 3), PAPER, np.uint8)
    rows, columns = np.nonzero(cv2.resize(mask.astype(np.uint8), color_rgb.shape[1::-1]))
    pad = max(np.ptp(rows), np.ptp(columns)) // 12
    top, left = max(rows.min() - pad, 0), max(columns.min() - pad, 0)
    return _fit(color_rgb[top : rows.max() + pad, left : columns.max() + pad])


def error_picture(at: Place) -> Rgb:
    """What lies in front, of the built and the true solid, by its signed distance from the other."""
    built, true = at.built, at.true
    size_px = SIZE_PX * SUPERSAMPLING
    distance_m, normals_view, which = cast_pieces([built, true], at.look, size_px)
    hit = np.isfinite(distance_m)
    points = _hits(at.look, distance_m, size_px)
    error_m = np.where(
        which[hit] == 0,
        ReferenceSurface(true).signed_distance_m(points),
        -ReferenceSurface(built).signed_distance_m(points),
    )
    colors = 255 * colormaps["coolwarm"](0.5 + error_m / (2 * SCALE_M))[:, :3]
    return _drawn(hit, colors, normals_view[hit])


def unknown_picture(at: Place) -> Rgb:
    """The built solid, orange where its voxels are unknown, behind the border of unknown air in violet."""
    shape, built = at.model.shape, at.built
    unknown = shape.labels == Label.UNKNOWN
    size_px = SIZE_PX * SUPERSAMPLING
    distance_m, normals_view = cast(built, at.look, size_px)
    hit = np.isfinite(distance_m)
    points_built = transform_points(invert_rigid(at.T_object_built), _hits(at.look, distance_m, size_px))
    unseen = _nearest_solid_unknown(at, points_built, unknown)
    colors = np.where(unseen[:, None], UNSEEN_RGB, np.array(CLAY, np.float64))
    lit = _drawn_large(hit, colors, normals_view[hit])
    border = _surface_of(unknown & ~shape.solid, at)
    border_m, border_normals = cast(border, at.look, size_px)
    before = border_m < distance_m
    shade = _lit(border_normals[before])
    lit[before] = (1 - COVER) * lit[before] + COVER * BORDER_RGB * shade[:, None]
    picture = np.clip(lit, 0, 255).astype(np.uint8)
    T_object_floor = at.T_object_built @ invert_rigid(at.model.floor.T_floor_world)
    arrows = arrows_to(at.model.quality.frontiers, ARROW_SHARE * at.look.half_m)
    for number, arrow in enumerate(arrows, start=1):
        draw_arrow(picture, at.look, transform_points(T_object_floor, arrow), str(number))
    return shrunk(picture, SIZE_PX)


def _nearest_solid_unknown(at: Place, points_built: Float64, unknown: Bools) -> Bools:
    """Of points (n, 3) on the built mesh, whether the solid voxel nearest to them is unknown."""
    from scipy.spatial import cKDTree

    shape = at.model.shape
    cells = np.argwhere(shape.solid)
    centres = transform_points(shape.grid.T_world_grid, (cells + 0.5) * shape.grid.voxel_size_m)
    nearest = cKDTree(centres).query(points_built)[1]
    return np.asarray(unknown[tuple(cells[nearest].T)])


def _surface_of(cells: Bools, at: Place) -> TriangleMesh:
    """The border of some of the object's voxels, in the true object's frame."""
    grid = at.model.shape.grid
    mesh = isosurface(np.pad(0.5 - cells.astype(np.float32), 1, constant_values=0.5))
    vertices = transform_points(grid.T_world_grid, (mesh.vertices - 0.5) * grid.voxel_size_m)
    return TriangleMesh(transform_points(at.T_object_built, vertices), mesh.faces)


def slice_picture(solids: EvaluatedSolids) -> Rgb:
    """The upright slice, across x or y, with most cells that are wrong."""
    wrong = solids.true ^ solids.built
    counts = [wrong.sum(axis=(1, 2)), wrong.sum(axis=(0, 2))]
    axis = int(counts[1].max() > counts[0].max())
    index = int(counts[axis].argmax())
    cut = [np.take(cells, index, axis) for cells in (solids.true, solids.built, solids.known)]
    picture = np.swapaxes(slice_colors(*cut), 0, 1)[::-1]
    return _fit(np.ascontiguousarray(picture).astype(np.uint8))


def _hits(look: Viewpoint, distance_m: Float64, size_px: int) -> Float64:
    hit = np.isfinite(distance_m)
    return np.asarray(ray_starts(look, size_px)[hit] + distance_m[hit, None] * look.R_frame_view[:, 2])


def _lit(normals_view: Float64) -> Float64:
    return np.asarray(0.62 + 0.45 * np.clip(normals_view @ LIGHT, 0.0, 1.0))


def _drawn_large(hit: Bools, colors: Float64, normals_view: Float64) -> Float64:
    picture = np.empty((*hit.shape, 3))
    picture[...] = PAPER
    picture[hit] = colors * _lit(normals_view)[:, None]
    return picture


def _drawn(hit: Bools, colors: Float64, normals_view: Float64) -> Rgb:
    picture = _drawn_large(hit, colors, normals_view)
    return shrunk(np.clip(picture, 0, 255).astype(np.uint8), SIZE_PX)


def _fit(image: Rgb) -> Rgb:
    """Into a square, whole."""
    high, wide = image.shape[:2]
    scale = SIZE_PX / max(high, wide)
    size = (max(round(wide * scale), 1), max(round(high * scale), 1))
    small = cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA)
    square = np.full((SIZE_PX, SIZE_PX, 3), PAPER, np.uint8)
    top, left = (SIZE_PX - small.shape[0]) // 2, (SIZE_PX - small.shape[1]) // 2
    square[top : top + small.shape[0], left : left + small.shape[1]] = small
    return square


def label(row: Row) -> str:
    """An object's figures in a line."""
    words = f"{row.name}   IoU {row.iou:.2f}"
    if row.estimated is not None:
        words += f", estimated {row.estimated:.2f}"
    if row.low is not None and row.high is not None:
        words += f" [{row.low:.2f}, {row.high:.2f}]"
    known = "-" if row.known_iou is None else f"{row.known_iou:.2f}"
    words += f"   known {known}, wrong by over 10 mm {row.known_gross:.1%}"
    words += f"   not known {row.not_known:.0%}"
    return words + (f"   frontiers {row.frontiers}" if row.frontiers is not None else "")


def strip(words: Sequence[str], step_px: int) -> Rgb:
    """A line of words, one every `step_px`."""
    width = len(TITLES) * SIZE_PX
    line = np.full((TITLE_PX, width, 3), PAPER, np.uint8)
    for k, word in enumerate(words):
        where = (k * step_px + 6, 16)
        cv2.putText(line, word, where, cv2.FONT_HERSHEY_SIMPLEX, 0.48, (40, 40, 40), 1, cv2.LINE_AA)
    return line


def object_rows(task: Task) -> list[Rgb]:
    """The lines of one object: its figures, and its pictures; or why it has none."""
    row = measure_row(task)
    if isinstance(row, NotBuilt):
        return [strip([f"{row.name}: not built: {row.why}"], SIZE_PX)]
    return [strip([label(row)], SIZE_PX), np.hstack(pictures(place(task.build, task.truth), task.build))]


def draw_sheets(tasks: Sequence[Task], out: Path, jobs: int) -> None:
    """Write sheet-1.png and so on into a folder."""
    with worker_pool(min(jobs, len(tasks))) as pool:
        rows = [one.result() for one in submit_all(pool, object_rows, tasks)]
    out.mkdir(parents=True, exist_ok=True)
    for number, first in enumerate(range(0, len(rows), ROWS), start=1):
        lines = [strip(TITLES, SIZE_PX), *(line for row in rows[first : first + ROWS] for line in row)]
        path = out / f"sheet-{number}.png"
        cv2.imwrite(str(path), np.vstack(lines)[..., ::-1])
        print(path)
