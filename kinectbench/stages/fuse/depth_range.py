"""Choose the largest depth to fuse so that it includes the cameras' target, unless the settings give it.

The target is what the cameras look at. Its distance is taken as the larger of two: the distance to where the
optical axes meet, and the 10th percentile of the depth in the middle of the images. If the axes do not meet,
as along a shelf, only the second is meaningful. The target may extend farther back, by the radius of a ball
that fills the wider side of the image. This rule is our own. Its result is clipped to 3 to 8 m.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kinectbench.core.artefacts.reconstruction import DepthRangePart
from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import Camera, Grid, invert_rigid, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.coverage import convergence_point
from kinectbench.core.types import Float32, Float64, Int64
from kinectbench.settings.models import LEAST_RANGE_M, FusionSettings

# The noise of a Kinect is 0.11 m there; larger values are often invalid.
FARTHEST_M = 8.0
# Rounded up to it, so that poses that differ by a hair give the same range.
RANGE_STEP_M = 0.1
# Number of evenly spread frames to sample, and stride of the sampled pixels along rows and columns.
SAMPLE_FRAMES, SAMPLE_STEP_PX = 40, 8
# The 10th percentile of depth, because a tenth of the pixels is more than a speck. The 95th percentile over
# the cameras, so that odd cameras do not count.
NEAREST_SHARE, USUAL_SHARE = 0.1, 0.95
# A warning is given if a larger share of the depth in the middle of the images is missed.
MAX_MISSED_SHARE = 0.05


@dataclass(frozen=True)
class SampledDepth:
    """Depth measured in some frames, at a sample of their pixels.

    Attributes:
        whole_m: (n,) float32, depth of all sampled pixels, metres.
        middle_m: (m,) depth of the pixels in the middle third of rows and of columns, metres.
        nearest_m: (k,) 10th percentile of the middle depth of each frame that has any, metres.
    """

    whole_m: Float32
    middle_m: Float32
    nearest_m: Float32


def sample_depth(depths_m: Iterable[Float32]) -> SampledDepth:
    """Collect the measured depth of images (height, width) of sampled pixels, metres, 0 = none."""
    whole, middle = [np.zeros(0, np.float32)], [np.zeros(0, np.float32)]
    nearest = []
    for depth_m in depths_m:
        height, width = depth_m.shape
        inner_m = depth_m[height // 3 : height - height // 3, width // 3 : width - width // 3]
        whole.append(depth_m[depth_m > 0])
        middle.append(inner_m[inner_m > 0])
        if len(middle[-1]):
            nearest.append(np.quantile(middle[-1], NEAREST_SHARE))
    return SampledDepth(np.concatenate(whole), np.concatenate(middle), np.array(nearest, np.float32))


def some_frames(frames: Int64, most: int = SAMPLE_FRAMES) -> Int64:
    """Return at most `most` of the frames (n,), evenly spread."""
    return frames[evenly(len(frames), most)]


def depth_range_of(
    sequence: Sequence, frames: Int64, T_world_camera: Float64, settings: FusionSettings
) -> DepthRangePart:
    """Sample the depth of frames (n,), n > 0, with poses (n, 4, 4), and choose their `depth_range`."""
    sampled = sample_depth(sequence.depths_m(some_frames(frames), SAMPLE_STEP_PX))
    return depth_range(sequence.camera, T_world_camera, sampled, settings)


def depth_range(
    camera: Camera, T_world_camera: Float64, sampled: SampledDepth, settings: FusionSettings
) -> DepthRangePart:
    """Choose the largest depth to fuse into the scene, 3 to 8 m, and find the share of the depth beyond it.

    Args:
        camera: intrinsics of the depth images.
        T_world_camera: (n, 4, 4), finite; n = 0 if no poses are known.
        sampled: depth of some frames.
        settings: may give the largest depth; then it is not chosen.
    """
    looked_at_m = _looked_at_m(T_world_camera, sampled)
    reach_m = None if looked_at_m is None else (1 + _ball_share(camera)) * looked_at_m
    given_m = settings.max_depth_m
    max_depth_m = _range_m(reach_m or 0.0) if given_m is None else given_m
    whole_m, middle_m = sampled.whole_m, sampled.middle_m
    missed = (middle_m > max_depth_m) & (middle_m <= (reach_m or 0.0))
    return DepthRangePart(
        max_depth_m=max_depth_m,
        chosen_by="recording" if given_m is None else "setting",
        looked_at_m=None if looked_at_m is None else round(looked_at_m, 3),
        reach_m=None if reach_m is None else round(reach_m, 3),
        beyond_share=round(float((whole_m > max_depth_m).mean()), 4) if len(whole_m) else 0.0,
        missed_share=round(float(missed.mean()), 4) if len(middle_m) else 0.0,
    )


def range_warnings(part: DepthRangePart) -> tuple[str, ...]:
    """Return a warning if the object of interest may lie beyond the largest fused depth, else ()."""
    if part.missed_share <= MAX_MISSED_SHARE:
        return ()
    remedy = "raise `fusion.max_depth_m`, or leave it out"
    if part.chosen_by == "recording":
        remedy = "record from nearer"
    return (
        f"{part.missed_share:.0%} of the depth in the middle of the images makes no surface: it lies beyond "
        f"{part.max_depth_m:g} m, and what the cameras look at may reach to {part.reach_m:.1f} m; {remedy}",
    )


def grid_range_m(T_world_camera: Float64, grid: Grid, settings: FusionSettings) -> float:
    """Return the largest depth to fuse into a grid, metres: its farthest point's, clipped to 3 to 8 m.

    All depth inside the grid is useful: depth measured on the far wall of a cavity carves the cavity. The
    size of the grid limits the cost. If the settings give `fusion.max_depth_m`, that is returned instead.

    Args:
        T_world_camera: (n, 4, 4), poses of the frames, finite.
        grid: the grid.
        settings: may give the largest depth.
    """
    if settings.max_depth_m is not None:
        return settings.max_depth_m
    corners = np.stack(np.meshgrid(*([0.0, side] for side in grid.size_m)), axis=-1).reshape(-1, 3)
    corners_world = transform_points(grid.T_world_grid, corners)
    ahead_m = [transform_points(invert_rigid(T), corners_world)[:, 2].max() for T in T_world_camera]
    return _range_m(float(max(ahead_m, default=0.0)))


def _range_m(reach_m: float) -> float:
    # A part of a millionth less, or 4.1 / 0.1 would be rounded up to 42 steps.
    stepped_m = np.ceil(reach_m / RANGE_STEP_M - 1e-6) * RANGE_STEP_M
    return round(float(np.clip(stepped_m, LEAST_RANGE_M, FARTHEST_M)), 3)


def _looked_at_m(T_world_camera: Float64, sampled: SampledDepth) -> float | None:
    """Return a typical distance to the target along the optical axis, metres; None if nothing is known."""
    distances_m = []
    if len(T_world_camera):
        towards = convergence_point(T_world_camera) - T_world_camera[:, :3, 3]
        ahead_m = (towards * T_world_camera[:, :3, 2]).sum(axis=1)
        distances_m.append(float(np.quantile(np.maximum(ahead_m, 0), USUAL_SHARE)))
    if len(sampled.nearest_m):
        distances_m.append(float(np.median(sampled.nearest_m)))
    return max(distances_m, default=None)


def _ball_share(camera: Camera) -> float:
    """Return the radius of a ball that fills the image's wider side, divided by its centre's distance."""
    half_view = np.arctan(max(camera.width / camera.fx, camera.height / camera.fy) / 2)
    return float(np.sin(half_view))
