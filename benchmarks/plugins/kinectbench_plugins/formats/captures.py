"""Captures with OpenGL's axes: nerfstudio's transforms.json with depth, and Polycam's raw data."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core.storage import pretty_json
from kinectbench.lab.simulate.writers.frame import DEPTH_SCALE, RecordedFrame, Rig, make_folders, png_bytes
from kinectbench_plugins.formats.phones import OPENGL_FROM_OPTICAL

# Polycam's word for the highest of its three levels of confidence.
POLYCAM_HIGH = 255


def write_nerfstudio(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write transforms.json, images/ and depth/ into an empty folder.

    Depth is PNG in mm. The layout has no stamps, and one camera: colour that is not registered is left out. A
    frame without a pose has no transform_matrix.
    """
    make_folders(folder, "images", "depth")
    camera = rig.depth
    rows: list[dict[str, Any]] = []
    for index, frame in enumerate(frames):
        name = f"frame_{index + 1:05d}"
        row: dict[str, Any] = {"depth_file_path": f"depth/{name}.png"}
        (folder / "depth" / f"{name}.png").write_bytes(frame.depth_png())
        if rig.color_registered:
            row["file_path"] = f"images/{name}.jpg"
            (folder / "images" / f"{name}.jpg").write_bytes(frame.color_jpeg())
        if frame.T_world_camera is not None:
            row["transform_matrix"] = (frame.T_world_camera @ OPENGL_FROM_OPTICAL).tolist()
        rows.append(row)
    said = {
        "camera_model": "OPENCV",
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + 0.5,
        "cy": camera.cy + 0.5,
        "depth_unit_scale_factor": 1 / DEPTH_SCALE,
        "frames": rows,
    }
    (folder / "transforms.json").write_text(pretty_json(said), encoding="utf-8")


def write_polycam(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write keyframes/ with depth, confidence, corrected_images and corrected_cameras into an empty folder.

    Depth is in mm, of high confidence everywhere. Names are microseconds: of equal ones the first is kept.
    Colour that is not registered is left out. A frame without a pose has none in its JSON.
    """
    inside = folder / "keyframes"
    inside.mkdir()
    make_folders(inside, "depth", "confidence", "corrected_images", "corrected_cameras")
    camera = rig.depth
    intrinsics = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
    said = intrinsics | {"width": camera.width, "height": camera.height}
    for frame in frames:
        stem, depth = str(frame.stamp_ns // 1000), frame.depth_native()
        if (inside / "depth" / f"{stem}.png").exists():
            continue
        (inside / "depth" / f"{stem}.png").write_bytes(png_bytes(depth))
        confidence = np.full(depth.shape, POLYCAM_HIGH, np.uint8)
        (inside / "confidence" / f"{stem}.png").write_bytes(png_bytes(confidence))
        if rig.color_registered:
            (inside / "corrected_images" / f"{stem}.jpg").write_bytes(frame.color_jpeg())
        pose: dict[str, Any] = {}
        if frame.T_world_camera is not None:
            T = (frame.T_world_camera @ OPENGL_FROM_OPTICAL).tolist()
            pose = {f"t_{row}{column}": T[row][column] for row in range(3) for column in range(4)}
        text = pretty_json(said | pose | {"timestamp": frame.stamp_ns // 1000})
        (inside / "corrected_cameras" / f"{stem}.json").write_text(text, encoding="utf-8")
