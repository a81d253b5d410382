"""A folder as Redwood's scans of objects: PNG depth in mm, JPEG colour, stamps in the names, a .log."""

from collections.abc import Iterable
from pathlib import Path

from kinectbench.simulate.writers.camera_text import camera_json, color_json, matrix_rows
from kinectbench.simulate.writers.frame import RecordedFrame, Rig, png_bytes
from kinectbench.workspace import pretty_json

DEPTH_SCALE = 1000.0


def write_redwood(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: depth/ and rgb/NUMBER-MICROSECONDS, NAME.log, camera.json.

    Frames are numbered from 1, depth and colour each with stamps of their own. The log holds `i i i+1` from 0
    and four rows, camera to world, for each frame that has a pose. The layout does not say its intrinsics;
    `camera.json` does, unlike in the data set.
    """
    for name in ("depth", "rgb"):
        (folder / name).mkdir()
    log: list[str] = []
    for index, frame in enumerate(frames):
        depth_name = f"{index + 1:07d}-{frame.stamp_ns // 1000 % 10**12:012d}.png"
        color_name = f"{index + 1:07d}-{frame.color_stamp_ns // 1000 % 10**12:012d}.jpg"
        (folder / "depth" / depth_name).write_bytes(png_bytes(frame.depth_native(DEPTH_SCALE)))
        (folder / "rgb" / color_name).write_bytes(frame.color_jpeg())
        if frame.T_world_camera is not None:
            log += [f"{index} {index} {index + 1}", *matrix_rows(frame.T_world_camera)]
    if log:
        (folder / "scan.log").write_text("\n".join(log) + "\n")
    (folder / "camera.json").write_text(pretty_json(camera_json(rig.depth) | color_json(rig)))
