"""Handheld orbits: a camera is carried around the subject and keeps looking at it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, closest_rotation, rigid
from kinectbench.simulate.solid import Solid

SHAKE_CYCLES = (3.0, 7.0, 12.0)


@dataclass(frozen=True)
class Orbit:
    """An orbit around a point above the room's origin.

    Attributes:
        frames: number of poses.
        arc_rad: angle walked around the subject, radians.
        distance_m: mean distance to the target, metres.
        target_room: (3,) what it looks at, metres.
        elevation_rad: mean angle of the camera above the horizon, radians.
        swing_rad: the elevation rises and falls by so much, radians.
        swings: how often it rises and falls.
        shake_m: amplitude of the hand's shake, metres.
        shake_rad: amplitude of the hand's shake, radians.
    """

    frames: int
    arc_rad: float
    distance_m: float
    target_room: tuple[float, float, float]
    elevation_rad: float = 0.44
    swing_rad: float = 0.33
    swings: float = 1.6
    shake_m: float = 0.012
    shake_rad: float = 0.02


def orbit_around(subject: Solid, camera: Camera, frames: int, arc_rad: float) -> Orbit:
    """An orbit from which the whole subject just about fits into the image."""
    low, high = subject.bounds_m()
    target = (low + high) / 2
    radius = float(np.linalg.norm(high - target))
    half_view = min(np.arctan(camera.width / 2 / camera.fx), np.arctan(camera.height / 2 / camera.fy))
    return Orbit(frames, arc_rad, float(radius / np.sin(half_view)), (0.0, 0.0, float(target[2])))


def orbit_poses(orbit: Orbit, rng: np.random.Generator) -> NDArray[np.float64]:
    """Poses (n, 4, 4) `T_room_camera` in optical axes (x right, y down, z forward)."""
    share = np.linspace(0, 1, orbit.frames)
    turn = rng.uniform(0, 2 * np.pi) + orbit.arc_rad * share
    swing = np.sin(2 * np.pi * (orbit.swings * share + rng.uniform()))
    elevation = orbit.elevation_rad + orbit.swing_rad * swing
    outward = np.column_stack(
        [np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation)]
    )
    distance_m = orbit.distance_m * (1 + 0.04 * _smooth(rng, share)[:, None])
    target = np.array(orbit.target_room)
    shake = np.stack([_smooth(rng, share) for _ in range(6)], axis=1)
    positions = target + outward * distance_m + orbit.shake_m * shake[:, :3]
    looks = [look_at(position, target) for position in positions]
    wobbles = orbit.shake_rad * shake[:, 3:]
    return np.stack(
        [
            look @ rigid(_small_rotation(wobble), np.zeros(3))
            for look, wobble in zip(looks, wobbles, strict=True)
        ]
    )


def look_at(position_room: NDArray[np.float64], target_room: NDArray[np.float64]) -> NDArray[np.float64]:
    """The level pose (4, 4) `T_room_camera` that looks at a target, not one straight above or below."""
    forward = target_room - position_room
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return rigid(np.column_stack([right, np.cross(forward, right), forward]), position_room)


def _smooth(rng: np.random.Generator, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """A smooth random curve (n,) within [-1, 1]."""
    phases = rng.uniform(0, 2 * np.pi, len(SHAKE_CYCLES))
    waves = [np.sin(2 * np.pi * c * share + p) for c, p in zip(SHAKE_CYCLES, phases, strict=True)]
    return np.asarray(np.mean(waves, axis=0), dtype=np.float64)


def _small_rotation(angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation (3, 3) by small angles about x, y and z."""
    x, y, z = angles_rad
    return closest_rotation(np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]]))
