"""The fused surface on its floor, and on it the object where the cameras look, with its feet."""

from dataclasses import dataclass

import numpy as np

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import OrientedBox, TriangleMesh, invert_rigid, transform_points
from kinectbench.core.trajectory.coverage import looked_at
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.segment.doubts import LOOK
from kinectbench.stages.segment.floor import Floor, find_floor, floor_cut_m, level_floor, low_cut_m
from kinectbench.stages.segment.near import cell_scale, enlarged_box, near_scale
from kinectbench.stages.segment.select import (
    CELL_M,
    connected,
    fit_box,
    label_pieces,
    select_object,
    spacing_m,
    surface_points,
)
from kinectbench.stages.segment.up import NOTHING_KNOWN, FloorHint

# Where the cameras look may lie beside a thing, but not farther.
MAX_BESIDE_FOCUS_M = 0.3
# No foot reaches farther beyond what stands on it.
MAX_BEYOND_M = 0.3
# A piece of surface that is nowhere higher is a bit of something low, such as a tube that lies on the floor.
MAX_LOW_M = 0.06


@dataclass(frozen=True)
class Scene:
    """The fused surface in the floor frame.

    Attributes:
        floor: the floor.
        points_floor: (n, 3) points spread evenly over the surface, floor frame, metres.
        owner: (v,) int64, the point that each vertex of the mesh belongs to.
        focus_floor: (3,) where the cameras look.
        scale: by what cells and gaps are multiplied, as cameras were near (`cell_scale`).
    """

    floor: Floor
    points_floor: Float64
    owner: Int64
    focus_floor: Float64
    scale: float = 1.0


def find_scene(
    mesh: TriangleMesh,
    trajectory: Trajectory,
    settings: FloorCuts,
    floor_may_lack: bool,
    hint: FloorHint = NOTHING_KNOWN,
) -> Scene:
    """Find the floor, and put the surface on it.

    Args:
        mesh: the fused scene, world frame.
        trajectory: poses of the frames.
        settings: seed.
        floor_may_lack: without a floor, take its lowest surface, level by gravity or as cameras were held.
        hint: what is known of the floor.

    Raises:
        SegmentationError: the scene is empty, or has no floor and must have one.
    """
    T_world_camera = trajectory.T_world_camera[trajectory.good_frames]
    focus_world = looked_at(T_world_camera, hint.middle_depth_m)
    near = near_scale(T_world_camera, focus_world)
    scale = cell_scale(near, spacing_m(mesh), CELL_M) if len(mesh.faces) else near
    surface = surface_points(mesh, CELL_M * scale)
    if len(surface.points) == 0:
        raise SegmentationError("no object found: the fused scene is empty; is the depth within max_depth_m?")
    try:
        floor = find_floor(surface.points, surface.normals, T_world_camera, focus_world, settings.seed, hint)
    except SegmentationError:
        if not floor_may_lack or hint.plane_world is not None:
            raise
        floor = level_floor(surface.points, T_world_camera, hint.up_world, near)
    points_floor = transform_points(floor.T_floor_world, surface.points)
    focus_floor = transform_points(floor.T_floor_world, focus_world)
    return Scene(floor, points_floor, surface.owner, focus_floor, scale)


def check_focus(box: OrientedBox, focus_floor: Float64, scale: float = 1.0) -> None:
    """Refuse an object chosen automatically that stands well beside where the cameras look.

    Args:
        box: around it, floor frame, metres over `scale`.
        focus_floor: (3,) alike.
        scale: of the scene.

    Raises:
        SegmentationError: seen from above, the focus (3,) lies more than 0.3 m outside the box.
    """
    local = transform_points(invert_rigid(box.T_floor_box), focus_floor)[:2]
    beside_m = float(np.linalg.norm(np.maximum(np.abs(local) - np.array(box.size_m[:2]) / 2, 0)))
    if beside_m > MAX_BESIDE_FOCUS_M:
        raise SegmentationError(
            f"no object found where the cameras look: what stands nearest is {scale * beside_m:.1f} m beside "
            f"it (a black, glass or mirror-like object gives no depth); if it is meant, give a box: {LOOK}"
        )


def low_pieces(points_floor: Float64, cell_m: float) -> Bools:
    """Which of the points above the floor cut (n, 3) are of pieces that hardly rise above it: (n,) bool.

    Args:
        points_floor: evenly spread, of everything but the object, floor frame, metres.
        cell_m: cells of this edge that touch are connected.
    """
    if not len(points_floor):
        return np.zeros(0, dtype=bool)
    label = label_pieces(points_floor, cell_m)
    top_m = np.zeros(int(label.max()) + 1)
    np.maximum.at(top_m, label, points_floor[:, 2])
    low: Bools = (top_m <= MAX_LOW_M)[label]
    return low


def low_parts(low_floor: Float64, object_floor: Float64, box: OrientedBox, cell_m: float) -> Bools:
    """Which of the low points are connected to the object (own rule).

    Args:
        low_floor: (n, 3) points of the surface between the low cut and the floor cut, and of low pieces,
            floor frame, metres.
        object_floor: (m, 3) points of the object above the floor cut, m > 0.
        box: around these; what lies more than 0.3 m beyond it is left out.
        cell_m: cells of this edge that touch are connected.

    Returns:
        (n,) bool.
    """
    held = box.grown(MAX_BEYOND_M).contains(low_floor)
    if not held.any():
        return held
    label = connected(np.concatenate([low_floor[held], object_floor]), cell_m)
    held[held] = np.isin(label[: held.sum()], label[held.sum() :])
    return held


@dataclass(frozen=True)
class FoundObject:
    """The object as it was chosen in a scene.

    Attributes:
        chosen: (n,) bool, the scene's points above the floor cut that are the object's.
        feet: (v,) bool, the vertices that are low parts of it.
        box: upright box around both, floor frame.
    """

    chosen: Bools
    feet: Bools
    box: OrientedBox


def find_object(scene: Scene, vertices_floor: Float64, settings: FloorCuts, cell_m: float) -> FoundObject:
    """Choose the piece the cameras look at, and what is connected to it near the floor.

    Args:
        scene: the fused surface in the floor frame.
        vertices_floor: (v, 3) vertices of its mesh, floor frame, metres.
        settings: floor cut and low cut.
        cell_m: cells of this edge that touch are connected.

    Raises:
        SegmentationError: nothing stands on the floor, or not where the cameras look.
    """
    scale = scene.scale
    points_floor, vertices_floor = scene.points_floor / scale, vertices_floor / scale
    heights_m, focus_floor = vertices_floor[:, 2], scene.focus_floor / scale
    cut_m, low_m = (cut(scene.floor, settings) / scale for cut in (floor_cut_m, low_cut_m))
    chosen = select_object(points_floor, cut_m, focus_floor)
    box = fit_box(points_floor[chosen])
    check_focus(box, focus_floor, scale)
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
    return FoundObject(chosen, feet, enlarged_box(box, scale))
