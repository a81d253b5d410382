"""The TUM RGB-D folder: image lists, PNG depth at 5000 units per metre, JPEG colour, poses, camera.json."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, quaternion_xyzw_from_rotation
from kinectbench.simulate.writers.frame import RecordedFrame, png_bytes
from kinectbench.workspace import pretty_json

DEPTH_SCALE = 5000.0


def write_tum(folder: Path, camera: Camera, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: rgb.txt, depth.txt, groundtruth.txt, camera.json, rgb/, depth/.

    `camera.json` holds width, height, fx, fy, cx, cy and depth_scale, which TUM folders by themselves do
    not say.
    """
    (folder / "rgb").mkdir()
    (folder / "depth").mkdir()
    rgb, depth = ["# timestamp filename"], ["# timestamp filename"]
    poses = ["# timestamp tx ty tz qx qy qz qw"]
    for frame in frames:
        stamp = seconds(frame.stamp_ns)
        (folder / "rgb" / f"{stamp}.jpg").write_bytes(frame.color_jpeg())
        (folder / "depth" / f"{stamp}.png").write_bytes(png_bytes(frame.depth_native(DEPTH_SCALE)))
        rgb.append(f"{stamp} rgb/{stamp}.jpg")
        depth.append(f"{stamp} depth/{stamp}.png")
        poses.append(tum_line(frame.stamp_ns, frame.T_world_camera))
    for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", poses)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    (folder / "camera.json").write_text(pretty_json(camera_json(camera) | {"depth_scale": DEPTH_SCALE}))


def camera_json(camera: Camera) -> dict[str, float]:
    """Size and intrinsics in pixels as plain JSON values."""
    return {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}


def seconds(stamp_ns: int) -> str:
    """A time stamp in seconds with six decimals, as TUM writes it."""
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9 // 1000:06d}"


def tum_line(stamp_ns: int, T_world_camera: NDArray[np.float64]) -> str:
    """One pose as `t tx ty tz qx qy qz qw`, seconds and metres, camera to world."""
    quaternion_xyzw = quaternion_xyzw_from_rotation(T_world_camera[:3, :3])
    numbers = [*T_world_camera[:3, 3], *quaternion_xyzw]
    return " ".join([seconds(stamp_ns), *(f"{value:.9f}" for value in numbers)])
