"""Recordings in one file with zlib depth in mm and JPEG colour: ElasticFusion's .klg and ScanNet's .sens."""

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from kinectbench.core.geometry import Camera
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.writers.frame import DEPTH_SCALE, RecordedFrame, Rig

SENS_NAME = b"kinectbench"
SENS_JPEG, SENS_ZLIB = 2, 1
# The pose of a frame that was lost.
SENS_LOST = np.full((4, 4), -np.inf)


def write_klg(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording to a .klg that does not exist yet.

    The number of frames stands at its start. Stamps are those of depth in microseconds. The layout has no
    place for size, intrinsics or poses, nor for a colour camera of its own: colour that is not registered is
    left out.
    """
    with path.open("wb") as file:
        file.write(struct.pack("<i", 0))
        count = 0
        for frame in frames:
            depth, color = _depth_zlib(frame), frame.color_jpeg() if rig.color_registered else b""
            head = struct.pack("<qii", frame.stamp_ns // 1000, len(depth), len(color))
            file.write(head + depth + color)
            count += 1
        file.seek(0)
        file.write(struct.pack("<i", count))


def write_sens(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording to a .sens, version 4, that does not exist yet.

    Stamps are microseconds. The extrinsic of depth is the identity, that of colour its place in the depth
    camera's frame. A frame without a pose has one of minus infinity. Numbers are float32.
    """
    with path.open("wb") as file:
        file.write(struct.pack("<IQ", 4, len(SENS_NAME)) + SENS_NAME)
        for matrix in (_matrix(rig.color), np.linalg.inv(rig.T_color_depth), _matrix(rig.depth), np.eye(4)):
            file.write(matrix.astype("<f4").tobytes())
        sizes = (rig.color.width, rig.color.height, rig.depth.width, rig.depth.height)
        file.write(struct.pack("<ii4If", SENS_JPEG, SENS_ZLIB, *sizes, DEPTH_SCALE))
        counted = file.tell()
        file.write(struct.pack("<Q", 0))
        count = 0
        for frame in frames:
            depth, color = _depth_zlib(frame), frame.color_jpeg()
            T = SENS_LOST if frame.T_world_camera is None else frame.T_world_camera
            stamps = (frame.color_stamp_ns // 1000, frame.stamp_ns // 1000)
            head = T.astype("<f4").tobytes() + struct.pack("<4Q", *stamps, len(color), len(depth))
            file.write(head + color + depth)
            count += 1
        file.seek(counted)
        file.write(struct.pack("<Q", count))


def _depth_zlib(frame: RecordedFrame) -> bytes:
    return zlib.compress(frame.depth_native().astype("<u2").tobytes(), 6)


def _matrix(camera: Camera) -> Float64:
    """Intrinsics as a 4x4 matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = camera.K
    return matrix
