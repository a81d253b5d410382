"""Planes of a scene: the frame of one, how flat it is, and which lies below which."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

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


class Plane(NamedTuple):
    """A plane of the scene: (4,) with its unit normal up, its points, and whether hardly any lies below."""

    plane: Float64
    points: int
    is_lowest: bool


@dataclass(frozen=True)
class Surface:
    """What of a scene is judged; lengths as if cameras were 1 m and more away.

    Attributes:
        points_world: (n, 3) spread evenly, metres.
        normals_world: (n, 3) unit.
        focus_world: (3,) where the cameras look.
        inlier_m: so near to a plane points are on it.
    """

    points_world: Float64
    normals_world: Float64
    focus_world: Float64
    inlier_m: float

    @cached_property
    def spacing_m(self) -> float:
        """How far a point's nearest neighbour usually is; planes are judged by it one after another."""
        from scipy.spatial import cKDTree

        points = self.points_world
        return float(np.quantile(cKDTree(points).query(points, k=2)[0][:, 1], USUAL_SHARE))

    def focus_above_m(self, plane: Plane) -> float:
        """How far the focus is above a plane."""
        return float(self.focus_world @ plane.plane[:3] + plane.plane[3])


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


def is_below(lower: Plane, upper: Plane, surface: Surface) -> bool:
    """Whether a plane is parallel to another, and lies well below it."""
    parallel = lower.plane[:3] @ upper.plane[:3] > PARALLEL_COSINE
    return bool(parallel and surface.focus_above_m(lower) > surface.focus_above_m(upper) + LOWER_M)


def is_flat(plane: Plane, surface: Surface) -> bool:
    """Whether what lies about a plane is no clutter that it cuts."""
    return noise_about_m(plane.plane, surface.points_world, surface.inlier_m) < MAX_NOISE_M


def noise_about_m(plane: Float64, points_world: Float64, inlier_m: float = INLIER_M) -> float:
    """Robust standard deviation of the points about a plane that passes through them, metres."""
    distance_m = np.abs(points_world @ plane[:3] + plane[3])
    return float(1.4826 * np.median(distance_m[distance_m < 2 * inlier_m]))
