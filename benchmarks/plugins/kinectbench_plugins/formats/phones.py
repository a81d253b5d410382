"""Folders as StrayScanner and 3D Scanner App make them on an iPhone: depth in mm with confidence."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.lab.simulate.writers.frame import (
    RecordedFrame,
    Rig,
    make_folders,
    matrix_rows,
    png_bytes,
    write_lines,
)
from kinectbench.lab.simulate.writers.image_folders import tum_line

HIGH = 2
COLOR_PX = (1920, 1440)
OPENGL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])


def write_stray(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a StrayScanner folder: depth/, confidence/, camera_matrix.csv, odometry.csv, rgb.mp4.

    Every pixel has high confidence. The layout asks for a pose of every frame: one that has none gets no row,
    and is not read. Colour that is not registered is left out, as the layout has one camera.
    """
    import cv2

    make_folders(folder, "depth", "confidence")
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    code, size = cv2.VideoWriter.fourcc(*"mp4v"), (rig.color.width, rig.color.height)
    video = cv2.VideoWriter(str(folder / "rgb.mp4"), code, 30.0, size) if rig.color_registered else None
    for index, frame in enumerate(frames):
        depth = frame.depth_native()
        (folder / "depth" / f"{index:06d}.png").write_bytes(png_bytes(depth))
        confidence = np.full(depth.shape, HIGH, np.uint8)
        (folder / "confidence" / f"{index:06d}.png").write_bytes(png_bytes(confidence))
        if video is not None:
            video.write(frame.color_bgr)
        if frame.T_world_camera is not None:
            stamp, *numbers = tum_line(frame.stamp_ns, frame.T_world_camera).split()
            rows.append(", ".join([stamp, f"{index:06d}", *numbers]))
    if video is not None:
        video.release()
    write_lines(folder / "odometry.csv", rows)
    matrix = [row.replace(" ", ", ") for row in matrix_rows(_color_matrix(rig))]
    write_lines(folder / "camera_matrix.csv", matrix)


def write_scanner_app(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a folder of 3D Scanner App: depth_, conf_, frame_XXXXX.jpg and .json.

    Every pixel has high confidence; times are seconds. A frame without a pose has none in its JSON. Colour
    that is not registered is left out.
    """
    for index, frame in enumerate(frames):
        depth = frame.depth_native()
        (folder / f"depth_{index:05d}.png").write_bytes(png_bytes(depth))
        (folder / f"conf_{index:05d}.png").write_bytes(png_bytes(np.full(depth.shape, HIGH, np.uint8)))
        said: dict[str, object] = {
            "frame_index": index,
            "time": frame.stamp_ns / 1e9,
            "intrinsics": _color_matrix(rig).ravel().tolist(),
        }
        if frame.T_world_camera is not None:
            said["cameraPoseARFrame"] = (frame.T_world_camera @ OPENGL_FROM_OPTICAL).ravel().tolist()
        (folder / f"frame_{index:05d}.json").write_text(json.dumps(said) + "\n", encoding="utf-8")
        if rig.color_registered:
            (folder / f"frame_{index:05d}.jpg").write_bytes(frame.color_jpeg())


def _color_matrix(rig: Rig) -> NDArray[np.float64]:
    """Intrinsics for the size of the colour images, or of those that the phone would have made."""
    camera = rig.depth
    if rig.color_registered:
        return camera.K
    x, y = COLOR_PX[0] / camera.width, COLOR_PX[1] / camera.height
    cx, cy = (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5
    return np.array([[camera.fx * x, 0, cx], [0, camera.fy * y, cy], [0, 0, 1]])
