"""The TUM RGB-D folder: image lists, PNG depth at 5000 units per metre, JPEG colour, poses, camera.json."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import quaternion_xyzw_from_rotation
from kinectbench.ingest.stamps import format_stamp
from kinectbench.simulate.writers.camera_text import camera_json, color_json
from kinectbench.simulate.writers.frame import RecordedFrame, Rig, png_bytes
from kinectbench.workspace import pretty_json

DEPTH_SCALE = 5000.0
HEADERS = {
    "rgb": "# timestamp filename",
    "depth": "# timestamp filename",
    "groundtruth": "# timestamp tx ty tz qx qy qz qw",
}


def write_tum(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: rgb.txt, depth.txt, groundtruth.txt, camera.json, rgb/, depth/.

    The lists are in the order of the frames, colour with its own stamps. A frame without a pose has no row
    in groundtruth.txt, which is not there at all if no frame has one. `camera.json` holds what TUM folders by
    themselves do not say: width, height, fx, fy, cx, cy, depth_scale, and what `color_json` says of colour.
    """
    rows = {name: [header] for name, header in HEADERS.items()}
    for name in ("rgb", "depth"):
        (folder / name).mkdir()
    for frame in frames:
        depth = png_bytes(frame.depth_native(DEPTH_SCALE))
        rows["depth"].append(_add_image(folder, "depth", frame.stamp_ns, ".png", depth))
        rows["rgb"].append(_add_image(folder, "rgb", frame.color_stamp_ns, ".jpg", frame.color_jpeg()))
        if frame.T_world_camera is not None:
            rows["groundtruth"].append(tum_line(frame.given_ns, frame.T_world_camera))
    if len(rows["groundtruth"]) == 1:
        del rows["groundtruth"]
    for name, lines in rows.items():
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    camera = camera_json(rig.depth) | {"depth_scale": DEPTH_SCALE} | color_json(rig)
    (folder / "camera.json").write_text(pretty_json(camera))


def seconds(stamp_ns: int) -> str:
    """A time stamp in seconds with six decimals, as TUM writes it; what is below 1 µs is cut off."""
    return format_stamp(stamp_ns // 1000 * 1000)[:-3]


def tum_line(stamp_ns: int, T_world_camera: NDArray[np.float64]) -> str:
    """One pose as `t tx ty tz qx qy qz qw`, seconds and metres, camera to world."""
    quaternion_xyzw = quaternion_xyzw_from_rotation(T_world_camera[:3, :3])
    numbers = [*T_world_camera[:3, 3], *quaternion_xyzw]
    return " ".join([seconds(stamp_ns), *(f"{value:.9f}" for value in numbers)])


def _add_image(folder: Path, name: str, stamp_ns: int, suffix: str, data: bytes) -> str:
    """Write one image into `folder / name`, named by its stamp; its row of the list, `stamp file`."""
    stamp = seconds(stamp_ns)
    file, copies = folder / name / f"{stamp}{suffix}", 1
    while file.exists():  # stamps may repeat, and every frame is kept
        copies += 1
        file = folder / name / f"{stamp}_{copies}{suffix}"
    file.write_bytes(data)
    return f"{stamp} {name}/{file.name}"
