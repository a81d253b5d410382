"""The guide: what the tracker, the look at what was seen, and the rule of the sentences say of each frame."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import KinectBenchError
from kinectbench.core.geometry import TriangleMesh, invert_rigid, rotation_angle_rad, transform_points
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.types import Float64
from kinectbench.record.guide.looking import LEAST_KEYFRAMES, ObjectLook, look
from kinectbench.record.guide.sentences import (
    FRAMES_ENOUGH,
    Advice,
    Ring,
    Situation,
    Speaker,
    advice,
    directions_of,
)
from kinectbench.record.guide.tracker import LiveTracker
from kinectbench.record.interface import Frame, Setup

# What was seen is looked at so often, by the clock of the frames, if a new keyframe came.
LOOK_EVERY_S = 3.0
# Depth is calibrated from so many keyframes on, and again when they are so many times as many.
LEAST_CALIBRATED, CALIBRATED_AGAIN = 8, 1.5
# Speeds are means of about so long: a hand shakes at several Hz.
SPEED_S = 0.5
# A ball around the object fills the picture but for a margin.
MARGIN = 1.1
# The path is shown by as many points.
PATH_POINTS = 400


@dataclass(frozen=True)
class Snapshot:
    """What is to be shown after a frame.

    Attributes:
        number: of the frame in the recording.
        advice: the sentence.
        lost: the camera has no pose.
        distance_m: from the camera to the middle of the object; None: it is not known yet.
        speed_mps: of the camera, metres a second.
        T_world_camera: (4, 4), the first frame defines the world; None: the camera is lost.
        T_floor_camera: (4, 4), or None: the floor is not known, or the camera is lost.
        looks: how often the object was looked at: another mesh is there when it has grown.
    """

    number: int
    advice: Advice
    lost: bool
    distance_m: float | None
    speed_mps: float
    T_world_camera: Float64 | None
    T_floor_camera: Float64 | None
    looks: int


class Guide:
    """Guides whoever records with one camera.

    Attributes:
        tracker: its keyframes.
        seen: the last look; None before the first.
        ring: directions that the object was seen from.
    """

    def __init__(self, setup: Setup, *, beside: bool = True) -> None:
        """Nothing was seen.

        Args:
            setup: the device's cameras.
            beside: look on a thread of its own, while frames go on.
        """
        self._setup = setup
        self.tracker, self.ring = LiveTracker(), Ring()
        self.seen: ObjectLook | None = None
        self.poses: list[tuple[int, Float64]] = []
        self._speaker, self._looks, self._looked_at = Speaker(), 0, (0, -np.inf)
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="look") if beside else None
        self._look: Future[ObjectLook] | None = None
        self._calibrated_at = 0
        self._shift_mps = self._turn_radps = 0.0

    def take(self, number: int, frame: Frame) -> Snapshot:
        """Track a frame, and say what is to be done."""
        T_world_camera = self.tracker.take(frame, self._setup)
        self._look_again(frame.stamp_ns / NS_PER_S)
        T_floor_camera: Float64 | None = None
        if T_world_camera is not None:
            self._measure_speed(frame.stamp_ns, T_world_camera)
            self.poses.append((frame.stamp_ns, T_world_camera))
            if self.seen is not None:
                T_floor_camera = np.asarray(self.seen.T_floor_world @ T_world_camera)
                self._count(T_floor_camera[None])
        now = self._situation(T_floor_camera)
        said = self._speaker.hear(advice(now), frame.stamp_ns / NS_PER_S)
        distance_m = None if now.position is None else float(np.linalg.norm(now.position - now.center))
        poses = T_world_camera, T_floor_camera
        return Snapshot(number, said, now.lost, distance_m, self._shift_mps, *poses, self._looks)

    def shown(self) -> dict[str, Any]:
        """Path, ring and box, for the page: metres, floor frame."""
        if self.seen is None:
            return {"path": [], "ring": [], "box": None}
        T_world = np.array([T for _, T in self.poses])
        every = max(1, len(T_world) // PATH_POINTS)
        path = transform_points(self.seen.T_floor_world, T_world[::every, :3, 3])
        box = self.seen.box
        return {
            "path": np.round(path, 3).tolist(),
            "ring": (self.ring.frames >= FRAMES_ENOUGH).tolist(),
            "box": {"center_m": box.center_m, "size_m": box.size_m, "yaw_rad": box.yaw_rad},
        }

    def close(self) -> None:
        """Wait for the last look."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def _look_again(self, now_s: float) -> None:
        """Take the result of a look that is done; begin another one if it is time."""
        if self._look is not None and self._look.done():
            self._take_look(self._look)
            self._look = None
        count = len(self.tracker.keyframes)
        known, last_s = self._looked_at
        if self._look is not None or count < max(LEAST_KEYFRAMES, known + 1) or now_s - last_s < LOOK_EVERY_S:
            return
        self._looked_at = count, now_s
        keyframes, calibration = tuple(self.tracker.keyframes), self.tracker.calibration
        again = count >= max(LEAST_CALIBRATED, CALIBRATED_AGAIN * self._calibrated_at)
        if again:
            self._calibrated_at = count
        given = keyframes, self.tracker.camera, None if again else calibration
        if self._pool is not None:
            self._look = self._pool.submit(look, *given)
            return
        self._look = Future()
        try:
            self._look.set_result(look(*given))
        except KinectBenchError as error:
            self._look.set_exception(error)

    def _take_look(self, done: "Future[ObjectLook]") -> None:
        try:
            self.seen = done.result()
        except KinectBenchError:
            return  # too little was seen; the next look knows more
        if self.seen.straight is not None:
            self.tracker.take_over(self.seen.straight)
        self._looks += 1
        self.ring = Ring()
        if self.poses:
            self._count(self.seen.T_floor_world @ np.array([T for _, T in self.poses]))

    def _count(self, T_floor_camera: Float64) -> None:
        """Count poses (n, 4, 4) that look at the object."""
        assert self.seen is not None
        center = np.array(self.seen.box.center_m)
        ways = center - T_floor_camera[:, :3, 3]
        cosine = np.einsum("ni,ni->n", ways, T_floor_camera[:, :3, 2]) / np.linalg.norm(ways, axis=1)
        looking = T_floor_camera[cosine > np.cos(self._half_view_rad())]
        for towards_rad, rise_rad in zip(*directions_of(looking[:, :3, 3], center), strict=True):
            self.ring.add(float(towards_rad), float(rise_rad))

    def _situation(self, T_floor_camera: Float64 | None) -> Situation:
        lost = self.tracker.lost
        if self.seen is None or T_floor_camera is None:
            return Situation(lost, turn_rad_per_s=self._turn_radps)
        box, T_floor_world = self.seen.box, self.seen.T_floor_world
        center = np.array(box.center_m)
        radius_m = float(np.linalg.norm(box.size_m)) / 2
        positions = np.array([each.T_world_camera[:3, 3] for each in self.tracker.keyframes])
        positions = transform_points(T_floor_world, positions)
        position = T_floor_camera[:3, 3]
        return Situation(
            lost=lost,
            shift_per_s=self._shift_mps / max(float(np.linalg.norm(position - center)), 1e-3),
            turn_rad_per_s=self._turn_radps,
            position=position,
            center=center,
            fits_m=MARGIN * radius_m / float(np.sin(self._half_view_rad())),
            first_rad=float(directions_of(positions[:1], center)[0][0]),
            ring=self.ring,
            frontiers=self.seen.frontiers,
            positions=positions,
        )

    def _half_view_rad(self) -> float:
        camera = self._setup.camera
        return float(min(np.arctan(camera.width / 2 / camera.fx), np.arctan(camera.height / 2 / camera.fy)))

    def _measure_speed(self, stamp_ns: int, T_world_camera: Float64) -> None:
        """Over the last half second or more, so that the hand's shake is no speed."""
        before = next(
            (pose for pose in reversed(self.poses) if stamp_ns - pose[0] >= SPEED_S * NS_PER_S), None
        )
        if before is None:
            return
        passed_s = (stamp_ns - before[0]) / NS_PER_S
        moved = invert_rigid(before[1]) @ T_world_camera
        self._shift_mps = float(np.linalg.norm(moved[:3, 3])) / passed_s
        self._turn_radps = float(rotation_angle_rad(moved[:3, :3])) / passed_s


def mesh_bytes(mesh: TriangleMesh) -> bytes:
    """A mesh for the page: two uint32 counts, vertices (n, 3) float32, metres, and faces (m, 3) uint32."""
    counts: NDArray[np.uint32] = np.array([len(mesh.vertices), len(mesh.faces)], np.uint32)
    vertices, faces = mesh.vertices.astype("<f4"), mesh.faces.astype("<u4")
    return counts.astype("<u4").tobytes() + vertices.tobytes() + faces.tobytes()
