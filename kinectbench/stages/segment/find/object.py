"""Find the floor of a fused scene, and the object on it."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import Grid, OrientedBox, TriangleMesh, invert_rigid, transform_points
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.core.voxels.point_cells import connected, spacing_m, surface_points
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.segment.find.floor import Floor, explained, find_floor, level_floor
from kinectbench.stages.segment.find.given import check_anchor
from kinectbench.stages.segment.find.hints import NOTHING_KNOWN, FloorHint
from kinectbench.stages.segment.find.pieces import (
    CELL_M,
    FINE_CELL_M,
    FLAT,
    LOOK,
    NOTHING_STANDS,
    Selection,
    choice_warnings,
    fit_box,
    label_pieces,
    select_in_box,
    select_object,
)
from kinectbench.stages.segment.find.scale import cell_scale, distance_scale, enlarged_box
from kinectbench.stages.track.outliers import far_warnings

# The focus of the cameras lies at most this far beside the object.
MAX_BESIDE_FOCUS_M = 0.3
# No foot reaches farther beyond what stands on it.
MAX_BEYOND_M = 0.3
# A piece of surface that is nowhere higher is part of something low, such as a tube that lies on the floor.
MAX_LOW_M = 0.06
# Fewer points, about one a cell of 3 cm, are a speck.
MIN_BOX_POINTS = 20
NO_FLOOR = (
    "no floor was found: z = 0 is the lowest surface in view, level by gravity or, where that is not known, "
    "as the cameras were held"
)
# A floor in view has a tenth of a scene's surface and more; without depth, hardly any (chosen by hand).
LEAST_ON_PLANE = 0.01
PLANE_IS_EMPTY = (
    "nothing that was measured lies on the plane of `floor` in benchmark.yaml: give it in metres in the "
    "world of the trajectory; all is well if what the object stands on gives no depth"
)


@dataclass(frozen=True)
class Scene:
    """The fused surface in the floor frame.

    Attributes:
        floor: the floor.
        points_floor: (n, 3) points spread evenly over the surface, floor frame, metres.
        owner: (v,) int64, for each vertex of the mesh the row of its point in `points_floor`.
        focus_floor: (3,) where the cameras look.
        scale: factor of cells and gaps for near cameras (`cell_scale`).
        picked: whether the focus is a point that the user picked.
    """

    floor: Floor
    points_floor: Float64
    owner: Int64
    focus_floor: Float64
    scale: float = 1.0
    picked: bool = False


def find_scene(
    mesh: TriangleMesh, trajectory: Trajectory, settings: FloorCuts, floor_may_lack: bool, hint: FloorHint
) -> Scene:
    """Find the floor, and move the surface into its frame.

    If no floor is found and `floor_may_lack` is set, a level plane at the lowest surface replaces it
    (`level_floor`).

    Raises:
        SegmentationError: the scene is empty, it has no floor and `floor_may_lack` is False, or a given plane
            lies above the cameras.
    """
    T_world_camera = trajectory.T_world_camera[trajectory.good_frames]
    focus_world = hint.focus_world(T_world_camera)
    near = distance_scale(T_world_camera, focus_world)
    scale = cell_scale(near, spacing_m(mesh), CELL_M)
    surface = surface_points(mesh, CELL_M * scale)
    if len(surface.points) == 0:
        raise SegmentationError(
            "no object found: the fused scene is empty; is the depth within max_depth_m?", what="empty-scene"
        )
    try:
        floor = find_floor(surface.points, surface.normals, T_world_camera, focus_world, settings.seed, hint)
    except SegmentationError:
        if not floor_may_lack or hint.plane_world is not None:
            raise
        floor = level_floor(surface.points, T_world_camera, hint.up_world, near)
    points_floor = transform_points(floor.T_floor_world, surface.points)
    focus_floor = transform_points(floor.T_floor_world, focus_world)
    return Scene(floor, points_floor, surface.owner, focus_floor, scale, hint.picked_world is not None)


def _check_focus(box: OrientedBox, focus_floor: Float64, scale: float = 1.0) -> None:
    """Refuse an object that, seen from above, lies over 0.3 m beside the point that the cameras look at.

    The box and this point (3,), the focus, are in the floor frame, in metres divided by `scale`.
    """
    local = transform_points(invert_rigid(box.T_floor_box), focus_floor)[:2]
    beside_m = float(np.linalg.norm(np.maximum(np.abs(local) - np.array(box.size_m[:2]) / 2, 0)))
    if beside_m > MAX_BESIDE_FOCUS_M:
        raise SegmentationError(
            f"no object found where the cameras look: what stands nearest is {scale * beside_m:.1f} m beside "
            f"it (a black, glass or mirror-like object gives no depth, and {FLAT}); if it is meant, give a "
            f"box: {LOOK}"
        )


def low_pieces(points_floor: Float64, cell_m: float) -> Bools:
    """Return which points (n, 3) belong to a piece that ends 6 cm above the floor or lower: (n,) bool."""
    if not len(points_floor):
        return np.zeros(0, dtype=bool)
    label = label_pieces(points_floor, cell_m)
    top_m = np.zeros(int(label.max()) + 1)
    np.maximum.at(top_m, label, points_floor[:, 2])
    return np.asarray((top_m <= MAX_LOW_M)[label])


def low_parts(low_floor: Float64, object_floor: Float64, box: OrientedBox, cell_m: float) -> Bools:
    """Which low points (n, 3) are connected to the object's points (m, 3): (n,) bool.

    Cells of edge `cell_m` that touch are connected. All points are in the floor frame, metres, m > 0. Low
    points more than 0.3 m outside `box`, which is around the object's points, are left out.
    """
    held = box.grown(MAX_BEYOND_M).contains(low_floor)
    if not held.any():
        return held
    label = connected(np.concatenate([low_floor[held], object_floor]), cell_m)
    held[held] = np.isin(label[: held.sum()], label[held.sum() :])
    return held


@dataclass(frozen=True)
class ObjectOnFloor:
    """The object as it was chosen in a scene.

    Attributes:
        chosen: (n,) bool, which of the scene's points above the floor cut belong to the object.
        feet: (v,) bool, which mesh vertices are connected to the object but not part of its main piece: those
            between the low cut and the floor cut, and those of low pieces.
        box: upright box around the chosen points and the feet, or the given box; floor frame.
    """

    chosen: Bools
    feet: Bools
    box: OrientedBox


def find_object(scene: Scene, vertices_floor: Float64, settings: FloorCuts, cell_m: float) -> ObjectOnFloor:
    """Choose the piece that the cameras look at, with the parts near the floor that are connected to it.

    The vertices (v, 3) of the scene's mesh are in the floor frame, metres; cells of edge `cell_m` that touch
    are connected.

    Raises:
        SegmentationError: nothing stands on the floor, or nothing where the cameras look.
    """
    scale = scene.scale
    points_floor, vertices_floor = scene.points_floor / scale, vertices_floor / scale
    heights_m, focus_floor = vertices_floor[:, 2], scene.focus_floor / scale
    cut_m, low_m = scene.floor.cut_m(settings) / scale, scene.floor.low_cut_m(settings) / scale
    chosen = select_object(points_floor, cut_m, focus_floor)
    box = fit_box(points_floor[chosen])
    if not scene.picked:
        _check_focus(box, focus_floor, scale)
    others = (points_floor[:, 2] > cut_m) & ~chosen
    specks = np.zeros(len(others), dtype=bool)
    specks[others] = low_pieces(points_floor[others], CELL_M)
    own = chosen[scene.owner] & (heights_m > cut_m)
    feet = (heights_m > low_m) & ~own & ((heights_m <= cut_m) | specks[scene.owner])
    feet[feet] = low_parts(vertices_floor[feet], vertices_floor[own], box, cell_m / scale)
    if feet.any():
        box = fit_box(np.concatenate([points_floor[chosen], vertices_floor[feet]]))
        reached = np.zeros(len(chosen), dtype=bool)
        reached[scene.owner[feet]] = True
        chosen = chosen | (specks & reached)
    return ObjectOnFloor(chosen, feet, enlarged_box(box, scale))


@dataclass(frozen=True)
class Segmentation:
    """The part of the scene that is the object.

    Attributes:
        floor: the floor.
        box: upright box around the object (or the given one), floor frame.
        object_cells: (n, 3) int64, cells of `cell_m` in the floor frame that hold its surface.
        other_cells: (m, 3) int64, cells of the surface that is not the object: other things above the floor;
            if `how` is "masks", pieces too small to be the object, and what lies outside a given box.
        how: how the object was chosen: "automatic" (what cameras look at), "box" (what a given box holds),
            or "masks" (all that was fused of masked frames).
        warnings: why the choice may be wrong, one line each.
        cell_m: edge of the cells: 30 mm, less where cameras were near.
    """

    floor: Floor
    box: OrientedBox
    object_cells: Int64
    other_cells: Int64
    how: str
    warnings: tuple[str, ...] = ()
    cell_m: float = CELL_M

    @property
    def support(self) -> Floor | None:
        """The plane that the object stands on; None if it hangs, or is held."""
        return None if self.how == "masks" and not self.floor.found else self.floor

    def beside_m(self, point_world: Float64) -> float:
        """Return the distance of a point (3,) from the middle of the nearest cell of the object, metres."""
        point_floor = transform_points(self.floor.T_floor_world, point_world)
        return float(np.linalg.norm((self.object_cells + 0.5) * self.cell_m - point_floor, axis=1).min())

    def neighbours(self, grid: Grid) -> Bools:
        """Return a mask of an upright grid: voxels near other surface, but not near the object's surface."""
        ground_floor, heights_m = self._middles_floor(grid)
        cells = np.floor(ground_floor[..., :2] / self.cell_m).astype(np.int64)
        levels = np.floor(heights_m / self.cell_m).astype(np.int64)
        first = np.append(cells.reshape(-1, 2).min(axis=0), levels.min())
        shape = np.append(cells.reshape(-1, 2).max(axis=0), levels.max()) + 1 - first
        foreign = _dilated(self.other_cells, first, shape) & ~_dilated(self.object_cells, first, shape)
        x, y = (cells[..., axis, None] - first[axis] for axis in (0, 1))
        return np.asarray(foreign[x, y, levels - first[2]])

    def beyond_box(self, grid: Grid) -> Bools | None:
        """Return a mask of an upright grid: voxels outside the given box; None if no box is given."""
        if self.how != "box":
            return None
        ground_floor, heights_m = self._middles_floor(grid)
        at_middle = ground_floor.copy()
        at_middle[..., 2] = self.box.center_m[2]
        inside = np.abs(heights_m - self.box.center_m[2]) <= self.box.size_m[2] / 2
        return np.asarray(~(self.box.contains(at_middle)[:, :, None] & inside))

    def _middles_floor(self, grid: Grid) -> tuple[Float64, Float64]:
        """Return the middles (nx, ny, 3) of an upright grid's columns and the heights (nz,) of its layers.

        Both are in the floor frame, in metres.
        """
        T_floor_grid = self.floor.T_floor_world @ grid.T_world_grid
        # The grid is upright: x and y in the floor frame depend on the first two axes, z on the last.
        nx, ny, nz = grid.shape
        ground = np.stack(
            np.meshgrid(np.arange(nx) + 0.5, np.arange(ny) + 0.5, [0.5], indexing="ij"), axis=-1
        )
        ground_floor = transform_points(T_floor_grid, ground * grid.voxel_size_m)[:, :, 0]
        heights_m = T_floor_grid[2, 3] + (np.arange(nz) + 0.5) * grid.voxel_size_m
        return ground_floor, heights_m


def find_floor_and_object(
    mesh: TriangleMesh,
    trajectory: Trajectory,
    given_box: OrientedBox | None,
    settings: FloorCuts,
    hint: FloorHint = NOTHING_KNOWN,
) -> Segmentation:
    """Find the floor, and the object on it: the piece that the cameras look at, or what a given box holds.

    The box is in the floor frame, the mesh of the fused scene in that of the world.

    Raises:
        SegmentationError: an empty scene, no floor (without a box), a given plane above the cameras, no
            object where they look, or a box that holds nothing or was chosen in another floor frame.
    """
    with explained(lambda: far_warnings(trajectory.T_world_camera)):
        scene = find_scene(mesh, trajectory, settings, given_box is not None, hint)
        with explained(lambda: scene.floor.against):
            return _find_on_floor(scene, mesh, trajectory, given_box, settings)


def _find_on_floor(
    scene: Scene,
    mesh: TriangleMesh,
    trajectory: Trajectory,
    given_box: OrientedBox | None,
    settings: FloorCuts,
) -> Segmentation:
    """Find the object on the known floor of a scene: the piece in view, or the content of a given box."""
    if given_box is not None:
        check_anchor(given_box, scene.floor, trajectory, scene.scale)
    cut_m, scale = scene.floor.cut_m(settings), scene.scale
    points_floor, above = scene.points_floor, scene.points_floor[:, 2] > cut_m
    vertices_floor = transform_points(scene.floor.T_floor_world, mesh.vertices)
    left = vertices_floor[:, 2] > cut_m
    least_m = spacing_m(mesh)
    cell_m = max(FINE_CELL_M * scale, least_m)
    if given_box is None:
        result = find_object(scene, vertices_floor, settings, cell_m)
    else:
        result = _object_in_box(scene, above, given_box)
    chosen, feet, box = result.chosen, result.feet, result.box
    own = chosen[scene.owner]
    cells = np.floor(points_floor / (CELL_M * scale)).astype(np.int64)
    selection = Selection(
        vertices_floor[(left & own) | feet] / scale,
        vertices_floor[left & ~own & ~feet] / scale,
        enlarged_box(box, 1 / scale),
        given_box is not None,
        scene.focus_floor / scale,
        cell_m / scale,
        least_m / scale,
        scale,
    )
    of_floor = scene.floor.warnings if scene.floor.found else (NO_FLOOR,)
    lines = (*of_floor, *choice_warnings(selection))
    if scene.floor.given and not scene.floor.against and scene.floor.inlier_share < LEAST_ON_PLANE:
        lines = (PLANE_IS_EMPTY, *lines)
    how = "automatic" if given_box is None else "box"
    return Segmentation(scene.floor, box, cells[chosen], cells[above & ~chosen], how, lines, CELL_M * scale)


def _object_in_box(scene: Scene, above: Bools, box: OrientedBox) -> ObjectOnFloor:
    """Return the object in a given box; `above` (n,) marks the points of the scene above the floor."""
    points_floor = scene.points_floor[above]
    in_box = box.contains(points_floor)
    if not len(in_box):
        raise SegmentationError(NOTHING_STANDS)
    if in_box.sum() < MIN_BOX_POINTS:
        low, high = points_floor.min(axis=0), points_floor.max(axis=0)
        raise SegmentationError(
            f"the box in benchmark.yaml holds nothing of the scene, which reaches from {_text(low)} to "
            f"{_text(high)} m in the floor frame; correct center_m and size_m, or choose one of those "
            "that `kinectbench segment --suggest` lists",
            what="empty-box",
        )
    chosen = np.zeros(len(above), dtype=bool)
    chosen[above] = select_in_box(points_floor / scene.scale, in_box)
    return ObjectOnFloor(chosen, np.zeros(len(scene.owner), dtype=bool), box)


def _dilated(cells: Int64, first: Int64, shape: Int64) -> Bools:
    """Mark cells (n, 3) and their 26 neighbours in a dense bool grid of `shape` that starts at `first`."""
    local = cells - first
    inside = np.all((local >= 0) & (local < shape), axis=1)
    dense = np.zeros(shape, dtype=bool)
    dense[tuple(local[inside].T)] = True
    return np.asarray(ndimage.binary_dilation(dense, np.ones((3, 3, 3))))


def _text(point: Float64) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in point) + ")"
