"""Write folders of images: TUM RGB-D, and plain folders as Open3D uses them."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from kinectbench.core import pretty_json
from kinectbench.core.geometry import quaternion_xyzw_from_rotation
from kinectbench.core.trajectory.stamps import format_stamp
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.writers.frame import (
    DEPTH_SCALE,
    RecordedFrame,
    Rig,
    color_json,
    make_folders,
    matrix_rows,
    write_lines,
)

TUM_DEPTH_SCALE = 5000.0
TUM_HEADERS = {
    "rgb": "# timestamp filename",
    "depth": "# timestamp filename",
    "groundtruth": "# timestamp tx ty tz qx qy qz qw",
}


def write_tum(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: rgb.txt, depth.txt, groundtruth.txt, camera.json, rgb/, depth/.

    Depth is PNG at 5000 units per metre, colour JPEG. The lists are in the order of the frames; colour has
    its own stamps. A frame without a pose has no row in groundtruth.txt; the file is missing if no frame has
    a pose. `camera.json` has what TUM's format lacks: width, height, fx, fy, cx, cy, depth_scale, and the
    keys of `color_json`. masks/ exists if frames have masks; a mask has the name of its depth image.
    """
    make_folders(folder, "rgb", "depth")
    rows = {name: [header] for name, header in TUM_HEADERS.items()}
    for frame in frames:
        depth = frame.depth_png(TUM_DEPTH_SCALE)
        rows["depth"].append(_add_stamped(folder, "depth", frame.stamp_ns, ".png", depth))
        frame.add_mask(folder / "masks" / rows["depth"][-1].rpartition("/")[2])
        for stamp_ns, jpeg in frame.color_jpegs():
            rows["rgb"].append(_add_stamped(folder, "rgb", stamp_ns, ".jpg", jpeg))
        if frame.T_world_camera is not None:
            rows["groundtruth"].append(tum_line(frame.given_ns, frame.T_world_camera))
    if len(rows["groundtruth"]) == 1:
        del rows["groundtruth"]
    for name, lines in rows.items():
        write_lines(folder / f"{name}.txt", lines)
    camera = asdict(rig.depth) | {"depth_scale": TUM_DEPTH_SCALE} | color_json(rig)
    (folder / "camera.json").write_text(pretty_json(camera), encoding="utf-8")


def write_folder(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: depth/XXXXXX.png, color/XXXXXX.jpg, intrinsics, trajectory.

    Depth is in mm. Frames are numbered from 0 in their order; the layout has no stamps. masks/XXXXXX.png
    exists if frames have masks. `camera_intrinsic.json` is Open3D's (`intrinsic_matrix` by columns), with
    depth_scale and the keys of `color_json` added, which Open3D ignores. `trajectory.log` is missing if no
    frame has a pose.
    """
    make_folders(folder, "depth", "color")
    log: list[str] = []
    for index, frame in enumerate(frames):
        (folder / "depth" / f"{index:06d}.png").write_bytes(frame.depth_png())
        (folder / "color" / f"{index:06d}.jpg").write_bytes(frame.color_jpeg())
        frame.add_mask(folder / "masks" / f"{index:06d}.png")
        log += log_rows(index, frame)
    if log:
        write_lines(folder / "trajectory.log", log)
    camera = {
        "width": rig.depth.width,
        "height": rig.depth.height,
        "intrinsic_matrix": rig.depth.K.T.ravel().tolist(),
        "depth_scale": DEPTH_SCALE,
    }
    (folder / "camera_intrinsic.json").write_text(pretty_json(camera | color_json(rig)), encoding="utf-8")


def seconds(stamp_ns: int) -> str:
    """Return a stamp as text in seconds with six decimals, truncated to 1 µs, as in TUM's files."""
    return format_stamp(stamp_ns // 1000 * 1000)[:-3]


def tum_line(stamp_ns: int, T_world_camera: Float64) -> str:
    """Return one pose as TUM's line `t tx ty tz qx qy qz qw`: seconds, metres, camera to world."""
    quaternion_xyzw = quaternion_xyzw_from_rotation(T_world_camera[:3, :3])
    numbers = [*T_world_camera[:3, 3], *quaternion_xyzw]
    return " ".join([seconds(stamp_ns), *(f"{value:.9f}" for value in numbers)])


def _add_stamped(folder: Path, name: str, stamp_ns: int, suffix: str, data: bytes) -> str:
    """Write an image's bytes into `folder / name`, named by its stamp; return its list row, `stamp file`."""
    stamp = seconds(stamp_ns)
    file, copies = folder / name / f"{stamp}{suffix}", 1
    while file.exists():  # stamps may repeat, and every frame is kept
        copies += 1
        file = folder / name / f"{stamp}_{copies}{suffix}"
    file.write_bytes(data)
    return f"{stamp} {name}/{file.name}"


def log_rows(index: int, frame: RecordedFrame) -> list[str]:
    """Return a frame's lines of Redwood's log: `i i i+1` and the four rows of its pose; [] if it has none."""
    if frame.T_world_camera is None:
        return []
    return [f"{index} {index} {index + 1}", *matrix_rows(frame.T_world_camera)]
