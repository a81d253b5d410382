"""Track the camera while recording: the build's odometry for each frame, now and then its keyframe graph.

The graph closes loops, joins lost segments, and calibrates depth. The odometry then continues from the
graph's keyframes.
"""

from collections.abc import Sequence as Rows
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import invert_rigid, on_so3
from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Float64, Int64
from kinectbench.record.interface import Frame, Setup
from kinectbench.stages.track.features import FeatureCache
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.keyframe_graph import KeyframeGraph, build_graph
from kinectbench.stages.track.odometry import FRAMES_BEFORE, RECENT_S, Follower, Odometry

# Number of newest frames whose images are kept. Data for registration is kept for these frames at least, and
# as far back as the odometry may register to; of older frames, only keyframes keep theirs.
NEWEST = FRAMES_BEFORE + 2


class LiveFrames:
    """The newest frames, by their index in the tracker, in the form that `Sequence.frames` needs."""

    def __init__(self) -> None:
        self._frames: dict[int, Frame] = {}

    def add(self, index: int, frame: Frame) -> None:
        """Keep a frame, and drop the frame that is no longer among the `NEWEST`."""
        self._frames[index] = frame
        self._frames.pop(index - NEWEST, None)

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Return a frame's depth, (height, width) uint16 in native units."""
        return self._frames[index].depth

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Return a frame's encoded colour; raw pixels are encoded without compression (.bmp)."""
        color = self._frames[index].color
        if color is None or isinstance(color, tuple):
            return color
        import cv2

        return ".bmp", cv2.imencode(".bmp", np.ascontiguousarray(color[..., ::-1]))[1].tobytes()


class KeyframesSoFar(NamedTuple):
    """The input of the keyframe graph; it does not change while frames arrive.

    Attributes:
        maps: depth maps of the keyframes.
        odometry: odometry of the frames so far.
    """

    maps: MapCache
    odometry: Odometry

    def placed(self, graph: KeyframeGraph, index: int) -> Float64 | None:
        """Return a frame's pose (4, 4) in the graph's world, from its keyframe's pose; None if unknown."""
        frame = self.odometry.frames[index]
        if frame is None:
            return None
        home = self.odometry.frames[frame.keyframe]
        assert home is not None
        T_world_home = graph.T_world[graph.keyframes.index(frame.keyframe)]
        T_world_camera = T_world_home @ invert_rigid(home.T_segment_camera) @ frame.T_segment_camera
        return T_world_camera if np.isfinite(T_world_camera).all() else None

    def graph(self) -> KeyframeGraph:
        """Build the graph: the keyframes' poses with loops closed; `maps` gets its depth calibration."""
        return build_graph(self.maps, FeatureCache(self.maps), self.odometry)


class LiveTracker:
    """Tracks the camera frame by frame; the first frame defines the world, until `go_on_from` changes it.

    Attributes:
        lost: whether the last frame has no pose in the world.
        keyframes: indices of the frames that others are registered to.
    """

    def __init__(self, setup: Setup) -> None:
        """Start without frames."""
        self._frames, self._setup, self._stamps_ns = LiveFrames(), setup, list[int]()
        maps = MapCache(self._sequence(), keeps_all=True)
        self._follower = Follower(maps, FeatureCache(maps))
        self.keyframes = self._follower.keyframes
        # The odometry segment that is the world, and the first frame to which others may be registered.
        self._world = self._kept_from = 0
        self.lost = False

    def take(self, frame: Frame) -> Float64 | None:
        """Track a frame; return its pose (4, 4) in the world, None if the camera is lost."""
        index, follower = len(self._stamps_ns), self._follower
        self._stamps_ns.append(frame.stamp_ns)
        self._frames.add(index, frame)
        follower.maps.sequence = self._sequence()
        follower.take(index)
        old_ns = frame.stamp_ns - 1e9 * RECENT_S
        while self._kept_from + NEWEST <= index and self._stamps_ns[self._kept_from] < old_ns:
            if self._kept_from not in follower.keyframes:
                follower.maps.forget(self._kept_from)
            self._kept_from += 1
        taken = follower.frames[index]
        self.lost = taken is None or taken.segment != self._world
        return None if taken is None or self.lost else taken.T_segment_camera

    def poses(self, frames: Rows[int] | None = None) -> tuple[Int64, Float64]:
        """Return stamps (n,) and current poses (n, 4, 4) in the world, of the frames that have a pose.

        Args:
            frames: indices of the requested frames; None: all.
        """
        followed = self._follower.frames
        wanted = range(len(followed)) if frames is None else frames
        known = [(index, each) for index in wanted if (each := followed[index]) is not None]
        known = [(index, each) for index, each in known if each.segment == self._world]
        stamps_ns = np.array([self._stamps_ns[index] for index, _ in known], np.int64)
        return stamps_ns, np.array([each.T_segment_camera for _, each in known]).reshape(-1, 4, 4)

    def number_at(self, stamp_ns: int) -> int | None:
        """Return the index of the frame with a stamp; None if there is no such frame."""
        return self._stamps_ns.index(stamp_ns) if stamp_ns in self._stamps_ns else None

    def newest(self, count: int) -> range:
        """Return the indices of the newest frames, at most `count`."""
        taken = len(self._stamps_ns)
        return range(max(0, taken - count), taken)

    def so_far(self) -> KeyframesSoFar:
        """Return a copy of the keyframes, from which another thread can build a graph."""
        odometry = self._follower.so_far()
        return KeyframesSoFar(self._follower.maps.copied(), odometry)

    def go_on_from(self, graph: KeyframeGraph) -> Float64 | None:
        """Move the keyframes to their poses in a graph; all other frames move with their keyframes.

        A keyframe that is newer than the graph moves with the last keyframe of its segment in the graph.

        Returns:
            The transform (4, 4) from the old world to the graph's world; None if the old world is no part of
                the graph's world.
        """
        frames, placed = self._follower.frames, dict(zip(graph.keyframes, graph.T_world, strict=True))
        T_moved: dict[int, Float64] = {}  # by keyframe
        T_last: dict[int, Float64] = {}  # by segment
        before, self._world = self._world, min(graph.joined)
        T_graph_before: Float64 | None = None
        for index, each in enumerate(frames):
            if each is None or each.segment not in graph.joined:
                continue
            if each.keyframe == index:
                if index in placed:
                    T_last[each.segment] = placed[index] @ invert_rigid(each.T_segment_camera)
                    if each.segment == before and T_graph_before is None:
                        T_graph_before = T_last[before]
                T_moved[index] = T_last[each.segment]
            T_world_camera = on_so3(T_moved[each.keyframe] @ each.T_segment_camera)
            frames[index] = replace(each, segment=self._world, T_segment_camera=T_world_camera)
        self._follower.calibrate(graph.calibration)
        return T_graph_before

    def _sequence(self) -> Sequence:
        setup, stamps_ns = self._setup, np.array(self._stamps_ns, np.int64)
        return Sequence(
            setup.camera, setup.depth_scale, stamps_ns, setup.color_registered, None, self._frames
        )
