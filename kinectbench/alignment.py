"""Aligning the full shape to a view: the trajectory's pose, corrected by the view's own depth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, rotation_angle_rad, transform_points
from kinectbench.icp import OrientedPoints, normal_equations, oriented_points
from kinectbench.segmentation.render import DepthRenderer
from kinectbench.tracking.twist import rigid_from_twist

ITERATIONS = 12
WANTED_POINTS = 4000
MIN_STRIDE_PX, MAX_STRIDE_PX = 2, 4
MIN_POINTS = 100
# Along the surface depth says little: on 9 simulated scans keeping every slightly better fit put poses off
# across the view, by up to 0.8 mm in a scan's median and 5 mm in single views.
MUST_FALL_TO = 0.9
NEAR_M = 0.06
# How far off a pose may be that was never checked; and at least, however well it was found to agree.
UNCHECKED_SIGMA_M = 0.02
LEAST_SIGMA_M = 0.001
# A pose off by 10 mm at the object is off by about 0.01 rad, at a metre.
RAD_PER_M = 0.75
MAX_SIGMAS = 2.5


@dataclass(frozen=True)
class Alignment:
    """The pose of a view.

    Attributes:
        T_world_camera: (4, 4), corrected where that helped, else as the trajectory says.
        moved_m: how far the view's points on the object moved, median, metres; 0 if not corrected.
        turned_rad: by how much the camera turned, radians.
    """

    T_world_camera: NDArray[np.float64]
    moved_m: float
    turned_rad: float


def align_view(
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    renderer: DepthRenderer,
    pose_sigma_m: float = UNCHECKED_SIGMA_M,
) -> Alignment:
    """Correct a view's pose by ICP of its depth to the object, within bounds, if that is confirmed.

    Half of the view's points on the object are fitted; the correction is kept only if the mean residual
    of the other half falls below 90 %: a right pose stays as it is. The trajectory's pose is a prior
    as strong as it was found to agree with the other frames, so motion that the object does not
    constrain stays near zero, and more than 2.5 times its uncertainty is refused.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        camera: intrinsics.
        T_world_camera: (4, 4) as the trajectory says.
        renderer: of the object's closed mesh.
        pose_sigma_m: by how much the pose may be off, metres.
    """
    given = Alignment(T_world_camera, 0.0, 0.0)
    rendered_m = renderer.depth_m(camera, T_world_camera)
    near = (rendered_m > 0) & (np.abs(depth_m - rendered_m) < NEAR_M)
    stride_px = int(np.clip(np.sqrt(near.sum() / WANTED_POINTS), MIN_STRIDE_PX, MAX_STRIDE_PX))
    points = oriented_points(np.where(near, depth_m, np.float32(0)), camera, stride_px)
    fitted, held_out = points.every_second(0), points.every_second(1)
    if len(held_out.points) < MIN_POINTS:
        return given
    sigma_m = max(pose_sigma_m, LEAST_SIGMA_M)
    prior = np.diag([(RAD_PER_M * sigma_m) ** -2] * 3 + [sigma_m**-2] * 3)
    motion = np.eye(4)
    for _ in range(ITERATIONS):
        A, b, _ = normal_equations(fitted, rendered_m, motion, camera)
        motion = motion @ rigid_from_twist(np.linalg.solve(A + prior, b))
    moved_m = float(
        np.median(np.linalg.norm(transform_points(motion, points.points) - points.points, axis=1))
    )
    turned_rad = float(rotation_angle_rad(motion[:3, :3]))
    before_m, after_m = (_residual_m(held_out, rendered_m, moved, camera) for moved in (np.eye(4), motion))
    helps = after_m < MUST_FALL_TO * before_m
    if not helps or moved_m > MAX_SIGMAS * sigma_m:
        return given
    return Alignment(T_world_camera @ motion, moved_m, turned_rad)


def _residual_m(
    points: OrientedPoints, rendered_m: NDArray[np.float32], motion: NDArray[np.float64], camera: Camera
) -> float:
    residuals = normal_equations(points, rendered_m, motion, camera)[2]
    return float(np.mean(np.abs(residuals))) if len(residuals) else np.inf
