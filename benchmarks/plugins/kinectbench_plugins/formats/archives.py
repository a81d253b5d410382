"""Recordings that are zip archives: Redwood's scans, and Record3D's .r3d files."""

import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core.geometry import quaternion_xyzw_from_rotation
from kinectbench.core.storage import pretty_json
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.writers.frame import RecordedFrame, Rig
from kinectbench_plugins.formats.image_folders import redwood_stem
from kinectbench_plugins.formats.phones import HIGH, OPENGL_FROM_OPTICAL


def add_member(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    """Add a member that is stored as it is, with a date that never changes."""
    archive.writestr(zipfile.ZipInfo(name), data)


def write_redwood_zip(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a scan of Redwood's as a zip archive: depth/ and rgb/NUMBER-MICROSECONDS.

    Depth is in mm. Depth and colour are each numbered from 1, with stamps of their own. The layout
    holds neither intrinsics nor poses; colour of the size of depth counts as registered.
    """
    with zipfile.ZipFile(path, "x") as archive:
        colors = 0
        for index, frame in enumerate(frames):
            add_member(archive, f"depth/{redwood_stem(index, frame.stamp_ns)}.png", frame.depth_png())
            for stamp_ns, jpeg in frame.color_jpegs():
                add_member(archive, f"rgb/{redwood_stem(colors, stamp_ns)}.jpg", jpeg)
                colors += 1


def write_record3d(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a .r3d file: metadata, and rgbd/N.depth, N.conf and N.jpg of each frame.

    Depth is float32 metres, every pixel of high confidence; both are packed by LZFSE (imagecodecs).
    Times are seconds. A frame without a pose has null in its place. Colour that is not registered is left
    out, as the layout has one camera.
    """
    import imagecodecs

    camera = rig.depth
    poses: list[list[float] | None] = []
    times_s: list[float] = []
    with zipfile.ZipFile(path, "x") as archive:
        for index, frame in enumerate(frames):
            depth = imagecodecs.lzfse_encode(frame.depth_m.astype("<f4").tobytes())
            confidence = imagecodecs.lzfse_encode(np.full(frame.depth_m.shape, HIGH, np.uint8).tobytes())
            add_member(archive, f"rgbd/{index}.depth", bytes(depth))
            add_member(archive, f"rgbd/{index}.conf", bytes(confidence))
            if rig.color_registered:
                add_member(archive, f"rgbd/{index}.jpg", frame.color_jpeg())
            times_s.append(frame.stamp_ns / 1e9)
            T = frame.T_world_camera
            poses.append(None if T is None else _pose_row(T @ OPENGL_FROM_OPTICAL))
        said: dict[str, Any] = {
            "w": camera.width,
            "h": camera.height,
            "dw": camera.width,
            "dh": camera.height,
        }
        said |= {"K": camera.K.T.ravel().tolist(), "fps": 30, "frameTimestamps": times_s}
        if any(poses):
            said["poses"] = poses
        add_member(archive, "metadata", pretty_json(said).encode())


def _pose_row(T: Float64) -> list[float]:
    """A rigid transform (4, 4) as quaternion x y z w and position."""
    return [*quaternion_xyzw_from_rotation(T[:3, :3]).tolist(), *T[:3, 3].tolist()]
