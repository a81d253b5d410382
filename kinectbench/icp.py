"""Projective point-to-plane ICP (Rusinkiewicz & Levoy 2001; Chen & Medioni 1991): points and kernel."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera
from kinectbench.geometry.depth_noise import depth_sigma_m

MAX_DEPTH_M = 3.5
OUTLIER_M = 0.15
HUBER_SIGMAS = 1.5
NORMAL_REACH_PX = 4


@dataclass(frozen=True)
class OrientedPoints:
    """Points of one frame, camera frame: (m, 3) metres, normals (m, 3), depth sigma (m,) metres."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    sigma_m: NDArray[np.float64]

    def every_second(self, start: int) -> "OrientedPoints":
        """Every second point, from the first (0) or the second (1) on."""
        return OrientedPoints(self.points[start::2], self.normals[start::2], self.sigma_m[start::2])


def oriented_points(depth_m: NDArray[np.float32], camera: Camera, stride_px: int) -> OrientedPoints:
    """Every n-th pixel with a normal by central differences over four pixels either way."""
    reach = NORMAL_REACH_PX
    points = camera.backproject(depth_m)
    centre = (slice(reach, -reach, stride_px), slice(reach, -reach, stride_px))

    def shifted(dv: int, du: int) -> NDArray[np.float64]:
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
        smooth &= (other[..., 2] > 0) & (np.abs(other[..., 2] - at[..., 2]) < 0.05)
    unit = normals[smooth] / length[smooth][:, None]
    return OrientedPoints(at[smooth], unit, np.asarray(depth_sigma_m(at[smooth][:, 2])))


def normal_equations(
    surface: OrientedPoints,
    depth_m: NDArray[np.float32],
    T_target_source: NDArray[np.float64],
    camera: Camera,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Gauss-Newton terms of the residuals n . (q - T p), Huber-weighted, in units of sigma.

    Args:
        surface: the source frame's points p and normals n.
        depth_m: (height, width) float32, the target's depth; q lies on the pixel that T p falls on.
        T_target_source: (4, 4), T.
        camera: of the target.

    Returns:
        A (6, 6), b (6,) for a twist (rotation, translation) in the source frame, and the residuals (m,)
        in metres of the points that met a measurement within 0.15 m.
    """
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    A, b, residuals = _accumulate(
        surface.points, surface.normals, surface.sigma_m, depth_m, T_target_source, intrinsics
    )
    return A, b, residuals


@numba.njit(cache=True, error_model="numpy")
def _accumulate(points, normals, sigma, depth, T, intrinsics):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    A, b, J = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    residuals = np.empty(len(points))
    count = 0
    for i in range(len(points)):
        p, n = points[i], normals[i]
        x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
        y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
        z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if z <= 0.1:
            continue
        u, v = fx * x / z + cx + 0.5, fy * y / z + cy + 0.5
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        d = depth[int(v), int(u)]
        if d <= 0 or abs(d - z) > OUTLIER_M:
            continue
        # The measured point q on the pixel's ray, and the residual along the (turned) normal of p.
        dx, dy, dz = (int(u) - cx) / fx * d - x, (int(v) - cy) / fy * d - y, d - z
        mx = T[0, 0] * n[0] + T[0, 1] * n[1] + T[0, 2] * n[2]
        my = T[1, 0] * n[0] + T[1, 1] * n[1] + T[1, 2] * n[2]
        mz = T[2, 0] * n[0] + T[2, 1] * n[1] + T[2, 2] * n[2]
        r = mx * dx + my * dy + mz * dz
        s = sigma[i] * 1.4142135
        huber = min(1.0, HUBER_SIGMAS * s / max(abs(r), 1e-12))
        w = huber / (s * s)
        J[0], J[1], J[2] = p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]
        J[3], J[4], J[5] = n[0], n[1], n[2]
        for row in range(6):
            b[row] += w * r * J[row]
            for column in range(6):
                A[row, column] += w * J[row] * J[column]
        residuals[count] = r
        count += 1
    return A, b, residuals[:count]
