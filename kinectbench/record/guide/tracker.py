"""Online tracking: each frame is registered to the keyframes that share most of its view.

The registration, its acceptance, and the rule for a new keyframe are those of `stages.track`, as is the
calibration of depth (`straight`). What is not here is the optimisation of the keyframes: a build does that
afterwards, with all frames.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, invert_rigid
from kinectbench.core.geometry.depth import NO_CALIBRATION
from kinectbench.core.geometry.rigid import on_so3, rigid_from_twist, twist_from_rigid
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.types import Float64
from kinectbench.record.guide.straight import Keyframe, Straight, calibrated
from kinectbench.record.interface import Frame, Setup
from kinectbench.stages.track.covisibility import keyframe_thumbnail, shared_view
from kinectbench.stages.track.features import find_features, pose_from_features, similarity
from kinectbench.stages.track.frame_maps import STORED_PER_M, FrameMaps, MapCache
from kinectbench.stages.track.odometry import MIN_POINTS, is_accepted, is_keyframe, point_stride
from kinectbench.stages.track.registration import Registration, register

# Keyframes that a frame is registered to, as `tracker.NEIGHBOURS`; and, of a lost camera, those that look
# most like its picture: more than three take longer than the next frame needs to come.
NEIGHBOURS, TRIED_WHEN_LOST = 2, 3
# The motion goes on as it was for so long; after a longer gap the last pose is the better guess.
STEADY_S = 0.3


class OneFrame:
    """The store of a sequence of one frame."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Its depth."""
        return self._frame.depth

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Its colour; pixels as a file without compression, which takes a copy."""
        color = self._frame.color
        if color is None or isinstance(color, tuple):
            return color
        import cv2

        return ".bmp", cv2.imencode(".bmp", np.ascontiguousarray(color[..., ::-1]))[1].tobytes()


def cache_of(frame: Frame, setup: Setup) -> MapCache:
    """The maps of a frame as the tracker of a build makes them."""
    stamps_ns = np.array([frame.stamp_ns])
    one = Sequence(setup.camera, setup.depth_scale, stamps_ns, setup.color_registered, None, OneFrame(frame))
    return MapCache(one)


class LiveTracker:
    """Follows the camera through the frames that it is given; the first one defines the world.

    Attributes:
        keyframes: so far, in the order of time.
        calibration: of depth, as far as it is known.
        lost: whether the last frame has no pose.
    """

    def __init__(self) -> None:
        """No frame was seen."""
        self.keyframes: list[Keyframe] = []
        self.calibration = NO_CALIBRATION
        self.lost = False
        self._last: tuple[int, Float64] | None = None
        self._twist_per_s = np.zeros(6)
        self._row = 0

    @property
    def camera(self) -> Camera:
        """Of the keyframes' depth; there must be one."""
        return self.keyframes[0].maps[0].camera

    def take(self, frame: Frame, setup: Setup) -> Float64 | None:
        """The pose (4, 4) of a frame in the world; None: the camera is lost."""
        cache = cache_of(frame, setup)
        cache.calibrate(self.calibration)
        maps = cache[0]
        if len(maps[0].points) < MIN_POINTS:
            self.lost = True
            return None
        if not self.keyframes:
            self._add(frame.stamp_ns, cache, np.eye(4))
            self._last = frame.stamp_ns, np.eye(4)
            return np.eye(4)
        found = self._placed(maps, self._predicted(frame.stamp_ns)) or self._found_again(maps)
        self.lost = found is None
        if found is None:
            return None
        row, registration = found
        T_world_camera = on_so3(self.keyframes[row].T_world_camera @ registration.T_target_source)
        self._move(frame.stamp_ns, T_world_camera)
        self._row = row
        if is_keyframe(registration, maps):
            self._add(frame.stamp_ns, cache, T_world_camera)
        return T_world_camera

    def take_over(self, straight: Straight) -> None:
        """Go on from calibrated keyframes; those that came since move with the last of them."""
        before, known = self.keyframes, len(straight.keyframes)
        keyframes = [*straight.keyframes]
        T_moved = keyframes[-1].T_world_camera @ invert_rigid(before[known - 1].T_world_camera)
        for each in before[known:]:
            T_world_camera = on_so3(T_moved @ each.T_world_camera)
            keyframes.append(replace(calibrated(each, straight.calibration), T_world_camera=T_world_camera))
        self.calibration, self.keyframes = straight.calibration, keyframes
        if self._last is not None:
            row = self._row
            T_moved = keyframes[row].T_world_camera @ invert_rigid(before[row].T_world_camera)
            self._last = self._last[0], on_so3(T_moved @ self._last[1])

    def _add(self, stamp_ns: int, cache: MapCache, T_world_camera: Float64) -> None:
        maps = cache[0]
        cache.calibrate(NO_CALIBRATION)
        depth = np.minimum(np.rint(cache[0][0].depth_m * STORED_PER_M), 65535).astype(np.uint16)
        made = (maps, keyframe_thumbnail(maps), find_features(maps), depth)
        self._row = len(self.keyframes)
        self.keyframes.append(Keyframe(stamp_ns, T_world_camera, *made))

    def _move(self, stamp_ns: int, T_world_camera: Float64) -> None:
        assert self._last is not None
        last_ns, T_last = self._last
        passed_s = max(stamp_ns - last_ns, 1) / NS_PER_S
        moved = twist_from_rigid(invert_rigid(T_last) @ T_world_camera)
        self._twist_per_s = moved / passed_s if passed_s < STEADY_S else np.zeros(6)
        self._last = stamp_ns, T_world_camera

    def _predicted(self, stamp_ns: int) -> list[Float64]:
        """Poses to begin at: the motion goes on, or the camera stands still."""
        assert self._last is not None
        last_ns, T_last = self._last
        passed_s = (stamp_ns - last_ns) / NS_PER_S
        if self.lost or not 0 < passed_s < STEADY_S:
            return [T_last]
        return [np.asarray(T_last @ rigid_from_twist(self._twist_per_s * passed_s)), T_last]

    def _placed(self, maps: FrameMaps, starts: list[Float64]) -> tuple[int, Registration] | None:
        """Register a frame to the keyframes that share its view: the row of the first, and how."""
        view = keyframe_thumbnail(maps)
        for T_start in starts:
            shared = [
                shared_view(each.thumbnail, view, invert_rigid(each.T_world_camera) @ T_start)
                for each in self.keyframes
            ]
            # The keyframe of the frame before goes first, so that the oldest ones hold the world in place.
            order = [int(k) for k in np.argsort(-np.array(shared), kind="stable") if shared[k] > 0]
            rows = ([self._row] + [k for k in order if k != self._row])[:NEIGHBOURS]
            found = self._registered(maps, rows, T_start)
            if is_accepted(found):
                return rows[0], found
        return None

    def _registered(self, maps: FrameMaps, rows: list[int], T_start: Float64) -> Registration:
        targets = [self.keyframes[row] for row in rows]
        starts = [invert_rigid(each.T_world_camera) @ T_start for each in targets]
        return register(maps, [each.maps for each in targets], starts, every=point_stride(maps))

    def _found_again(self, maps: FrameMaps) -> tuple[int, Registration] | None:
        """Register a frame of a lost camera to the keyframes that look most like it."""
        features = find_features(maps)
        known = [each.features for each in self.keyframes]
        scores = similarity([features, *known])[0, 1:]
        for row in np.argsort(-scores, kind="stable")[:TRIED_WHEN_LOST]:
            keyframe = self.keyframes[int(row)]
            seen = pose_from_features(features, keyframe.features, maps[0].camera)
            if seen is not None:
                found = register(maps, [keyframe.maps], [seen[0]], 1, every=point_stride(maps))
                if is_accepted(found):
                    return int(row), found
        return None
