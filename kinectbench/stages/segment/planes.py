"""Planes of a scene: the frame of one, how flat it is, and which lies below which."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kinectbench.core.geometry import invert_rigid
from kinectbench.core.types import Float64

INLIER_M = 0.02
# Surface lies along a plane if its normal is within 26 degrees of the plane's (own choice): fused depth is
# as rough as that.
FLAT_COSINE = 0.9
# Clutter that a plane happens to cut spreads evenly about it (30 mm); a real floor does not.
MAX_NOISE_M = 0.02
# A plane this parallel to the one with most points, and this much lower, is the floor below a table top.
PARALLEL_COSINE = 0.97
LOWER_M = 0.2
# Of the points so many have a neighbour as near as is usual.
USUAL_SHARE = 0.9


@dataclass(frozen=True)
class Surface:
    """What of a scene is judged; lengths as if cameras were 1 m and more away.

    Attributes:
        points_world: (n, 3) spread evenly, metres.
        normals_world: (n, 3) unit.
        focus_world: (3,) where the cameras look.
        inlier_m: so near to a plane points are on it.
        times_noise: (n,) or one for all: so many times noisier than what the cameras look at each point is.
    """

    points_world: Float64
    normals_world: Float64
    focus_world: Float64
    inlier_m: float
    times_noise: Float64 | float = 1.0

    @cached_property
    def spacing_m(self) -> float:
        """How far a point's nearest neighbour usually is; planes are judged by it one after another."""
        from scipy.spatial import cKDTree

        points = self.points_world
        return float(np.quantile(cKDTree(points).query(points, k=2)[0][:, 1], USUAL_SHARE))

    def focus_above_m(self, plane: Float64) -> float:
        """How far the focus is above a plane (4,)."""
        return float(self.focus_world @ plane[:3] + plane[3])


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


def is_below(lower: Float64, upper: Float64, surface: Surface) -> bool:
    """Whether a plane (4,) is parallel to another, and lies well below it."""
    parallel = lower[:3] @ upper[:3] > PARALLEL_COSINE
    return bool(parallel and surface.focus_above_m(lower) > surface.focus_above_m(upper) + LOWER_M)


def is_flat(plane: Float64, surface: Surface) -> bool:
    """Whether what lies about a plane (4,) is no clutter that it cuts, its noise apart."""
    distance_m = np.abs(surface.points_world @ plane[:3] + plane[3]) / surface.times_noise
    return _noise_m(distance_m, surface.inlier_m) < MAX_NOISE_M


def noise_about_m(plane: Float64, points_world: Float64, inlier_m: float = INLIER_M) -> float:
    """Robust standard deviation of the points about a plane that passes through them, metres."""
    return _noise_m(np.abs(points_world @ plane[:3] + plane[3]), inlier_m)


def _noise_m(distance_m: Float64, inlier_m: float) -> float:
    return float(1.4826 * np.median(distance_m[distance_m < 2 * inlier_m]))
