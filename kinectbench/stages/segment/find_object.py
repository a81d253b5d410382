"""The fused surface on its floor, and on it the object where the cameras look, with its feet."""

from dataclasses import dataclass

import numpy as np

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import OrientedBox, TriangleMesh, invert_rigid, transform_points
from kinectbench.core.trajectory.coverage import convergence_point
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.settings.models import SegmentationSettings
from kinectbench.stages.segment.doubts import LOOK
from kinectbench.stages.segment.floor import Floor, find_floor, level_floor, low_cut_m
from kinectbench.stages.segment.select import (
    CELL_M,
    connected,
    fit_box,
    label_pieces,
    select_object,
    surface_points,
)

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
    """

    floor: Floor
    points_floor: Float64
    owner: Int64
    focus_floor: Float64


def find_scene(
    mesh: TriangleMesh, trajectory: Trajectory, settings: SegmentationSettings, floor_may_lack: bool
) -> Scene:
    """Find the floor, and put the surface on it.

    Args:
        mesh: the fused scene, world frame.
        trajectory: poses of the frames.
        settings: seed.
        floor_may_lack: without a floor, take the lowest surface, level as the cameras were held.

    Raises:
        SegmentationError: the scene is empty, or has no floor and must have one.
    """
    T_world_camera = trajectory.T_world_camera[trajectory.good_frames]
    surface = surface_points(mesh)
    if len(surface.points) == 0:
        raise SegmentationError("no object found: the fused scene is empty; is the depth within max_depth_m?")
    focus_world = convergence_point(T_world_camera)
    try:
        floor = find_floor(surface.points, surface.normals, T_world_camera, focus_world, settings.seed)
    except SegmentationError:
        if not floor_may_lack:
            raise
        floor = level_floor(surface.points, T_world_camera)
    points_floor = transform_points(floor.T_floor_world, surface.points)
    return Scene(floor, points_floor, surface.owner, transform_points(floor.T_floor_world, focus_world))


def check_focus(box: OrientedBox, focus_floor: Float64) -> None:
    """Refuse an object chosen automatically that stands well beside where the cameras look.

    Raises:
        SegmentationError: seen from above, the focus (3,) lies more than 0.3 m outside the box.
    """
    local = transform_points(invert_rigid(box.T_floor_box), focus_floor)[:2]
    beside_m = float(np.linalg.norm(np.maximum(np.abs(local) - np.array(box.size_m[:2]) / 2, 0)))
    if beside_m > MAX_BESIDE_FOCUS_M:
        raise SegmentationError(
            f"no object found where the cameras look: what stands nearest is {beside_m:.1f} m beside it (a "
            f"black, glass or mirror-like object gives no depth); if it is meant, give a box: {LOOK}"
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


def find_object(
    scene: Scene, vertices_floor: Float64, settings: SegmentationSettings, cell_m: float
) -> FoundObject:
    """Choose the piece the cameras look at, and what is connected to it near the floor.

    Args:
        scene: the fused surface in the floor frame.
        vertices_floor: (v, 3) vertices of its mesh, floor frame, metres.
        settings: floor cut and low cut.
        cell_m: cells of this edge that touch are connected.

    Raises:
        SegmentationError: nothing stands on the floor, or not where the cameras look.
    """
    points_floor, heights_m = scene.points_floor, vertices_floor[:, 2]
    chosen = select_object(points_floor, settings.floor_cut_m, scene.focus_floor)
    box = fit_box(points_floor[chosen])
    check_focus(box, scene.focus_floor)
    others = (points_floor[:, 2] > settings.floor_cut_m) & ~chosen
    specks = np.zeros(len(others), dtype=bool)
    specks[others] = low_pieces(points_floor[others], CELL_M)
    own = chosen[scene.owner] & (heights_m > settings.floor_cut_m)
    low = heights_m > low_cut_m(scene.floor, settings)
    feet = low & ~own & ((heights_m <= settings.floor_cut_m) | specks[scene.owner])
    feet[feet] = low_parts(vertices_floor[feet], vertices_floor[own], box, cell_m)
    if feet.any():
        box = fit_box(np.concatenate([points_floor[chosen], vertices_floor[feet]]))
        reached = np.zeros(len(chosen), dtype=bool)
        reached[scene.owner[feet]] = True
        chosen = chosen | (specks & reached)
    return FoundObject(chosen, feet, box)
