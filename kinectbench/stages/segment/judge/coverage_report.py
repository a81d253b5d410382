"""Report faults of the recording: unseen sides, few frames, motion in the scene."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from kinectbench.core.artefacts.object import MAX_OFF_SHARE, MovingPart, UnseenSidePart
from kinectbench.core.geometry import (
    DepthRenderer,
    Grid,
    OrientedBox,
    TriangleMesh,
    depth_sigma_m,
    invert_rigid,
    transform_points,
)
from kinectbench.core.sensor_limits import DEFAULT_LIMITS, SensorLimits
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.core.voxels.point_cells import spacing_m
from kinectbench.stages.fuse.depth_range import some_frames
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.object import Segmentation
from kinectbench.stages.segment.find.planes import GIVEN
from kinectbench.stages.segment.judge.depth_bias import inverse_depth_steps, is_of_kinect
from kinectbench.stages.segment.judge.frontiers import MOVE_AWAY, is_obstructed, turn_in_words

# Images are looked at in about this many columns: a person who walks by is many of them wide.
COLUMNS = 160
# A pixel moves if it is nearer than the scene by both; a frame, if this share of it does.
NEARER_M, NEARER_SIGMAS, MOVING_SHARE = 0.1, 5.0, 0.02
# Depth on the object contradicts its surface if it lies off it by both, metres and spacings of the scene's
# mesh, and by as many sigmas. In such patches objects have hardly any (`MAX_OFF_SHARE`). A mesh in voxels of
# 20 mm wears thin parts away: its spacing is 28 mm, of the default ones 11 to 15 mm.
OFF_M, OFF_SPACINGS = 0.02, 1.4
# Speckle and edges are thinner than this many of the pixels looked at.
THICK_PX = 3
# A Kinect measures surfaces up to about this slant: a camera sees an upright side from this far around.
SEEN_WITHIN_RAD = np.radians(75.0)
# Fewer good frames leave most of the noise in the surface, and sides unseen. Chosen by hand.
MIN_FRAMES = 10
# Real floors scatter by up to 6 mm; a surface that scatters by 20 mm is not taken for a plane.
MAX_FLOOR_NOISE_M = 0.010
# This share of the depth around the object may be dropped: a corner of the grid (chosen by hand).
MAX_BEYOND_SHARE = 0.01
# What to do about poses that are not good, by where they are from, if nothing else is recommended.
_AGAIN = "record again, slowly, with edges and corners in view, and end where it began"
REMEDIES: Mapping[str, str] = {
    "trust": "if odd and even frames agree better with `trajectory: refine`, take that",
    "refine": f"if odd and even frames agree better with `trajectory: ignore`, take that, or else {_AGAIN}",
    "tracked": _AGAIN,
}


def frames_against_scene(
    sequence: Sequence, trajectory: Trajectory, scene: TriangleMesh, floor: Floor, box: OrientedBox
) -> tuple[MovingPart, float | None]:
    """Compare at most 40 good frames with the fused scene; find what moves and what contradicts the object.

    The pixels are sampled in about 160 columns. One moves if it is nearer than the scene by more than max(5
    sigma, 0.1 m), lies more than 0.1 m above the floor (which is measured badly at a grazing angle), and is
    in a patch at least three sampled pixels wide; a frame, if 2 % of its pixels do. What moves leaves no
    surface in the fused scene, because other frames saw through it.

    One contradicts the object's surface if it lies behind it (a surface in `box`) or, where nothing moves,
    before it (as a point in `box`) by more than max(5 sigma, 20 mm, 1.4 spacings of the scene's mesh), and 20
    mm (times `floor.scale`) above the floor, in such a patch, too. The distance is that from the plane of the
    face: along a ray that grazes a face, noise and a pose that is off by millimetres reach centimetres.
    Hardly any does unless the object was moved or changed, or poses, intrinsics or depth are wrong.

    Returns:
        The frames in which something moves; and the share of the depth on the object that contradicts it, to
        four digits, or None if there is no depth on it.
    """
    good = trajectory.good_frames
    judged = some_frames(good)
    step_px = max(1, round(sequence.camera.width / COLUMNS))
    camera = sequence.camera.every(step_px)
    rays, renderer = camera.rays(), DepthRenderer(scene)
    shares, on, off, least_m = list[float](), 0, 0, max(OFF_M, OFF_SPACINGS * spacing_m(scene))
    for frame, measured_m in zip(judged, sequence.depths_m(judged, step_px), strict=True):
        T_world_camera = trajectory.T_world_camera[frame]
        heights_m = floor.heights_m(measured_m, camera, T_world_camera)
        scene_m, lift = renderer.depth_and_lift(camera, T_world_camera)
        both, sigmas_m = (measured_m > 0) & (scene_m > 0), NEARER_SIGMAS * depth_sigma_m(scene_m)
        nearer = both & (scene_m - measured_m > np.maximum(sigmas_m, NEARER_M))
        shares.append(float(_patches(nearer & (heights_m > NEARER_M)).mean()))
        T_floor_camera, off_m = floor.T_floor_world @ T_world_camera, np.maximum(sigmas_m, least_m)
        seen, there = (
            both & _clear_in(box, transform_points(T_floor_camera, rays * depth_m[..., None]), floor)
            for depth_m in (measured_m, scene_m)
        )
        if shares[-1] > MOVING_SHARE:  # somebody walks through: that leaves no surface
            seen = there
        else:
            off += int(_patches(seen & ((scene_m - measured_m) * lift > off_m)).sum())
        off += int(_patches(there & ((measured_m - scene_m) * lift > off_m)).sum())
        on += int((seen | there).sum())
    moving: Int64 = judged[np.array(shares) > MOVING_SHARE]
    part = MovingPart(judged=len(judged), frames=tuple(moving.tolist()), largest_share=round(max(shares), 4))
    return part, round(off / on, 4) if on else None


def _clear_in(box: OrientedBox, points: Float64, floor: Floor) -> Bools:
    """Return which points (height, width, 3), floor frame, lie in a box, and clearly above the floor."""
    inside = box.contains(points.reshape(-1, 3)).reshape(points.shape[:-1])
    return np.asarray(inside & (points[..., 2] > OFF_M * floor.scale))


def _patches(pixels: Bools) -> Bools:
    """Return the pixels (height, width) in patches of three by three: edges and speckle are thinner."""
    kernel = np.ones((THICK_PX, THICK_PX), np.uint8)
    return np.asarray(cv2.morphologyEx(pixels.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0)


def beyond_depth_share(sequence: Sequence, trajectory: Trajectory, grid: Grid, max_depth_m: float) -> float:
    """Return the share of the depth in the object's grid that lies beyond `max_depth_m` and is not fused.

    At most 40 good frames are used, subsampled to about 160 columns of pixels, with rows as far apart.
    """
    step_px = max(1, round(sequence.camera.width / COLUMNS))
    rays = sequence.camera.every(step_px).rays()
    inside, beyond = 0, 0
    some = some_frames(trajectory.good_frames)
    for frame, depth_m in zip(some, sequence.depths_m(some, step_px), strict=True):
        T_grid_camera = invert_rigid(grid.T_world_grid) @ trajectory.T_world_camera[frame]
        points = transform_points(T_grid_camera, rays[depth_m > 0] * depth_m[depth_m > 0, None])
        within = ((points >= 0) & (points <= grid.size_m)).all(axis=1)
        inside += int(within.sum())
        beyond += int((within & (depth_m[depth_m > 0] > max_depth_m)).sum())
    return beyond / max(inside, 1)


@dataclass(frozen=True)
class CoverageReport:
    """The part of quality.json about the recording, with a warning for each fault.

    Attributes:
        good_frames: number of good frames.
        unseen_side: the widest range of directions from which no camera looked at the object.
        moving: the frames in which something moves.
        max_depth_m: depth up to this is fused, metres.
        beyond_share: share of the depth near the object that lies beyond `max_depth_m`.
        off_share: share of the depth on the object that contradicts its surface.
        inverse_depth_steps: steps of inverse depth, 1/m; None: there is too little depth to tell.
        of_kinect: whether the depth is a Kinect v1's, by these steps.
        warnings: all warnings, one line each.
        choice_warnings: those about the floor and the choice of the object; `doubts` in quality.json.
        first_rad: direction from the object to the first camera, seen from above, radians, counterclockwise
            from x of the floor frame.
    """

    good_frames: int
    unseen_side: UnseenSidePart
    moving: MovingPart
    max_depth_m: float
    beyond_share: float
    off_share: float | None
    inverse_depth_steps: float | None
    of_kinect: bool
    warnings: tuple[str, ...]
    choice_warnings: tuple[str, ...]
    first_rad: float = 0.0


def unseen_side(T_floor_camera: Float64, center_floor: Float64) -> tuple[float, float, float]:
    """Find the widest gap between the cameras (n, 4, 4), n > 0, around a centre (3,), seen from above.

    A side within 75 degrees of a camera's direction is seen: a gap of 150 degrees hides nothing upright.

    Returns:
        Width of the gap, radians, 0 to 2 pi; direction of its middle, radians, counter-clockwise from the
        floor's x axis; and the share of all directions for which no camera saw an upright side that faces
        that way.
    """
    x, y, _ = (T_floor_camera[:, :3, 3] - center_floor).T
    angles = np.sort(np.arctan2(y, x))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    widest = int(np.argmax(gaps))
    gap_rad = float(gaps[widest])
    towards_rad = float(np.angle(np.exp(1j * (angles[widest] + gap_rad / 2))))
    return gap_rad, towards_rad, max(0.0, gap_rad - 2 * SEEN_WITHIN_RAD) / (2 * np.pi)


def _of_trajectory(trajectory: Trajectory) -> list[str]:
    """Return a warning if the trajectory is graded "not good": the shape cannot be better than the poses.

    It names a remedy that differs from the settings.
    """
    health = trajectory.health
    if health is None or health.grade != "not good":
        return []
    better = health.recommended
    if better not in (None, trajectory.source):
        line = f"write `trajectory: {better}` below its `id` in benchmark.yaml"
        return [f"the trajectory is {health.verdict}; {line}"]
    return [f"the trajectory is {health.verdict}; {REMEDIES[trajectory.source]}"]


def _of_floor(floor: Floor) -> list[str]:
    """Return a warning if the floor is hardly flat: it may be another surface."""
    if not floor.found or floor.noise_m <= MAX_FLOOR_NOISE_M:
        return []
    if floor.given:
        # Where other warnings speak against the plane, the surface beside it scatters.
        scatter = f"scatters by {1000 * floor.noise_m:.0f} mm, a flat floor by 1 to 6"
        what = f"what was measured about {GIVEN} {scatter}"
        return [] if floor.against else [f"{what}; check that the object stands on that plane"]
    return [
        f"the floor found scatters by {1000 * floor.noise_m:.0f} mm, a flat one by 1 to 6: it may be another "
        "surface; record with more of the floor in view, or give a box"
    ]


def _of_side(
    chosen: Segmentation, towards_rad: float, hidden_share: float, first_rad: float, limits: SensorLimits
) -> list[str]:
    """Return a warning if no frame looks at a side; arguments as returned by `unseen_side`."""
    if hidden_share <= 0:
        return []
    towards, show = np.array([np.cos(towards_rad), np.sin(towards_rad), 0.0]), "show it to the camera, too"
    obstructed = is_obstructed(chosen, np.array(chosen.box.center_m), towards, limits)
    return [
        f"no frame looks at the object's side {turn_in_words(towards_rad, first_rad)}, over "
        f"{360 * hidden_share:.0f} degrees of arc: what is there is inferred; "
        + (f"{MOVE_AWAY} {show}" if obstructed else show)
    ]


def _of_frames(good: int, moving: MovingPart) -> list[str]:
    """Return a warning if there are few good frames, and one if something moves in some of them."""
    few = f"made from {good} frames only: too few to average the noise; record more"
    lines = [few] if good < MIN_FRAMES else []
    if moving.frames:
        lines.append(
            f"in {len(moving.frames)} of {moving.judged} frames looked at (such as {moving.frames[0]}) "
            "something stands before the scene that the others do not see: a person walking through, or "
            "poses that are off? record it without, and look at the trajectory"
        )
    return lines


def _of_range(too_far: float, max_depth_m: float, is_set: bool) -> list[str]:
    """Return a warning if too large a share of the depth is beyond the range; `is_set`: by the user."""
    if too_far <= MAX_BEYOND_SHARE:
        return []
    remedy = "raise `fusion.max_depth_m`, or leave it out" if is_set else "record from nearer"
    return [
        f"{too_far:.0%} of the depth around the object lies beyond {max_depth_m:g} m and makes no surface: "
        f"its far side and cavities may be wrong; {remedy}"
    ]


def _of_contradictions(off_share: float | None) -> list[str]:
    """Return a warning if too much of the depth on the object contradicts its surface."""
    if off_share is None or off_share <= MAX_OFF_SHARE:
        return []
    return [
        f"{off_share:.2%} of the depth on the object lies 2 cm and more off its surface, whose shape is "
        "wrong there: the object was moved or changed, or poses, intrinsics or depth are wrong; look at "
        "object/mesh.ply, and record it again, or correct them"
    ]


def coverage_report(
    sequence: Sequence,
    trajectory: Trajectory,
    scene: TriangleMesh,
    chosen: Segmentation,
    grid: Grid,
    max_depth_m: float,
    limits: SensorLimits = DEFAULT_LIMITS,
    *,
    range_is_set: bool = True,
) -> CoverageReport:
    """Measure how well a recording shows its object, with a warning for each fault.

    Faults are a trajectory graded "not good", depth that contradicts the object, a side that no frame looks
    at, few frames, something that moves, depth near the object beyond `max_depth_m`, up to which it is fused,
    and signs of a wrongly chosen floor or object. The trajectory has at least one good frame, the scene is in
    the world frame, and `range_is_set` is whether `max_depth_m` is the user's setting.
    """
    good = trajectory.good_frames
    T_floor_camera = chosen.floor.T_floor_world @ trajectory.T_world_camera[good]
    center = np.array(chosen.box.center_m)
    first_rad = float(np.arctan2(*(T_floor_camera[0, :2, 3] - center[:2])[::-1]))
    gap_rad, towards_rad, hidden_share = unseen_side(T_floor_camera, center)
    moving, off_share = frames_against_scene(sequence, trajectory, scene, chosen.floor, chosen.box)
    too_far = beyond_depth_share(sequence, trajectory, grid, max_depth_m)
    of_choice = (*_of_floor(chosen.floor), *chosen.warnings)
    warnings = (
        *_of_trajectory(trajectory),
        *_of_contradictions(off_share),
        *of_choice,
        *_of_side(chosen, towards_rad, hidden_share, first_rad, limits),
        *_of_frames(len(good), moving),
        *_of_range(too_far, max_depth_m, range_is_set),
    )
    side = UnseenSidePart(
        gap_rad=np.radians(round(np.degrees(gap_rad), 1)),
        towards_rad=np.radians(round(np.degrees(towards_rad), 1)),
        share=round(hidden_share, 4),
    )
    steps = inverse_depth_steps(sequence, good)
    steps = None if steps is None else round(steps, 1)
    figures = len(good), side, moving, max_depth_m, round(too_far, 4), off_share, steps
    of_kinect = is_of_kinect(steps, sequence.camera)
    return CoverageReport(*figures, of_kinect, warnings, of_choice, first_rad)
