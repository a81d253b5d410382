"""The 7-Scenes folder: PNG depth in mm with 65535 for none, PNG colour, a 4x4 pose beside each frame."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from kinectbench.simulate.writers.camera_text import matrix_rows
from kinectbench.simulate.writers.frame import RecordedFrame, Rig, png_bytes

DEPTH_SCALE = 1000.0
INVALID = 65535


def write_seven_scenes(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: frame-XXXXXX.{depth.png,color.png,pose.txt}.

    Frames are numbered from 0 in their order; a frame without a pose has no pose.txt. `camera-intrinsics.txt`
    holds the 3x3 matrix of depth. The layout has no place for stamps, for the colour camera, or to say that
    colour is registered: it is read as not registered.
    """
    for index, frame in enumerate(frames):
        stem = f"frame-{index:06d}"
        depth = frame.depth_native(DEPTH_SCALE)
        depth[depth == 0] = INVALID
        (folder / f"{stem}.depth.png").write_bytes(png_bytes(depth))
        bgr = np.ascontiguousarray(frame.color_rgb[..., ::-1])
        (folder / f"{stem}.color.png").write_bytes(png_bytes(bgr))
        if frame.T_world_camera is not None:
            pose = matrix_rows(frame.T_world_camera)
            (folder / f"{stem}.pose.txt").write_text("\n".join(pose) + "\n")
    (folder / "camera-intrinsics.txt").write_text("\n".join(matrix_rows(rig.depth.K)) + "\n")
