"""The sensor's own depth distortion, found from what no rigid motion between keyframes explains.

A structured-light sensor errs in disparity, by an amount that varies smoothly over the image (Herrera,
Kannala and Heikkila, PAMI 2012; Teichman, Miller and Thrun, RSS 2013). It moves with the camera, pulls every
registration a little the same way, and bends a walk around a chair by millimetres. So, after Zhou and Koltun
("Simultaneous localization and calibration", CVPR 2014), it is estimated along: 1 / true depth = 1 / depth +
correction, a polynomial of the pixel.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, transform_points
from kinectbench.geometry.depth_calibration import (
    NO_CALIBRATION,
    TERMS,
    DepthCalibration,
    legendre_terms,
)
from kinectbench.geometry.depth_noise import depth_sigma_m
from kinectbench.tracking.frame_maps import Level
from kinectbench.tracking.linearise import add_products, mirrored
from kinectbench.tracking.registration import CORRELATED_POINTS

Float64 = NDArray[np.float64]

# A point of each tie in so many is enough.
POINTS_PER_TIE = 1500
# How large the correction may be expected: 1 % of depth at 4 m; higher degrees less.
PRIOR_PER_M = 0.0025
GATE_M, MIN_FACING, HUBER_SIGMAS = 0.06, 0.7, 1.5
MIN_TIES = 6


@dataclass(frozen=True)
class View:
    """One tie as it is seen by the calibration: points of b that fall on a, finest level."""

    source: Level
    target: Level
    T_target_source: Float64


def calibrate(views: Iterable[View]) -> DepthCalibration:
    """The correction that agrees best with many ties; each tie's motion is free besides.

    Args:
        views: with depth as recorded, not yet corrected.
    """
    k = len(TERMS)
    normal_matrix = np.diag([((1 + i + j) / PRIOR_PER_M) ** 2 for i, j in TERMS])
    right = np.zeros(k)
    ties = 0
    for view in views:
        rows, residuals, weights = _linearised(view)
        if len(rows) < 10 * k:
            continue
        ties += 1
        sums = np.zeros((6 + k + 1, 6 + k + 1))
        columns = np.ascontiguousarray(np.column_stack([rows, residuals]).T)
        add_products(sums, columns, weights / CORRELATED_POINTS, len(weights))
        sums = mirrored(sums)
        A, b = sums[:-1, :-1], sums[:-1, -1]
        # The motion is eliminated: what is left is what it cannot explain.
        motion = np.linalg.solve(A[:6, :6] + 1e-6 * np.eye(6), np.column_stack([A[:6, 6:], b[:6]]))
        normal_matrix += A[6:, 6:] - A[6:, :6] @ motion[:, :-1]
        right += b[6:] - A[6:, :6] @ motion[:, -1]
    if ties < MIN_TIES:
        return NO_CALIBRATION
    return DepthCalibration(np.asarray(-np.linalg.solve(normal_matrix, right), np.float64))


def _linearised(view: View) -> tuple[Float64, Float64, Float64]:
    """Rows (m, 6 + k) of residual + row @ (twist, coefficients), the residuals (m,) and weights (m,)."""
    source, target = view.source, view.target
    every = max(1, len(source.points) // POINTS_PER_TIE)
    points = source.points[::every].astype(np.float64)
    p, normals = points[:, :3], points[:, 3:6]
    at = transform_points(view.T_target_source, p)
    ahead = at[:, 2] > 0.1
    p, normals, at = p[ahead], normals[ahead], at[ahead]
    u, v = np.rint(target.camera.project(at)).astype(int).T
    height, width = target.depth_m.shape
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    p, normals, at, u, v = p[inside], normals[inside], at[inside], u[inside], v[inside]
    d = target.depth_m[v, u].astype(np.float64)
    n = normals @ view.T_target_source[:3, :3].T + target.normals[v, u]
    length = np.linalg.norm(n, axis=1)
    # Twice the cosine of half the angle between the normals.
    met = (d > 0) & (np.abs(d - at[:, 2]) < GATE_M) & (length > 2 * MIN_FACING)
    p, at, u, v, d, n = p[met], at[met], u[met], v[met], d[met], n[met] / length[met][:, None]
    q = _rays(target.camera, u, v) * d[:, None]
    residuals = (n * (q - at)).sum(axis=1)
    own = source.camera.project(p)
    by_target = (
        legendre_terms(u.astype(float), v.astype(float), width, height) * (-d * (n * q).sum(axis=1))[:, None]
    )
    along = (n * (at - view.T_target_source[:3, 3])).sum(axis=1)
    by_source = legendre_terms(own[:, 0], own[:, 1], width, height) * (p[:, 2] * along)[:, None]
    n_source = n @ view.T_target_source[:3, :3]
    rows = np.column_stack([-np.cross(p, n_source), -n_source, by_target + by_source])
    sigma = np.sqrt(depth_sigma_m(d) ** 2 + depth_sigma_m(p[:, 2]) ** 2)
    huber = np.minimum(1.0, HUBER_SIGMAS * sigma / np.maximum(np.abs(residuals), 1e-9))
    return rows, residuals, huber / sigma**2


def _rays(camera: Camera, u: NDArray[np.int64], v: NDArray[np.int64]) -> Float64:
    return np.column_stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))])
