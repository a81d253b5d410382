"""A plain folder as Open3D and Redwood use it: PNG depth in mm, JPEG colour, intrinsics, trajectory.log."""

from collections.abc import Iterable
from pathlib import Path

from kinectbench.simulate.writers.camera_text import color_json, matrix_rows
from kinectbench.simulate.writers.frame import RecordedFrame, Rig, png_bytes
from kinectbench.workspace import pretty_json

DEPTH_SCALE = 1000.0


def write_folder(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: depth/XXXXXX.png, color/XXXXXX.jpg, intrinsics, trajectory.

    Frames are numbered from 0 in their order; the layout has no stamps. `camera_intrinsic.json` is Open3D's
    (`intrinsic_matrix` by columns) with depth_scale and what `color_json` says beside it, which Open3D passes
    over. `trajectory.log` holds `i i i+1` and four rows, camera to world, for each frame that has a pose; it
    is not there if none has.
    """
    for name in ("depth", "color"):
        (folder / name).mkdir()
    log: list[str] = []
    for index, frame in enumerate(frames):
        (folder / "depth" / f"{index:06d}.png").write_bytes(png_bytes(frame.depth_native(DEPTH_SCALE)))
        (folder / "color" / f"{index:06d}.jpg").write_bytes(frame.color_jpeg())
        if frame.T_world_camera is not None:
            log += [f"{index} {index} {index + 1}", *matrix_rows(frame.T_world_camera)]
    if log:
        (folder / "trajectory.log").write_text("\n".join(log) + "\n")
    camera = {
        "width": rig.depth.width,
        "height": rig.depth.height,
        "intrinsic_matrix": rig.depth.K.T.ravel().tolist(),
        "depth_scale": DEPTH_SCALE,
    }
    (folder / "camera_intrinsic.json").write_text(pretty_json(camera | color_json(rig)))
