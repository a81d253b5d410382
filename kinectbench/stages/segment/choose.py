"""Floor and object of a fused scene."""

from dataclasses import dataclass

import numpy as np

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import Grid, OrientedBox, TriangleMesh, transform_points
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.segment.box_anchor import check_anchor
from kinectbench.stages.segment.doubts import FINE_CELL_M, Selection, doubts
from kinectbench.stages.segment.find_object import Scene, find_object, find_scene
from kinectbench.stages.segment.floor import Floor, floor_cut_m
from kinectbench.stages.segment.near import enlarged_box
from kinectbench.stages.segment.select import (
    CELL_M,
    NOTHING_STANDS,
    select_in_box,
    spacing_m,
)
from kinectbench.stages.segment.up import NOTHING_KNOWN, FloorHint

MIN_BOX_POINTS = 20
NO_FLOOR = (
    "no floor was found: z = 0 is the lowest surface in view, level by gravity or, where that is not known, "
    "as the cameras were held"
)

# A floor in view has a tenth of a scene's surface and more; one without depth, hardly any (own choice).
LEAST_ON_PLANE = 0.01
PLANE_IS_EMPTY = (
    "nothing that was measured lies on the plane of `floor` in benchmark.yaml: give it in metres in the "
    "world of the trajectory; all is well if what the object stands on gives no depth"
)


@dataclass(frozen=True)
class Segmentation:
    """Which part of the scene is the object.

    Attributes:
        floor: the floor.
        box: upright box around the object (or the given one), floor frame.
        object_cells: (n, 3) int64, cells of `cell_m` in the floor frame that hold its surface.
        other_cells: (m, 3) int64, the same for everything else: what stands on the floor; with masks, specks.
        how: "automatic", "box", or "masks": all that was fused is the object.
        doubts: why the choice may be wrong, one line for people each.
        cell_m: edge of the cells: 30 mm, less where cameras were near.
    """

    floor: Floor
    box: OrientedBox
    object_cells: Int64
    other_cells: Int64
    how: str
    doubts: tuple[str, ...] = ()
    cell_m: float = CELL_M

    @property
    def hangs(self) -> bool:
        """Whether it is on nothing that is known, so that what lies below is not known either."""
        return self.how == "masks" and not self.floor.found

    def excluded(self, grid: Grid) -> Bools:
        """Voxels of an upright grid that cannot be the object: bool of the grid's shape.

        Outside a given box, and where a neighbour's surface is and the object's is not.
        """
        T_floor_grid = self.floor.T_floor_world @ grid.T_world_grid
        # The grid is upright: x and y in the floor frame depend on the first two axes, z on the last.
        nx, ny, nz = grid.shape
        ground = np.stack(
            np.meshgrid(np.arange(nx) + 0.5, np.arange(ny) + 0.5, [0.5], indexing="ij"), axis=-1
        )
        ground_floor = transform_points(T_floor_grid, ground * grid.voxel_size_m)[:, :, 0]
        heights_m = T_floor_grid[2, 3] + (np.arange(nz) + 0.5) * grid.voxel_size_m
        cells = np.floor(ground_floor[..., :2] / self.cell_m).astype(np.int64)
        levels = np.floor(heights_m / self.cell_m).astype(np.int64)
        first = np.append(cells.reshape(-1, 2).min(axis=0), levels.min())
        shape = np.append(cells.reshape(-1, 2).max(axis=0), levels.max()) + 1 - first
        foreign = _dilated(self.other_cells, first, shape) & ~_dilated(self.object_cells, first, shape)
        x, y = (cells[..., axis, None] - first[axis] for axis in (0, 1))
        excluded: Bools = foreign[x, y, levels - first[2]]
        if self.how == "box":
            at_middle = np.dstack([ground_floor[..., :2], np.full((nx, ny), self.box.center_m[2])])
            inside = np.abs(heights_m - self.box.center_m[2]) <= self.box.size_m[2] / 2
            excluded = excluded | ~(self.box.contains(at_middle)[:, :, None] & inside)
        return excluded


def segment(
    mesh: TriangleMesh,
    trajectory: Trajectory,
    given_box: OrientedBox | None,
    settings: FloorCuts,
    hint: FloorHint = NOTHING_KNOWN,
) -> Segmentation:
    """Find the floor, and on it the object: the piece the cameras look at, or what a given box holds.

    Args:
        mesh: the fused scene, world frame.
        trajectory: poses of the frames.
        given_box: floor frame, or None.
        settings: seed, floor cut and low cut.
        hint: what is known of the floor.

    Raises:
        SegmentationError: no floor (without a box), no object where the cameras look, nothing in the box, or
            it was chosen in another floor frame.
    """
    scene = find_scene(mesh, trajectory, settings, given_box is not None, hint)
    with scene.floor.said_in_errors():
        return _segment_on(scene, mesh, trajectory, given_box, settings)


def _segment_on(
    scene: Scene,
    mesh: TriangleMesh,
    trajectory: Trajectory,
    given_box: OrientedBox | None,
    settings: FloorCuts,
) -> Segmentation:
    """`segment` where the floor is known."""
    if given_box is not None:
        check_anchor(given_box, scene.floor, trajectory, scene.scale)
    cut_m, scale = floor_cut_m(scene.floor, settings), scene.scale
    points_floor, above = scene.points_floor, scene.points_floor[:, 2] > cut_m
    vertices_floor = transform_points(scene.floor.T_floor_world, mesh.vertices)
    left = vertices_floor[:, 2] > cut_m
    cell_m = max(FINE_CELL_M * scale, spacing_m(mesh))
    feet = np.zeros(len(vertices_floor), dtype=bool)
    if given_box is None:
        found = find_object(scene, vertices_floor, settings, cell_m)
        chosen, feet, box = found.chosen, found.feet, found.box
    else:
        box = given_box
        chosen = np.zeros(len(points_floor), dtype=bool)
        chosen[above] = _held(points_floor[above], given_box, scale)
    own = chosen[scene.owner]
    cells = np.floor(points_floor / (CELL_M * scale)).astype(np.int64)
    chose = Selection(
        vertices_floor[(left & own) | feet] / scale,
        vertices_floor[left & ~own & ~feet] / scale,
        enlarged_box(box, 1 / scale),
        given_box is not None,
        scene.focus_floor / scale,
        cell_m / scale,
        scale,
    )
    of_floor = scene.floor.doubts if scene.floor.found else (NO_FLOOR,)
    lines = (*of_floor, *doubts(chose))
    if scene.floor.given and not scene.floor.against and scene.floor.inlier_share < LEAST_ON_PLANE:
        lines = (PLANE_IS_EMPTY, *lines)
    how = "automatic" if given_box is None else "box"
    return Segmentation(scene.floor, box, cells[chosen], cells[above & ~chosen], how, lines, CELL_M * scale)


def _held(points_floor: Float64, box: OrientedBox, scale: float) -> Bools:
    """Which of the points (n, 3) above the floor are the object that a person's box holds."""
    in_box = box.contains(points_floor)
    if not len(in_box):
        raise SegmentationError(NOTHING_STANDS)
    if in_box.sum() < MIN_BOX_POINTS:
        low, high = points_floor.min(axis=0), points_floor.max(axis=0)
        raise SegmentationError(
            f"the box in benchmark.yaml holds nothing of the scene, which reaches from {_text(low)} to "
            f"{_text(high)} m in the floor frame; correct center_m and size_m, or choose one of those "
            "that `kinectbench segment --suggest` lists"
        )
    return select_in_box(points_floor / scale, in_box)


def _dilated(cells: Int64, first: Int64, shape: Int64) -> Bools:
    """A dense grid with the cells and their 26 neighbours set."""
    from scipy import ndimage

    local = cells - first
    inside = np.all((local >= 0) & (local < shape), axis=1)
    dense = np.zeros(shape, dtype=bool)
    dense[tuple(local[inside].T)] = True
    dilated: Bools = ndimage.binary_dilation(dense, np.ones((3, 3, 3)))
    return dilated


def _text(point: Float64) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in point) + ")"
