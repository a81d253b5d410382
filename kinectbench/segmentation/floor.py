"""The floor plane: not the largest plane, but the one the cameras stand above."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import SegmentationError
from kinectbench.geometry import invert_rigid

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
NO_FLOOR = "no floor found: no plane below all cameras that faces up; record with more of the floor in view"


@dataclass(frozen=True)
class Floor:
    """The floor of a recording.

    Attributes:
        plane_world: (4,) a, b, c, d with a x + b y + c z + d = 0; (a, b, c) is the unit normal, upward.
        T_floor_world: (4, 4); frame `floor`: z up, floor at z = 0, origin below the world's origin, x
            along the world's x axis projected onto the floor (or its z axis where that is degenerate).
        noise_m: robust standard deviation of the surface around the plane, metres.
        inlier_share: share of the scene's surface that lies on the plane.
    """

    plane_world: NDArray[np.float64]
    T_floor_world: NDArray[np.float64]
    noise_m: float
    inlier_share: float

    @property
    def T_world_floor(self) -> NDArray[np.float64]:
        """(4, 4), maps the floor frame to the world."""
        return invert_rigid(self.T_floor_world)


def find_floor(
    points_world: NDArray[np.float64],
    normals_world: NDArray[np.float64],
    T_world_camera: NDArray[np.float64],
    focus_world: NDArray[np.float64],
    seed: int,
) -> Floor:
    """Find the floor among up to six planes of the scene.

    A plane qualifies if its normal agrees with the cameras' mean up direction (cosine > 0.6), every
    camera is more than 0.1 m above it, and under 5 % of the points are below it. Of those that
    qualify, the one with most points is the floor. It is then refined by least squares where it
    matters, within 1.2 m of the focus: farther floor is measured with several times the noise, and a
    Kinect's depth bias grows with distance.

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
    cameras = T_world_camera[:, :3, 3]
    rng = np.random.default_rng(seed)
    left = normals_world @ up > MIN_UP_COSINE
    best: tuple[int, NDArray[np.float64]] | None = None
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
            and (cameras @ plane[:3] + plane[3]).min() > MIN_CAMERA_HEIGHT_M
            and np.mean(distance_m < -BELOW_M) < MAX_BELOW_SHARE
        )
        if qualifies and (best is None or inliers.sum() > best[0]):
            best = (int(inliers.sum()), plane)
    if best is None:
        raise SegmentationError(NO_FLOOR)
    plane = best[1]
    flat = (np.linalg.norm(points_world - focus_world, axis=1) < FOCUS_M) & (normals_world @ plane[:3] > 0.9)
    near = points_world[flat & (np.abs(points_world @ plane[:3] + plane[3]) < 2 * BELOW_M)]
    if len(near) >= MIN_NEAR_POINTS:
        plane = _refine(near, plane, 2 * BELOW_M)
    return _describe(
        plane, near if len(near) >= MIN_NEAR_POINTS else points_world, best[0] / len(points_world)
    )


def floor_frame(plane_world: NDArray[np.float64]) -> NDArray[np.float64]:
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


def _ransac_plane(
    points: NDArray[np.float64], normals: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
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


def _refine(points: NDArray[np.float64], plane: NDArray[np.float64], reach_m: float) -> NDArray[np.float64]:
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


def _describe(plane: NDArray[np.float64], points_world: NDArray[np.float64], inlier_share: float) -> Floor:
    distance_m = points_world @ plane[:3] + plane[3]
    near = np.abs(distance_m[np.abs(distance_m) < 2 * INLIER_M])
    noise_m = float(1.4826 * np.median(near))
    if noise_m > MAX_NOISE_M:
        raise SegmentationError(NO_FLOOR)
    return Floor(plane, floor_frame(plane), noise_m, inlier_share)
