"""Coverage of a trajectory: the point that the cameras look at, the arc around it, and covisibility."""

from collections.abc import Iterable

import numpy as np

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import invert_rigid, rotation_angle_rad, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Bools, Float32, Float64, Int64

# Distance of the focus where optical axes never meet: about that of recording furniture. Chosen by hand.
TYPICAL_DISTANCE_M = 1.5
# Up vectors with a mean shorter than this have no common direction.
MIN_UPRIGHT = 0.1
# Large enough for a few cameras side by side, whose rows do not determine up; small enough to find 119 of 120
# degrees.
LEAN_WEIGHT = 0.01
# Above this cosine a camera looks straight up or down.
NEARLY_ALONG = 0.95
# A camera counts as looking at a point that lies within this angle of its axis.
LOOKING_AT_RAD = np.pi / 4
# The axes meet by chance under two conditions: the meeting point is nearer or farther than the depth in the
# middle of the images by more than this factor, and the axes turn by less than this ratio of the cameras' arc
# around it. A camera that walks around an object turns as far as its arc, even if it sees the wall beside it.
# Measured: the factor is 0.9 to 1.3 in three recordings around an object, and 1/12 for a sweep over a desk.
# The sweep turns by 0.12 of the arc, the others by 0.98 and 2.5.
MEETS_BY_CHANCE = 2.0
LEAST_TURN_SHARE = 0.75
# Number of frames, and pixel stride, for the median depth in the middle of the images.
MIDDLE_FRAMES, MIDDLE_STEP_PX = 40, 4
# Depth is reduced to about this many columns; every eighth pixel of it becomes a test point.
DEPTH_COLUMNS = 160
POINT_STEP = 8
# A point is seen if the depth agrees within this ratio: coarse, because the grid is coarse and poses have
# errors.
SEEN_SHARE_OF_DEPTH = 0.05
# Between consecutive frames the view changes by less than this ratio of the change between distant frames.
# Measured: 0.01 to 0.15 for walks, even with a view every 15 degrees; 1 for views in no order.
STEP_SHARE = 0.5
# Views closer than this (1 m of distance counts as 1 rad of rotation) are always consecutive: the steps of a
# still camera are as large as its whole path. Chosen by hand.
NEAR = 0.1
# With fewer poses the median step is unreliable.
FEWEST = 6


def convergence_point(T_world_camera: Float64) -> Float64:
    """Return the point (3,) nearest to the optical axes of poses (n, 4, 4), n > 0, by least squares.

    Nearly parallel axes do not determine the distance, so a weak prior pulls the point towards 1.5 m ahead.
    If diverging axes meet behind most cameras, the result is the mean of the points 1.5 m ahead.
    """
    axes, positions = T_world_camera[:, :3, 2], T_world_camera[:, :3, 3]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    weak = 1e-3 * len(axes)
    ahead = (positions + TYPICAL_DISTANCE_M * axes).mean(axis=0)
    normal_matrix = across.sum(axis=0) + weak * np.eye(3)
    nearest = np.linalg.solve(
        normal_matrix, (across @ positions[:, :, None]).sum(axis=0)[:, 0] + weak * ahead
    )
    in_front = ((nearest - positions) * axes).sum(axis=1) > 0
    return nearest if in_front.mean() > 0.5 else ahead


def from_above(T_world_camera: Float64) -> Float64:
    """Rotation R_above_world (3, 3) to an upright frame: z up, y along the first camera's viewing direction.

    Up is close to the mean up vector of the cameras, and as perpendicular as possible to their image rows:
    cameras that look down at an object are pitched forward, but not rolled.

    Args:
        T_world_camera: (n, 4, 4), n > 0.
    """
    first, rows = T_world_camera[0, :3, :3], T_world_camera[:, :3, 0]
    upper = -T_world_camera[:, :3, 1].mean(axis=0)
    if np.linalg.norm(upper) < MIN_UPRIGHT:
        upper = -first[:, 1]
    square = rows.T @ rows / len(rows) - LEAN_WEIGHT * np.outer(upper, upper)
    up = np.linalg.eigh(square)[1][:, 0]
    up = up if up @ upper > 0 else -up
    # If the camera looks straight down, the viewing direction from above is its up vector.
    ahead = first[:, 2] if abs(first[:, 2] @ up) < NEARLY_ALONG else -first[:, 1]
    right = np.cross(ahead, up)
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(up, right), up])


def median_middle_depth_m(sequence: Sequence, frames: Int64) -> float | None:
    """Return the median depth in the middle third of up to 40 of the frames (n,), metres; None if none."""
    some = frames[evenly(len(frames), MIDDLE_FRAMES)]
    return middle_depth_m(sequence.depths_m(some, MIDDLE_STEP_PX))


def middle_depth_m(depths_m: Iterable[Float32]) -> float | None:
    """Median depth, m, in the middle third of images (height, width), 0 = none; None if none is there."""
    middles_m: list[float] = []
    for depth_m in depths_m:
        height, width = depth_m.shape
        middle_m = depth_m[height // 3 : height - height // 3, width // 3 : width - width // 3]
        if (middle_m > 0).any():
            middles_m.append(float(np.median(middle_m[middle_m > 0])))
    return float(np.median(middles_m)) if middles_m else None


def looked_at(T_world_camera: Float64, depth_m: float | None) -> Float64:
    """Return the point (3,) where the cameras' axes meet, or the mean point ahead if they meet by chance.

    The axes of a camera that hardly turns may cross anywhere, even in empty space close to it. Then the
    result is the mean of the points ahead of each camera, at the median depth in the middle of the images. If
    the axes turn as far as the cameras' arc around the meeting point, they do not meet by chance, even if
    depth disagrees: with a slender object, or one with gaps, the middle of most images shows the wall.

    Args:
        T_world_camera: (n, 4, 4), n > 0.
        depth_m: median depth in the middle of their images (`middle_depth_m`), metres; None: unknown.
    """
    point, positions = convergence_point(T_world_camera), T_world_camera[:, :3, 3]
    if depth_m is None:
        return point
    far_m = float(np.median(np.linalg.norm(point - positions, axis=1)))
    if depth_m / MEETS_BY_CHANCE <= far_m <= depth_m * MEETS_BY_CHANCE:
        return point
    looking, axes = _looking_at(point, T_world_camera), T_world_camera[:, :3, 2]
    if looking.any():
        turned_rad, around_rad = (
            _arc_rad(towards[looking], T_world_camera) for towards in (axes, point - positions)
        )
        if turned_rad >= LEAST_TURN_SHARE * around_rad:
            return point
    ahead: Float64 = (positions + depth_m * axes).mean(axis=0)
    return ahead


def covered_arc_rad(T_world_camera: Float64, depth_m: float | None) -> float | None:
    """Return the arc of directions, from above, from which the cameras look at one point.

    The directions are projected onto the horizontal plane. The arc is the full circle minus the largest gap
    between two of them.

    Args:
        T_world_camera: (n, 4, 4), finite, any n.
        depth_m: median depth in the middle of their images (`middle_depth_m`), metres; None: unknown. It
            helps to find the point.

    Returns:
        Radians, 0 to 2 pi. None if there is no camera, or if fewer than half of them have the point within 45
        degrees of their axis, as in a panorama of a room.
    """
    if not len(T_world_camera):
        return None
    point = looked_at(T_world_camera, depth_m)
    looking = _looking_at(point, T_world_camera)
    if 2 * looking.sum() < len(T_world_camera):
        return None
    return _arc_rad(point - T_world_camera[looking, :3, 3], T_world_camera)


def _looking_at(point: Float64, T_world_camera: Float64) -> Bools:
    """Whether each camera (n,) has a world point (3,) within 45 degrees of its axis."""
    towards = point - T_world_camera[:, :3, 3]
    ahead_m = (towards * T_world_camera[:, :3, 2]).sum(axis=1)
    return np.asarray(ahead_m > np.cos(LOOKING_AT_RAD) * np.linalg.norm(towards, axis=1))


def _arc_rad(directions_world: Float64, T_world_camera: Float64) -> float:
    """Arc that directions (m, 3), m > 0, cover from above: the full circle minus the largest gap, radians."""
    right, forward, _ = from_above(T_world_camera) @ directions_world.T
    angles = np.sort(np.arctan2(forward, right))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    return float(2 * np.pi - gaps.max())


def covisibility(sequence: Sequence, T_world_camera: Float64, frames: Int64) -> Float64:
    """Compute, for each pair of frames, the ratio of the points of one frame that the other frame sees.

    The points are computed from depth and poses. A frame sees a point if the depth at the point's pixel
    agrees with the point within 5 %.

    Args:
        sequence: the recording.
        T_world_camera: (n, 4, 4) of all its frames.
        frames: (k,) indices of frames that have a pose.

    Returns:
        (k, k): [i, j] is the ratio of the points of frame i that frame j sees; 0 for frames without depth.
    """
    step = max(1, round(sequence.camera.width / DEPTH_COLUMNS))
    depths_m = [sequence.depth_m(int(f))[::step, ::step] for f in frames]
    rays = sequence.camera.rays()[::step, ::step][::POINT_STEP, ::POINT_STEP]
    points_world, owners = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for k, (frame, depth_m) in enumerate(zip(frames, depths_m, strict=True)):
        coarse_m = depth_m[::POINT_STEP, ::POINT_STEP]
        points = (rays * coarse_m[..., None])[coarse_m > 0]
        points_world.append(transform_points(T_world_camera[frame], points))
        owners.append(np.full(len(points), k))
    points, owner = np.concatenate(points_world), np.concatenate(owners)
    shares = np.zeros((len(frames), len(frames)))
    counts = np.maximum(np.bincount(owner, minlength=len(frames)), 1)
    for k, (frame, depth_m) in enumerate(zip(frames, depths_m, strict=True)):
        seen = _seen(transform_points(invert_rigid(T_world_camera[frame]), points), depth_m, sequence, step)
        shares[:, k] = np.bincount(owner[seen], minlength=len(frames)) / counts
    return shares


def _seen(points_camera: Float64, depth_m: Float32, sequence: Sequence, step: int) -> Bools:
    """Whether each point (m, 3) agrees with a depth image of every `step`-th pixel: (m,) bool."""
    height, width = depth_m.shape
    before = points_camera[:, 2] > 0
    pixels = np.full((len(points_camera), 2), -1.0)
    pixels[before] = sequence.camera.project(points_camera[before]) / step
    # Clip first, because pixels far outside would overflow integers.
    u, v = np.rint(np.clip(pixels, -1, [width, height])).astype(np.int64).T
    inside = before & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    seen = np.zeros(len(points_camera), dtype=bool)
    measured_m, expected_m = depth_m[v[inside], u[inside]], points_camera[inside, 2]
    seen[inside] = (measured_m > 0) & (np.abs(measured_m - expected_m) < SEEN_SHARE_OF_DEPTH * expected_m)
    return seen


def in_order_of_time(T_world_camera: Float64) -> bool:
    """Whether consecutive poses (n, 4, 4), NaN where there is none, show similar views, as in a video.

    Renderings and sets of views often have exact poses in no order, so a frame does not predict the next one.
    Fewer than 6 poses count as a video.
    """
    T = T_world_camera[np.isfinite(T_world_camera[:, 0, 0])]
    if len(T) < FEWEST:
        return True
    step = float(np.median(_views_apart(T[:-1], T[1:])))
    far = np.concatenate([_views_apart(T, np.roll(T, len(T) // k, axis=0)) for k in (2, 3, 5)])
    return step < max(NEAR, STEP_SHARE * float(np.median(far)))


def _views_apart(T_a: Float64, T_b: Float64) -> Float64:
    """Distance (n,) between views (n, 4, 4): metres between the cameras plus radians of rotation."""
    apart_m = np.linalg.norm(T_a[:, :3, 3] - T_b[:, :3, 3], axis=1)
    turn_rad = rotation_angle_rad(np.swapaxes(T_a[:, :3, :3], 1, 2) @ T_b[:, :3, :3])
    return np.asarray(apart_m + turn_rad)
