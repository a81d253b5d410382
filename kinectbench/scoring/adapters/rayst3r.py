"""RaySt3R (Duisterhof et al., NeurIPS 2025) predicts points behind the silhouette: metres, camera frame.

Source: its repository, commit 2c93f81. `eval_wrapper/eval.py` reads a folder, and writes its output there.
"""

from pathlib import Path

import numpy as np

from kinectbench.release.exchange.rgbd import RgbdView, framed, write_color, write_png
from kinectbench.release.release import Release
from kinectbench.scoring.adapters.adapter import Adapter, scaling
from kinectbench.scoring.camera_shape import CameraShape, read_shape

# RaySt3R's loader resizes every image to this size.
WIDTH, HEIGHT = 640, 480
# RaySt3R's depth.png: 65535 stands for 10 m.
MOST_M, STEPS = 10.0, 65535


def write_rayst3r(release: Release, view: RgbdView, folder: Path) -> tuple[RgbdView, dict[str, object]]:
    """Write rgb.png, mask.png, depth.png and intrinsics.pt.

    depth.png is uint16: 65535 stands for 10 m; farther depth becomes 0. No cam2world.pt is written, so
    RaySt3R's output is in the camera frame.
    """
    import torch

    shown = framed(view, WIDTH, HEIGHT)
    write_color(shown, folder)
    write_png(folder / "mask.png", shown.mask.astype(np.uint8) * 255)
    metres = np.where(shown.depth_mm > MOST_M * 1000, 0, shown.depth_mm / 1000.0)
    write_png(folder / "depth.png", np.rint(metres * (STEPS / MOST_M)).astype(np.uint16))
    torch.save(torch.tensor(shown.K, dtype=torch.float32), folder / "intrinsics.pt")
    return shown, {"T_camera_method": scaling(1.0)}


def read_rayst3r(path: Path) -> CameraShape:
    """Read the points of inference_points.ply: float64 x, y, z, metres, camera frame; colours are ignored."""
    return read_shape(path, path.name)


RAYST3R = Adapter(
    write_rayst3r, "inference_points.ply", read_rayst3r, "points", ("color", "depth", "mask"), "torch"
)
