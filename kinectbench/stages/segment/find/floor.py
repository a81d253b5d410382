"""Find the floor: the plane that the cameras look down on, not just the largest; or judge a given plane."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import Camera, invert_rigid, ransac_plane, refine
from kinectbench.core.trajectory.coverage import from_above
from kinectbench.core.types import Float64
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.segment.find.floor_choice import (
    FOCUS_M,
    MIN_NEAR_POINTS,
    NEAR_PLANE_M,
    NO_CHOICE,
    REPORTED_ABOVE_SHARE,
    PlaneCandidate,
    PlaneChoice,
    choose_plane,
    refined_near,
)
from kinectbench.stages.segment.find.hints import (
    MIN_GRAVITY_COSINE,
    MIN_UP_COSINE,
    NOTHING_KNOWN,
    FloorHint,
    distance_scale,
    enlarged_transform,
)
from kinectbench.stages.segment.find.planes import (
    FLAT_COSINE,
    INLIER_M,
    SceneSurface,
    floor_frame,
    noise_about_m,
)

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
GIVEN = "the plane that benchmark.yaml gives as `floor`"
# The plane that is seen is the one given if it is off by at most this, or this many times its noise, and
# turned by at most this (chosen by hand; floors scatter by 1 to 6 mm, their fits by less than 0.5 degrees).
LEAST_OFF_M, OFF_SIGMAS, TURNED_DEG = 0.010, 3.0, 3.0
# A person means the plane given if it has points of its own, within this distance: at least this share of the
# points of the plane beside it. A board on a floor is one of two planes that are seen (chosen by hand).
OWN_SHARE, LEAST_ON_M = 0.05, 0.005


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

    @contextmanager
    def explained_in_errors(self) -> Iterator[None]:
        """Within the block, add the first line of `against`, if any, to a `SegmentationError`."""
        try:
            yield
        except SegmentationError as error:
            if not self.against:
                raise
            raise SegmentationError(f"{error}; {self.against[0]}", what=error.what) from error

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
        given = _given_floor(
            hint.plane_world, points_world, T_world_camera, INLIER_M * scale**2, hint.up_world
        )
        against = against_plane(hint.plane_world, surface, hint.up_world, scale)
        return replace(given, scale=scale, given=True, against=against)
    floor = _find_floor(surface, enlarged_transform(T_world_camera, scale), seed, hint.up_world)
    plane = floor.plane_world * [1, 1, 1, scale]
    return replace(
        floor,
        plane_world=plane,
        T_floor_world=floor_frame(plane),
        noise_m=floor.noise_m * scale,
        scale=scale,
        choice=floor.choice.scaled(scale),
    )


def _find_floor(surface: SceneSurface, T_world_camera: Float64, seed: int, up_world: Float64 | None) -> Floor:
    """Find the floor among the planes of a world scaled so that the cameras are at least 1 m from the focus.

    In this world, `surface.inlier_m` is smaller for near cameras, because noise grows with the square of the
    distance; otherwise a board that lies on the floor would pass as floor. If no plane can be the floor and
    gravity is unknown, the search is repeated for cameras held upside down.
    """
    choice, against = choose_plane(surface, T_world_camera, up_world, seed), tuple[str, ...]()
    if choice.chosen is None and up_world is None:
        T_world_turned = T_world_camera @ HALF_TURN
        turned = choose_plane(surface, T_world_turned, None, seed)
        if turned.chosen is not None and _is_plain(turned.chosen, T_world_turned):
            choice, against, T_world_camera = turned, (UPSIDE_DOWN,), T_world_turned
    if choice.chosen is None:
        raise SegmentationError(NO_FLOOR.format(why=choice.likeliest), what="no-floor")
    plane, noise_m = refined_near(choice.chosen.plane, surface)
    tilt_rad = _tilt_rad(plane, T_world_camera, up_world)
    share = choice.chosen.inlier_share
    return Floor(plane, floor_frame(plane), noise_m, share, tilt_rad, choice=choice, against=against)


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
    inlier_m: float,
    up_world: Float64 | None,
) -> Floor:
    """Return the floor at a given plane (4,); the points (n, 3) near it give its noise and inlier share.

    Near means within twice `inlier_m`. `up_world` (3,) is up by gravity; if it is None, the poses (m, 4, 4)
    show how the cameras were held.
    """
    _check_below_cameras(plane_world, T_world_camera)
    near = points_world[np.abs(points_world @ plane_world[:3] + plane_world[3]) < 2 * inlier_m]
    noise_m = noise_about_m(plane_world, near, inlier_m) if len(near) >= MIN_NEAR_POINTS else 0.0
    tilt_rad = _tilt_rad(plane_world, T_world_camera, up_world)
    return Floor(plane_world, floor_frame(plane_world), noise_m, len(near) / len(points_world), tilt_rad)


def _check_below_cameras(plane_world: Float64, T_world_camera: Float64) -> None:
    """Refuse a given plane (4,) that lies above most cameras (n, 4, 4)."""
    if np.median(T_world_camera[:, :3, 3] @ plane_world[:3] + plane_world[3]) <= 0:
        raise SegmentationError(ABOVE_CAMERAS, what="bad-plane")


def level_floor(
    points_world: Float64, T_world_camera: Float64, up_world: Float64 | None = None, scale: float = 1.0
) -> Floor:
    """Return a substitute for the floor: a level plane at the lowest of the points (n, 3).

    It only defines a floor frame, in which a box can be given. If `up_world` (3,) is None, up is estimated
    from how the cameras (m, 4, 4) were held.
    """
    up = from_above(T_world_camera)[2] if up_world is None else up_world
    lowest_m = float(np.quantile(points_world @ up, LOWEST_SHARE))
    plane = np.append(up, -lowest_m)
    return Floor(plane, floor_frame(plane), 0.0, 0.0, 0.0, found=False, scale=scale)


def floor_cut_m(floor: Floor, settings: FloorCuts) -> float:
    """Return the height up to which surface is floor, metres: the setting, reduced for near cameras."""
    return settings.floor_cut_m * floor.scale


def low_cut_m(floor: Floor, settings: FloorCuts) -> float:
    """Return the height from which surface can belong to the object if it goes on above the floor cut.

    It is the setting `low_cut_m`, reduced for near cameras, but at least four standard deviations of the
    floor and at most the floor cut, in metres. If no floor was measured, it is the floor cut.
    """
    cut_m = floor_cut_m(floor, settings)
    if not floor.found:
        return cut_m
    return min(max(settings.low_cut_m * floor.scale, FLOOR_SIGMAS * floor.noise_m), cut_m)


def _tilt_rad(plane: Float64, T_world_camera: Float64, up_world: Float64 | None) -> float:
    up = from_above(T_world_camera)[2] if up_world is None else up_world
    return float(np.arccos(np.clip(plane[:3] @ up, -1, 1)))


def against_plane(
    plane_world: Float64, surface: SceneSurface, up_world: Float64 | None, scale: float
) -> tuple[str, ...]:
    """Return objections to a given plane (4,), one line each, with advice after a semicolon.

    There are two: the plane is not level by gravity, or the frames show another plane close to it. The other
    plane must lie within 0.1 m, differ by more than noise, and be the only one there. If the frames show both
    planes, such as a table and the floor, the user decides which one is meant. The given plane is in a world
    `scale` times as large as that of `surface`.
    """
    gravity = against_gravity(plane_world, up_world)
    beside = _beside(plane_world * [1, 1, 1, 1 / scale], surface)
    if beside is None:
        return gravity
    seen, off_m, turn_deg = beside
    way = f"{1000 * scale * abs(off_m):.0f} mm {'above' if off_m > 0 else 'below'} it"
    turned = f", turned by {turn_deg:.0f} degrees" if turn_deg > TURNED_DEG else ", parallel to it"
    numbers = ", ".join(f"{value:.5f}" for value in seen * [1, 1, 1, scale])
    line = (
        f"{GIVEN} is not one that the frames show: they show a plane {way}{turned}; if the object stands "
        f"on that, write `floor: {{plane_world: [{numbers}]}}`"
    )
    return (*gravity, line)


def against_gravity(plane_world: Float64, up_world: Float64 | None) -> tuple[str, ...]:
    """Return an objection if a plane (4,) is not level by gravity, else (); () if `up_world` is unknown."""
    if up_world is None or plane_world[:3] @ up_world >= MIN_GRAVITY_COSINE:
        return ()
    turn_deg = float(np.degrees(np.arccos(np.clip(plane_world[:3] @ up_world, -1, 1))))
    return (
        f"{GIVEN} is turned by {turn_deg:.0f} degrees against level by gravity; give one whose normal "
        "points up, in the frame of the trajectory",
    )


def _beside(plane: Float64, surface: SceneSurface) -> tuple[Float64, float, float] | None:
    """Find a measured plane close to a given plane (4,), near the focus.

    Return the measured plane (4,), its height in metres above the given plane, and the angle between them in
    degrees. Return None if the surface near the focus shows no plane, or if it shows the given plane.
    """
    points, normals = surface.points_world, surface.normals_world
    near = normals @ plane[:3] > FLAT_COSINE
    near &= np.abs(points @ plane[:3] + plane[3]) < NEAR_PLANE_M
    near &= np.linalg.norm(points - surface.focus_world, axis=1) < FOCUS_M
    if near.sum() < MIN_NEAR_POINTS:
        return None
    points, normals, inlier_m = points[near], normals[near], surface.inlier_m
    seen = ransac_plane(points, normals, np.random.default_rng(0), inlier_m)
    seen = refine(points, seen, 2 * inlier_m, inlier_m)
    on_seen = points[np.abs(points @ seen[:3] + seen[3]) < inlier_m]
    if len(on_seen) < MIN_NEAR_POINTS:
        return None
    noise_m = noise_about_m(seen, on_seen, inlier_m)
    off_m = float(on_seen.mean(axis=0) @ plane[:3] + plane[3])
    turn_deg = float(np.degrees(np.arccos(np.clip(seen[:3] @ plane[:3], -1, 1))))
    off_noise_m = max(LEAST_OFF_M, OFF_SIGMAS * noise_m)
    if abs(off_m) <= off_noise_m and turn_deg <= TURNED_DEG:
        return None
    own = np.abs(points @ plane[:3] + plane[3]) < max(LEAST_ON_M, noise_m)
    own &= np.abs(points @ seen[:3] + seen[3]) > off_noise_m
    return None if own.sum() > OWN_SHARE * len(on_seen) else (seen, off_m, turn_deg)
