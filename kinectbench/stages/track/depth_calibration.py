"""Depth distortion of the sensor, estimated from residuals that no rigid motion explains.

A structured-light sensor errs in disparity, by an amount that varies smoothly over the image (Herrera,
Kannala and Heikkila, PAMI 2012; Teichman, Miller and Thrun, RSS 2013). The error moves with the camera. It
biases every registration in the same direction and bends a path around a chair by millimetres. The distortion
is therefore estimated together with the poses, after Zhou and Koltun ("Simultaneous localization and
calibration", CVPR 2014): 1 / true depth = 1 / depth + correction, where the correction is a polynomial of the
pixel.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import (
    NO_CALIBRATION,
    TERMS,
    DepthCalibration,
    depth_sigma_m,
    invert_rigid,
    legendre_terms,
    transform_points,
)
from kinectbench.core.geometry.gauss_newton import NormalEquations, eliminated, weighted_products
from kinectbench.core.threads import ahead
from kinectbench.core.types import Float64
from kinectbench.stages.track.covisibility import covisible, keyframe_thumbnail
from kinectbench.stages.track.frame_maps import Level, MapCache
from kinectbench.stages.track.map_kernels import PROJECTED_FROM_M
from kinectbench.stages.track.registration import CORRELATED_POINTS

# Points that each pair contributes.
POINTS_PER_PAIR = 1500
# Prior standard deviation of the correction: 1 % of the depth at 4 m; less for higher degrees.
PRIOR_PER_M = 0.0025
# Points farther from the measurement, or whose normals differ by more than 90 degrees (compared as the cosine
# of half the angle), belong to another surface; residuals beyond HUBER_SIGMAS standard deviations count less.
GATE_M, MIN_FACING, HUBER_SIGMAS = 0.06, 0.7, 1.5
# With fewer pairs, validating one half by the other is unreliable.
MIN_PAIRS = 6
# Smallest shared view of a pair of frames, and the largest number of pairs.
MIN_SHARED_VIEW, MAX_PAIRS = 0.3, 400
# A correction is used with given poses only if it lowers the squared residuals to this ratio or less.
POSED_FALLS_TO = 0.98


@dataclass(frozen=True)
class CalibrationView:
    """Two overlapping frames, compared to estimate the depth distortion.

    Attributes:
        source: finest pyramid level of the frame whose points are projected into the other one.
        target: finest pyramid level of that other frame.
        T_target_source: (4, 4), source camera to target camera, metres.
    """

    source: Level
    target: Level
    T_target_source: Float64


def calibrate(views: Iterable[CalibrationView]) -> DepthCalibration:
    """Estimate the correction under which pairs of frames agree best; each pair's relative pose is free.

    The result is `NO_CALIBRATION` for fewer than six pairs, or if the correction estimated from one half of
    the pairs does not lower the residuals of the other half. The pairs are in the order of time, with depth
    as recorded, not yet corrected.
    """
    return _accepted([unexplained for _, unexplained in _all_sums(views)])


def calibrate_posed(maps: MapCache, T_world_camera: Float64, frames: NDArray[np.int64]) -> DepthCalibration:
    """Estimate the depth correction of a recording whose poses are given; `NO_CALIBRATION` if not accepted.

    The correction is fitted as in `calibrate`, with the relative pose of each pair free. The given poses
    choose the pairs and judge the result: it is accepted only if it also lowers the squared residuals at the
    given poses by more than 2 %. Poses from an inexact hand-eye calibration, or from the same distorted
    depth, fit corrected depth worse than recorded depth, and then it is not used.

    Args:
        maps: maps of the recording, depth as recorded.
        T_world_camera: (n, 4, 4) given poses, NaN where unknown.
        frames: (k,) indices of the frames to compare, ascending; all have poses.
    """
    seen = covisible([keyframe_thumbnail(maps[frame]) for frame in frames.tolist()], T_world_camera[frames])
    pairs = sorted((int(frames[i]), int(frames[j])) for share, i, j in seen if share >= MIN_SHARED_VIEW)
    all_sums = _all_sums(
        CalibrationView(maps[b][0], maps[a][0], invert_rigid(T_world_camera[a]) @ T_world_camera[b])
        for a, b in evenly_chosen(pairs)
    )
    sums = [unexplained for _, unexplained in all_sums]
    helps = len(sums) >= MIN_PAIRS and _left(sums, [posed for posed, _ in all_sums]) < POSED_FALLS_TO
    return _accepted(sums) if helps else NO_CALIBRATION


def evenly_chosen(pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Choose at most 400 of the pairs, evenly spread, in their order."""
    return [pairs[row] for row in evenly(len(pairs), MAX_PAIRS)]


def _accepted(sums: Sequence[Float64]) -> DepthCalibration:
    """Return the correction fitted to all pairs if it passes the conditions of `calibrate`.

    `sums` has the normal matrix of each pair; its last row and column belong to the residual.
    """
    accepted = len(sums) >= MIN_PAIRS and _left(sums, sums) < 1
    return DepthCalibration(_solved(sums)) if accepted else NO_CALIBRATION


def _left(solved: Sequence[Float64], judged: Sequence[Float64]) -> float:
    """Return the sum of squared residuals with correction, divided by that without: the worse of two halves.

    Each half of the pairs is evaluated with the correction estimated from the other half.

    Args:
        solved: normal matrix of each pair for the estimates; its last row and column belong to the residual.
        judged: normal matrix of each pair for the evaluation, in the same form.
    """
    half = len(solved) // 2
    return max(
        _falls_to(judged[half:], _solved(solved[:half])), _falls_to(judged[:half], _solved(solved[half:]))
    )


def _falls_to(products: Sequence[Float64], coefficients_per_m: Float64) -> float:
    """Return the sum of squared residuals with these k coefficients, divided by that without correction.

    `products` are normal matrices (k + 1, k + 1); their last row and column belong to the residual.
    """
    one, whole = np.append(coefficients_per_m, 1.0), np.sum(products, axis=0)
    return 1 + float(one @ whole @ one - whole[-1, -1]) / max(float(whole[-1, -1]), 1e-12)


def _solved(products: Sequence[Float64]) -> Float64:
    prior = np.diag([((1 + i + j) / PRIOR_PER_M) ** 2 for i, j in TERMS])
    equations = NormalEquations.of_products(np.sum(products, axis=0))
    return -(equations + NormalEquations(prior, np.zeros(len(TERMS)))).step()


def _all_sums(views: Iterable[CalibrationView]) -> list[tuple[Float64, Float64]]:
    return [each for each in ahead(_sums, views) if each is not None]


def _sums(view: CalibrationView) -> tuple[Float64, Float64] | None:
    """Return two normal matrices (k + 1, k + 1) of a pair, where k is the number of correction coefficients.

    Each is the sum of w J J^T over the overlapping points, where J is (derivatives of the residual with
    respect to the coefficients, residual) and w a weight. In the first matrix, the relative pose of the pair
    is fixed; in the second, it is eliminated. The result is None if the number of overlapping points is below
    10 * k.
    """
    k = len(TERMS)
    rows, residuals, weights = _linearised(view)
    if len(rows) < 10 * k:
        return None
    products = weighted_products(np.column_stack([rows, residuals]), weights / CORRELATED_POINTS)
    return products[6:, 6:], eliminated(products, 6, 1e-6 * np.eye(6))[0]


def _linearised(view: CalibrationView) -> tuple[Float64, Float64, Float64]:
    """Linearise a pair's m residuals with respect to its relative pose and the k correction coefficients.

    Returns:
        rows (m, 6 + k), residuals (m,), and their weights (m,). For a small twist and small coefficients the
        residuals become residuals + rows @ (twist, coefficients).
    """
    source, target = view.source, view.target
    every = max(1, len(source.points) // POINTS_PER_PAIR)
    points = source.points[::every].astype(np.float64)
    p, normals = points[:, :3], points[:, 3:6]
    at = transform_points(view.T_target_source, p)
    ahead = at[:, 2] > PROJECTED_FROM_M
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
    q = target.camera.rays_at(u, v) * d[:, None]
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
