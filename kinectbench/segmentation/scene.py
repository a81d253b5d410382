"""The fused surface on its floor, and where the cameras look."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import SegmentationSettings
from kinectbench.errors import SegmentationError
from kinectbench.geometry import OrientedBox, TriangleMesh, invert_rigid, transform_points
from kinectbench.segmentation.doubts import LOOK
from kinectbench.segmentation.floor import Floor, find_floor, level_floor
from kinectbench.segmentation.select import surface_points
from kinectbench.tracking.coverage import convergence_point
from kinectbench.tracking.trajectory import Trajectory

# Where the cameras look may lie beside a thing, but not farther.
MAX_BESIDE_FOCUS_M = 0.3


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
    points_floor: NDArray[np.float64]
    owner: NDArray[np.int64]
    focus_floor: NDArray[np.float64]


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


def check_focus(box: OrientedBox, focus_floor: NDArray[np.float64]) -> None:
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
