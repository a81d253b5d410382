"""The trajectory is smoothed where frames are uncertain, and only there: against known motions."""

import numpy as np
import pytest

from kinectbench.core.geometry import invert_rigid
from kinectbench.core.geometry.rigid import rigid_from_twist, twist_from_rigid
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.track.smoothing import second_differences, smoothed

pytestmark = pytest.mark.xdist_group("tracking")

N = 90
STAMPS_NS = (np.arange(N) * 1e9 / 30).astype(np.int64)
# A frame is known to 0.2 mm and 0.2 mrad, but to 4 mm along its x axis.
SIGMA = np.array([2e-4, 2e-4, 2e-4, 4e-3, 2e-4, 2e-4])
INFORMATION = np.tile(np.diag(SIGMA**-2), (N, 1, 1))


def walk() -> np.ndarray:
    """Part of a circle, looking at its middle, with a slow sway."""
    t = np.arange(N) / 30
    x, y = 1.5 * np.cos(0.3 * t), 1.5 * np.sin(0.3 * t)
    z = 0.9 + 0.05 * np.sin(2 * np.pi * 0.5 * t)
    return np.stack([look_at(np.array(eye), np.zeros(3)) for eye in zip(x, y, z, strict=True)])


def moved(poses: np.ndarray, twists: np.ndarray) -> np.ndarray:
    return np.stack([T @ rigid_from_twist(twist) for T, twist in zip(poses, twists, strict=True)])


def off_m(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(n, 3) along the camera's axes."""
    return np.stack([twist_from_rigid(T)[3:] for T in invert_rigid(truth) @ poses])


def test_noise_along_what_is_hardly_known_is_taken_off() -> None:
    noise = np.random.default_rng(0).normal(0, 1, (N, 6)) * SIGMA
    before, after = (
        off_m(T, walk())
        for T in (moved(walk(), noise), smoothed(moved(walk(), noise), STAMPS_NS, INFORMATION))
    )
    assert before[:, 0].std() > 3e-3
    assert after[:, 0].std() < 0.75 * before[:, 0].std()
    assert after[:, 1:].std() < 1.2 * before[:, 1:].std()


def test_well_known_frames_stay_as_shaky_as_they_are() -> None:
    shaky = moved(walk(), np.random.default_rng(1).normal(0, 2e-3, (N, 6)))
    known = np.tile(np.diag(np.full(6, 2e-4**-2)), (N, 1, 1))
    assert np.abs(off_m(smoothed(shaky, STAMPS_NS, known), shaky)).max() < 4e-4


def test_a_jolt_is_kept() -> None:
    """Half way the camera is knocked aside by 30 mm, along what is hardly known, and stays there."""
    truth = walk()
    truth[N // 2 :, :3, 3] += 0.03 * truth[N // 2, :3, 0]
    noise = np.random.default_rng(2).normal(0, 1, (N, 6)) * SIGMA
    after = off_m(smoothed(moved(truth, noise), STAMPS_NS, INFORMATION), truth)
    assert np.abs(after[:, 0]).max() < 0.012


def test_frames_may_come_in_any_order_and_at_any_times() -> None:
    rng = np.random.default_rng(3)
    kept = np.sort(rng.choice(N, 60, replace=False))
    noisy = moved(walk(), rng.normal(0, 1, (N, 6)) * SIGMA)[kept]
    expected = smoothed(noisy, STAMPS_NS[kept], INFORMATION[kept])
    order = rng.permutation(60)
    found = smoothed(noisy[order], STAMPS_NS[kept][order], INFORMATION[kept][order])
    np.testing.assert_allclose(found, expected[order], atol=1e-9)
    assert off_m(expected, walk()[kept])[:, 0].std() < 0.7 * off_m(noisy, walk()[kept])[:, 0].std()


def test_frames_of_one_time_and_few_frames() -> None:
    poses = walk()
    found = smoothed(poses, np.zeros(N, np.int64), INFORMATION)
    assert np.isfinite(found).all()
    for n in range(5):
        np.testing.assert_array_equal(smoothed(poses[:n], STAMPS_NS[:n], INFORMATION[:n]), poses[:n])


def test_second_differences_of_a_parabola() -> None:
    times = np.array([0.0, 0.1, 0.15, 0.4, 0.45])
    values = 3 + 2 * times + 5 * times**2
    weights = second_differences(times)
    found = sum(w * values[k : k + 3] for k, w in enumerate(weights))
    # The span of a difference is half of what lies between its ends: exact for a second derivative of 10.
    np.testing.assert_allclose(found, 10, rtol=1e-12)
