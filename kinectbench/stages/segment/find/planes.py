"""Planes of a scene: frames, heights, angles, flatness, what one carries, and whether a given one is seen.

A plane is a, b, c, d with a x + b y + c z + d = 0; (a, b, c) is its unit normal.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core.geometry import invert_rigid, ransac_plane, refine, transform_points
from kinectbench.core.types import Float64, Int64
from kinectbench.core.voxels.point_cells import connected
from kinectbench.stages.segment.find.hints import MIN_GRAVITY_COSINE
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
# A plane is refined with the surface within this distance, near what the cameras look at.
NEAR_PLANE_M, FOCUS_M = 0.1, 1.2
# Fewer points there say less of the plane than the whole scene does.
MIN_NEAR_POINTS = 100
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

GIVEN = "the plane that benchmark.yaml gives as `floor`"
# The plane that is seen is the one given if it is off by at most this, or this many times its noise, and
# turned by at most this (chosen by hand; floors scatter by 1 to 6 mm, their fits by less than 0.5 degrees).
LEAST_OFF_M, OFF_SIGMAS, TURNED_DEG = 0.010, 3.0, 3.0
# A person means the plane given if it has points of its own, within this distance: at least this share of the
# points of the plane beside it. A board on a floor is one of two planes that are seen (chosen by hand).
OWN_SHARE, LEAST_ON_M = 0.05, 0.005


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
        return float(above_m(plane, self.focus_world))


def above_m(plane: Float64, points: Float64) -> Float64:
    """Return the heights of points (..., 3) above a plane (4,), metres; negative below it."""
    return np.asarray(points @ plane[:3] + plane[3])


def turn_rad(plane: Float64, other: Float64) -> float:
    """Return the angle between the normals of planes (4,), or to a unit vector (3,), radians."""
    return float(np.arccos(np.clip(plane[:3] @ other[:3], -1, 1)))


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
    distance_m = np.abs(above_m(plane, surface.points_world)) / surface.times_noise
    return _noise_m(distance_m, surface.inlier_m) < MAX_NOISE_M


def noise_about_m(plane: Float64, points_world: Float64, inlier_m: float) -> float:
    """Robust standard deviation about a plane (4,), metres, of the points (n, 3) within twice `inlier_m`.

    It is infinite if no points are.
    """
    return _noise_m(np.abs(above_m(plane, points_world)), inlier_m)


def _noise_m(distance_m: Float64, inlier_m: float) -> float:
    near_m = distance_m[distance_m < 2 * inlier_m]
    return float(1.4826 * np.median(near_m)) if len(near_m) else np.inf


def refined_near(plane: Float64, surface: SceneSurface) -> tuple[Float64, float]:
    """Refine a plane (4,) by the surface near the focus. Do nothing if there are too few points.

    Return the plane, and the robust standard deviation of the surface about the plane, metres.
    """
    points_world, inlier_m = surface.points_world, surface.inlier_m
    flat = np.linalg.norm(points_world - surface.focus_world, axis=1) < FOCUS_M
    flat &= surface.normals_world @ plane[:3] > FLAT_COSINE
    near = points_world[flat & (np.abs(above_m(plane, points_world)) < NEAR_PLANE_M)]
    if len(near) < MIN_NEAR_POINTS:
        return plane, noise_about_m(plane, points_world, inlier_m)
    plane = refine(near, plane, NEAR_PLANE_M if inlier_m == INLIER_M else inlier_m, inlier_m)
    return plane, noise_about_m(plane, near, inlier_m)


def carries_what_is_looked_at(plane: Float64, surface: SceneSurface) -> bool:
    """Whether a plane (4,) carries the object at the focus and is larger than it.

    It is larger if it is twice as long as the object, or if it extends beyond the object on most sides and
    the cameras look at the object rather than at the plane. The object must stand on the plane: a lamp that
    stands beside a table and reaches over it does not.
    """
    height_m = above_m(plane, surface.points_world)
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
    turn_deg = np.degrees(turn_rad(plane_world, up_world))
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
    near &= np.abs(above_m(plane, points)) < NEAR_PLANE_M
    near &= np.linalg.norm(points - surface.focus_world, axis=1) < FOCUS_M
    if near.sum() < MIN_NEAR_POINTS:
        return None
    points, normals, inlier_m = points[near], normals[near], surface.inlier_m
    seen = ransac_plane(points, normals, np.random.default_rng(0), inlier_m)
    seen = refine(points, seen, 2 * inlier_m, inlier_m)
    on_seen = points[np.abs(above_m(seen, points)) < inlier_m]
    if len(on_seen) < MIN_NEAR_POINTS:
        return None
    noise_m = noise_about_m(seen, on_seen, inlier_m)
    off_m = float(above_m(plane, on_seen.mean(axis=0)))
    turn_deg = float(np.degrees(turn_rad(seen, plane)))
    off_noise_m = max(LEAST_OFF_M, OFF_SIGMAS * noise_m)
    if abs(off_m) <= off_noise_m and turn_deg <= TURNED_DEG:
        return None
    own = np.abs(above_m(plane, points)) < max(LEAST_ON_M, noise_m)
    own &= np.abs(above_m(seen, points)) > off_noise_m
    return None if own.sum() > OWN_SHARE * len(on_seen) else (seen, off_m, turn_deg)
