"""Align a view with the full shape: correct the trajectory's pose by ICP on the view's own depth."""

from dataclasses import dataclass

import numpy as np

from kinectbench.core.geometry import (
    Camera,
    depth_sigma_m,
    gauss_newton,
    rigid_from_twist,
    rotation_angle_rad,
    transform_points,
    twist_from_rigid,
)
from kinectbench.core.geometry.gauss_newton import NormalEquations
from kinectbench.core.types import Float32, Float64

# Farther depth is ignored: a Kinect's noise is 19 mm there.
MAX_DEPTH_M = 3.5
# A point farther than this from the measurement at its pixel belongs to another surface.
OUTLIER_M = 0.15
# Larger residuals get less weight: near Huber's 1.345, which loses 5 % of the efficiency for normal noise.
HUBER_SIGMAS = 1.5
# Distance of the pixels for normals: nearer pixels share their noise, farther pixels lie beside thin parts.
NORMAL_REACH_PX = 4
# Neighbours whose depths differ by more lie on two surfaces.
STEP_M = 0.05
# Largest number of Gauss-Newton steps.
ITERATIONS = 12
# The stride on the object's pixels is 2 to 4, so that about this many points are left (chosen by hand, for
# time).
WANTED_POINTS, MIN_STRIDE_PX, MAX_STRIDE_PX = 4000, 2, 4
# Fewer points may fit by chance.
MIN_POINTS = 100
# A correction must lower the residual to this ratio. Depth constrains motion along the surface weakly: on 9
# simulated scans, accepting every slightly better fit shifted poses across the view by up to 0.8 mm in a
# scan's median, and by 5 mm in single views.
MUST_FALL_TO = 0.9
# Depth farther than this from the rendered object does not count as the object's.
NEAR_M = 0.06
# Smallest uncertainty of a pose, however well it agrees with the depth.
LEAST_SIGMA_M = 0.001
# A pose that is off by 10 mm at the object is also off by about 0.01 rad, at a metre.
RAD_PER_M = 0.75
# The pose's uncertainty does not explain larger motions.
MAX_SIGMAS = 2.5


@dataclass(frozen=True)
class OrientedPoints:
    """Points (m, 3) in the camera frame, metres, unit normals (m, 3), and sigma of depth (m,), metres."""

    points: Float64
    normals: Float64
    sigma_m: Float64

    def every_second(self, start: int) -> "OrientedPoints":
        """Return every second point, from the first on (start 0) or from the second on (start 1)."""
        return OrientedPoints(self.points[start::2], self.normals[start::2], self.sigma_m[start::2])


def oriented_points(depth_m: Float32, camera: Camera, stride_px: int) -> OrientedPoints:
    """Compute points with normals from depth (height, width), metres, 0 = none, in the camera frame.

    A point's normal comes from the four pixels that are four rows or four columns away. Pixels beyond 3.5 m
    or at a depth edge are left out.
    """
    reach = NORMAL_REACH_PX
    points = camera.backproject(depth_m)
    centre = (slice(reach, -reach, stride_px), slice(reach, -reach, stride_px))

    def shifted(dv: int, du: int) -> Float64:
        height, width = depth_m.shape
        return points[
            reach + dv : height - reach + dv : stride_px, reach + du : width - reach + du : stride_px
        ]

    around = [shifted(0, reach), shifted(0, -reach), shifted(reach, 0), shifted(-reach, 0)]
    normals = np.cross(around[0] - around[1], around[2] - around[3])
    length = np.linalg.norm(normals, axis=-1)
    at = points[centre]
    smooth = (at[..., 2] > 0) & (at[..., 2] < MAX_DEPTH_M) & (length > 0)
    for other in around:
        smooth &= (other[..., 2] > 0) & (np.abs(other[..., 2] - at[..., 2]) < STEP_M)
    unit = normals[smooth] / length[smooth][:, None]
    return OrientedPoints(at[smooth], unit, np.asarray(depth_sigma_m(at[smooth][:, 2])))


def normal_equations(
    surface: OrientedPoints, depth_m: Float32, T_target_source: Float64, camera: Camera
) -> tuple[Float64, Float64, Float64]:
    """Gauss-Newton normal equations of the residuals n . (q - T p), Huber-weighted, in units of sigma.

    Args:
        surface: points p and normals n of the source frame.
        depth_m: (height, width) float32, metres, depth of the target; q is the point measured at the pixel to
            which T p projects.
        T_target_source: (4, 4), T.
        camera: intrinsics of the target.

    Returns:
        A (6, 6), b (6,) for a twist (rotation, translation) in the source frame, and the residuals (m,) in
            metres; NaN for points without a measurement within 0.15 m.
    """
    p, n = surface.points, surface.normals
    no_normals = np.zeros((0, 0, 3), np.float32)
    residuals = gauss_newton.projective_residuals(
        p, n, depth_m, no_normals, camera.intrinsics, np.ascontiguousarray(T_target_source), OUTLIER_M, 0.0
    )
    met, s = np.isfinite(residuals), np.sqrt(2) * surface.sigma_m
    weights = np.minimum(1.0, HUBER_SIGMAS * s / np.maximum(np.abs(residuals), 1e-12)) / s**2
    rows = np.column_stack([np.cross(p, n), n, residuals])
    equations = NormalEquations.of_products(gauss_newton.weighted_products(rows[met], weights[met]))
    return equations.matrix, equations.gradient, residuals


@dataclass(frozen=True)
class ViewAlignment:
    """The pose of a view after alignment.

    Attributes:
        T_world_camera: (4, 4), the corrected pose, or the trajectory's if the correction did not help.
        moved_m: median displacement of the view's points on the object, metres; 0 if not corrected.
        turned_rad: rotation of the camera, radians; 0 if not corrected.
    """

    T_world_camera: Float64
    moved_m: float
    turned_rad: float


def align_view(
    depth_m: Float32, camera: Camera, T_world_camera: Float64, rendered_m: Float32, pose_sigma_m: float
) -> ViewAlignment:
    """Correct a view's pose by ICP of its depth against the object.

    The fit uses every second point on the object. The trajectory's pose is a prior: it keeps motions that
    the object does not constrain near zero. The corrected pose is accepted only if the mean residual of the
    other points falls below 90 % of its initial value, and the median displacement of all points is at most
    2.5 times `pose_sigma_m` (taken as at least 1 mm). With fewer than 100 other points, nothing is corrected.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        camera: intrinsics.
        T_world_camera: (4, 4), the trajectory's pose.
        rendered_m: (height, width) float32, metres, depth of the object's closed mesh at that pose, 0 = none.
        pose_sigma_m: standard deviation of the trajectory's pose, metres.

    Returns:
        The corrected pose, or the trajectory's, and the displacement.
    """
    given = ViewAlignment(T_world_camera, 0.0, 0.0)
    near = (rendered_m > 0) & (np.abs(depth_m - rendered_m) < NEAR_M)
    stride_px = int(np.clip(np.sqrt(near.sum() / WANTED_POINTS), MIN_STRIDE_PX, MAX_STRIDE_PX))
    points = oriented_points(np.where(near, depth_m, np.float32(0)), camera, stride_px)
    fitted, held_out = points.every_second(0), points.every_second(1)
    if len(held_out.points) < MIN_POINTS:
        return given
    sigma_m = max(pose_sigma_m, LEAST_SIGMA_M)
    prior = np.diag([(RAD_PER_M * sigma_m) ** -2] * 3 + [sigma_m**-2] * 3)
    motion = fitted_motion(fitted, rendered_m, camera, prior)
    moved_m = float(
        np.median(np.linalg.norm(transform_points(motion, points.points) - points.points, axis=1))
    )
    turned_rad = float(rotation_angle_rad(motion[:3, :3]))
    if not helps(held_out, rendered_m, motion, camera) or moved_m > MAX_SIGMAS * sigma_m:
        return given
    return ViewAlignment(T_world_camera @ motion, moved_m, turned_rad)


def fitted_motion(surface: OrientedPoints, depth_m: Float32, camera: Camera, prior: Float64) -> Float64:
    """Find the motion (4, 4) of points that best fits a depth image, with a prior for no motion.

    Gauss-Newton minimises the residuals of `normal_equations` plus the motion's twist, weighted by `prior`.

    Args:
        surface: points of a frame, already close to the depth to fit.
        depth_m: (height, width) float32, metres, the depth to fit.
        camera: intrinsics of the depth.
        prior: (6, 6) information of the twist (rotation, translation), in 1 / rad^2 and 1 / m^2.
    """

    def advance(motion: Float64) -> tuple[Float64, float]:
        A, b, _ = normal_equations(surface, depth_m, motion, camera)
        equations = NormalEquations(A, b) + NormalEquations.of_prior(prior, twist_from_rigid(motion))
        return motion @ rigid_from_twist(equations.step()), np.inf

    return gauss_newton.descend(advance, np.eye(4), ITERATIONS)[0]


def helps(points: OrientedPoints, rendered_m: Float32, motion: Float64, camera: Camera) -> bool:
    """Whether a motion lowers the mean residual of at least 100 held-out points to below 90 %.

    Args:
        points: points that the fit did not use, camera frame.
        rendered_m: (height, width) float32, metres, depth of the object; 0 = not on it.
        motion: (4, 4) motion of the points.
        camera: intrinsics of the image.
    """
    before_m, after_m = (
        np.abs(normal_equations(points, rendered_m, T, camera)[2]) for T in (np.eye(4), motion)
    )
    met = np.isfinite(before_m) & np.isfinite(after_m)
    return bool(met.sum() >= MIN_POINTS and after_m[met].mean() < MUST_FALL_TO * before_m[met].mean())
