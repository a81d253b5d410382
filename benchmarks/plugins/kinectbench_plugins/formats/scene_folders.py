"""Folders of the data sets of whole rooms: what ScanNet's reader exports, and SUN3D's sequences."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.writers.frame import (
    RecordedFrame,
    Rig,
    make_folders,
    matrix_rows,
    png_bytes,
    write_lines,
)
from kinectbench.stages.ingest.depth_codes import BITS

# The pose of a frame that was lost.
LOST: Float64 = np.full((4, 4), -np.inf, np.float64)


def rotated(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Depth in mm as SUN3D stores it: the inverse of `depth_codes.unrotated`."""
    return np.asarray((depth << np.uint16(BITS)) | (depth >> np.uint16(16 - BITS)), np.uint16)


def write_scannet(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a scene as ScanNet's reader exports it: depth/N.png, color/N.jpg, pose/N.txt, intrinsic/.

    Depth is in mm. The rig is the depth camera, in which colour has its place. A frame without a pose has
    one of minus infinity. The layout has no stamps.
    """
    make_folders(folder, "depth", "color", "pose", "intrinsic")
    for index, frame in enumerate(frames):
        (folder / "depth" / f"{index}.png").write_bytes(frame.depth_png())
        (folder / "color" / f"{index}.jpg").write_bytes(frame.color_jpeg())
        T: Float64 = LOST if frame.T_world_camera is None else frame.T_world_camera
        write_lines(folder / "pose" / f"{index}.txt", matrix_rows(T))
    T_depth_color = np.asarray(np.linalg.inv(rig.T_color_depth), np.float64)
    places = {"depth": (rig.depth, np.eye(4)), "color": (rig.color, T_depth_color)}
    for name, (camera, T_rig_camera) in places.items():
        write_lines(folder / "intrinsic" / f"intrinsic_{name}.txt", matrix_rows(_matrix(camera)))
        write_lines(folder / "intrinsic" / f"extrinsic_{name}.txt", matrix_rows(T_rig_camera))


def write_sun3d(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a sequence of SUN3D: image/ and depth/NUMBER-MICROSECONDS, intrinsics.txt, extrinsics/.

    Depth is in mm with rotated bits. Frames are numbered from 1. Poses are of colour images, which have the
    stamps of depth here; a frame without a pose has one that is not a number. Colour that is not registered
    is left out, as the layout has one camera.
    """
    make_folders(folder, "depth", "image", "extrinsics")
    rows: list[str] = []
    for index, frame in enumerate(frames):
        stem = f"{index + 1:07d}-{frame.stamp_ns // 1000 % 10**12:012d}"
        (folder / "depth" / f"{stem}.png").write_bytes(png_bytes(rotated(frame.depth_native())))
        if rig.color_registered:
            (folder / "image" / f"{stem}.jpg").write_bytes(frame.color_jpeg())
        T = np.full((4, 4), np.nan) if frame.T_world_camera is None else frame.T_world_camera
        rows += matrix_rows(T[:3])
    write_lines(folder / "extrinsics" / "20130101000000.txt", rows)
    write_lines(folder / "intrinsics.txt", matrix_rows(rig.depth.K))


def _matrix(camera: Camera) -> Float64:
    """Intrinsics as a 4x4 matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = camera.K
    return matrix
