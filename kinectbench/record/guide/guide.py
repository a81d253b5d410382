"""The guide: tracks each frame, reconstructs the seen part of the object, and chooses the advice."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import KinectBenchError
from kinectbench.core.geometry import TriangleMesh, invert_rigid, rotation_angle_rad, transform_points
from kinectbench.core.sequence import depth_in_metres
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
from kinectbench.record.guide.tracker import KeyframesSoFar, LiveTracker
from kinectbench.record.interface import Frame, Setup
from kinectbench.stages.segment.find.given import point_under
from kinectbench.stages.track.keyframe_graph import KeyframeGraph

# Interval, by the clock of the frames, at which the graph is built and the object is looked at, if a new
# keyframe was added. With 3 s the trajectory was 2.05 mm off while recording, with 1.5 s 1.87 mm (600
# simulated frames).
LOOK_EVERY_S = 1.5
# A speed is a mean over about this time, and over at most this many frames: a hand shakes at several Hz.
SPEED_S, SPEED_FRAMES = 0.5, 60
# The index of a frame in the tracker, and a point (3,) in its camera frame, metres.
Picked: TypeAlias = tuple[int, Float64]
# Messages why a pixel is not accepted.
NOTHING_THERE = "nothing was measured there: click another spot of the object"
FLOOR_THERE = "that is the floor: click the object, above where it stands"
# Niceness of `look`, beside that of its process: half the way to that of the build beside the recording.
NICER = 5
# A ball of the object's size fills the picture except for this margin.
MARGIN = 1.1
# Number of points that show the path.
PATH_POINTS = 400


@dataclass(frozen=True)
class Snapshot:
    """The state that the page shows after a frame.

    Attributes:
        number: the frame's number in the recording.
        advice: the sentence, and the motion that it asks for.
        lost: whether the camera has no pose.
        distance_m: distance from the camera to the middle of the object, metres; None: not known yet.
        speed_mps: speed of the camera, metres per second; while the camera is lost, its last known speed.
        T_world_camera: (4, 4), camera to the tracker's current world; None: the camera is lost.
        T_floor_camera: (4, 4), camera to floor frame; None: the floor is not known, or the camera is lost.
        looks: number of reconstructions of the object so far (`look`); each one gives a new mesh.
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
    """Guides the person who records with one camera.

    Attributes:
        tracker: tracks the camera and keeps the keyframes.
        seen: the last reconstruction of the object (`look`); None before the first.
        ring: directions from which the object was seen.
    """

    def __init__(self, setup: Setup, *, beside: bool = True) -> None:
        """Start without frames.

        Args:
            setup: the device's cameras.
            beside: whether `look` runs on a separate thread while frames arrive.
        """
        self._setup = setup
        self.tracker, self.ring = LiveTracker(setup), Ring()
        self.seen: ObjectLook | None = None
        self._speaker, self._looks, self._looked_at = Speaker(), 0, (0, -np.inf)
        pool = ThreadPoolExecutor(1, thread_name_prefix="look", initializer=_lower) if beside else None
        self._pool = pool
        self._look: Future[tuple[KeyframeGraph, ObjectLook | None]] | None = None
        self._picked: Picked | None = None
        # A click arrives on the page's thread; the lock keeps the world and the floor consistent for it.
        self._moving = Lock()
        self._shift_mps = self._turn_radps = 0.0

    def take(self, number: int, frame: Frame) -> Snapshot:
        """Track a frame, and return the state that the page shows after it."""
        self._look_again(frame.stamp_ns / NS_PER_S)
        T_world_camera = self.tracker.take(frame)
        T_floor_camera: Float64 | None = None
        if T_world_camera is not None:
            self._measure_speed()
            if self.seen is not None:
                T_floor_camera = np.asarray(self.seen.T_floor_world @ T_world_camera)
                self._count(T_floor_camera[None])
        now = self._situation(T_floor_camera)
        said = self._speaker.hear(advice(now), frame.stamp_ns / NS_PER_S)
        distance_m = None if now.position is None else float(np.linalg.norm(now.position - now.center))
        poses = T_world_camera, T_floor_camera
        return Snapshot(number, said, now.lost, distance_m, self._shift_mps, *poses, self._looks)

    def pick(self, frame: Frame, pixel: tuple[int, int], keep: Callable[[], None] = lambda: None) -> str:
        """Choose the object at a depth pixel of a frame; return "", or a sentence why it is not accepted.

        Args:
            frame: a frame that was given to `take`.
            pixel: column and row.
            keep: called before the object changes; if it raises an error, the object stays.
        """
        setup, index = self._setup, self.tracker.number_at(frame.stamp_ns)
        point = point_under(depth_in_metres(frame.depth, setup.depth_scale), setup.camera, pixel)
        if index is None or point is None:
            return NOTHING_THERE
        with self._moving:
            if self._is_floor(index, point):
                return FLOOR_THERE
            keep()
            self._picked, self._looked_at = (index, point), (0, -np.inf)
        return ""

    def _is_floor(self, index: int, point_camera: Float64) -> bool:
        """Return whether a point (3,) in a frame lies on the floor; False if that is not known.

        Measured on a simulated chair and a table (four frames each; 2,415 pixels of floor, 757 of objects):
        one floor pixel was accepted as object, and no object pixel was refused.
        """
        _, T_world_camera = self.tracker.poses([index])
        if self.seen is None or not len(T_world_camera):
            return False
        T_floor_camera = self.seen.T_floor_world @ T_world_camera[0]
        return bool(abs(transform_points(T_floor_camera, point_camera)[2]) <= self.seen.floor_cut_m)

    def shown(self) -> dict[str, object]:
        """Return what the page draws, in the floor frame: path, ring and box of the object.

        "path" has camera positions (n, 3), metres; "ring" (12, 3) bool says which directions of `Ring` were
        seen; "box" has center_m, size_m and yaw_rad. While the object is unknown, they are [], [] and None.
        """
        if self.seen is None:
            return {"path": [], "ring": [], "box": None}
        _, T_world = self.tracker.poses()
        every = max(1, len(T_world) // PATH_POINTS)
        path = transform_points(self.seen.T_floor_world, T_world[::every, :3, 3])
        box = self.seen.box
        return {
            "path": np.round(path, 3).tolist(),
            "ring": (self.ring.frames >= FRAMES_ENOUGH).tolist(),
            "box": {"center_m": box.center_m, "size_m": box.size_m, "yaw_rad": box.yaw_rad},
        }

    def close(self) -> None:
        """Wait until the last call of `look` has ended."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def _look_again(self, now_s: float) -> None:
        """Take over the result of `look` if it has ended; start `look` again if it is due."""
        if self._look is not None and self._look.done():
            with self._moving:
                self._take_look(*self._look.result())
            self._look = None
        count = len(self.tracker.keyframes)
        known, last_s = self._looked_at
        if self._look is not None or count < max(LEAST_KEYFRAMES, known + 1) or now_s - last_s < LOOK_EVERY_S:
            return
        self._looked_at = count, now_s
        given = self.tracker.so_far(), self._picked
        if self._pool is not None:
            self._look = self._pool.submit(_looked, *given)
            return
        self._look = Future()
        self._look.set_result(_looked(*given))

    def _take_look(self, graph: KeyframeGraph, seen: ObjectLook | None) -> None:
        T_graph_before = self.tracker.go_on_from(graph)
        if seen is None:  # too little was seen so far
            if self.seen is not None:
                self.seen = self.seen.moved(T_graph_before)
            return
        self.seen = seen
        self._looks += 1
        self.ring = Ring()
        self._count(self.seen.T_floor_world @ self.tracker.poses()[1])

    def _count(self, T_floor_camera: Float64) -> None:
        """Add to the ring the directions of those poses (n, 4, 4), camera to floor, that face the object."""
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
        positions = self.tracker.poses(self.tracker.keyframes)[1][:, :3, 3]
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
            unknown_share=self.seen.unknown_share,
            positions=positions,
        )

    def _half_view_rad(self) -> float:
        camera = self._setup.camera
        return float(min(np.arctan(camera.width / 2 / camera.fx), np.arctan(camera.height / 2 / camera.fy)))

    def _measure_speed(self) -> None:
        """Measure the mean speed over at least the last half second, to average out the hand's shake."""
        stamps_ns, T_world = self.tracker.poses(self.tracker.newest(SPEED_FRAMES))
        before = np.flatnonzero(stamps_ns[-1] - stamps_ns >= SPEED_S * NS_PER_S)
        if not len(before):
            return
        first = int(before[-1])
        passed_s = float(stamps_ns[-1] - stamps_ns[first]) / NS_PER_S
        moved = invert_rigid(T_world[first]) @ T_world[-1]
        self._shift_mps = float(np.linalg.norm(moved[:3, 3])) / passed_s
        self._turn_radps = float(rotation_angle_rad(moved[:3, :3])) / passed_s


def _lower() -> None:
    """Lower this thread's priority (on Linux) below that of tracking: a sentence may come later, not age."""
    with suppress(OSError):
        os.nice(NICER)


def _looked(known: KeyframesSoFar, picked: Picked | None) -> tuple[KeyframeGraph, ObjectLook | None]:
    """Build the keyframe graph, and reconstruct the object with it (None if that fails); return both."""
    graph = known.graph()
    T_world_camera = None if picked is None else known.placed(graph, picked[0])
    at = None if picked is None or T_world_camera is None else transform_points(T_world_camera, picked[1])
    try:
        return graph, look(known.maps, graph, at)
    except KinectBenchError:
        return graph, None


def mesh_bytes(mesh: TriangleMesh) -> bytes:
    """Encode a mesh for the page: n, m (uint32), vertices (n, 3) float32 in metres, faces (m, 3) uint32."""
    counts: NDArray[np.uint32] = np.array([len(mesh.vertices), len(mesh.faces)], np.uint32)
    vertices, faces = mesh.vertices.astype("<f4"), mesh.faces.astype("<u4")
    return counts.astype("<u4").tobytes() + vertices.tobytes() + faces.tobytes()
