"""Find the floor as a build does, and the camera's height above it."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import SegmentationError
from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import Camera, depth_sigma_m, transform_points
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.coverage import middle_depth_m
from kinectbench.doctor.delays import clock_ns
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.pose_delay import longest_gap_s, on_clock
from kinectbench.doctor.probe import Probe, SmallFrame
from kinectbench.doctor.trajectory import PoseFit
from kinectbench.stages.ingest.recording import Recording
from kinectbench.stages.segment.find.floor import MIN_POINTS, Floor, find_floor, floor_of_frames, oriented
from kinectbench.stages.segment.find.hints import hint_of

# Number of frames that are searched one by one, or together by their poses; limited to save time.
FRAMES, POSED_FRAMES = 6, 40
# If poses and depth disagree more, frames are not combined to find a floor.
FITTING = 0.5
# Assumed point of interest of a frame without a pose, camera frame, metres: a typical distance of furniture.
FOCUS_CAMERA = np.array([0.0, 0.0, 1.5])
# Plausible heights of a hand-held camera above the floor or the table, metres.
LOWEST_M, HIGHEST_M = 0.25, 2.5
# A floor that is seen in a smaller share of the frames is reported. Chosen by hand.
SEEN_SHARE = 0.3
# A frame sees the scene's floor if this share of its points lies within this distance of the floor, metres.
MIN_ON_FLOOR, ON_FLOOR_M = 0.01, 0.04

# Largest scatter of combined frames about a floor, in multiples of a Kinect's depth noise at that distance.
# Above it the poses, the intrinsics or the plane are reported as uncertain. Measured: 0.4 to 2.4 if they are
# correct (50 simulated recordings, 5 real ones), 5.3 to 6.6 if they are wrong (3).
SCATTER_TIMES = 4.0
SCATTERS = (
    "the frames scatter by {seen_mm:.0f} mm about the floor, a Kinect's depth at {far_m:.1f} m by "
    "{expected_mm:.0f}; the poses or the intrinsics are off, or it is another surface: try "
    "{modes}, record with more of the floor in view, or give a box"
)
BY_FRAMES = "{why}; that is what {count} frames show by themselves: a build fuses all, and may still find it"

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Ground:
    """Prior knowledge about the floor that the object stands on.

    Attributes:
        recording: the recording, with its gravity and its trajectory, even if the trajectory is ignored.
        plane_world: (4,) a plane from the settings, in the world of the given poses; None: not set.
        is_needed: whether a build must find a floor: the settings have neither a plane nor a box.
        refined: whether the settings refine the given trajectory.
    """

    recording: Recording
    plane_world: Sequence[float] | None = None
    is_needed: bool = True
    refined: bool = False


@dataclass(frozen=True)
class SeenFloor:
    """The camera's heights above the floor in k searched frames.

    Attributes:
        heights_m: (k,) height of the camera above the floor in each frame, metres; NaN where the frame shows
            no floor. With a plane from the settings, it is known in every frame.
        warnings: reasons why the floor may be wrong, one line each, as a build gives them.
        why: why a search in all k frames together found no floor, as a build says it; None if it found one,
            or if each frame was searched separately.
    """

    heights_m: Points
    warnings: tuple[str, ...] = ()
    why: str | None = None


def seen_floor(
    probe: Probe, ground: Ground, poses: PoseFit | None = None, max_depth_m: float = np.inf
) -> SeenFloor:
    """Search for the floor in some frames of the probe.

    If given poses fit, one floor is searched for in up to 40 frames together, as in a build. Otherwise each
    of up to six frames is searched separately, as if it were a recording. A plane from the settings is used
    only with poses, because it is in their world.

    Args:
        probe: the probe of the recording.
        ground: prior knowledge of the floor.
        poses: the fit of the given poses; None: there are none, or they were not judged.
        max_depth_m: depth beyond this is not fused, metres.
    """
    posed = None if poses is None or poses.best > FITTING else _posed(probe, poses)
    if poses is not None and posed is not None and len(posed[0]) > 1:
        # If poses need another convention, gravity in their frame needs it, too.
        if poses.given != poses.best:
            ground = replace(ground, recording=replace(ground.recording, given_trajectory=None))
        return _heights_together(probe, *posed, max_depth_m, ground)
    count = len(probe.frames)
    indices = evenly(count, FRAMES).tolist()
    alone = [_floor_alone(probe.frames[i], probe.small_camera, ground.recording) for i in indices]
    heights_m = [np.nan if each is None else each.plane_world[3] for each in alone]
    # A warning for most single frames counts for the recording.
    counts = Counter(line for each in alone if each is not None for line in each.against)
    warnings = tuple(line for line, count in counts.items() if 2 * count > len(alone))
    return SeenFloor(np.array(heights_m), warnings)


def check_floor(probe: Probe, floor: SeenFloor, ground: Ground) -> Iterator[Finding]:
    """Report a floor that is needed but missing, an uncertain floor, and an implausible camera height."""
    heights_m = floor.heights_m
    seen = np.isfinite(heights_m)
    if seen.mean() < SEEN_SHARE:
        if not ground.is_needed:
            return
        what = f"a floor is in view in {seen.sum()} of {len(seen)} frames"
        advice = (
            "let the camera see what the object stands on around it; or give a `box`, or its plane: "
            "`floor: {plane_world: [a, b, c, d]}`"
        )
        if floor.why is not None:
            what, advice = BY_FRAMES.format(why=floor.why, count=len(seen)).split("; ", 1)
        yield Finding("no_floor", "warning" if not seen.any() else "note", what, probe.where, advice)
        return
    for warning in floor.warnings:
        what, advice = warning.split("; ", 1)
        yield Finding("floor_doubtful", "warning", what, probe.where, advice)
    height_m = float(np.nanmedian(heights_m))
    if height_m <= 0:
        what = "most cameras are below the plane that benchmark.yaml gives as `floor`"
        advice = "its normal must point up, in the frame of the trajectory"
        yield Finding("floor_above", "stops", what, probe.where, advice)
    elif not LOWEST_M <= height_m <= HIGHEST_M:
        what = f"the camera is {height_m:.2f} m above the floor, if depth has the right unit"
        yield Finding("camera_height", "warning", what, probe.where, "check `depth_scale`")


def _posed(probe: Probe, poses: PoseFit) -> tuple[list[SmallFrame], Points] | None:
    """Return n evenly chosen frames with a pose, and their poses (n, 4, 4) in the convention that fits."""
    given = probe.recording.given_trajectory
    if given is None:
        return None
    moved = on_clock(probe, given)
    T_world_camera = poses.convention.apply(
        poses_at(moved, clock_ns(probe, probe.frames), longest_gap_s(moved))
    )
    known = np.flatnonzero(np.isfinite(T_world_camera[:, 0, 0]))
    shape = probe.small_camera.height, probe.small_camera.width
    known = np.array([i for i in known if probe.frames[i].depth_m.shape == shape], np.int64)
    chosen = known[evenly(len(known), POSED_FRAMES)]
    return [probe.frames[i] for i in chosen], T_world_camera[chosen]


def _heights_together(
    probe: Probe, frames: list[SmallFrame], T_world_camera: Points, max_depth_m: float, ground: Ground
) -> SeenFloor:
    """Return the cameras' heights above the floor found in all frames together, or above a given plane.

    Args:
        probe: the probe of the recording.
        frames: n frames of the probe, all of the size of its small images.
        T_world_camera: (n, 4, 4), their poses.
        max_depth_m: depth beyond this is not used, metres.
        ground: prior knowledge of the floor.
    """
    stamps_ns = np.array([frame.stamp_ns for frame in frames], np.int64)
    hint = replace(
        hint_of(ground.recording, stamps_ns, T_world_camera, ground.plane_world),
        middle_depth_m=middle_depth_m(frame.depth_m for frame in frames),
    )
    near_m = [np.where(frame.depth_m <= max_depth_m, frame.depth_m, np.float32(0)) for frame in frames]
    heights_m = np.full(len(frames), np.nan)
    if hint.plane_world is not None:
        heights_m = T_world_camera[:, :3, 3] @ hint.plane_world[:3] + hint.plane_world[3]
    try:
        floor, clouds = floor_of_frames(near_m, probe.small_camera, T_world_camera, hint)
    except SegmentationError as error:
        return SeenFloor(heights_m, why=str(error))
    if floor.given:
        return SeenFloor(heights_m, floor.warnings)
    depths_m = []
    for index, points_world in enumerate(clouds):
        on_floor = np.abs(transform_points(floor.T_floor_world, points_world)[:, 2]) < ON_FLOOR_M
        T = T_world_camera[index]
        depths_m.append((points_world[on_floor] - T[:3, 3]) @ T[:3, 2])
        if on_floor.sum() > MIN_ON_FLOOR * len(points_world):
            heights_m[index] = transform_points(floor.T_floor_world, T_world_camera[index, :3, 3])[2]
    scatters = _scatters(floor.noise_m, np.concatenate(depths_m), ground.refined)
    return SeenFloor(heights_m, (*floor.warnings, *scatters))


def _scatters(noise_m: float, depths_m: Points, refined: bool) -> Iterator[str]:
    """Yield a warning if the frames scatter about their common floor more than depth noise explains.

    Args:
        noise_m: scatter of all frames' points about the floor, metres.
        depths_m: (m,) depths of the points near the floor in their cameras, metres; if empty, no warning.
        refined: whether the settings refine the poses, so that this is not advised.
    """
    if not len(depths_m):
        return
    far_m = float(np.median(depths_m))
    expected_m = depth_sigma_m(far_m)
    if noise_m > SCATTER_TIMES * expected_m:
        modes = "`trajectory: ignore`" if refined else "`trajectory: refine` or `ignore`"
        yield SCATTERS.format(seen_mm=1000 * noise_m, far_m=far_m, expected_mm=1000 * expected_m, modes=modes)


def _floor_alone(frame: SmallFrame, camera: Camera, recording: Recording) -> Floor | None:
    """Find the floor in one frame. Return None if no floor is found.

    World axes in the returned Floor are the axes of this frame's camera. The search scales all points to a
    median depth of 1.5 m, so that a wrong depth unit does not hide the floor. `plane_world` is converted back
    to metres. All other lengths of the returned Floor stay scaled.
    """
    if frame.depth_m.shape != (camera.height, camera.width):
        return None
    points, normals = oriented(frame.depth_m, camera)
    if len(points) < MIN_POINTS:
        return None
    # Lengths are scaled to a median distance of 1.5 m, so that a wrong unit does not hide the floor.
    unit = float(FOCUS_CAMERA[2]) / float(np.median(points[:, 2]))
    alone = np.eye(4)[None]
    hint = hint_of(recording, np.array([frame.stamp_ns], np.int64), alone)
    try:
        floor = find_floor(points * unit, normals, alone, FOCUS_CAMERA, 0, hint)
    except SegmentationError:
        return None
    return replace(floor, plane_world=floor.plane_world * [1, 1, 1, 1 / unit])
