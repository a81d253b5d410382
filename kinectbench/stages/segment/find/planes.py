"""Planes of a scene: their frames, flatness and order, and whether one carries the object."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.types import Float64, Int64
from kinectbench.core.voxels.point_cells import connected
from kinectbench.stages.segment.find.pieces import GROUNDED_M, SMALL_CELLS, fit_box

# Points this near to a plane are on it: floors scatter by 1 to 6 mm, and this holds three times the worst
# (chosen by hand).
INLIER_M = 0.02
# Surface lies along a plane if its normal is within 26 degrees of the plane's (chosen by hand): fused depth
# is as rough as that.
FLAT_COSINE = 0.9
# Clutter that a plane cuts spreads evenly about it (30 mm); a real floor does not.
MAX_NOISE_M = 0.02
# A plane this parallel to the one with most points, and this much lower, is the floor below a table top.
PARALLEL_COSINE, LOWER_M = 0.97, 0.2
# This share of the points has a neighbour within the spacing.
SPACING_QUANTILE = 0.9
# The focus may lie this far below the support of a flat thing: people aim no better than a finger's breadth.
FOCUS_BELOW_M = 0.03
# A thing that stands on a plane rises this far above it.
CUT_M = 0.02
# A thing is at most this share as long as the plane that it stands on: a chair's back is as long as its seat,
# and stands on the floor with it; a kettle is a third of the visible part of a table (chosen by hand).
MAX_SHARE_OF_PLANE = 0.5
# A larger thing stands on the plane if the plane reaches beyond it on this share of a number of sides (a
# chair's back ends with its seat, behind and beside), and if the focus is at least this share of the thing's
# height above the plane (chosen by hand; a bin on a small table .37, furniture 0).
SIDES, MOST_SIDES, LEAST_HEIGHT = 12, 0.75, 0.2
# The cameras look at it if their focus is at most this many of its longer sides beside it (chosen by hand).
MAX_BESIDE = 0.5
# Points lie at most this many times the spacing apart (chosen by hand): cells of that edge touch.
SPACINGS = 2.0


@dataclass(frozen=True)
class SceneSurface:
    """The surface of a scene, scaled so that the cameras are at least 1 m from the focus.

    Attributes:
        points_world: (n, 3) spread evenly, metres.
        normals_world: (n, 3) unit.
        focus_world: (3,) where the cameras look.
        inlier_m: points this near to a plane are on it.
        times_noise: (n,), or one number for all: noise of each point divided by that at the focus.
    """

    points_world: Float64
    normals_world: Float64
    focus_world: Float64
    inlier_m: float
    times_noise: Float64 | float = 1.0

    @cached_property
    def spacing_m(self) -> float:
        """The distance within which 90 % of the points have a neighbour, metres."""
        points = self.points_world
        return float(np.quantile(cKDTree(points).query(points, k=2)[0][:, 1], SPACING_QUANTILE))

    def focus_above_m(self, plane: Float64) -> float:
        """Return the height of the focus above a plane (4,)."""
        return float(self.focus_world @ plane[:3] + plane[3])


def floor_frame(plane_world: Float64) -> Float64:
    """Return T_floor_world (4, 4) of a plane (4,): the frame whose z axis is the plane's unit normal.

    The origin is the point of the plane nearest to the world's origin. The x axis is the world's x axis
    projected onto the plane, or the world's z axis if the x axis is nearly normal to the plane.
    """
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


def is_below(lower: Float64, upper: Float64, surface: SceneSurface) -> bool:
    """Whether the plane `lower` (4,) is parallel to `upper`, and over 0.2 m below it at the focus."""
    parallel = lower[:3] @ upper[:3] > PARALLEL_COSINE
    return bool(parallel and surface.focus_above_m(lower) > surface.focus_above_m(upper) + LOWER_M)


def is_flat(plane: Float64, surface: SceneSurface) -> bool:
    """Whether the surface about a plane (4,) is flat, and not clutter that the plane cuts."""
    distance_m = np.abs(surface.points_world @ plane[:3] + plane[3]) / surface.times_noise
    return _noise_m(distance_m, surface.inlier_m) < MAX_NOISE_M


def noise_about_m(plane: Float64, points_world: Float64, inlier_m: float = INLIER_M) -> float:
    """Robust standard deviation about a plane (4,), metres, of the points (n, 3) within twice `inlier_m`."""
    return _noise_m(np.abs(points_world @ plane[:3] + plane[3]), inlier_m)


def _noise_m(distance_m: Float64, inlier_m: float) -> float:
    return float(1.4826 * np.median(distance_m[distance_m < 2 * inlier_m]))


def carries_what_is_looked_at(plane: Float64, surface: SceneSurface) -> bool:
    """Whether a plane (4,) carries the object at the focus and is larger than it.

    It is larger if it is twice as long as the object, or if it extends beyond the object on most sides and
    the cameras look at the object rather than at the plane. The object must stand on the plane: a lamp that
    stands beside a table and reaches over it does not.
    """
    height_m = surface.points_world @ plane[:3] + plane[3]
    focus_m = surface.focus_above_m(plane)
    if focus_m < -FOCUS_BELOW_M:
        return False
    T_level_world = floor_frame(plane)
    local = transform_points(T_level_world, surface.points_world)
    focus = transform_points(T_level_world, surface.focus_world)
    cell_m = SPACINGS * surface.spacing_m
    on_plane = (np.abs(height_m) < 2 * surface.inlier_m) & (surface.normals_world @ plane[:3] > FLAT_COSINE)
    thing = _nearest_piece(local[height_m > CUT_M], focus, cell_m)
    patch = _nearest_piece(local[on_plane] * [1, 1, 0], focus * [1, 1, 0], cell_m)
    if thing is None or patch is None:
        return False
    long_m, around = max(fit_box(thing).size_m[:2]), fit_box(patch)
    beside_m = float(np.linalg.norm(thing[:, :2] - focus[:2], axis=1).min())
    stands = thing[:, 2] <= GROUNDED_M
    if not stands.any():
        return False
    foot = np.append(np.median(thing[stands, :2], axis=0), around.center_m[2])
    is_larger = long_m <= MAX_SHARE_OF_PLANE * max(around.size_m[:2]) or (
        focus_m >= LEAST_HEIGHT * float(thing[:, 2].max()) and _surrounds(patch[:, :2], thing[:, :2])
    )
    return bool(around.contains(foot[None])[0] and is_larger and beside_m <= MAX_BESIDE * long_m)


def _surrounds(patch: Float64, thing: Float64) -> bool:
    """Whether points `patch` (k, 2) reach farther than `thing` (n, 2) on most sides of its middle."""
    middle = (thing.min(axis=0) + thing.max(axis=0)) / 2
    reach_m = np.zeros((2, SIDES))
    for row, points in enumerate((patch - middle, thing - middle)):
        turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5
        side = (turn * SIDES).astype(np.int64) % SIDES
        np.maximum.at(reach_m[row], side, np.linalg.norm(points, axis=1))
    return bool((reach_m[0] > reach_m[1]).mean() >= MOST_SIDES)


def _nearest_piece(points: Float64, focus: Float64, cell_m: float) -> Float64 | None:
    """Return the connected piece (k, 3) of points nearest to the focus; None if none is large enough."""
    if len(points) < SMALL_CELLS:
        return None
    label: Int64 = connected(points, cell_m).astype(np.int64)
    distance_m = np.full(int(label.max()) + 1, np.inf)
    np.minimum.at(distance_m, label, np.linalg.norm(points - focus, axis=1))
    distance_m[np.bincount(label) < SMALL_CELLS] = np.inf
    if not np.isfinite(distance_m).any():
        return None
    return np.asarray(points[label == np.argmin(distance_m)])
