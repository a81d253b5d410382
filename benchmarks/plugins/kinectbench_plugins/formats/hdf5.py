"""Objects of YCB's Berkeley RGB-D data, as one of its cameras records them."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.lab.simulate.writers.frame import RecordedFrame, Rig, make_folders

# As the reader has it: units a metre, and degrees that the turntable turns from frame to frame.
DEPTH_SCALE, STEP_DEG = 10_000.0, 3
SENSOR = "NP5"


def write_ycb(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write NP5_A.h5 and NP5_A.jpg for each angle A, calibration.h5 and poses/NP5_A_pose.h5.

    The camera is NP5, so that its colour camera is the reference. Masks are in pixels of colour, and are
    left out where it has others than depth. The layout has no stamps.
    """
    import h5py

    make_folders(folder, "poses")
    T_depth_color = np.linalg.inv(rig.T_color_depth)
    with h5py.File(folder / "calibration.h5", "w") as file:
        file[f"{SENSOR}_depth_K"], file[f"{SENSOR}_rgb_K"] = rig.depth.K, rig.color.K
        file[f"{SENSOR}_rgb_d"], file[f"{SENSOR}_ir_depth_scale"] = np.zeros(5), np.ones(1)
        file[f"H_{SENSOR}_from_NP5"], file[f"H_{SENSOR}_ir_from_NP5"] = np.eye(4), T_depth_color
    for index, frame in enumerate(frames):
        stem = f"{SENSOR}_{index * STEP_DEG}"
        with h5py.File(folder / f"{stem}.h5", "w") as file:
            file.create_dataset("depth", data=frame.depth_native(DEPTH_SCALE), compression="gzip")
        (folder / f"{stem}.jpg").write_bytes(frame.color_jpeg())
        if frame.mask is not None and rig.color_registered:
            head = f"P4\n{rig.depth.width} {rig.depth.height}\n".encode()
            (folder / "masks").mkdir(exist_ok=True)
            # Black, which is 1 in a bitmap, is the object.
            bits = np.packbits(frame.mask, axis=1).tobytes()
            (folder / "masks" / f"{stem}_mask.pbm").write_bytes(head + bits)
        if frame.T_world_camera is not None:
            with h5py.File(folder / "poses" / f"{stem}_pose.h5", "w") as file:
                file["H_table_from_reference_camera"] = frame.T_world_camera @ T_depth_color


def angles_as_seconds(index: int, stamp_ns: int) -> int:
    """The stamp of a layout of angles: degrees count seconds."""
    return index * STEP_DEG * NS_PER_S
