"""What a user of Open3D would track with: its dense SLAM, and its RGB-D odometry in a chain.

Both as Open3D's own examples do it, on the CPU, without a guard of ours: a frame that comes out wrong is
kept, and only the library's own exception ends the chain.
"""

from typing import Any

import numpy as np

from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Float64

# Open3D's default_config.yml (examples/python/t_reconstruction_system); the farthest depth is 4 m instead of
# 3 m, because rooms are larger than that, and it loses less often so.
VOXEL_M = 0.0058
BLOCK_RESOLUTION, BLOCK_COUNT = 16, 40_000
MIN_DEPTH_M, MAX_DEPTH_M = 0.1, 4.0
MAX_DEPTH_DIFFERENCE_M = 0.07
TRUNCATION_VOXELS = 8.0


def dense_slam(sequence: Sequence) -> tuple[Float64, str | None]:
    """`t.pipelines.slam.Model`: each frame is registered to what its model shows from the pose before.

    Returns:
        (n, 4, 4) T_world_camera, NaN from the frame on where the library gave up; and what it said then.
    """
    import open3d as o3d

    # It warns of the missing colour of its own synthesised frames.
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    camera, device, scale = sequence.camera, o3d.core.Device("CPU:0"), sequence.depth_scale
    intrinsics = o3d.core.Tensor.from_numpy(camera.K)
    slam = o3d.t.pipelines.slam
    pose = o3d.core.Tensor.from_numpy(np.eye(4))
    model = slam.Model(VOXEL_M, BLOCK_RESOLUTION, BLOCK_COUNT, pose, device)
    measured, seen = (slam.Frame(camera.height, camera.width, intrinsics, device) for _ in range(2))
    found = np.full((len(sequence), 4, 4), np.nan)
    for index in range(len(sequence)):
        depth, color = _images(sequence, index)
        measured.set_data_from_image("depth", depth)
        measured.set_data_from_image("color", color)
        try:
            if index:
                step = model.track_frame_to_model(measured, seen, scale, MAX_DEPTH_M, MAX_DEPTH_DIFFERENCE_M)
                pose = pose @ step.transformation
            model.update_frame_pose(index, pose)
            model.integrate(measured, scale, MAX_DEPTH_M, TRUNCATION_VOXELS)
            model.synthesize_model_frame(seen, scale, MIN_DEPTH_M, MAX_DEPTH_M, TRUNCATION_VOXELS, False)
        except RuntimeError as error:
            return found, _problem(index, error)
        found[index] = pose.numpy()
    return found, None


def chained_odometry(sequence: Sequence) -> tuple[Float64, str | None]:
    """`rgbd_odometry_multi_scale` from each frame to the one before: Hybrid, or point-to-plane.

    Hybrid where colour lies on depth pixels.

    Returns:
        As `dense_slam`.
    """
    import open3d as o3d

    methods = o3d.t.pipelines.odometry.Method
    method = methods.Hybrid if sequence.color_registered else methods.PointToPlane
    intrinsics = o3d.core.Tensor.from_numpy(sequence.camera.K)
    still = o3d.core.Tensor.from_numpy(np.eye(4))
    found = np.full((len(sequence), 4, 4), np.nan)
    found[0] = np.eye(4)
    before = _rgbd(sequence, 0)
    for index in range(1, len(sequence)):
        current = _rgbd(sequence, index)
        try:
            step = o3d.t.pipelines.odometry.rgbd_odometry_multi_scale(
                current, before, intrinsics, still, sequence.depth_scale, MAX_DEPTH_M, method=method
            )
        except RuntimeError as error:
            return found, _problem(index, error)
        found[index] = found[index - 1] @ step.transformation.cpu().numpy()
        before = current
    return found, None


def _rgbd(sequence: Sequence, index: int) -> Any:
    import open3d as o3d

    depth, color = _images(sequence, index)
    return o3d.t.geometry.RGBDImage(color, depth)


def _images(sequence: Sequence, index: int) -> tuple[Any, Any]:
    """Depth in native units and colour (black where there is none) as the library's images."""
    import open3d as o3d

    depth = sequence.frames.depth_native(index)
    color = sequence.color_rgb(index)
    if color is None or color.shape[:2] != depth.shape:
        color = np.zeros((*depth.shape, 3), np.uint8)
    images = (np.ascontiguousarray(image) for image in (depth[..., None], color))
    first, second = (o3d.t.geometry.Image(o3d.core.Tensor.from_numpy(image)) for image in images)
    return first, second


def _problem(index: int, error: RuntimeError) -> str:
    """The library's message in a line, without the place in its source."""
    return f"gives up at frame {index}: {str(error).strip().splitlines()[-1].rpartition(': ')[2]}"
