"""Frame-to-frame odometry by Open3D, for recordings without a trajectory. It drifts, and says so."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.sequence import Sequence

MAX_DEPTH_M = 4.0
MIN_FITNESS = 0.3
MAX_STEP_M = 0.5


def odometry(
    sequence: Sequence, progress: Callable[[int, int], None] | None = None
) -> tuple[NDArray[np.float64], int | None]:
    """Chain frame-to-frame motion, starting at the first camera.

    Hybrid (colour and depth) where colour is registered to depth, point-to-plane ICP otherwise
    (Open3D `rgbd_odometry_multi_scale`).

    Returns:
        (n, 4, 4) T_world_camera, NaN from the frame on that could not be joined; and that frame's
        index, or None if all were joined.
    """
    import open3d as o3d

    camera = sequence.camera
    intrinsics = o3d.core.Tensor.from_numpy(camera.K)
    methods = o3d.t.pipelines.odometry.Method
    method = methods.Hybrid if sequence.color_registered else methods.PointToPlane
    poses = np.full((len(sequence), 4, 4), np.nan)
    poses[0] = np.eye(4)
    before = _rgbd(sequence, 0)
    for index in range(1, len(sequence)):
        current = _rgbd(sequence, index)
        try:
            step = o3d.t.pipelines.odometry.rgbd_odometry_multi_scale(
                current,
                before,
                intrinsics,
                o3d.core.Tensor.from_numpy(np.eye(4)),
                1.0,
                MAX_DEPTH_M,
                method=method,
            )
        except RuntimeError:
            # The library's way of saying that it found no correspondences.
            return poses, index
        motion = step.transformation.cpu().numpy()
        if step.fitness < MIN_FITNESS or np.linalg.norm(motion[:3, 3]) > MAX_STEP_M:
            return poses, index
        poses[index] = poses[index - 1] @ motion
        before = current
        if progress:
            progress(index + 1, len(sequence))
    return poses, None


def _rgbd(sequence: Sequence, index: int) -> Any:
    import open3d as o3d

    depth_m = sequence.depth_m(index)
    color = sequence.color_rgb(index) if sequence.color_registered else None
    if color is None:
        color = np.zeros((*depth_m.shape, 3), np.uint8)
    return o3d.t.geometry.RGBDImage(
        o3d.t.geometry.Image(o3d.core.Tensor.from_numpy(color)),
        o3d.t.geometry.Image(o3d.core.Tensor.from_numpy(depth_m[..., None])),
    )
