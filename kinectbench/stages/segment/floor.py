"""The floor plane: not the largest plane, but the one the cameras stand above."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import Camera, invert_rigid
from kinectbench.core.trajectory.coverage import from_above
from kinectbench.core.types import Float64
from kinectbench.settings.models import SegmentationSettings

CANDIDATES = 6
HYPOTHESES = 400
INLIER_M = 0.02
MIN_UP_COSINE = 0.6
MIN_CAMERA_HEIGHT_M = 0.1
MAX_BELOW_SHARE = 0.05
BELOW_M = 0.05
MIN_INLIER_SHARE = 0.01
FOCUS_M = 1.2
MIN_NEAR_POINTS = 100
# Clutter that a plane happens to cut spreads evenly about it (30 mm); a real floor does not.
MAX_NOISE_M = 0.02
NO_FLOOR = (
    "no floor found: no plane below all cameras that faces up; record with more of the floor in view, "
    "or give a box: `kinectbench segment --suggest` lists some"
)
# A plane this parallel to the one with most points, and this much lower, is the floor below a table top.
PARALLEL_COSINE = 0.97
LOWER_M = 0.2
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
        tilt_rad: angle between its normal and up as the cameras were held, radians; coarse, as hands are;
            NaN if it is not known.
        found: False if it is not a measured plane but `level_floor`.
    """

    plane_world: Float64
    T_floor_world: Float64
    noise_m: float
    inlier_share: float
    tilt_rad: float = 0.0
    found: bool = True

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
) -> Floor:
    """Find the floor among up to six planes of the scene.

    A plane qualifies if its normal agrees with the cameras' mean up direction (cosine > 0.6), every
    camera is more than 0.1 m above it, and under 5 % of the points are below it. Of those that
    qualify, the one with most points is the floor, unless another one lies parallel to it and at least
    0.2 m lower: a table top may fill more of the frames than the floor does. The floor is then refined by
    least squares where it matters, within 1.2 m of the focus: farther floor is measured with several times
    the noise, and a Kinect's depth bias grows with distance.

    Args:
        points_world: (n, 3) points spread evenly over the scene's surface, metres.
        normals_world: (n, 3) their unit normals.
        T_world_camera: (m, 4, 4) poses of the good frames.
        focus_world: (3,) where the cameras look.
        seed: seed of RANSAC.

    Raises:
        SegmentationError: no plane qualifies.
    """
    up = -T_world_camera[:, :3, 1].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    planes = _qualifying_planes(points_world, normals_world, T_world_camera[:, :3, 3], up, seed)
    if not planes:
        raise SegmentationError(NO_FLOOR)
    count, plane = _lowest(planes, points_world, focus_world)
    flat = (np.linalg.norm(points_world - focus_world, axis=1) < FOCUS_M) & (normals_world @ plane[:3] > 0.9)
    near = points_world[flat & (np.abs(points_world @ plane[:3] + plane[3]) < 2 * BELOW_M)]
    if len(near) >= MIN_NEAR_POINTS:
        plane = _refine(near, plane, 2 * BELOW_M)
    judged = near if len(near) >= MIN_NEAR_POINTS else points_world
    noise_m = _noise_m(plane, judged)
    if noise_m > MAX_NOISE_M:
        raise SegmentationError(NO_FLOOR)
    tilt_rad = _tilt_rad(plane, T_world_camera)
    return Floor(plane, floor_frame(plane), noise_m, count / len(points_world), tilt_rad)


def level_floor(points_world: Float64, T_world_camera: Float64) -> Floor:
    """A floor for a scene without one: level as the cameras were held, at its lowest surface (own rule).

    Only a box that a person gives makes sense of it: its frame is where the box is given.

    Args:
        points_world: (n, 3) points spread evenly over the scene's surface, metres.
        T_world_camera: (m, 4, 4) poses of the good frames.
    """
    up = from_above(T_world_camera)[2]
    lowest_m = float(np.quantile(points_world @ up, LOWEST_SHARE))
    plane = np.append(up, -lowest_m)
    return Floor(plane, floor_frame(plane), 0.0, 0.0, 0.0, found=False)


def floor_frame(plane_world: Float64) -> Float64:
    """T_floor_world of a plane (4,) with upward unit normal, by the rule in `Floor`."""
    z_axis = plane_world[:3]
    for axis in (np.array([1.0, 0, 0]), np.array([0, 0, 1.0])):
        along = axis - (axis @ z_axis) * z_axis
        if np.linalg.norm(along) > 0.1:
            break
    x_axis = along / np.linalg.norm(along)
    T_world_floor = np.eye(4)
    T_world_floor[:3, :3] = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], axis=1)
    T_world_floor[:3, 3] = -plane_world[3] * z_axis
    return invert_rigid(T_world_floor)


def low_cut_m(floor: Floor, settings: SegmentationSettings) -> float:
    """From which height on a surface may be the object's where it goes on above the floor cut, metres.

    `low_cut_m` of the settings, or four standard deviations of the floor if that is more, but at most the
    floor cut itself; that, too, where no floor was measured.

    Args:
        floor: of the recording.
        settings: both cuts.
    """
    if not floor.found:
        return settings.floor_cut_m
    return min(max(settings.low_cut_m, FLOOR_SIGMAS * floor.noise_m), settings.floor_cut_m)


def _qualifying_planes(
    points_world: Float64, normals_world: Float64, cameras_world: Float64, up: Float64, seed: int
) -> list[tuple[int, Float64]]:
    """Of up to six planes of the scene those that may be the floor: (points on it, plane)."""
    rng = np.random.default_rng(seed)
    left = normals_world @ up > MIN_UP_COSINE
    planes: list[tuple[int, Float64]] = []
    for _ in range(CANDIDATES):
        indices = np.flatnonzero(left)
        if len(indices) < max(50, MIN_INLIER_SHARE * len(points_world)):
            break
        plane = _ransac_plane(points_world[indices], normals_world[indices], rng)
        plane = _refine(points_world[indices], plane, 2 * INLIER_M)
        distance_m = points_world @ plane[:3] + plane[3]
        inliers = left & (np.abs(distance_m) < 2 * INLIER_M)
        left &= ~inliers
        qualifies = (
            plane[:3] @ up > MIN_UP_COSINE
            and (cameras_world @ plane[:3] + plane[3]).min() > MIN_CAMERA_HEIGHT_M
            and np.mean(distance_m < -BELOW_M) < MAX_BELOW_SHARE
        )
        if qualifies and inliers.sum() >= MIN_INLIER_SHARE * len(points_world):
            planes.append((int(inliers.sum()), plane))
    return planes


def _ransac_plane(points: Float64, normals: Float64, rng: np.random.Generator) -> Float64:
    """The plane through one point with its own normal that has most inliers (one-point RANSAC)."""
    judged = points[rng.permutation(len(points))[:20_000]]
    chosen = rng.integers(len(points), size=HYPOTHESES)
    offsets = -(points[chosen] * normals[chosen]).sum(axis=1)
    counts = [
        int((np.abs(judged @ normal + offset) < INLIER_M).sum())
        for normal, offset in zip(normals[chosen], offsets, strict=True)
    ]
    best = int(np.argmax(counts))
    return np.append(normals[chosen[best]], offsets[best])


def _refine(points: Float64, plane: Float64, reach_m: float) -> Float64:
    """Least squares on the inliers, which are chosen anew eight times, within 3 robust deviations."""
    for _ in range(8):
        distance_m = points @ plane[:3] + plane[3]
        inliers = points[np.abs(distance_m) < reach_m]
        if len(inliers) < 10:
            return plane
        centre = inliers.mean(axis=0)
        _, _, axes = np.linalg.svd(inliers - centre, full_matrices=False)
        normal = axes[2] * np.sign(axes[2] @ plane[:3])
        plane = np.append(normal, -normal @ centre)
        deviation_m = 1.4826 * np.median(np.abs(inliers @ plane[:3] + plane[3]))
        reach_m = float(np.clip(3 * deviation_m, 0.5 * INLIER_M, 2 * INLIER_M))
    return plane


def _lowest(
    planes: list[tuple[int, Float64]],
    points_world: Float64,
    focus_world: Float64,
) -> tuple[int, Float64]:
    """Of (points, plane): the one with most points, or the lowest parallel one well below it."""
    most = max(planes, key=lambda each: each[0])

    def height_m(plane: Float64) -> float:
        """Of the focus above the plane."""
        return float(focus_world @ plane[:3] + plane[3])

    lower = [
        each
        for each in planes
        if each[1][:3] @ most[1][:3] > PARALLEL_COSINE
        and height_m(each[1]) > height_m(most[1]) + LOWER_M
        and _noise_m(each[1], points_world) < MAX_NOISE_M
    ]
    return max([most, *lower], key=lambda each: height_m(each[1]))


def _noise_m(plane: Float64, points_world: Float64) -> float:
    """Robust standard deviation of the points about a plane that passes through them, metres."""
    distance_m = np.abs(points_world @ plane[:3] + plane[3])
    return float(1.4826 * np.median(distance_m[distance_m < 2 * INLIER_M]))


def _tilt_rad(plane: Float64, T_world_camera: Float64) -> float:
    return float(np.arccos(np.clip(plane[:3] @ from_above(T_world_camera)[2], -1, 1)))
