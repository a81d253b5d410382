"""The sensor model against its published figures."""

import numpy as np
import pytest

from kinectbench.simulate.kinect import KinectNoise, axial_sigma_m, depth_step_m, kinect_depth, quantise

NOISE = KinectNoise()
CLEAN = KinectNoise(random_drop=0.0)


def measured(depth_m, noise=CLEAN, cosine=1.0, shape=(400, 400), seed=0):
    depth = np.broadcast_to(np.asarray(depth_m, np.float32), shape).copy()
    cosines = np.full(shape, cosine, np.float32)
    return kinect_depth(depth, cosines, noise, np.random.default_rng(seed))


@pytest.mark.parametrize(("depth_m", "sigma_mm"), [(1.0, 1.884), (2.0, 6.064), (3.0, 14.044)])
def test_noise_has_the_published_standard_deviation(depth_m, sigma_mm):
    assert float(axial_sigma_m(np.array(depth_m), np.array(0.0))) * 1000 == pytest.approx(sigma_mm)
    # A small spread of depths, so that the phase of the quantisation averages out.
    exact = np.linspace(depth_m - 0.03, depth_m + 0.03, 400, dtype=np.float32)
    error_mm = (measured(exact) - exact) * 1000
    assert error_mm.std() == pytest.approx(sigma_mm, rel=0.04)
    assert abs(error_mm.mean()) < 0.05 * sigma_mm


def test_noise_grows_at_grazing_angles():
    z = np.array(1.0)
    # Nguyen et al.: 0.1 mm * (80 / 10)^2 = 6.4 mm more at 80 degrees and 1 m.
    extra_m = axial_sigma_m(z, np.radians(80.0)) - axial_sigma_m(z, np.radians(30.0))
    assert float(extra_m) == pytest.approx(0.0064)


def test_depth_is_quantised_in_eighths_of_a_disparity_pixel():
    values = np.unique(measured(2.0))
    disparity_px = 580 * 0.075 / values.astype(np.float64)
    assert np.allclose(disparity_px * 8, np.round(disparity_px * 8), atol=1e-3)
    assert np.allclose(np.diff(values), depth_step_m(np.array(2.0), NOISE), rtol=0.05)
    assert float(quantise(np.array(2.0), NOISE)) == pytest.approx(348 / 174)


def test_depth_out_of_range_is_no_measurement():
    for depth_m in (0.0, 0.39, 4.51, 9.0):
        assert not measured(depth_m).any()
    assert (measured(1.0) > 0).all()


def test_pixels_drop_out_at_edges_and_at_grazing_angles():
    step = np.full((200, 200), 1.0, np.float32)
    step[:, 100:] = 1.5
    result = kinect_depth(step, np.ones_like(step), NOISE, np.random.default_rng(1))
    assert (result[:, 99:101] == 0).mean() == pytest.approx(NOISE.edge_drop, abs=0.1)
    assert (result[:, :90] == 0).mean() < 0.01
    assert not measured(1.0, cosine=0.12).any()
    assert (measured(1.0, cosine=0.3) > 0).all()


def test_the_seed_decides():
    assert np.array_equal(measured(1.5, seed=3), measured(1.5, seed=3))
    assert not np.array_equal(measured(1.5, seed=3), measured(1.5, seed=4))
