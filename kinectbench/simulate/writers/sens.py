"""ScanNet's .sens, version 4: zlib depth in mm, JPEG colour, intrinsics, extrinsics and poses."""

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera
from kinectbench.simulate.writers.frame import RecordedFrame, Rig

DEPTH_SCALE = 1000.0
NAME = b"kinectbench"
JPEG, ZLIB = 2, 1
# A pose that is lost.
LOST = np.full((4, 4), -np.inf)


def write_sens(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording to a file that does not exist yet.

    Stamps are microseconds. The extrinsic of depth is the identity, that of colour its place in the depth
    camera's frame. A frame without a pose has one of minus infinity. Numbers are float32.
    """
    with path.open("wb") as file:
        file.write(struct.pack("<IQ", 4, len(NAME)) + NAME)
        T_depth_color = np.linalg.inv(rig.T_color_depth)
        for matrix in (_matrix(rig.color), T_depth_color, _matrix(rig.depth), np.eye(4)):
            file.write(matrix.astype("<f4").tobytes())
        sizes = (rig.color.width, rig.color.height, rig.depth.width, rig.depth.height)
        file.write(struct.pack("<ii4If", JPEG, ZLIB, *sizes, DEPTH_SCALE))
        counted = file.tell()
        file.write(struct.pack("<Q", 0))
        count = 0
        for frame in frames:
            depth = zlib.compress(frame.depth_native(DEPTH_SCALE).astype("<u2").tobytes(), 6)
            color = frame.color_jpeg()
            T = LOST if frame.T_world_camera is None else frame.T_world_camera
            stamps = (frame.color_stamp_ns // 1000, frame.stamp_ns // 1000)
            file.write(T.astype("<f4").tobytes() + struct.pack("<4Q", *stamps, len(color), len(depth)))
            file.write(color)
            file.write(depth)
            count += 1
        file.seek(counted)
        file.write(struct.pack("<Q", count))


def _matrix(camera: Camera) -> NDArray[np.float64]:
    """Intrinsics as a 4x4 matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = camera.K
    return matrix
