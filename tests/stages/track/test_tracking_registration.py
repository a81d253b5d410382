"""The solver against numeric derivatives and a plain reference, and known motions recovered."""

from dataclasses import dataclass

import numpy as np
import pytest
from analytic_scenes import depth_of, displaced, plane
from tracking_scenes import CORNER_VIEW, FLOOR, ROOM, SMALL, frame_maps, painted, waves

from kinectbench.core.geometry import invert_rigid, rigid, rotation_angle_rad, transform_points
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.geometry.rigid import on_so3, rigid_from_twist, twist_from_rigid
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.track import linearise as constants
from kinectbench.stages.track.frame_maps import FrameMaps, Level
from kinectbench.stages.track.linearise import LinearTerms, linearise
from kinectbench.stages.track.registration import measure, register, search

pytestmark = pytest.mark.xdist_group("tracking")

MOVED = displaced(CORNER_VIEW, (0.02, -0.015, 0.01), 1.2)
GATE_M = 0.06
STEEP = look_at(np.array([0.3, 0.2, 1.2]), np.array([0.0, 0.05, 0.0]))
GRAZING = look_at(np.array([1.5, 1.2, 0.7]), np.array([0.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def pair() -> tuple[FrameMaps, FrameMaps]:
    """Two noisy, textured views of a room's corner, a small motion apart; the second is exposed otherwise."""
    sequence = painted(
        ROOM,
        np.stack([CORNER_VIEW, MOVED]),
        texture=waves,
        exposures=[(1.0, 0.0), (0.9, 12.0)],
        noise=np.random.default_rng(3),
    )
    return frame_maps(sequence, 0), frame_maps(sequence, 1)


# --- a plain reference of the kernel


@dataclass(frozen=True)
class Correspondences:
    """Points p of the source (m, 3), what they are taken for: q with normal n, in the target."""

    p: np.ndarray
    q: np.ndarray
    n: np.ndarray
    sigma: np.ndarray
    own: np.ndarray  # the source's intensity
    over_noise: np.ndarray  # (m,) one over what the noise of the source's normals goes with
    photometric: np.ndarray  # (m,) bool
    violations: int

    def residuals(self, T: np.ndarray) -> np.ndarray:
        return ((self.q - transform_points(T, self.p)) * self.n).sum(axis=1)


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
        over_noise=p[:, 2] / p[:, 6] / np.maximum(slant_cosine(p), constants.MIN_COSINE),
        photometric=np.abs(depth[same] - moved[same, 2]) <= 3 * sigma + 0.01,
        violations=int(behind.sum() + (near & ~same).sum() + outlying.sum()),
    )


def slant_cosine(p: np.ndarray) -> np.ndarray:
    return np.abs((p[:, :3] * p[:, 3:6]).sum(axis=1)) / np.linalg.norm(p[:, :3], axis=1)


def huber_weights(residuals: np.ndarray, sigma: np.ndarray | float) -> np.ndarray:
    """Of a Huber loss (as iteratively reweighted least squares), per unit of squared residual."""
    return np.minimum(1, constants.HUBER_SIGMAS * sigma / np.abs(residuals)) / sigma**2


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
    return (image[v, u] * (1 - a) + image[v, u + 1] * a) * (1 - b) + (
        image[v + 1, u] * (1 - a) + image[v + 1, u + 1] * a
    ) * b


def numeric(function, size: int, step: float = 1e-6) -> np.ndarray:
    """Central differences of a function of a vector around 0."""
    columns = [(function(step * e) - function(-step * e)) / (2 * step) for e in np.eye(size)]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("level", [0, 1])
def test_geometric_sums_equal_a_plain_reference(pair, level):
    target, source = (maps[level] for maps in pair)
    T = rigid_from_twist(np.array([0.01, -0.004, 0.006, 0.004, 0.003, -0.006]))
    found = corresponding(source, target, T, GATE_M)
    r, J = found.residuals(T), geometric_jacobian(found, T)
    w, inlier = huber_weights(r, found.sigma), np.abs(r) <= 3 * found.sigma + 0.003
    assert len(r) > 300 and (~inlier).sum() > 0 and (w < 0.99 / found.sigma**2).any()  # all branches
    terms = linearise(without_intensity(source), without_intensity(target), T, GATE_M, with_shares=True)
    assert close(terms.geometric, (J * w[:, None]).T @ J) and close(terms.gradient, J.T @ (w * r))
    over_noise = (J * found.over_noise[:, None])[inlier]
    assert close(terms.shares, over_noise.T @ over_noise)
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


def test_geometric_terms_are_derivatives_of_the_cost(pair):
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


def test_photometric_terms_are_derivatives_of_the_cost(pair):
    """The step of the twist and of gain and offset is that of the full system of eight unknowns."""
    target, source = (maps[0] for maps in pair)
    T = rigid_from_twist(np.array([-0.003, 0.004, 0.002, -0.002, 0.003, 0.002]))
    exposure = np.array([1.05, -5.0])
    found = corresponding(source, target, T, GATE_M)
    p, own = found.p[found.photometric], found.own[found.photometric]

    def differences(unknowns: np.ndarray) -> np.ndarray:
        gain, offset = exposure + unknowns[6:]
        return sampled(target, T @ rigid_from_twist(unknowns[:6]), p) - gain * own - offset

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


# --- known motions


def off(T: np.ndarray, T_true: np.ndarray) -> tuple[float, float]:
    """Millimetres and degrees."""
    error = invert_rigid(T_true) @ T
    return float(np.linalg.norm(error[:3, 3])) * 1000, float(np.degrees(rotation_angle_rad(error[:3, :3])))


MOTIONS = [
    ((0.0, 0.0, 0.0), 0.0),
    ((0.03, 0.0, 0.0), 0.0),
    ((0.0, 0.0, 0.05), 0.0),
    ((-0.02, 0.03, 0.02), 3.0),
    ((0.06, -0.02, 0.03), -5.0),
]


@pytest.mark.parametrize(("shift_m", "turn_deg"), MOTIONS)
@pytest.mark.parametrize("color", [False, True])
def test_a_known_motion_is_recovered(shift_m, turn_deg, color):
    moved = displaced(CORNER_VIEW, shift_m, turn_deg)
    sequence = painted(ROOM, np.stack([CORNER_VIEW, moved]), texture=waves if color else None)
    target, source = frame_maps(sequence, 0), frame_maps(sequence, 1)
    found = register(source, [target], [np.eye(4)])
    off_mm, off_deg = off(found.T_target_source, invert_rigid(CORNER_VIEW) @ moved)
    assert off_mm < 1.0 and off_deg < 0.08
    assert found.inlier_share > 0.97 and found.residual_m < 0.002 and not found.degenerate
    assert np.isnan(found.intensity_correlation) != color


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.8, 15.0), (1.2, -20.0)])
def test_colour_fixes_what_a_plane_leaves_open_whatever_the_exposure(gain, offset):
    """A textured floor alone: depth says nothing of the walk across it, and colour does."""
    moved = displaced(STEEP, (0.02, -0.015, 0.0), 1.0)
    sequence = painted(
        [FLOOR], np.stack([STEEP, moved]), texture=waves, exposures=[(1.0, 0.0), (gain, offset)]
    )
    found = register(frame_maps(sequence, 1), [frame_maps(sequence, 0)], [np.eye(4)])
    off_mm, off_deg = off(found.T_target_source, invert_rigid(STEEP) @ moved)
    assert off_mm < 1.0 and off_deg < 0.05
    assert found.intensity_correlation > 0.98 and not found.degenerate


def test_two_targets_agree_on_one_pose():
    poses = np.stack(
        [
            CORNER_VIEW,
            displaced(CORNER_VIEW, (0.1, 0.0, 0.0), -4.0),
            displaced(CORNER_VIEW, (0.05, 0.01, 0.0), -2.0),
        ]
    )
    maps = [frame_maps(painted(ROOM, poses, noise=np.random.default_rng(5)), i) for i in range(3)]
    true = [invert_rigid(T) @ poses[2] for T in poses[:2]]
    start = [T @ rigid_from_twist(np.array([0.01, 0, 0.01, 0.01, -0.01, 0.0])) for T in true]
    found = register(maps[2], maps[:2], start, coarsest=0)
    assert off(found.T_target_source, true[0])[0] < 3.0


def test_a_strong_prior_keeps_the_start(pair):
    start = rigid_from_twist(np.array([0.004, 0.0, 0.0, 0.01, 0.0, 0.0]))
    kept = register(pair[1], [pair[0]], [start], prior=1e12 * np.eye(6))
    np.testing.assert_allclose(kept.T_target_source, start, atol=1e-5)
    free = register(pair[1], [pair[0]], [start])
    assert off(free.T_target_source, invert_rigid(CORNER_VIEW) @ MOVED)[0] < 3.0


def test_the_search_finds_what_registration_misses():
    """Turned by 25 degrees and moved by 0.3 m: too far for registration from standing still."""
    moved = displaced(CORNER_VIEW, (0.25, 0.05, 0.1), -18.0)
    sequence = painted(ROOM, np.stack([CORNER_VIEW, moved]))
    target, source = frame_maps(sequence, 0), frame_maps(sequence, 1)
    found = search(source, target, np.eye(4))
    assert off(found.T_target_source, invert_rigid(CORNER_VIEW) @ moved)[0] < 5.0


# --- what is left open


def floor_pair(noise: bool) -> tuple[FrameMaps, FrameMaps]:
    moved = displaced(STEEP, (0.02, 0.0, 0.0), 0.0)
    rng = np.random.default_rng(1) if noise else None
    sequence = painted([FLOOR], np.stack([STEEP, moved]), noise=rng)
    return frame_maps(sequence, 1), frame_maps(sequence, 0)


@pytest.mark.parametrize("noise", [False, True])
def test_a_plane_is_seen_to_leave_motions_open(noise):
    source, target = floor_pair(noise)
    found = register(source, [target], [np.eye(4)])
    assert found.degenerate and found.sigma_m == np.inf
    # Along the floor, and around its normal, nothing is known: shown by the information.
    normal = STEEP[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    right = np.cross(normal, [0.0, 0.0, 1.0])
    for along in (right, np.cross(normal, right)):
        along = along / np.linalg.norm(along)
        twist = np.concatenate([np.zeros(3), along])
        across = np.concatenate([np.zeros(3), normal])
        assert twist @ found.information @ twist < 1e-3 * (across @ found.information @ across)
    # And noise does not drive the camera there: what it sees is not moved along the floor.
    points = source[0].points[:, :3].astype(np.float64)
    moved = transform_points(found.T_target_source, points) - points
    along_m = moved - (moved @ normal)[:, None] * normal
    assert np.linalg.norm(along_m.mean(axis=0)) < 0.01


def test_a_corner_leaves_nothing_open(pair):
    found = measure(pair[1], [pair[0]], [invert_rigid(CORNER_VIEW) @ MOVED])
    assert not found.degenerate and found.sigma_m < 0.005
    assert np.linalg.eigvalsh(found.information).min() > 0


PLANES = [FLOOR, plane((1.0, 0.0, 0.0), -0.3), plane((0.0, 1.0, 0.0), -0.3)]


@pytest.mark.parametrize(
    ("view", "walls"),
    [
        (STEEP, 1),
        (STEEP, 3),
        (CORNER_VIEW, 3),
        (GRAZING, 3),
        (CORNER_VIEW, 1),
        (CORNER_VIEW, 2),
        (GRAZING, 1),
        (GRAZING, 2),
    ],
)
def test_it_takes_three_planes_to_fix_a_camera(view, walls):
    moved = displaced(view, (0.01, 0.01, 0.0), 0.5)
    sequence = painted(PLANES[:walls], np.stack([view, moved]), noise=np.random.default_rng(2))
    found = register(frame_maps(sequence, 1), [frame_maps(sequence, 0)], [np.eye(4)])
    # A narrow view of two walls leaves little room to tell noise from a third.
    assert found.degenerate or (walls == 3) == (found.sigma_m < 0.002)
    if walls < 3:
        assert found.sigma_m > 0.008
    else:
        assert not found.degenerate
        assert off(found.T_target_source, invert_rigid(view) @ moved)[0] < 2.0


# --- figures


def test_figures_of_a_wrong_pose_do_not_convince(pair):
    right = measure(pair[1], [pair[0]], [invert_rigid(CORNER_VIEW) @ MOVED])
    wrong = measure(
        pair[1], [pair[0]], [displaced(invert_rigid(CORNER_VIEW) @ MOVED, (0.03, 0.02, 0.03), 2.0)]
    )
    assert right.inlier_share > 0.97 and wrong.inlier_share < 0.85
    assert wrong.residual_m > right.residual_m
    assert right.intensity_correlation > 0.95 > wrong.intensity_correlation


def test_what_is_hidden_is_no_contradiction_and_what_is_seen_through_is():
    """A box between camera and wall: the wall behind it is hidden, but the box is missed where it is gone."""
    sequence_with = painted(ROOM, CORNER_VIEW[None])
    sequence_without = painted(ROOM[:3] + ROOM[4:], CORNER_VIEW[None])
    with_box, without_box = frame_maps(sequence_with, 0), frame_maps(sequence_without, 0)
    hidden = measure(without_box, [with_box], [np.eye(4)])
    seen_through = measure(with_box, [without_box], [np.eye(4)])
    assert hidden.inlier_share > 0.97
    on_box = (
        np.abs(depth_of(ROOM, SMALL, CORNER_VIEW) - depth_of(ROOM[:3] + ROOM[4:], SMALL, CORNER_VIEW)) > 0.1
    )
    assert on_box.mean() > 0.05
    assert seen_through.inlier_share < 1 - 0.5 * on_box.mean()
    assert hidden.overlap < 1 - 0.5 * on_box.mean()


def test_nothing_in_common_is_told_as_such(pair):
    away = rigid(np.diag([-1.0, 1.0, -1.0]), [0.0, 0.0, 0.0])  # looks backwards
    found = measure(pair[1], [pair[0]], [away])
    assert found.overlap < 0.02 and found.degenerate and found.over_noise == 0
    found = register(pair[1], [pair[0]], [away])
    assert np.isfinite(found.T_target_source).all()


def test_twists_there_and_back():
    for twist in np.random.default_rng(0).normal(0, 0.5, (20, 6)):
        T = rigid_from_twist(twist)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(twist_from_rigid(T), twist, atol=1e-9)
    np.testing.assert_array_equal(rigid_from_twist(np.zeros(6)), np.eye(4))
    drifted = rigid(np.array(rigid_from_twist(twist)[:3, :3]) * 1.001, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(on_so3(drifted), rigid(rigid_from_twist(twist)[:3, :3], [1, 2, 3]), atol=1e-12)


def test_the_inputs_stay_as_they_are_and_the_bytes_are_the_same(pair):
    before = [level.points.tobytes() + level.depth_m.tobytes() for maps in pair for level in maps]
    a, b = (register(pair[1], [pair[0]], [np.eye(4)]) for _ in range(2))
    assert a.T_target_source.tobytes() == b.T_target_source.tobytes()
    assert a.information.tobytes() == b.information.tobytes()
    assert before == [level.points.tobytes() + level.depth_m.tobytes() for maps in pair for level in maps]


def test_exposure_follows_from_the_step(pair):
    """The second image is 0.9 of the first and 12 brighter: so is what registration ends with."""
    T, exposure = invert_rigid(CORNER_VIEW) @ MOVED, np.array([1.0, 0.0])
    for _ in range(10):
        terms: LinearTerms = linearise(pair[1][0], pair[0][0], T, GATE_M, exposure)
        exposure = terms.exposure_after(np.zeros(6))
    assert exposure[0] == pytest.approx(1 / 0.9, abs=0.02)
    assert exposure[1] == pytest.approx(-12 / 0.9, abs=3)
