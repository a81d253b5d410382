"""What speaks against the plane that a person gives as the floor: gravity, and a plane seen beside it."""

import numpy as np

from kinectbench.core.types import Float64
from kinectbench.stages.segment.floor_planes import (
    FOCUS_M,
    MIN_NEAR_POINTS,
    NEAR_PLANE_M,
    ransac_plane,
    refine,
)
from kinectbench.stages.segment.planes import FLAT_COSINE, Surface, noise_about_m
from kinectbench.stages.segment.up import MIN_GRAVITY_COSINE

GIVEN = "the plane that benchmark.yaml gives as `floor`"
# The plane that is seen is the one given if it is off by no more than this, or so many times its noise, and
# turned by no more than this (own choices; floors scatter by 1 to 6 mm, their fits by less than 0.5 degrees).
LEAST_OFF_M, OFF_SIGMAS, TURNED_DEG = 0.010, 3.0, 3.0
# A person means what lies on the plane given where so many points do that are not of the one beside it, as a
# share of the points of that: a board on a floor is one of two planes that are seen (own choice).
OWN_SHARE, LEAST_ON_M = 0.05, 0.005


def against_plane(
    plane_world: Float64, surface: Surface, up_world: Float64 | None, scale: float
) -> tuple[str, ...]:
    """What speaks against a person's plane, one line for people each; an advice follows after a semicolon.

    Only a plane within 0.1 m of the one given, and off by more than noise, speaks against it: where a table
    and the floor are seen, a person says which is meant.

    Args:
        plane_world: (4,) a, b, c, d with unit (a, b, c) up and a x + b y + c z + d = 0, metres.
        surface: of the scene, as if the cameras were 1 m and more from what they look at.
        up_world: (3,) unit, up by gravity; None: not known.
        scale: the world is so many times as large as that of `surface`.
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
    """A line for people if a person's plane (4,) is not level by gravity, as `against_plane` has them.

    Args:
        plane_world: a, b, c, d with unit (a, b, c) up.
        up_world: (3,) unit, or None: not known.
    """
    if up_world is None or plane_world[:3] @ up_world >= MIN_GRAVITY_COSINE:
        return ()
    turn_deg = float(np.degrees(np.arccos(np.clip(plane_world[:3] @ up_world, -1, 1))))
    return (
        f"{GIVEN} is turned by {turn_deg:.0f} degrees against level by gravity; give one whose normal "
        "points up, in the frame of the trajectory",
    )


def _beside(plane: Float64, surface: Surface) -> tuple[Float64, float, float] | None:
    """A plane (4,) seen right beside another, how far above that it lies, and by how many degrees turned.

    None if the surface shows none near what the cameras look at, or the other itself.
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
