"""Find the floor in the frames themselves, before fusion; a build compares it with the floor of the scene."""

from collections.abc import Sequence as Rows

import numpy as np

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import Camera, image_normals, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float32, Float64
from kinectbench.core.voxels.point_cells import thinned
from kinectbench.stages.fuse.depth_range import some_frames
from kinectbench.stages.segment.find.floor import Floor, find_floor
from kinectbench.stages.segment.find.hints import FloorHint, distance_scale
from kinectbench.stages.segment.find.pieces import CELL_M

# Images about this wide, and a stride of this many pixels, save time (chosen by hand).
COLUMNS, STEP_PX = 160, 4
# No plane is looked for in fewer points (chosen by hand).
MIN_POINTS = 200
# The fused scene and its frames have one floor if their planes differ by less than this angle, and by less
# than this share of the cameras' distance where the cameras look (chosen by hand; on six recordings .02 to
# .43 degrees, and .0012 of that distance at most).
SAME_DEG, SAME_SHARE = 5.0, 0.05
OTHER_FLOOR = (
    "the plane that was taken for the floor is not the one that the frames show by themselves: it is turned "
    "by {turn_deg:.0f} degrees against it, and {apart_m:.2f} m away where the cameras look; see the scene "
    "and give its plane: `floor: {{plane_world: [a, b, c, d]}}`"
)


def oriented(depth_m: Float32, camera: Camera) -> tuple[Float64, Float64]:
    """Return points and unit normals towards the camera, (n, 3) each, of every fourth row and column.

    Args:
        depth_m: (height, width) metres, 0 = none.
        camera: of the image; the points are in its axes.
    """
    surface = camera.backproject(depth_m)
    normals = image_normals(surface, depth_m, reach_px=2)
    chosen = np.isfinite(normals).all(axis=-1) & (depth_m > 0)
    keep = np.zeros_like(chosen)
    keep[::STEP_PX, ::STEP_PX] = chosen[::STEP_PX, ::STEP_PX]
    return surface[keep], normals[keep]


def floor_of_frames(
    depths_m: Rows[Float32], camera: Camera, T_world_camera: Float64, hint: FloorHint
) -> tuple[Floor, list[Float64]]:
    """Find the common floor of some frames, as in a fused scene.

    Args:
        depths_m: (height, width) each, metres, 0 = none.
        camera: of the images.
        T_world_camera: (n, 4, 4) their poses.
        hint: known facts about the floor.

    Returns:
        The floor, and the points (k, 3) of each frame, world frame.

    Raises:
        SegmentationError: there is no floor, or hardly any depth.
    """
    clouds, normals = [], []
    for depth_m, T in zip(depths_m, T_world_camera, strict=True):
        points, toward = oriented(depth_m, camera)
        clouds.append(transform_points(T, points))
        normals.append(toward @ T[:3, :3].T)
    focus_world = hint.focus_world(T_world_camera)
    cell_m = CELL_M * distance_scale(T_world_camera, focus_world)
    surface = thinned(np.concatenate(clouds), np.concatenate(normals), cell_m)
    if len(surface.points) < MIN_POINTS:
        raise SegmentationError("the frames hardly show any surface", what="no-floor")
    floor = find_floor(surface.points, surface.normals, T_world_camera, focus_world, 0, hint)
    return floor, clouds


def other_floor(
    floor: Floor, sequence: Sequence, trajectory: Trajectory, hint: FloorHint, max_depth_m: float
) -> tuple[str, ...]:
    """Return a warning if single frames show another floor than the fused scene; else none.

    Depth beyond `max_depth_m` is ignored. A given plane is not compared here: `find_floor` judges it.
    """
    frames = trajectory.good_frames
    if hint.plane_world is not None or not floor.found or len(frames) < 2:
        return ()
    frames = some_frames(frames)
    step = max(1, round(sequence.camera.width / COLUMNS))
    depths_m = sequence.depths_m(frames, step)
    near_m = [np.where(depth_m <= max_depth_m, depth_m, np.float32(0)) for depth_m in depths_m]
    T_world_camera = trajectory.T_world_camera[frames]
    try:
        seen, _ = floor_of_frames(near_m, sequence.camera.every(step), T_world_camera, hint)
    except SegmentationError:
        return ()
    focus = np.append(hint.focus_world(T_world_camera), 1.0)
    far_m = float(np.median(np.linalg.norm(T_world_camera[:, :3, 3] - focus[:3], axis=1)))
    cosine = np.clip(seen.plane_world[:3] @ floor.plane_world[:3], -1, 1)
    turn_deg = float(np.degrees(np.arccos(cosine)))
    apart_m = abs(float((seen.plane_world - floor.plane_world) @ focus))
    if turn_deg < SAME_DEG and apart_m < SAME_SHARE * far_m:
        return ()
    return (OTHER_FLOOR.format(turn_deg=turn_deg, apart_m=apart_m),)
