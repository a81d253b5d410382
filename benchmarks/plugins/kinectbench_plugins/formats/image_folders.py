"""Folders of images: 7-Scenes, Redwood's scans, BOP, WildRGB-D."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core.storage import pretty_json
from kinectbench.lab.simulate.writers.frame import (
    DEPTH_SCALE,
    RecordedFrame,
    Rig,
    color_json,
    make_folders,
    matrix_rows,
    png_bytes,
    write_lines,
)
from kinectbench.lab.simulate.writers.image_folders import log_rows

SEVEN_SCENES_INVALID = 65535
MM_PER_M = 1000.0


def write_seven_scenes(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: frame-XXXXXX.{depth.png,color.png,pose.txt}.

    Depth is PNG in mm with 65535 for none, colour PNG. Frames are numbered from 0 in their order; a frame
    without a pose has no pose.txt. `camera-intrinsics.txt` holds the 3x3 matrix of depth. The layout has no
    place for stamps, for the colour camera, or to say that colour is registered: it is read as not
    registered.
    """
    for index, frame in enumerate(frames):
        stem = f"frame-{index:06d}"
        depth = frame.depth_native()
        depth[depth == 0] = SEVEN_SCENES_INVALID
        (folder / f"{stem}.depth.png").write_bytes(png_bytes(depth))
        (folder / f"{stem}.color.png").write_bytes(png_bytes(frame.color_bgr))
        if frame.T_world_camera is not None:
            write_lines(folder / f"{stem}.pose.txt", matrix_rows(frame.T_world_camera))
    write_lines(folder / "camera-intrinsics.txt", matrix_rows(rig.depth.K))


def write_redwood(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: depth/ and rgb/NUMBER-MICROSECONDS, NAME.log, camera.json.

    Depth is in mm. Depth and colour are each numbered from 1, with stamps of their own. The layout
    does not say its intrinsics; `camera.json` does, unlike in the data set.
    """
    make_folders(folder, "depth", "rgb")
    log: list[str] = []
    colors = 0
    for index, frame in enumerate(frames):
        (folder / "depth" / f"{redwood_stem(index, frame.stamp_ns)}.png").write_bytes(frame.depth_png())
        for stamp_ns, jpeg in frame.color_jpegs():
            (folder / "rgb" / f"{redwood_stem(colors, stamp_ns)}.jpg").write_bytes(jpeg)
            colors += 1
        log += log_rows(index, frame)
    if log:
        write_lines(folder / "scan.log", log)
    (folder / "camera.json").write_text(pretty_json(asdict(rig.depth) | color_json(rig)), encoding="utf-8")


def write_bop(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a BOP scene into an empty folder: depth/, rgb/, scene_camera.json.

    Poses are world to camera, translation in mm. The layout has no stamps. Frames with masks are of object 1,
    in mask_visib/ and, without its pose, in scene_gt.json. Colour that is not registered is left out, as the
    format has one camera.
    """
    make_folders(folder, "depth", "rgb")
    cameras: dict[str, dict[str, Any]] = {}
    objects: dict[str, list[dict[str, Any]]] = {}
    for index, frame in enumerate(frames):
        (folder / "depth" / f"{index:06d}.png").write_bytes(frame.depth_png())
        if rig.color_registered:
            (folder / "rgb" / f"{index:06d}.jpg").write_bytes(frame.color_jpeg())
        camera = {"cam_K": rig.depth.K.ravel().tolist(), "depth_scale": MM_PER_M / DEPTH_SCALE}
        if frame.T_world_camera is not None:
            T_camera_world = np.linalg.inv(frame.T_world_camera)
            camera["cam_R_w2c"] = T_camera_world[:3, :3].ravel().tolist()
            camera["cam_t_w2c"] = (T_camera_world[:3, 3] * MM_PER_M).tolist()
        cameras[str(index)] = camera
        frame.add_mask(folder / "mask_visib" / f"{index:06d}_000000.png")
        if frame.mask is not None:
            objects[str(index)] = [{"obj_id": 1}]
    (folder / "scene_camera.json").write_text(pretty_json(cameras), encoding="utf-8")
    if objects:
        (folder / "scene_gt.json").write_text(pretty_json(objects), encoding="utf-8")


def write_wildrgbd(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a scene of WildRGB-D into an empty folder: depth/, rgb/, metadata, cam_poses.txt.

    Depth is PNG in mm, colour PNG, K column by column, poses camera to world. The layout has no stamps.
    masks/ is there if frames have masks. Colour that is not registered is left out, as there is one camera.
    """
    make_folders(folder, "depth", "rgb")
    rows: list[str] = []
    for index, frame in enumerate(frames):
        (folder / "depth" / f"{index:05d}.png").write_bytes(frame.depth_png())
        if rig.color_registered:
            (folder / "rgb" / f"{index:05d}.png").write_bytes(png_bytes(frame.color_bgr))
        if frame.T_world_camera is not None:
            rows.append(f"{index:05d} {' '.join(matrix_rows(frame.T_world_camera))}")
        frame.add_mask(folder / "masks" / f"{index:05d}.png")
    write_lines(folder / "cam_poses.txt", rows)
    K = {"w": rig.depth.width, "h": rig.depth.height, "K": rig.depth.K.T.ravel().tolist()}
    (folder / "metadata").write_text(pretty_json(K), encoding="utf-8")


def redwood_stem(index: int, stamp_ns: int) -> str:
    """The name of Redwood's image at a place of its stream, from 0: NUMBER-MICROSECONDS, from 1."""
    return f"{index + 1:07d}-{stamp_ns // 1000 % 10**12:012d}"
