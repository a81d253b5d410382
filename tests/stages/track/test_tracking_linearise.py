"""The solver's sums against a plain reference, and its terms against numeric derivatives."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from tracking_scenes import moved_pair

from kinectbench.core.geometry import transform_points
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.geometry.rigid import rigid_from_twist
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.track import linearise as constants
from kinectbench.stages.track.frame_maps import FrameMaps, Level
from kinectbench.stages.track.linearise import linearise
from kinectbench.stages.track.map_kernels import MIN_COSINE

pytestmark = pytest.mark.xdist_group("tracking")

GATE_M = 0.06
STEEP = look_at(np.array([0.3, 0.2, 1.2]), np.array([0.0, 0.05, 0.0]))
GRAZING = look_at(np.array([1.5, 1.2, 0.7]), np.array([0.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def pair() -> tuple[FrameMaps, FrameMaps]:
    return moved_pair()


@dataclass(frozen=True)
class Correspondences:
    """Points p of the source (m, 3), what they are taken for: q with normal n, in the target."""

    p: np.ndarray
    q: np.ndarray
    n: np.ndarray
    sigma: np.ndarray
    own: np.ndarray  # the source's intensity
    normal_weights: np.ndarray  # (m,) one over what the noise of the source's normals goes with
    photometric: np.ndarray  # (m,) bool
    violations: int

    def residuals(self, T: np.ndarray) -> np.ndarray:
        residuals: np.ndarray = ((self.q - transform_points(T, self.p)) * self.n).sum(axis=1)
        return residuals


def corresponding(source: Level, target: Level, T: np.ndarray, gate_m: float) -> Correspondences:
    """Projective association as its definition says, in whole arrays."""
    points = source.points.astype(np.float64)
    moved = transform_points(T, points[:, :3])
    keep = moved[:, 2] >= 0.1
    points, moved = points[keep], moved[keep]
    camera, (height, width) = target.camera, target.depth_m.shape
    uv = camera.project(moved)
    keep = (uv >= 0).all(axis=1) & (uv[:, 0] < width - 1) & (uv[:, 1] < height - 1)
    points, moved, uv = points[keep], moved[keep], uv[keep]
    u, v = np.floor(uv + 0.5).astype(int).T
    depth = target.depth_m[v, u].astype(np.float64)
    gate = gate_m + 3 * depth_sigma_m(moved[:, 2])
    behind = (depth > 0) & (depth - moved[:, 2] > gate)
    normal = target.normals[v, u].astype(np.float64)
    near = (depth > 0) & (np.abs(depth - moved[:, 2]) <= gate) & (normal[:, 2] != 0)
    own = points[:, 3:6] @ T[:3, :3].T
    facing = (own * normal).sum(axis=1)
    same = near & (facing >= constants.MIN_FACING)
    mean = (own + normal)[same] / np.sqrt(2 + 2 * facing[same])[:, None]
    q = camera.rays()[v[same], u[same]] * depth[same, None]
    sigma = np.hypot(depth_sigma_m(moved[same, 2]), points[same, 6])
    p = points[same]
    residual = ((q - moved[same]) * mean).sum(axis=1)
    outlying = np.abs(residual) > 3 * sigma + 0.003
    return Correspondences(
        p=p[:, :3],
        q=q,
        n=mean,
        sigma=sigma,
        own=p[:, 7],
        normal_weights=p[:, 2] / p[:, 6] / np.maximum(slant_cosine(p), MIN_COSINE),
        photometric=np.abs(depth[same] - moved[same, 2]) <= 3 * sigma + 0.01,
        violations=int(behind.sum() + (near & ~same).sum() + outlying.sum()),
    )


def slant_cosine(p: np.ndarray) -> np.ndarray:
    cosine: np.ndarray = np.abs((p[:, :3] * p[:, 3:6]).sum(axis=1)) / np.linalg.norm(p[:, :3], axis=1)
    return cosine


def huber_weights(residuals: np.ndarray, sigma: np.ndarray | float) -> np.ndarray:
    """Of a Huber loss (as iteratively reweighted least squares), per unit of squared residual."""
    weights: np.ndarray = np.minimum(1, constants.HUBER_SIGMAS * sigma / np.abs(residuals)) / sigma**2
    return weights


def huber_loss(residuals: np.ndarray, sigma: np.ndarray | float) -> float:
    k, r = constants.HUBER_SIGMAS, np.abs(residuals) / sigma
    return float(np.where(r <= k, r**2 / 2, k * r - k**2 / 2).sum())


def geometric_jacobian(found: Correspondences, T: np.ndarray) -> np.ndarray:
    """(m, 6): by how much a twist lowers each residual."""
    n_source = found.n @ T[:3, :3]
    return np.hstack([np.cross(found.p, n_source), n_source])


def sampled(target: Level, T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Intensity of the target, bilinear, where points fall."""
    uv = target.camera.project(transform_points(T, points))
    u, v = np.floor(uv).astype(int).T
    a, b = (uv - np.floor(uv)).T
    image = target.intensity.astype(np.float64)
    sampled: np.ndarray = (image[v, u] * (1 - a) + image[v, u + 1] * a) * (1 - b) + (
        image[v + 1, u] * (1 - a) + image[v + 1, u + 1] * a
    ) * b
    return sampled


def numeric(function: Callable[[np.ndarray], np.ndarray], size: int, step: float = 1e-6) -> np.ndarray:
    """Central differences of a function of a vector around 0."""
    columns = [(function(step * e) - function(-step * e)) / (2 * step) for e in np.eye(size)]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("level", [0, 1])
def test_geometric_sums_equal_a_plain_reference(pair: tuple[FrameMaps, FrameMaps], level: int) -> None:
    target, source = (maps[level] for maps in pair)
    T = rigid_from_twist(np.array([0.01, -0.004, 0.006, 0.004, 0.003, -0.006]))
    found = corresponding(source, target, T, GATE_M)
    r, J = found.residuals(T), geometric_jacobian(found, T)
    w, inlier = huber_weights(r, found.sigma), np.abs(r) <= 3 * found.sigma + 0.003
    assert len(r) > 300 and (~inlier).sum() > 0 and (w < 0.99 / found.sigma**2).any()  # all branches
    terms = linearise(
        without_intensity(source), without_intensity(target), T, GATE_M, with_observability=True
    )
    assert close(terms.geometric, (J * w[:, None]).T @ J) and close(terms.gradient, J.T @ (w * r))
    normal_weights = (J * found.normal_weights[:, None])[inlier]
    assert close(terms.normal_information, normal_weights.T @ normal_weights)
    homogeneous = np.column_stack([found.p, np.ones(len(r))])[inlier]
    assert close(terms.moments, homogeneous.T @ homogeneous)
    assert terms.residual_m == pytest.approx(np.sqrt(np.mean(r[inlier] ** 2)), rel=1e-9)
    moved = transform_points(T, found.p)
    along_ray = (found.n * moved).sum(axis=1) / moved[:, 2]
    assert terms.noise_m == pytest.approx(np.sqrt(np.mean((found.sigma * along_ray)[inlier] ** 2)), rel=1e-6)
    assert (terms.inliers, terms.violations) == (inlier.sum(), found.violations)
    assert not terms.photometric.any() and np.isnan(terms.intensity_correlation)


def close(a: np.ndarray, b: np.ndarray) -> bool:
    """Equal to 1e-9 of the largest entry."""
    return bool(np.abs(a - b).max() <= 1e-9 * np.abs(b).max())


def without_intensity(level: Level) -> Level:
    return Level(
        level.camera,
        level.depth_m,
        level.normals,
        np.zeros((0, 0), np.float32),
        level.points,
        level.normal_noise,
    )


def test_geometric_terms_are_derivatives_of_the_cost(pair: tuple[FrameMaps, FrameMaps]) -> None:
    """Correspondences held fixed: J^T w J of the numeric Jacobian, and minus the gradient of the loss."""
    target, source = (without_intensity(maps[0]) for maps in pair)
    T = rigid_from_twist(np.array([-0.006, 0.008, 0.003, -0.003, 0.005, 0.004]))
    found = corresponding(source, target, T, GATE_M)
    terms = linearise(source, target, T, GATE_M)
    jacobian = numeric(lambda twist: found.residuals(T @ rigid_from_twist(twist)), 6)
    w = huber_weights(found.residuals(T), found.sigma)
    scale = np.sqrt(np.diag(terms.geometric))
    expected = (jacobian * w[:, None]).T @ jacobian
    np.testing.assert_allclose(
        terms.geometric / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-7
    )
    slope = numeric(
        lambda twist: np.array(huber_loss(found.residuals(T @ rigid_from_twist(twist)), found.sigma)), 6
    )
    np.testing.assert_allclose(terms.gradient, -slope, rtol=1e-5, atol=1e-5 * np.abs(slope).max())


def test_photometric_terms_are_derivatives_of_the_cost(pair: tuple[FrameMaps, FrameMaps]) -> None:
    """The step of the twist and of gain and offset is that of the full system of eight unknowns."""
    target, source = (maps[0] for maps in pair)
    T = rigid_from_twist(np.array([-0.003, 0.004, 0.002, -0.002, 0.003, 0.002]))
    exposure = np.array([1.05, -5.0])
    found = corresponding(source, target, T, GATE_M)
    p, own = found.p[found.photometric], found.own[found.photometric]

    def differences(unknowns: np.ndarray) -> np.ndarray:
        gain, offset = exposure + unknowns[6:]
        differences: np.ndarray = sampled(target, T @ rigid_from_twist(unknowns[:6]), p) - gain * own - offset
        return differences

    sigma = constants.INTENSITY_SIGMA
    e, jacobian = differences(np.zeros(8)), numeric(differences, 8)
    w = constants.PHOTOMETRIC_WEIGHT * huber_weights(e, sigma)
    assert len(e) > 3000 and (np.abs(e) > constants.HUBER_SIGMAS * sigma).any()
    r, J = found.residuals(T), geometric_jacobian(found, T)
    full, right = (jacobian * w[:, None]).T @ jacobian, -(jacobian.T @ (w * e))
    slope = numeric(lambda x: np.array(constants.PHOTOMETRIC_WEIGHT * huber_loss(differences(x), sigma)), 8)
    np.testing.assert_allclose(right, -slope, rtol=1e-4, atol=1e-5 * np.abs(slope).max())
    full[6:, 6:] += constants.EXPOSURE_PRIOR
    w_geometric = huber_weights(r, found.sigma)
    full[:6, :6] += (J * w_geometric[:, None]).T @ J
    right[:6] += J.T @ (w_geometric * r)
    expected = np.linalg.solve(full, right)

    terms = linearise(source, target, T, GATE_M, exposure)
    step = np.linalg.solve(terms.geometric + terms.photometric, terms.gradient)
    np.testing.assert_allclose(step, expected[:6], rtol=1e-4, atol=1e-4 * np.abs(expected[:6]).max())
    np.testing.assert_allclose(terms.exposure_after(step), exposure + expected[6:], rtol=1e-4)
    # The correlation of both images, weighted.
    covariance = np.cov(np.stack([own, e + exposure[0] * own + exposure[1]]), aweights=w)
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert terms.intensity_correlation == pytest.approx(correlation, rel=1e-6)
