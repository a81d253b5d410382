"""An object that moves: masks of one that turns before a still camera, and the scene of masked frames.

Of masked frames, all fused surface is the object, and there is no floor.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import (
    Camera,
    OrientedBox,
    TriangleMesh,
    depth_sigma_m,
    image_normals,
    transform_points,
)
from kinectbench.core.own_pixels import Masks
from kinectbench.core.sequence import Sequence
from kinectbench.core.still_camera import Watched, watch_some
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.core.voxels.point_cells import cell_numbers, connected, spacing_m, surface_points
from kinectbench.stages.segment.find.floor import Floor, find_floor, level_floor
from kinectbench.stages.segment.find.floor_choice import MIN_PLANE_POINTS
from kinectbench.stages.segment.find.given import check_anchor
from kinectbench.stages.segment.find.hints import NOTHING_KNOWN, FloorHint, up_or_held
from kinectbench.stages.segment.find.object import MIN_BOX_POINTS, Segmentation
from kinectbench.stages.segment.find.pieces import CELL_M, fit_box
from kinectbench.stages.segment.find.planes import GIVEN, against_gravity, floor_frame, turn_rad
from kinectbench.stages.segment.find.scale import cell_scale, distance_scale

# Neighbours on each side whose points make a normal (chosen by hand).
NORMAL_REACH_PX = 2
# What turns is larger than specks of fewer points in a cell of this edge (chosen by hand).
MOVING_CELL_M, MIN_POINTS = 0.02, 4
# The cylinder is this much wider than the moving points, for surface that did not change meanwhile.
WIDER, MARGIN_M = 1.05, 0.01
# What turns begins this many standard deviations of the depth above its plane, or more (chosen by hand).
CLEAR_SIGMAS, CLEAR_M = 3.0, 0.008
# This share of the moving points is above that plane.
ABOVE_SHARE = 0.9
# A plate's top is level. It is looked for within this many radii of what moves (farther out the floor would
# count), and has this many points. This share of the moving points may lie below its top (chosen by hand).
LEVEL_COSINE, PLATE_RATIO, MIN_PLATE_POINTS, LOWEST_SHARE = 0.9, 1.2, 40, 0.05
# What passes in front of something is nearer by this many standard deviations of its depth, or this much: two
# depths differ by less from noise alone in all but a few of a thousand pixels (chosen by hand).
NEARER_SIGMAS, NEARER_M = 4.0, 0.01
# What is seen of a standing object begins within this height of the floor; of a hand-held one, higher.
HANGS_M = 0.06
MOVES = (
    "`segment_by: turntable` needs a camera that stands still before an object that turns, and here {what}; "
    "give masks of the object and `segment_by: masks`"
)
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


@dataclass(frozen=True)
class Turntable:
    """The space of an object that turns in front of a still camera: a cylinder on a plane, or a ball.

    Attributes:
        floor: the plane below the cylinder, which is the floor or a plate's top; None for a ball.
        center: (3,) metres: middle of the cylinder's base in the floor frame, or of the ball in the camera
            frame.
        radius_m: of the cylinder or the ball.
    """

    floor: Floor | None
    center: Float64
    radius_m: float

    def mask(self, depth_m: Float32, camera: Camera) -> Bools:
        """Return the turning object's pixels, (height, width) bool, in depth (height, width) in metres."""
        points = camera.backproject(depth_m)
        if self.floor is None:
            return np.asarray((depth_m > 0) & (np.linalg.norm(points - self.center, axis=-1) < self.radius_m))
        local = self._local(points)
        beside_m = np.linalg.norm(local[..., :2] - self.center[:2], axis=-1)
        clear_m = np.maximum(CLEAR_SIGMAS * depth_sigma_m(depth_m), CLEAR_M)
        return np.asarray((depth_m > 0) & (beside_m < self.radius_m) & (local[..., 2] > clear_m))

    def lowest_m(self, depth_m: Float32, camera: Camera) -> float:
        """Return the turning object's lowest visible height above the floor, metres; infinite if not seen."""
        heights_m = self._local(camera.backproject(depth_m))[self.mask(depth_m, camera), 2]
        return float(np.quantile(heights_m, LOWEST_SHARE)) if len(heights_m) else np.inf

    def _local(self, points: Float64) -> Float64:
        T_floor_camera = np.eye(4) if self.floor is None else self.floor.T_floor_world
        return transform_points(T_floor_camera, points.reshape(-1, 3)).reshape(points.shape)


def turntable_masks(sequence: Sequence) -> Masks:
    """Masks of the turning object: a function from a frame's index to (height, width) bool.

    Raises:
        SegmentationError: the camera does not stand still, nothing turns in front of it, or what turns stands
            on no plane in view.
    """
    turntable = find_turntable(sequence)
    return lambda index: turntable.mask(sequence.depth_m(index), sequence.camera)


def plane_below(sequence: Sequence, trajectory: Trajectory) -> Float64 | None:
    """Return the plane (4,) that the object turns on, its normal up, in the object's own frame.

    That frame is the trajectory's world. The plane does not move relative to the camera. Each pose of the
    camera, which stands still, transforms it to the object's frame, where the results agree up to noise:
    their mean normal and median distance are used. The result is None if no plane is in view.

    Raises:
        SegmentationError: as `turntable_masks`.
    """
    floor = find_turntable(sequence).floor
    if floor is None:
        return None
    T_world_camera = trajectory.T_world_camera[trajectory.good_frames]
    normal = (T_world_camera[:, :3, :3] @ floor.plane_world[:3]).mean(axis=0)
    normal /= np.linalg.norm(normal)
    # The plane's point below the camera, in the camera's axes.
    foot = -floor.plane_world[3] * floor.plane_world[:3]
    feet = T_world_camera[:, :3, :3] @ foot + T_world_camera[:, :3, 3]
    return np.append(normal, -float(np.median(feet @ normal)))


def find_turntable(sequence: Sequence) -> Turntable:
    """Find the space of the object that turns in front of a still camera, from some of the frames.

    Moving points are those that pass in front of a still background. The floor is a plane of the background,
    which `find_floor` finds for one camera, or the top of a plate on it. The space is an upright cylinder on
    the floor around all moving points. If nothing else is around the object, it is a ball around them.

    Raises:
        SegmentationError: as `turntable_masks`.
    """
    depths_m, step, watched = watch_some(sequence)
    if watched is None or not watched.something_moves:
        raise SegmentationError(MOVES.format(what="nothing moves before it"), what="no-turntable")
    if not (watched.camera_still or watched.plain):
        raise SegmentationError(MOVES.format(what="the camera moves"), what="no-turntable")
    camera = sequence.camera.every(step)
    before = [_before(depth_m, watched) for depth_m in depths_m]
    moving = _largest(
        np.concatenate(
            [camera.backproject(np.where(b, d, 0))[b] for b, d in zip(before, depths_m, strict=True)]
        )
    )
    if not len(moving):
        raise SegmentationError(MOVES.format(what="nothing moves before it"), what="no-turntable")
    if watched.plain:
        center = np.median(moving, axis=0)
        radius_m = float(np.linalg.norm(moving - center, axis=1).max())
        return Turntable(None, center, WIDER * radius_m + MARGIN_M)
    turntable = _on_floor(watched, camera, moving)
    if np.median([turntable.lowest_m(depth_m, camera) for depth_m in depths_m]) > HANGS_M:
        raise SegmentationError(MOVES.format(what="what moves hangs in the air"), what="no-turntable")
    return turntable


def _on_floor(watched: Watched, camera: Camera, moving: Float64) -> Turntable:
    """Return the cylinder around the moving points (n, 3), on the floor or on a plate."""
    floor = _floor(watched, camera, moving)
    if floor is None:
        raise SegmentationError(
            MOVES.format(what="no plane that it stands on was found around it"), what="no-turntable"
        )
    local = transform_points(floor.T_floor_world, moving)
    ground = local[local[:, 2] > CLEAR_M, :2]
    (x, y), radius_m = cv2.minEnclosingCircle(ground.astype(np.float32))
    top_m = _plate_m(floor, watched, camera, local, np.array([x, y]), radius_m)
    plane_world = floor.plane_world - np.array([0, 0, 0, top_m])
    top = replace(floor, plane_world=plane_world, T_floor_world=floor_frame(plane_world))
    return Turntable(top, np.array([x, y, 0.0]), WIDER * radius_m + MARGIN_M)


def _plate_m(
    floor: Floor, watched: Watched, camera: Camera, moving_floor: Float64, center: Float64, radius_m: float
) -> float:
    """Return the height of the turning object's support above the plane `floor`, metres.

    The support is the top of a round plate: level surface that looks still, with nothing moving below it.
    Without a plate it is the floor, but measured again near the object: a plane fitted to the floor and a low
    plate together may pass below the object. `moving_floor` (n, 3) are the moving points, and `center` (2,)
    is their middle, both in the floor frame.
    """
    lowest_m = float(np.quantile(moving_floor[:, 2], LOWEST_SHARE))
    surface = camera.backproject(watched.still_m)
    level = image_normals(surface, watched.still_m, NORMAL_REACH_PX) @ floor.plane_world[:3] > LEVEL_COSINE
    points = transform_points(floor.T_floor_world, surface[level])
    near = np.linalg.norm(points[:, :2] - center, axis=1) < PLATE_RATIO * radius_m
    heights_m = points[near & (np.abs(points[:, 2]) < max(lowest_m, 0) + CLEAR_M), 2]
    if len(heights_m) < MIN_PLATE_POINTS:
        return 0.0
    # Most of the level surface there is the plate's top, or else the floor.
    bins = np.arange(heights_m.min(), heights_m.max() + CLEAR_M, CLEAR_M / 2)
    counts, edges = np.histogram(heights_m, bins)
    top_m = float(edges[np.argmax(counts)]) + CLEAR_M / 4
    on_top = np.abs(heights_m - top_m) < CLEAR_M / 2
    return float(np.median(heights_m[on_top])) if on_top.sum() >= MIN_PLATE_POINTS else 0.0


def _before(depth_m: Float32, watched: Watched) -> Bools:
    """Pixels of a frame, (height, width), that are clearly nearer than the still surface behind them."""
    behind_m = watched.behind_m
    far_m = np.where(np.isfinite(behind_m), behind_m, 0)
    nearer = depth_m < behind_m - np.maximum(NEARER_SIGMAS * depth_sigma_m(far_m), NEARER_M)
    return np.asarray((depth_m > 0) & nearer & watched.moving)


def _largest(points: Float64) -> Float64:
    """Return the largest connected part of points (n, 3), without sparse points at edges and occlusions."""
    if not len(points):
        return points
    cells = np.floor(points / MOVING_CELL_M).astype(np.int64)
    _, cell, counts = np.unique(cell_numbers(cells), return_inverse=True, return_counts=True)
    points = points[counts[cell.reshape(-1)] >= MIN_POINTS]
    if not len(points):
        return points
    label = connected(points, MOVING_CELL_M)
    return np.asarray(points[label == np.argmax(np.bincount(label))])


def _floor(watched: Watched, camera: Camera, moving: Float64) -> Floor | None:
    """Return the plane below the moving points (n, 3); None if none exists, or they do not rise above it."""
    surface = camera.backproject(watched.still_m)
    normals = image_normals(surface, watched.still_m, NORMAL_REACH_PX)
    chosen = np.isfinite(normals).all(axis=-1)
    if chosen.sum() < MIN_PLANE_POINTS:
        return None
    focus = np.median(moving, axis=0)
    try:
        floor = find_floor(surface[chosen], normals[chosen], np.eye(4)[None], focus, 0)
    except SegmentationError:
        return None
    heights_m = transform_points(floor.T_floor_world, moving)[:, 2]
    stands = (heights_m > 0).mean() >= ABOVE_SHARE and heights_m.max() > CLEAR_M
    return floor if stands else None


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
    near = distance_scale(T_world_camera, hint.focus_world(T_world_camera))
    cell_m = CELL_M * cell_scale(near, spacing_m(mesh), CELL_M)
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
        tilt_rad = turn_rad(hint.plane_world, up_or_held(T_world_camera, hint.up_world))
        frame = floor_frame(hint.plane_world)
        return Floor(hint.plane_world, frame, 0.0, 0.0, tilt_rad, scale=scale, given=True, against=against)
    return level_floor(points_world, T_world_camera, hint.up_world, scale, BELOW_M * scale)
