"""The floor plane: not the largest plane, but the one the cameras stand above."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import Camera, invert_rigid
from kinectbench.core.trajectory.coverage import from_above
from kinectbench.core.types import Float64
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.segment.floor_planes import (
    MIN_NEAR_POINTS,
    NO_CHOICE,
    TOLD_ABOVE_SHARE,
    PlaneCandidate,
    PlaneChoice,
    choose_plane,
    refined_near,
)
from kinectbench.stages.segment.given_floor import against_plane
from kinectbench.stages.segment.near import enlarged_transform, near_scale
from kinectbench.stages.segment.planes import (
    INLIER_M,
    Surface,
    floor_frame,
    noise_about_m,
)
from kinectbench.stages.segment.up import MIN_UP_COSINE, NOTHING_KNOWN, FloorHint

NO_FLOOR = (
    "no floor found: no plane that faces up, and below which nothing is seen, lies below most cameras{why}; "
    "record with more of what the object stands on in view, or give its plane (`floor: {{plane_world: "
    "[a, b, c, d]}}`) or a box (`kinectbench segment --suggest` lists some)"
)
ABOVE_CAMERAS = (
    "most cameras are below the plane that benchmark.yaml gives as `floor`; its normal must point up, in the "
    "frame of the trajectory"
)
# Cameras that were held upside down, as robots and ceilings hold them: their poses turned about their axes.
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
UPSIDE_DOWN = (
    "the cameras are taken for held upside down: only so there is a floor; if they were, write its plane "
    "into benchmark.yaml (`floor: {plane_world: [a, b, c, d]}`; `kinectbench build` writes the numbers to "
    "build/<id>/object/floor.json)"
)
# Of the surface, so much must lie on a floor that is seen upside down (own choice: of 30 fused scenes .15 to
# .97 lies on the floor; of a ceiling, while cameras look at a thing below it, hardly anything is in view).
LEAST_UPSIDE_DOWN = 0.15
# Of the surface, what may lie below the lowest height that a scene without floor is given.
LOWEST_SHARE = 0.001
# The fused floor's surface strays this many of its standard deviations from the plane at most.
FLOOR_SIGMAS = 4.0


@dataclass(frozen=True)
class Floor:
    """The floor of a recording.

    Attributes:
        plane_world: (4,) a, b, c, d with a x + b y + c z + d = 0; (a, b, c) is the unit normal, upward.
        T_floor_world: (4, 4); frame `floor`: z up, floor at z = 0, origin below the world's origin, x
            along the world's x axis projected onto the floor (or its z axis where that is degenerate).
        noise_m: robust standard deviation of the surface around the plane, metres.
        inlier_share: share of the scene's surface that lies on the plane.
        tilt_rad: angle between its normal and up by gravity, or else as the cameras were held, radians; the
            latter is coarse, as hands are; NaN if it is not known.
        found: False if it is not a measured plane but `level_floor`.
        scale: by what the cuts of the settings are multiplied for it, as cameras were near (`near_scale`).
        choice: the planes among which it was chosen; none of a person's plane.
        given: whether it is a person's plane.
        against: what speaks against a person's plane, or for cameras upside down, one line for people each.
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
    def doubts(self) -> tuple[str, ...]:
        """What speaks against it, one line for people each."""
        return (*self.against, *self.choice.doubts())

    @contextmanager
    def said_in_errors(self) -> Iterator[None]:
        """What cannot be segmented within the block also names what speaks against a person's plane."""
        try:
            yield
        except SegmentationError as error:
            if not self.against:
                raise
            raise SegmentationError(f"{error}; {self.against[0]}") from error

    @property
    def T_world_floor(self) -> Float64:
        """(4, 4), maps the floor frame to the world."""
        return invert_rigid(self.T_floor_world)

    def heights_m(self, depth_m: NDArray[np.floating], camera: Camera, T_world_camera: Float64) -> Float64:
        """Height above the floor of what each pixel measured, metres: (height, width).

        Args:
            depth_m: (height, width) metres along z; 0 = none, its height is the camera's.
            camera: of the image.
            T_world_camera: (4, 4).
        """
        up = (self.T_floor_world @ T_world_camera)[2]
        heights: Float64 = depth_m * (camera.rays() @ up[:3]) + up[3]
        return heights


def find_floor(
    points_world: Float64,
    normals_world: Float64,
    T_world_camera: Float64,
    focus_world: Float64,
    seed: int,
    hint: FloorHint = NOTHING_KNOWN,
) -> Floor:
    """Find the floor among the planes of the scene (`choose_plane`); a person's is taken as it is and judged.

    The plane is refined by least squares where it matters, within 1.2 m of the focus: farther floor is
    measured with several times the noise, and a Kinect's depth bias grows with distance. Where cameras are
    nearer than 1 m, all these lengths are less in proportion (`near_scale`).

    Args:
        points_world: (n, 3) points spread evenly over the scene's surface, metres.
        normals_world: (n, 3) their unit normals.
        T_world_camera: (m, 4, 4) poses of the good frames.
        focus_world: (3,) where the cameras look.
        seed: seed of RANSAC.
        hint: gravity, and a person's plane.

    Raises:
        SegmentationError: no plane may be a floor, or the cameras are below a person's.
    """
    scale = near_scale(T_world_camera, focus_world)
    surface = Surface(points_world / scale, normals_world, focus_world / scale, INLIER_M * scale)
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


def _find_floor(surface: Surface, T_world_camera: Float64, seed: int, up_world: Float64 | None) -> Floor:
    """`find_floor` by the planes, in a world in which the cameras are 1 m and more from what they look at.

    There a floor's inliers lie closer still, as noise grows with the square of the distance: a board that
    lies on it must not pass for floor.
    """
    choice, against = choose_plane(surface, T_world_camera, up_world, seed), tuple[str, ...]()
    if choice.chosen is None and up_world is None:
        T_world_turned = T_world_camera @ HALF_TURN
        turned = choose_plane(surface, T_world_turned, None, seed)
        if turned.chosen is not None and _is_plain(turned.chosen, T_world_turned):
            choice, against, T_world_camera = turned, (UPSIDE_DOWN,), T_world_turned
    if choice.chosen is None:
        raise SegmentationError(NO_FLOOR.format(why=choice.likeliest))
    plane, noise_m = refined_near(choice.chosen.plane, surface)
    tilt_rad = _tilt_rad(plane, T_world_camera, up_world)
    share = choice.chosen.inlier_share
    return Floor(plane, floor_frame(plane), noise_m, share, tilt_rad, choice=choice, against=against)


def _is_plain(chosen: PlaneCandidate, T_world_camera: Float64) -> bool:
    """Whether so much lies on a plane, and all look down on it so, that it must be the floor.

    A wall that is looked at from above is like a floor that is looked at steeply upside down: that is none.
    """
    upright = float(np.median(-T_world_camera[:, :3, 1] @ chosen.plane[:3]))
    seen = chosen.inlier_share >= LEAST_UPSIDE_DOWN and chosen.above_share >= TOLD_ABOVE_SHARE
    return seen and upright > MIN_UP_COSINE


def _given_floor(
    plane_world: Float64,
    points_world: Float64,
    T_world_camera: Float64,
    inlier_m: float,
    up_world: Float64 | None,
) -> Floor:
    """The floor by a person's plane (4,)."""
    above_m = T_world_camera[:, :3, 3] @ plane_world[:3] + plane_world[3]
    if np.median(above_m) <= 0:
        raise SegmentationError(ABOVE_CAMERAS)
    near = points_world[np.abs(points_world @ plane_world[:3] + plane_world[3]) < 2 * inlier_m]
    noise_m = noise_about_m(plane_world, near, inlier_m) if len(near) >= MIN_NEAR_POINTS else 0.0
    tilt_rad = _tilt_rad(plane_world, T_world_camera, up_world)
    return Floor(plane_world, floor_frame(plane_world), noise_m, len(near) / len(points_world), tilt_rad)


def level_floor(
    points_world: Float64, T_world_camera: Float64, up_world: Float64 | None = None, scale: float = 1.0
) -> Floor:
    """A floor for a scene without one: level, at its lowest surface (own rule).

    Only a box that a person gives makes sense of it: its frame is where the box is given.

    Args:
        points_world: (n, 3) points spread evenly over the scene's surface, metres.
        T_world_camera: (m, 4, 4) poses of the good frames.
        up_world: (3,) unit, by gravity; None: level as the cameras were held.
        scale: of the floor (`Floor`).
    """
    up = from_above(T_world_camera)[2] if up_world is None else up_world
    lowest_m = float(np.quantile(points_world @ up, LOWEST_SHARE))
    plane = np.append(up, -lowest_m)
    return Floor(plane, floor_frame(plane), 0.0, 0.0, 0.0, found=False, scale=scale)


def floor_cut_m(floor: Floor, settings: FloorCuts) -> float:
    """What rises no higher above the floor is floor, metres: that of the settings, less for near cameras."""
    return settings.floor_cut_m * floor.scale


def low_cut_m(floor: Floor, settings: FloorCuts) -> float:
    """From which height on a surface may be the object's where it goes on above the floor cut, metres.

    `low_cut_m` of the settings, or four standard deviations of the floor if that is more, but at most the
    floor cut itself; that, too, where no floor was measured.

    Args:
        floor: of the recording.
        settings: both cuts.
    """
    cut_m = floor_cut_m(floor, settings)
    if not floor.found:
        return cut_m
    return min(max(settings.low_cut_m * floor.scale, FLOOR_SIGMAS * floor.noise_m), cut_m)


def _tilt_rad(plane: Float64, T_world_camera: Float64, up_world: Float64 | None) -> float:
    up = from_above(T_world_camera)[2] if up_world is None else up_world
    return float(np.arccos(np.clip(plane[:3] @ up, -1, 1)))
