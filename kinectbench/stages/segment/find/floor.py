"""Find the floor: the plane that the cameras look down on, not just the largest; or judge a given plane.

It is found in a fused scene, and in the frames themselves, with which a build compares it.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import Camera, image_normals, invert_rigid, transform_points
from kinectbench.core.sequence import Sequence as Recorded
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float32, Float64
from kinectbench.core.voxels.point_cells import thinned
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.fuse.depth_range import some_frames
from kinectbench.stages.segment.find.floor_choice import (
    NO_CHOICE,
    REPORTED_ABOVE_SHARE,
    PlaneCandidate,
    PlaneChoice,
    choose_plane,
)
from kinectbench.stages.segment.find.hints import MIN_UP_COSINE, NOTHING_KNOWN, FloorHint, up_or_held
from kinectbench.stages.segment.find.pieces import CELL_M
from kinectbench.stages.segment.find.planes import (
    INLIER_M,
    MIN_NEAR_POINTS,
    SceneSurface,
    above_m,
    against_plane,
    floor_frame,
    noise_about_m,
    refined_near,
    turn_rad,
)
from kinectbench.stages.segment.find.scale import distance_scale, enlarged_transform

NO_FLOOR = (
    "no floor found: no plane that faces up, and below which nothing is seen, lies below most cameras{why}; "
    "record with more of what the object stands on in view, or give its plane (`floor: {{plane_world: "
    "[a, b, c, d]}}`) or a box (`kinectbench segment --suggest` lists some)"
)
ABOVE_CAMERAS = (
    "most cameras are below the plane that benchmark.yaml gives as `floor`; its normal must point up, in the "
    "frame of the trajectory"
)
# Cameras held upside down, as robots and ceilings hold them: their poses are turned about their axes.
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
UPSIDE_DOWN = (
    "the cameras are taken for held upside down: only so there is a floor; if they were, write its plane "
    "into benchmark.yaml (`floor: {plane_world: [a, b, c, d]}`; `kinectbench build` writes the numbers to "
    "build/<id>/object/floor.json)"
)
# A floor that is seen upside down has at least this share of the surface (chosen by hand: in 30 fused scenes
# .15 to .97 lies on the floor; a ceiling is hardly in view of cameras that look at a thing below it).
LEAST_UPSIDE_DOWN = 0.15
# This share of the surface may lie below the height that a scene without floor is given.
LOWEST_SHARE = 0.001
# The fused floor's surface strays from the plane by this many of its standard deviations at most.
FLOOR_SIGMAS = 4.0
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


@dataclass(frozen=True)
class Floor:
    """The floor of a recording.

    Attributes:
        plane_world: (4,) a, b, c, d with a x + b y + c z + d = 0; (a, b, c) is the unit normal, upward.
        T_floor_world: (4, 4); frame `floor`: z up, floor at z = 0, origin below the world's origin, x along
            the world's x axis projected onto the floor (or its z axis where that is degenerate).
        noise_m: robust standard deviation of the surface around the plane, metres.
        inlier_share: share of the scene's surface that lies on the plane.
        tilt_rad: angle between its normal and up, radians; NaN if unknown. Up is by gravity; without gravity,
            it is coarsely estimated from how the cameras were held.
        found: False if the plane was not measured, as that of `level_floor`.
        scale: 0.3 to 1, smaller for nearer cameras; the heights of floor cuts are multiplied by it.
        choice: the planes among which it was chosen; empty if the user gave the plane.
        given: whether the user gave the plane.
        against: one line for each objection to a given plane, or a warning that the cameras were taken for
            held upside down.
    """

    plane_world: Float64
    T_floor_world: Float64
    noise_m: float
    inlier_share: float
    tilt_rad: float = 0.0
    found: bool = True
    scale: float = 1.0
    choice: PlaneChoice = NO_CHOICE
    given: bool = False
    against: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the floor, one line each."""
        return (*self.against, *self.choice.warnings())

    def cut_m(self, settings: FloorCuts) -> float:
        """Return the height up to which surface is floor, metres: the setting, reduced for near cameras."""
        return settings.floor_cut_m * self.scale

    def low_cut_m(self, settings: FloorCuts) -> float:
        """Return the height from which surface can belong to the object if it goes on above the floor cut.

        It is the setting `low_cut_m`, reduced for near cameras, but at least four standard deviations of the
        floor and at most the floor cut, in metres. If no floor was measured, it is the floor cut.
        """
        if not self.found:
            return self.cut_m(settings)
        low_m = max(settings.low_cut_m * self.scale, FLOOR_SIGMAS * self.noise_m)
        return min(low_m, self.cut_m(settings))

    @property
    def T_world_floor(self) -> Float64:
        """(4, 4), maps the floor frame to the world."""
        return invert_rigid(self.T_floor_world)

    def heights_m(self, depth_m: NDArray[np.floating], camera: Camera, T_world_camera: Float64) -> Float64:
        """Return the height above the floor of the surface that each pixel shows: (height, width), metres.

        Where `depth_m` is 0, it is the height of the camera.
        """
        up = (self.T_floor_world @ T_world_camera)[2]
        return np.asarray(depth_m * (camera.rays() @ up[:3]) + up[3])


@contextmanager
def explained(why: Callable[[], Sequence[str]]) -> Iterator[None]:
    """Within the block, add the first line that `why` returns, if any, to a `SegmentationError`."""
    try:
        yield
    except SegmentationError as error:
        lines = why()
        if not lines:
            raise
        raise SegmentationError(f"{error}; {lines[0]}", what=error.what) from error


def find_floor(
    points_world: Float64,
    normals_world: Float64,
    T_world_camera: Float64,
    focus_world: Float64,
    seed: int,
    hint: FloorHint = NOTHING_KNOWN,
) -> Floor:
    """Find the floor among the planes of the scene (`choose_plane`), or judge a given plane.

    The plane is refined by least squares within 1.2 m of the focus: farther floor has several times the
    noise, and a Kinect's depth bias grows with distance. Where cameras are nearer than 1 m, all these lengths
    shrink in proportion (`distance_scale`).

    Args:
        points_world: (n, 3) points spread evenly over the scene's surface, metres.
        normals_world: (n, 3) their unit normals.
        T_world_camera: (m, 4, 4) poses of the good frames.
        focus_world: (3,) where the cameras look.
        seed: seed of RANSAC.
        hint: gravity, and the plane that the user gave, if known.

    Raises:
        SegmentationError: no plane can be the floor, or the cameras are below the given plane.
    """
    scale = distance_scale(T_world_camera, focus_world)
    surface = SceneSurface(points_world / scale, normals_world, focus_world / scale, INLIER_M * scale)
    if hint.plane_world is not None:
        return _given_floor(hint.plane_world, points_world, T_world_camera, hint.up_world, surface, scale)
    choice, held, against = _choose(surface, enlarged_transform(T_world_camera, scale), hint.up_world, seed)
    if choice.chosen is None:
        raise SegmentationError(NO_FLOOR.format(why=choice.likeliest), what="no-floor")
    plane, noise_m = refined_near(choice.chosen.plane, surface)
    tilt_rad = turn_rad(plane, up_or_held(held, hint.up_world))
    plane = plane * [1, 1, 1, scale]
    return Floor(
        plane,
        floor_frame(plane),
        noise_m * scale,
        choice.chosen.inlier_share,
        tilt_rad,
        scale=scale,
        choice=choice.scaled(scale),
        against=against,
    )


def _choose(
    surface: SceneSurface, T_world_camera: Float64, up_world: Float64 | None, seed: int
) -> tuple[PlaneChoice, Float64, tuple[str, ...]]:
    """Choose a plane, of cameras held upside down only if there is no floor otherwise.

    Returns:
        The choice; the poses, turned upright; and a warning if they had to be turned.
    """
    choice = choose_plane(surface, T_world_camera, up_world, seed)
    if choice.chosen is None and up_world is None:
        T_world_turned = T_world_camera @ HALF_TURN
        turned = choose_plane(surface, T_world_turned, None, seed)
        if turned.chosen is not None and _is_plain(turned.chosen, T_world_turned):
            return turned, T_world_turned, (UPSIDE_DOWN,)
    return choice, T_world_camera, ()


def _is_plain(chosen: PlaneCandidate, T_world_camera: Float64) -> bool:
    """Whether a plane is clearly enough the floor to assume that the cameras were held upside down.

    The cameras (n, 4, 4) are already turned upright. Enough of the surface must lie on the plane, and enough
    cameras above it. The cameras must not look down steeply: a wall seen from above looks like a floor that
    is seen steeply and upside down.
    """
    upright = float(np.median(-T_world_camera[:, :3, 1] @ chosen.plane[:3]))
    seen = chosen.inlier_share >= LEAST_UPSIDE_DOWN and chosen.above_share >= REPORTED_ABOVE_SHARE
    return seen and upright > MIN_UP_COSINE


def _given_floor(
    plane_world: Float64,
    points_world: Float64,
    T_world_camera: Float64,
    up_world: Float64 | None,
    surface: SceneSurface,
    scale: float,
) -> Floor:
    """Return the floor at a given plane; the points near it give its noise and inlier share.

    The arguments are those of `find_floor` and `against_plane`. A plane above most cameras is refused.
    """
    if np.median(above_m(plane_world, T_world_camera[:, :3, 3])) <= 0:
        raise SegmentationError(ABOVE_CAMERAS, what="bad-plane")
    inlier_m = INLIER_M * scale**2
    near = points_world[np.abs(above_m(plane_world, points_world)) < 2 * inlier_m]
    noise_m = noise_about_m(plane_world, near, inlier_m) if len(near) >= MIN_NEAR_POINTS else 0.0
    tilt_rad = turn_rad(plane_world, up_or_held(T_world_camera, up_world))
    against, share = against_plane(plane_world, surface, up_world, scale), len(near) / len(points_world)
    frame = floor_frame(plane_world)
    return Floor(plane_world, frame, noise_m, share, tilt_rad, scale=scale, given=True, against=against)


def level_floor(
    points_world: Float64, T_world_camera: Float64, up_world: Float64 | None, scale: float, below_m: float = 0
) -> Floor:
    """Return a substitute for the floor: a level plane `below_m` below the lowest of the points (n, 3).

    It only defines a floor frame, in which a box can be given. If `up_world` (3,) is None, up is estimated
    from how the cameras (m, 4, 4) were held.
    """
    up = up_or_held(T_world_camera, up_world)
    lowest_m = float(np.quantile(points_world @ up, LOWEST_SHARE))
    plane = np.append(up, below_m - lowest_m)
    return Floor(plane, floor_frame(plane), 0.0, 0.0, 0.0, found=False, scale=scale)


def oriented(depth_m: Float32, camera: Camera) -> tuple[Float64, Float64]:
    """Return points and unit normals towards the camera, (n, 3) each, of every fourth row and column.

    They are in the camera's axes; `depth_m` is (height, width), 0 = none.
    """
    surface = camera.backproject(depth_m)
    normals = image_normals(surface, depth_m, reach_px=2)
    chosen = np.isfinite(normals).all(axis=-1) & (depth_m > 0)
    keep = np.zeros_like(chosen)
    keep[::STEP_PX, ::STEP_PX] = chosen[::STEP_PX, ::STEP_PX]
    return surface[keep], normals[keep]


def floor_of_frames(
    depths_m: Sequence[Float32], camera: Camera, T_world_camera: Float64, hint: FloorHint
) -> tuple[Floor, list[Float64]]:
    """Find the common floor of some frames, as in a fused scene.

    The depth of each is (height, width), metres, 0 = none; the poses are (n, 4, 4).

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
    floor: Floor, sequence: Recorded, trajectory: Trajectory, hint: FloorHint, max_depth_m: float
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
    turn_deg = float(np.degrees(turn_rad(seen.plane_world, floor.plane_world)))
    apart_m = abs(float((seen.plane_world - floor.plane_world) @ focus))
    if turn_deg < SAME_DEG and apart_m < SAME_SHARE * far_m:
        return ()
    return (OTHER_FLOOR.format(turn_deg=turn_deg, apart_m=apart_m),)
