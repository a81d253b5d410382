"""Linearise the relative pose of two frames: projective point-to-plane and photometric residuals.

Geometry: Chen & Medioni 1991, Rusinkiewicz & Levoy 2001; residuals n . (q - T p), where q is the target's
measurement at the pixel of T p, and n the mean of both normals (Rusinkiewicz 2019). Photometry:
Steinbruecker, Sturm & Cremers 2011, Park, Zhou & Koltun 2017; residuals I_target(T p) - gain I_source(p) -
offset. Gain and offset are estimated too, because the exposure may change. Twists are (rotation, translation)
in the source frame: T <- T exp(twist).
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M, SIGMA_NEAR_M
from kinectbench.core.geometry.gauss_newton import NormalEquations, add_products, eliminated, symmetric_matrix
from kinectbench.core.types import Float64
from kinectbench.stages.track.frame_maps import Level
from kinectbench.stages.track.map_kernels import MIN_COSINE, PROJECTED_FROM_M

# Larger residuals get less weight: near Huber's 1.345, which loses 5 % of the efficiency for normal noise.
HUBER_SIGMAS = 1.5
# Standard deviation of intensities from 0 to 255.
INTENSITY_SIGMA = 8.0
# Photometric errors exceed the image noise, because colour and depth are not taken at the same instant.
PHOTOMETRIC_WEIGHT = 0.25
# With fewer intensities, gain and offset are not estimated.
MIN_INTENSITIES = 100
# Surfaces whose normals differ by more than 60 degrees are different surfaces.
MIN_FACING = 0.5
# Added to three standard deviations of the depth noise: what misalignment a point may have and be an inlier,
# and to be compared by its intensity.
INLIER_SLACK_M, INTENSITY_SLACK_M = 0.003, 0.01
# Gain 1 and offset 0.
NO_EXPOSURE_CHANGE = np.array([1.0, 0.0])
# Standard deviations between two frames: 0.3 for the gain, and 30 of 255 for the offset (chosen by hand).
EXPOSURE_PRIOR = np.diag([0.3**-2, 30.0**-2])
# Rows are gathered in blocks of this many, which stay in the cache. Padding avoids cache-set conflicts.
BLOCK, PADDING = 512, 8


@dataclass(frozen=True)
class LinearTerms:
    """Gauss-Newton terms of one pair of frames.

    Attributes:
        geometric: (6, 6) normal matrix of the point-to-plane residuals.
        photometric: (6, 6) normal matrix of photometry, with gain and offset of intensity eliminated.
        gradient: (6,) gradient of geometry and photometry together.
        inliers: number of points with a residual within three standard deviations plus 3 mm.
        violations: number of points that contradict the target: it sees through them, or sees another surface
            there. Occluded points count neither here nor as inliers.
        residual_m: root mean square of the inliers' residuals, metres.
        noise_m: root mean square residual expected from the depth noise alone, metres.
        normal_information: (6, 6) sum of J J^T over the inliers. Each term is divided by the squared noise of
            the point's normal, up to a common factor: by (sigma * cosine / depth)^2, with the cosine of the
            angle between normal and viewing ray.
        moments: (4, 4) sum of p p^T over the inliers, p = (x, y, z, 1).
        intensity_correlation: weighted correlation of the intensities, -1 to 1; NaN if fewer than 100 were
            compared.
        exposure: (2,) gain and offset before the step.
        exposure_step: (2, 7) matrix F: a step x (6,) adds F[:, 6] - F[:, :6] @ x to gain and offset.
    """

    geometric: Float64
    photometric: Float64
    gradient: Float64
    inliers: int
    violations: int
    residual_m: float
    noise_m: float
    normal_information: Float64
    moments: Float64
    intensity_correlation: float
    exposure: Float64
    exposure_step: Float64

    @property
    def equations(self) -> NormalEquations:
        """The normal equations for the twist."""
        return NormalEquations(self.geometric + self.photometric, self.gradient)

    def exposure_after(self, step: NDArray[np.floating]) -> Float64:
        """Gain and offset (2,) after the twist `step` (6,)."""
        return np.asarray(self.exposure + self.exposure_step[:, 6] - self.exposure_step[:, :6] @ step)


def linearise(
    source: Level,
    target: Level,
    T_target_source: Float64,
    gate_m: float,
    exposure: Float64 = NO_EXPOSURE_CHANGE,
    with_observability: bool = False,
    every: int = 1,
) -> LinearTerms:
    """Linearise the residuals of a pair of frames.

    Args:
        source: level with the points p.
        target: level into which the points are projected.
        T_target_source: (4, 4), the pose at which to linearise.
        gate_m: largest difference in depth between a point and its measurement, in addition to three standard
            deviations of noise, metres.
        exposure: (2,) gain and offset of intensity.
        with_observability: whether to sum `normal_information` and `moments`, which show unobservable
            directions; else they are 0.
        every: stride of the points used.
    """
    (A, P, S, M), inliers, violations, compared, squares, variances = _accumulate(
        source.points[::every],
        target.depth_m,
        target.normals,
        # If the source has no colour, only depth is compared.
        target.intensity if source.intensity.size else source.intensity,
        target.camera.intrinsics,
        np.ascontiguousarray(T_target_source),
        gate_m,
        exposure,
        with_observability,
    )
    photometric, gradient, follows = np.zeros((6, 6)), A[:6, 6], np.zeros((2, 7))
    if compared >= MIN_INTENSITIES:
        # Gain and offset are eliminated: they follow from the twist.
        left, follows = eliminated(P, 2, EXPOSURE_PRIOR)
        photometric, gradient = left[:6, :6], gradient + left[:6, 6]
    return LinearTerms(
        geometric=A[:6, :6],
        photometric=photometric,
        gradient=gradient,
        inliers=inliers,
        violations=violations,
        residual_m=float(np.sqrt(squares / max(1, inliers))),
        noise_m=float(np.sqrt(variances / max(1, inliers))),
        normal_information=S,
        moments=M,
        intensity_correlation=_correlation(P, exposure) if compared >= MIN_INTENSITIES else np.nan,
        exposure=exposure,
        exposure_step=follows,
    )


def _correlation(P: Float64, exposure: Float64) -> float:
    """Correlation of source and target intensities, from the sums P (9, 9) of `_accumulate`."""
    products = P[[0, 1, 8]][:, [0, 1, 8]]  # of the source's intensity, 1 and the residual
    # The target's intensity is the residual + gain * source + offset.
    to_target = np.array([exposure[0], exposure[1], 1.0])
    n, s, t = products[1, 1], products[0, 1], products[1] @ to_target
    ss, st, tt = products[0, 0], products[0] @ to_target, to_target @ products @ to_target
    spread = (n * ss - s * s) * (n * tt - t * t)
    return float((n * st - s * t) / np.sqrt(spread)) if spread > 1e-9 else 0.0


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _within(error, variance, slack):  # type: ignore[no-untyped-def]
    """Whether an error is at most three standard deviations plus a slack."""
    beyond = abs(error) - slack
    return beyond <= 0 or beyond * beyond <= 9 * variance


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _turned_back(rows, x, y, z):  # type: ignore[no-untyped-def]
    """Turn a vector by the inverse of a rotation, given by the nine values of its rows."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rows
    return r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _plane_row(J, weights, m, px, py, pz, nx, ny, nz, r, variance):  # type: ignore[no-untyped-def]
    """Write the row m of a point p with the normal n, whose residual is r."""
    w = 1 / variance
    if r * r > HUBER_SIGMAS**2 * variance:
        w = HUBER_SIGMAS * np.sqrt(w) / abs(r)
    J[0, m], J[1, m], J[2, m] = py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx
    J[3, m], J[4, m], J[5, m], J[6, m] = nx, ny, nz, r
    weights[m] = w


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _interpolated(intensity, u, v):  # type: ignore[no-untyped-def]
    """Return the bilinear value of an image at (u, v), and its derivatives by u and v."""
    u0, v0 = np.uint32(u), np.uint32(v)
    au, av = u - u0, v - v0
    i00, i01 = float(intensity[v0, u0]), float(intensity[v0, u0 + 1])
    i10, i11 = float(intensity[v0 + 1, u0]), float(intensity[v0 + 1, u0 + 1])
    value = (i00 * (1 - au) + i01 * au) * (1 - av) + (i10 * (1 - au) + i11 * au) * av
    gu = (i01 - i00) * (1 - av) + (i11 - i10) * av
    gv = (i10 - i00) * (1 - au) + (i11 - i01) * au
    return value, gu, gv


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _intensity_row(Q, weights, k, px, py, pz, qx, qy, qz, own, e):  # type: ignore[no-untyped-def]
    """Write the row k of a point p whose intensity is `own`, with the gradient q and the residual e."""
    w = PHOTOMETRIC_WEIGHT / INTENSITY_SIGMA**2
    if abs(e) > HUBER_SIGMAS * INTENSITY_SIGMA:
        w *= HUBER_SIGMAS * INTENSITY_SIGMA / abs(e)
    Q[0, k], Q[1, k], Q[8, k] = own, 1.0, e
    Q[2, k], Q[3, k], Q[4, k] = pz * qy - py * qz, px * qz - pz * qx, py * qx - px * qy
    Q[5, k], Q[6, k], Q[7, k] = -qx, -qy, -qz
    weights[k] = w


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"}, nogil=True)
def _accumulate(points, depth, normals, intensity, intrinsics, T, gate_m, exposure, with_observability):  # type: ignore[no-untyped-def]
    """Sum the normal equations of a pair of frames over the source's points, at the pose T.

    `points` belong to the source (`Level.points`). `depth`, `normals`, `intensity` and `intrinsics` belong to
    the target. The other arguments are those of `linearise`.

    Returns:
        (A, P, S, M), inliers, violations, compared intensities (three counts), and two sums over the inliers:
        of the squared residuals, and of their expected variances. The matrices are symmetric:
        A: (7, 7) sum of w J J^T over the point-to-plane residuals, J = (twist, residual).
        P: (9, 9) sum of w J J^T over the photometric residuals, J = (gain, offset, twist, residual).
        S: (6, 6) sum over inliers of J J^T, J = twist of A, divided by the squared noise of the normal.
        M: (4, 4) sum over inliers of p p^T, p = (x, y, z, 1). S and M are 0 without `with_observability`.

    The vectors J are gathered in blocks that stay in the cache, with one contiguous array per component, so
    that the products are vectorised.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    r00, r01, r02, t0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    r10, r11, r12, t1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    r20, r21, r22, t2 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    rows = r00, r01, r02, r10, r11, r12, r20, r21, r22
    gain, offset = exposure
    over_fx, over_fy = 1 / fx, 1 / fy
    has_intensity = intensity.size > 0
    A, P, S, M = np.zeros((7, 7)), np.zeros((9, 9)), np.zeros((6, 6)), np.zeros((4, 4))
    J, J_weights = np.empty((7, BLOCK + PADDING)), np.empty(BLOCK)
    Q, Q_weights = np.empty((9, BLOCK + PADDING)), np.empty(BLOCK)
    places, inlying, normal_weights = np.empty((4, BLOCK + PADDING)), np.empty(BLOCK), np.empty(BLOCK)
    inliers, violations, compared, squares, variances = 0, 0, 0, 0.0, 0.0
    n = len(points)
    for first in range(0, n, BLOCK):
        m, k = 0, 0
        for i in range(first, min(first + BLOCK, n)):
            px, py, pz = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
            z = r20 * px + r21 * py + r22 * pz + t2
            if z < PROJECTED_FROM_M:
                continue
            x = r00 * px + r01 * py + r02 * pz + t0
            y = r10 * px + r11 * py + r12 * pz + t1
            over_z = 1 / z
            u, v = fx * x * over_z + cx, fy * y * over_z + cy
            if u < 0 or v < 0 or u >= width - 1 or v >= height - 1:
                continue
            ui, vi = np.uint32(u + 0.5), np.uint32(v + 0.5)
            d = float(depth[vi, ui])
            if d <= 0:
                continue
            sigma = SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (z - SIGMA_NEAR_DEPTH_M) ** 2
            gate = gate_m + 3 * sigma
            if d - z < -gate:
                continue
            if d - z > gate:
                violations += 1
                continue
            mx, my, mz = float(normals[vi, ui, 0]), float(normals[vi, ui, 1]), float(normals[vi, ui, 2])
            if mz == 0:
                continue
            # The mean of both normals, in the source's axes: less noisy than either (Rusinkiewicz 2019).
            ox, oy, oz = np.float64(points[i, 3]), np.float64(points[i, 4]), np.float64(points[i, 5])
            nx, ny, nz = _turned_back(rows, mx, my, mz)
            facing = nx * ox + ny * oy + nz * oz
            if facing < MIN_FACING:
                # A different orientation means a different surface.
                violations += 1
                continue
            shorten = 1 / np.sqrt(2 + 2 * facing)
            nx, ny, nz = (nx + ox) * shorten, (ny + oy) * shorten, (nz + oz) * shorten
            mx = r00 * nx + r01 * ny + r02 * nz
            my = r10 * nx + r11 * ny + r12 * nz
            mz = r20 * nx + r21 * ny + r22 * nz
            r = mx * ((ui - cx) * over_fx * d - x) + my * ((vi - cy) * over_fy * d - y) + mz * (d - z)
            variance = sigma * sigma + np.float64(points[i, 6]) ** 2
            _plane_row(J, J_weights, m, px, py, pz, nx, ny, nz, r, variance)
            inlies = _within(r, variance, INLIER_SLACK_M)
            if inlies:
                inliers += 1
                squares += r * r
                # Noise moves a measurement along its ray.
                variances += variance * ((mx * x + my * y + mz * z) * over_z) ** 2
            else:
                violations += 1
            if with_observability:
                cosine = abs(px * ox + py * oy + pz * oz) / np.sqrt(px * px + py * py + pz * pz)
                places[0, m], places[1, m], places[2, m], places[3, m] = px, py, pz, 1.0
                inlying[m] = 1.0 if inlies else 0.0
                normal_weights[m] = (
                    inlying[m] * (pz / (np.float64(points[i, 6]) * max(cosine, MIN_COSINE))) ** 2
                )
            m += 1
            if not has_intensity or not _within(d - z, variance, INTENSITY_SLACK_M):
                continue
            value, gu, gv = _interpolated(intensity, u, v)
            own = np.float64(points[i, 7])
            # Gradient of the target's intensity in space, then in the source's axes.
            sx, sy = gu * fx * over_z, gv * fy * over_z
            sz = -(sx * x + sy * y) * over_z
            qx, qy, qz = _turned_back(rows, sx, sy, sz)
            _intensity_row(Q, Q_weights, k, px, py, pz, qx, qy, qz, own, value - gain * own - offset)
            k += 1
        add_products(A, J, J_weights, m)
        add_products(P, Q, Q_weights, k)
        compared += k
        if with_observability:
            add_products(S, J, normal_weights, m)
            add_products(M, places, inlying, m)
    sums = symmetric_matrix(A), symmetric_matrix(P), symmetric_matrix(S), symmetric_matrix(M)
    return sums, inliers, violations, compared, squares, variances
