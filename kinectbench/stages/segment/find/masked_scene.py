"""Segment a scene of masked frames: all fused surface is the object, and there is no floor."""

import numpy as np

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import OrientedBox, TriangleMesh, transform_points
from kinectbench.core.trajectory.coverage import looked_at
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.core.voxels.surface_points import spacing_m, surface_points
from kinectbench.core.voxels.touching_cells import connected
from kinectbench.stages.segment.find.box_anchor import check_anchor
from kinectbench.stages.segment.find.distance_scale import cell_scale, distance_scale
from kinectbench.stages.segment.find.floor import (
    GIVEN,
    Floor,
    against_gravity,
    level_floor,
)
from kinectbench.stages.segment.find.gravity import NOTHING_KNOWN, FloorHint
from kinectbench.stages.segment.find.object import MIN_BOX_POINTS, Segmentation
from kinectbench.stages.segment.find.planes import floor_frame
from kinectbench.stages.segment.find.select import CELL_M, fit_box

# Pieces with a smaller share of the surface are specks that masks let through (chosen by hand).
LEAST_SHARE = 0.05
# The unseen part of a hand-held object may reach lower than the measured surface: z = 0 lies this much below
# that, times `distance_scale`.
BELOW_M = 0.03
NOTHING_FUSED = (
    "no object found: within the masks nothing was fused; do the masks lie on the object, and is its depth "
    "within max_depth_m?"
)
BELOW_PLANE = f"most of what the masks show lies below {GIVEN}; correct it, or leave it out"


def segment_masked_scene(
    mesh: TriangleMesh,
    trajectory: Trajectory,
    given_box: OrientedBox | None = None,
    hint: FloorHint = NOTHING_KNOWN,
) -> Segmentation:
    """Take all fused surface as the object, except specks.

    A plane that the user gave is z = 0 of the floor frame. Otherwise the frame is level by gravity or,
    without gravity, as the cameras were held, and z = 0 lies below the measured surface.

    Raises:
        SegmentationError: nothing was fused, the given box holds none of it or was chosen in another floor
            frame, or most of it lies below the given plane.
    """
    T_world_camera = trajectory.T_world_camera[trajectory.good_frames]
    near = distance_scale(T_world_camera, looked_at(T_world_camera, hint.middle_depth_m))
    scale = cell_scale(near, spacing_m(mesh), CELL_M) if len(mesh.faces) else near
    cell_m = CELL_M * scale
    surface = surface_points(mesh, cell_m)
    points_world = surface.points
    if len(points_world) < MIN_BOX_POINTS:
        raise SegmentationError(NOTHING_FUSED, what="empty-scene")
    label = connected(points_world, cell_m)
    sizes = np.bincount(label)
    kept = (sizes >= LEAST_SHARE * sizes.max())[label]
    floor = _level(points_world[kept], T_world_camera, hint, near)
    points_floor = transform_points(floor.T_floor_world, points_world)
    if given_box is not None:
        check_anchor(given_box, floor, trajectory, near)
        kept &= given_box.contains(points_floor)
        if kept.sum() < MIN_BOX_POINTS:
            raise SegmentationError(
                "the box in benchmark.yaml holds nothing of what the masks show; leave it out, or correct it",
                what="empty-box",
            )
    if np.median(points_floor[kept, 2]) <= 0:
        raise SegmentationError(BELOW_PLANE, what="bad-plane")
    vertices_floor = transform_points(floor.T_floor_world, mesh.vertices)
    box = given_box or fit_box(vertices_floor[kept[surface.owner]])
    cells = np.floor(points_floor / cell_m).astype(np.int64)
    return Segmentation(floor, box, cells[kept], cells[~kept], "masks", floor.warnings, cell_m)


def _level(points_world: Float64, T_world_camera: Float64, hint: FloorHint, scale: float) -> Floor:
    """Return the plane z = 0 as a floor: the given plane, or else a level plane below the points (n, 3)."""
    if hint.plane_world is not None:
        against = against_gravity(hint.plane_world, hint.up_world)
        frame = floor_frame(hint.plane_world)
        return Floor(hint.plane_world, frame, 0.0, 0.0, scale=scale, given=True, against=against)
    level = level_floor(points_world, T_world_camera, hint.up_world, scale)
    plane = level.plane_world + np.array([0, 0, 0, BELOW_M * scale])
    return Floor(plane, floor_frame(plane), 0.0, 0.0, found=False, scale=scale)
