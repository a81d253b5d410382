"""Handheld camera paths: carried around the object at changing speed, always looking at it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kinectbench.core.geometry import Camera, TriangleMesh, rigid
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.spec import PathSettings

# A hand shakes below about 6 Hz, the faster the less; a walker's pace varies over seconds (own choices).
SHAKE_HZ = np.geomspace(0.3, 6.0, 9)
PACE_HZ = np.array([0.07, 0.13, 0.23])
REACH_HZ = np.array([0.05, 0.11])
REACH_SHARE = 0.04
PROGRESS_STEP_S = 0.005
JOLT_HZ, JOLT_DECAY_S = 4.0, 0.12
FIT_MARGIN = 1.06
# Nobody holds a camera closer to the floor, but for the shake.
LOWEST_M = 0.25


@dataclass(frozen=True)
class Waves:
    """Smooth random curves: sums of sines with random phases, each of standard deviation 1.

    Attributes:
        frequency_hz: (k,).
        amplitude: (k,), for a standard deviation of 1.
        phase_rad: (k, curves).
    """

    frequency_hz: Float64
    amplitude: Float64
    phase_rad: Float64

    def at(self, time_s: Float64) -> Float64:
        """Values (n, curves) at times (n,) in seconds."""
        angle = 2 * np.pi * self.frequency_hz[:, None] * time_s
        waves = np.sin(angle[:, :, None] + self.phase_rad[:, None, :])
        return np.asarray(np.einsum("k,knc->nc", self.amplitude, waves))


def draw_waves(frequency_hz: Float64, curves: int, rng: np.random.Generator) -> Waves:
    """Draw curves whose amplitudes fall as 1 / frequency."""
    amplitude = 1 / frequency_hz
    amplitude = amplitude * np.sqrt(2 / np.sum(amplitude**2))
    return Waves(frequency_hz, amplitude, rng.uniform(0, 2 * np.pi, (len(frequency_hz), curves)))


@dataclass(frozen=True)
class CameraPath:
    """A camera's motion as a function of time, in frame `room`.

    Attributes:
        settings: its shape.
        target_room: (3,) what it looks at, metres.
        distance_m: mean distance to the target.
        start_rad: direction from the target to the camera at the start.
        swing_phase_rad: where in its rise and fall the camera starts.
        knots_s: (k,) ascending times.
        knots_share: (k,) share of the way that is done at these times, 0 to 1.
        shake: six curves, of position and of orientation.
        reach: one curve, of the distance.
        jolt: (6,) direction of the knock, of position and of orientation, unit vectors.
    """

    settings: PathSettings
    target_room: Float64
    distance_m: float
    start_rad: float
    swing_phase_rad: float
    knots_s: Float64
    knots_share: Float64
    shake: Waves
    reach: Waves
    jolt: Float64

    @property
    def duration_s(self) -> float:
        """Time of the last frame."""
        return (self.settings.frames - 1) / self.settings.rate_hz

    def poses(self, time_s: Float64) -> Float64:
        """`T_room_camera` (n, 4, 4) in optical axes at times (n,) in seconds; also beyond both ends."""
        chosen = self.settings
        share = np.interp(time_s, self.knots_s, self.knots_share)
        turn = self.start_rad + chosen.arc_rad * share
        swing = np.sin(2 * np.pi * chosen.swings * share + self.swing_phase_rad)
        lowest = np.arcsin(np.clip((LOWEST_M - self.target_room[2]) / self.distance_m, -1, 1))
        rise = np.maximum(chosen.elevation_rad + chosen.swing_rad * swing, lowest)
        outward = np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], axis=-1)
        reach = self.distance_m * (1 + REACH_SHARE * self.reach.at(time_s))
        shake = self.shake.at(time_s)
        knock = self._knock(time_s)
        moved = chosen.shake_m * shake[:, :3] + chosen.jolt_m * knock[:, :3]
        turned = chosen.shake_rad * shake[:, 3:] + chosen.jolt_rad * knock[:, 3:]
        positions = self.target_room + outward * reach + moved
        looks = np.stack(
            [look_at(self.target_room + o * r, self.target_room) for o, r in zip(outward, reach, strict=True)]
        )
        looks[:, :3, :3] = looks[:, :3, :3] @ Rotation.from_rotvec(turned).as_matrix()
        looks[:, :3, 3] = positions
        return looks

    def _knock(self, time_s: Float64) -> Float64:
        """The knock's course (n, 6): a damped swing that starts at two thirds of the way; peak about 1."""
        since = np.maximum(time_s - self.duration_s * 2 / 3, 0)
        course = 1.6 * np.exp(-since / JOLT_DECAY_S) * np.sin(2 * np.pi * JOLT_HZ * since)
        return np.asarray(course[:, None] * self.jolt)


def draw_path(
    settings: PathSettings, subject: TriangleMesh, camera: Camera, rng: np.random.Generator
) -> CameraPath:
    """Draw a path around a subject that stands at the room's origin.

    Args:
        settings: its shape; without a distance, the subject just fits into the image.
        subject: its mesh, z up, metres.
        camera: the depth camera.
        rng: draws everything else.
    """
    low, high = subject.vertices.min(axis=0), subject.vertices.max(axis=0)
    target_room = np.array([0.0, 0.0, (low[2] + high[2]) / 2])
    knots_s, knots_share = _progress(settings, draw_waves(PACE_HZ, 1, rng))
    directions = rng.standard_normal((2, 3))
    return CameraPath(
        settings=settings,
        target_room=target_room,
        distance_m=settings.distance_m or _fitting_distance_m(subject, target_room, camera),
        start_rad=float(rng.uniform(0, 2 * np.pi)),
        swing_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        knots_s=knots_s,
        knots_share=knots_share,
        shake=draw_waves(SHAKE_HZ, 6, rng),
        reach=draw_waves(REACH_HZ, 1, rng),
        jolt=(directions / np.linalg.norm(directions, axis=1, keepdims=True)).ravel(),
    )


def _fitting_distance_m(subject: TriangleMesh, target_room: Float64, camera: Camera) -> float:
    """From where a ball around the subject just fits into the image, with a small margin."""
    radius_m = float(np.linalg.norm(subject.vertices - target_room, axis=1).max())
    half_view = min(np.arctan(camera.width / 2 / camera.fx), np.arctan(camera.height / 2 / camera.fy))
    return FIT_MARGIN * radius_m / float(np.sin(half_view))


def _progress(settings: PathSettings, pace: Waves) -> tuple[Float64, Float64]:
    """Times (k,) in seconds and the share of the way (k,) done by then: pace varies, and is 0 in a pause."""
    duration_s = (settings.frames - 1) / settings.rate_hz
    if duration_s == 0:
        return np.array([0.0]), np.array([0.0])
    time_s = np.linspace(0, duration_s, max(2, int(np.ceil(duration_s / PROGRESS_STEP_S))))
    speed = 1 + settings.speed_variation * np.clip(pace.at(time_s)[:, 0], -1, 1)
    pausing = np.abs(time_s - duration_s / 2) < settings.pause_s / 2
    speed = np.where(pausing, 0.0, speed)
    done = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)])
    return time_s, done / done[-1] if done[-1] > 0 else done


def look_at(position_room: Float64, target_room: Float64) -> Float64:
    """The level pose (4, 4) `T_room_camera` that looks at a target, not one straight above or below."""
    forward = target_room - position_room
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return rigid(np.column_stack([right, np.cross(forward, right), forward]), position_room)
