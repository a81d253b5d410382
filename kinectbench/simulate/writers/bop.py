"""A scene in the BOP format: PNG depth with its scale, JPEG colour, scene_camera.json with poses."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.simulate.writers.frame import RecordedFrame, Rig, png_bytes
from kinectbench.workspace import pretty_json

DEPTH_SCALE = 1000.0
MM_PER_M = 1000.0


def write_bop(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a scene into an empty folder: depth/, rgb/, scene_camera.json.

    Poses are world to camera, translation in mm. The layout has no stamps. A writer does not see the truth:
    there are no masks. Colour that is not registered is left out, as the format has one camera.
    """
    for name in ("depth", "rgb"):
        (folder / name).mkdir()
    cameras: dict[str, dict[str, Any]] = {}
    for index, frame in enumerate(frames):
        (folder / "depth" / f"{index:06d}.png").write_bytes(png_bytes(frame.depth_native(DEPTH_SCALE)))
        if rig.color_registered:
            (folder / "rgb" / f"{index:06d}.jpg").write_bytes(frame.color_jpeg())
        camera: dict[str, Any] = {
            "cam_K": rig.depth.K.ravel().tolist(),
            "depth_scale": MM_PER_M / DEPTH_SCALE,
        }
        if frame.T_world_camera is not None:
            T_camera_world = np.linalg.inv(frame.T_world_camera)
            camera["cam_R_w2c"] = T_camera_world[:3, :3].ravel().tolist()
            camera["cam_t_w2c"] = (T_camera_world[:3, 3] * MM_PER_M).tolist()
        cameras[str(index)] = camera
    (folder / "scene_camera.json").write_text(pretty_json(cameras))
