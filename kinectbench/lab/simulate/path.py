"""Camera paths around the object: a hand-held walk, or views in random order."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kinectbench.core.geometry import Camera, TriangleMesh, rigid
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.spec import PathSettings

# A hand shakes below about 6 Hz, with an amplitude that falls with frequency; a walker's pace varies over
# seconds.
SHAKE_HZ = np.geomspace(0.3, 6.0, 9)
PACE_HZ = np.array([0.07, 0.13, 0.23])
REACH_HZ = np.array([0.05, 0.11])
PROGRESS_STEP_S = 0.005
JOLT_HZ, JOLT_DECAY_S = 4.0, 0.12
FIT_MARGIN = 1.06
# Two sines of these frequencies, with standard deviation 1, reach 1.87 at most.
REACH_PEAK = 1.9
# On a low pass the hand sinks and rises by the first value; it is lowered over the second share of the path
# before (chosen here).
LOW_SWING_M, LOWERED_SHARE = 0.05, 0.05
# Largest elevation of a view whose right is level: 86 degrees.
STEEPEST_RAD = 1.5
# The camera's axes in the order of the rotations: roll, pitch, yaw.
TURN_AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
GOLDEN_SHARE = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class Waves:
    """Smooth random curves over time: each is a sum of k sines, with standard deviation 1.

    Attributes:
        frequency_hz: (k,) frequencies of the sines, the same for all curves.
        amplitude: (k,) amplitudes of the sines.
        phase_rad: (k, curves) random phases.
    """

    frequency_hz: Float64
    amplitude: Float64
    phase_rad: Float64

    def at(self, time_s: Float64) -> Float64:
        """Return the curves' values (n, curves) at times (n,) in seconds."""
        angle = 2 * np.pi * self.frequency_hz[:, None] * time_s
        waves = np.sin(angle[:, :, None] + self.phase_rad[:, None, :])
        return np.asarray(np.einsum("k,knc->nc", self.amplitude, waves))


def draw_waves(frequency_hz: Float64, curves: int, rng: np.random.Generator) -> Waves:
    """Draw random curves: sums of sines of these frequencies, with amplitudes that fall as 1 / frequency."""
    amplitude = 1 / frequency_hz
    amplitude = amplitude * np.sqrt(2 / np.sum(amplitude**2))
    return Waves(frequency_hz, amplitude, rng.uniform(0, 2 * np.pi, (len(frequency_hz), curves)))


@dataclass(frozen=True)
class CameraPath:
    """A camera's motion as a function of time, in frame `room`.

    Attributes:
        settings: the settings of the path's shape.
        target_room: (3,) the point to look at, metres.
        distance_m: mean distance to the target.
        start_rad: azimuth from the target to the camera at the start.
        swing_phase_rad: phase of the elevation's rise and fall at the start.
        knots_s: (k,) ascending times.
        knots_share: (k,) share of the path covered at these times, 0 to 1.
        shake: six curves of the hand's shake: three for position, three for orientation.
        reach: one curve, for the relative change of the distance.
        jolt: (6,) two unit vectors: direction of the knock's displacement, and axis of its rotation.
        stations_rad: (frames, 2) azimuth and elevation of views in random order; None on a walk.
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
    stations_rad: Float64 | None

    @property
    def duration_s(self) -> float:
        """Time of the last frame, seconds."""
        return (self.settings.frames - 1) / self.settings.rate_hz

    def poses(self, time_s: Float64) -> Float64:
        """Return `T_room_camera` (n, 4, 4), optical axes, at any times (n,) in seconds."""
        chosen = self.settings
        turn, rise = self._stations(time_s)
        lowest = np.arcsin(np.clip((chosen.lowest_m - self.target_room[2]) / self.distance_m, -1, 1))
        rise = np.clip(rise, lowest, STEEPEST_RAD)
        outward = np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], axis=-1)
        reach = self.distance_m * (1 + chosen.reach_share * self.reach.at(time_s))
        shake = self.shake.at(time_s)
        knock = self._knock(time_s)
        moved = chosen.shake_m * shake[:, :3] + chosen.jolt_m * knock[:, :3]
        turned = chosen.shake_rad * shake[:, 3:] + chosen.jolt_rad * knock[:, 3:]
        positions = self.target_room + outward * reach + moved
        looks = np.stack(
            [look_at(self.target_room + o * r, self.target_room) for o, r in zip(outward, reach, strict=True)]
        )
        looks[:, :3, :3] = looks[:, :3, :3] @ Rotation.from_rotvec(turned).as_matrix()
        if chosen.turn_rad > 0:
            looks[:, :3, :3] = looks[:, :3, :3] @ Rotation.from_rotvec(self._turns(time_s)).as_matrix()
        looks[:, :3, 3] = positions
        return looks

    def _stations(self, time_s: Float64) -> tuple[Float64, Float64]:
        """Return azimuth and elevation, each (n,) radians, at times (n,) in seconds.

        Views in random order have those of the view that is nearest in time.
        """
        chosen = self.settings
        if self.stations_rad is not None:
            frame = np.clip(np.rint(time_s * chosen.rate_hz), 0, chosen.frames - 1).astype(np.int64)
            return self.stations_rad[frame, 0], self.stations_rad[frame, 1]
        share = np.interp(time_s, self.knots_s, self.knots_share)
        swing = np.sin(2 * np.pi * chosen.swings * share + self.swing_phase_rad)
        rise = chosen.elevation_rad + chosen.swing_rad * swing
        if chosen.low_pass_share > 0:
            height_m = chosen.low_pass_m + LOW_SWING_M * swing - self.target_room[2]
            low = np.arcsin(np.clip(height_m / self.distance_m, -1, 1))
            down = np.clip((share - (1 - chosen.low_pass_share)) / LOWERED_SHARE, 0, 1)
            rise += (low - rise) * down**2 * (3 - 2 * down)
        return self.start_rad + chosen.arc_rad * share, rise

    def _turns(self, time_s: Float64) -> Float64:
        """Return rotation vectors (n, 3), in camera axes, of the camera's repeated turns at times (n,).

        The camera turns about roll, pitch and yaw, one after the other and again and again. About each axis,
        it turns to one side and back, then to the other side and back.
        """
        chosen = self.settings
        # The angle A (1 - cos(2 pi t / period)) / 2 is fastest at a quarter of its period: pi A / period.
        number, since = np.divmod(time_s * chosen.turn_rad_per_s / (np.pi * chosen.turn_rad), 1)
        axis, side = np.mod(number // 2, 3).astype(np.int64), 1 - 2 * np.mod(number, 2)
        angle_rad = side * chosen.turn_rad * (1 - np.cos(2 * np.pi * since)) / 2
        return np.asarray(angle_rad[:, None] * TURN_AXES[axis])

    def _knock(self, time_s: Float64) -> Float64:
        """Return displacement and rotation (n, 6) of a knock against the camera, with a peak of about 1.

        It is a damped oscillation that starts after two thirds of the recording.
        """
        since = np.maximum(time_s - self.duration_s * 2 / 3, 0)
        course = 1.6 * np.exp(-since / JOLT_DECAY_S) * np.sin(2 * np.pi * JOLT_HZ * since)
        return np.asarray(course[:, None] * self.jolt)


def draw_path(
    settings: PathSettings,
    subject: TriangleMesh,
    camera: Camera,
    rng: np.random.Generator,
    min_range_m: float = 0.0,
) -> CameraPath:
    """Draw a camera path around a subject at the room's origin.

    Args:
        settings: the path's shape. If it has no distance, the subject just fits into the image.
        subject: the subject's mesh, z up, metres.
        camera: the depth camera.
        rng: draws all random parts of the path.
        min_range_m: minimum range of the sensor. If the settings have no distance, the camera stays at least
            this far from the subject.
    """
    low, high = subject.vertices.min(axis=0), subject.vertices.max(axis=0)
    target_room = np.array([0.0, 0.0, (low[2] + high[2]) / 2])
    knots_s, knots_share = _progress(settings, draw_waves(PACE_HZ, 1, rng))
    directions = rng.standard_normal((2, 3))
    distance_m = settings.distance_m
    if distance_m is None:
        distance_m = _fitting_distance_m(subject, target_room, camera, min_range_m, settings.reach_share)
    start_rad = float(rng.uniform(0, 2 * np.pi))
    return CameraPath(
        settings=settings,
        target_room=target_room,
        distance_m=distance_m,
        start_rad=start_rad,
        swing_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        knots_s=knots_s,
        knots_share=knots_share,
        shake=draw_waves(SHAKE_HZ, 6, rng),
        reach=draw_waves(REACH_HZ, 1, rng),
        jolt=(directions / np.linalg.norm(directions, axis=1, keepdims=True)).ravel(),
        stations_rad=_shuffled_rad(settings, start_rad, rng) if settings.order == "shuffled" else None,
    )


def _shuffled_rad(settings: PathSettings, start_rad: float, rng: np.random.Generator) -> Float64:
    """Return azimuth and elevation (frames, 2), radians, of views in random order.

    They are spread evenly by area over the azimuths and elevations of the walk, as a spherical Fibonacci
    lattice: the sine of the elevation in even steps, the azimuth in steps of 0.618 (golden ratio) of the arc
    (Gonzalez: Measurement of Areas on a Sphere Using Fibonacci and Latitude-Longitude Lattices, Mathematical
    Geosciences 42, 2010).
    """
    low, high = np.sin(
        np.clip(settings.elevation_rad + np.array([-1, 1]) * settings.swing_rad, -STEEPEST_RAD, STEEPEST_RAD)
    )
    index = np.arange(settings.frames)
    rise = np.arcsin(low + (high - low) * (index + 0.5) / settings.frames)
    turn = start_rad + settings.arc_rad * np.mod(index * GOLDEN_SHARE, 1)
    return rng.permutation(np.column_stack([turn, rise]))


def _fitting_distance_m(
    subject: TriangleMesh, target_room: Float64, camera: Camera, min_range_m: float, reach_share: float
) -> float:
    """Return the distance in metres at which a bounding sphere of the subject just fits into the image.

    A small margin is added. The distance is also so large that the sphere stays beyond the sensor's minimum
    range even where the hand comes nearest. `reach_share` is the standard deviation of the distance's
    relative change.
    """
    radius_m = float(np.linalg.norm(subject.vertices - target_room, axis=1).max())
    half_view = min(np.arctan(camera.width / 2 / camera.fx), np.arctan(camera.height / 2 / camera.fy))
    out_of_blindness_m = (min_range_m + radius_m) / (1 - REACH_PEAK * reach_share)
    return max(FIT_MARGIN * radius_m / float(np.sin(half_view)), out_of_blindness_m)


def _progress(settings: PathSettings, pace: Waves) -> tuple[Float64, Float64]:
    """Return times (k,) in seconds and the share of the path (k,) covered by each, at a varying pace."""
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
    """Return the pose (4, 4) `T_room_camera`, without roll, of a camera that looks at a target.

    The target must not be straight above or below the camera.
    """
    forward = target_room - position_room
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return rigid(np.column_stack([right, np.cross(forward, right), forward]), position_room)
