"""The sensor model against its published figures, geometry worked out by hand, and plain loops."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from references import axial_sigma_m, depth_step_m, lateral_sigma_px

from kinectbench.core.geometry import Camera
from kinectbench.lab.simulate.kinect import (
    KinectNoise,
    KinectUnit,
    displace,
    draw_device,
    measured_depth,
    projector_lit,
    sense,
)
from kinectbench.lab.simulate.render import Rendering

CAMERA = Camera(400, 300, 525.0, 525.0, 199.5, 149.5)
SHAPE = (CAMERA.height, CAMERA.width)
NOISE = KinectNoise()
BLIND = round(NOISE.blind_share * CAMERA.width)
SHIFT = CAMERA.fx * NOISE.baseline_m


def rendering(
    depth_m: NDArray[np.float64] | float | NDArray[np.float32], cosine: float = 1.0, albedo: float = 0.6
) -> Rendering:
    depth, cosines, albedos = (
        np.broadcast_to(np.asarray(values, np.float32), SHAPE).copy() for values in (depth_m, cosine, albedo)
    )
    return Rendering(depth, np.zeros((*SHAPE, 3), np.uint8), np.zeros(SHAPE, bool), cosines, albedos)


def measured(
    exact: Rendering, distortion: float = 0.0, sunlight: float = 0.0, seed: int = 0, **changed: float
) -> NDArray[np.float64]:
    """Measured depth without the blind columns."""
    device = draw_device(CAMERA, distortion, sunlight, np.random.default_rng(seed))
    device = KinectUnit(NOISE._replace(**changed), device.distortion_px, sunlight)
    return measured_depth(exact, CAMERA, device, np.random.default_rng(seed + 1))[:, :-BLIND].astype(
        np.float64
    )


def errors_m(depth_m: float, cosine: float = 1.0, **settings: Any) -> NDArray[np.float64]:
    """Measured minus exact where there is depth, of a surface that varies slightly in depth.

    So that the phase of the rounding averages out.
    """
    exact = np.linspace(depth_m - 0.03, depth_m + 0.03, SHAPE[1]) + np.linspace(0, 0.02, SHAPE[0])[:, None]
    found = measured(rendering(exact, cosine), **settings)
    return np.where(found > 0, found - exact.astype(np.float32)[:, :-BLIND], np.nan)


def lost(exact: Rendering, **settings: Any) -> float:
    """Share of pixels without depth."""
    return float((measured(exact, **settings) == 0).mean())


@pytest.mark.parametrize(("depth_m", "sigma_mm"), [(0.6, 1.276), (1.0, 1.884), (2.0, 6.064), (4.0, 25.824)])
def test_noise_has_the_published_standard_deviation(depth_m: float, sigma_mm: float) -> None:
    assert float(axial_sigma_m(np.array(depth_m), np.array(0.0))) * 1000 == pytest.approx(sigma_mm)
    error_mm = np.stack([errors_m(depth_m, seed=seed) for seed in range(0, 6, 2)]) * 1000
    assert np.nanstd(error_mm) == pytest.approx(sigma_mm, rel=0.04)
    assert abs(np.nanmean(error_mm)) < 0.06 * sigma_mm


def test_noise_grows_at_grazing_angles() -> None:
    # Nguyen et al.: 0.1 mm * (80 / 10)^2 = 6.4 mm more at 80 degrees and 1 m.
    extra_m = axial_sigma_m(np.array(1.0), np.radians(80.0)) - axial_sigma_m(np.array(1.0), np.radians(30.0))
    assert float(extra_m) == pytest.approx(0.0064)
    tilt = np.radians(74.0)
    published_m = float(axial_sigma_m(np.array(1.0), tilt))
    assert np.nanstd(errors_m(1.0, np.cos(tilt))) == pytest.approx(published_m, rel=0.05)


def test_errors_of_neighbours_correlate_as_on_real_planes() -> None:
    error_m = np.stack([errors_m(1.7, seed=seed) for seed in range(0, 8, 2)])
    for lag_px, real in ((1, 0.55), (2, 0.40), (3, 0.26)):
        both = error_m[:, :, :-lag_px] * error_m[:, :, lag_px:]
        assert np.nanmean(both) / np.nanvar(error_m) == pytest.approx(real, abs=0.09)
    assert abs(np.nanmean(error_m[:, :, :-12] * error_m[:, :, 12:]) / np.nanvar(error_m)) < 0.05


def test_depth_is_quantised_in_eighths_of_a_disparity_pixel() -> None:
    found = measured(rendering(2.0))
    values = np.unique(found[found > 0])
    steps = 580 * 0.075 * 8 / values
    assert len(values) > 3
    assert np.allclose(steps, np.round(steps), atol=1e-4)
    assert np.allclose(np.diff(values), depth_step_m(values[1:], NOISE), rtol=0.05)


def test_depth_out_of_range_is_no_measurement() -> None:
    for depth_m in (0.0, 0.39, 4.51, 9.0):
        assert not measured(rendering(depth_m)).any()
    assert lost(rendering(1.0)) < 0.005


def test_the_columns_at_the_right_are_blind() -> None:
    device = draw_device(CAMERA, 0.0, 0.0, np.random.default_rng(0))
    found = measured_depth(rendering(1.0), CAMERA, device, np.random.default_rng(0))
    assert not found[:, -5:].any()
    assert (found[:, :-5] > 0).mean() > 0.99


def object_before_wall(
    near_m: float = 1.0, far_m: float = 2.0, left: int = 200, right: int = 300
) -> NDArray[np.float32]:
    depth_m = np.full(SHAPE, far_m, np.float32)
    depth_m[:, left:right] = near_m
    return depth_m


def test_the_shadow_lies_to_the_left_and_has_the_width_of_the_disparity() -> None:
    lit = projector_lit(object_before_wall(), SHIFT)
    assert (lit == lit[0]).all()
    dark = np.flatnonzero(~lit[0])
    width_px = 525 * 0.075 * (1 / 1.0 - 1 / 2.0)
    assert dark.max() == 199
    assert np.array_equal(dark, np.arange(dark.min(), 200))
    assert len(dark) == pytest.approx(width_px, abs=1)
    found = measured(rendering(object_before_wall()))
    assert (found[:, 182:198] > 0).mean() < 0.05
    assert (found[:, 302:330] > 0).mean() > 0.99


def test_the_projector_sees_past_a_thin_object_on_both_sides() -> None:
    # At 1 m it hides 10 columns of the projector; its shadow on the wall lies 20 columns aside.
    lit = projector_lit(object_before_wall(left=200, right=210), SHIFT)[0]
    assert np.flatnonzero(~lit).tolist() == pytest.approx(np.arange(180, 190), abs=1)


def plainly_lit(row_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which pixels of a row the projector reaches: those that no span of surface lies before."""
    column = np.arange(len(row_m)) - SHIFT / row_m
    spans = np.abs(row_m[1:] / row_m[:-1] - 1) < 0.02
    lit = np.zeros(len(row_m), bool)
    for u, at in enumerate(column):
        before = spans & (column[:-1] <= at) & (at <= column[1:])
        lit[u] = not np.any(before & (row_m[:-1] < row_m[u] * 0.97))
    return lit


def test_the_shadow_agrees_with_a_plain_search() -> None:
    rng = np.random.default_rng(3)
    depth_m = np.full((6, 300), 3.0, np.float32)
    for row in depth_m:
        for left in rng.integers(0, 280, 5):
            row[left : left + 20] = rng.uniform(0.8, 2.5) + rng.uniform(-0.004, 0.004) * np.arange(20)
    plain = np.stack([plainly_lit(row) for row in depth_m])
    differs = projector_lit(depth_m, SHIFT) != plain
    # Columns are rounded, so the borders of shadows may differ by a pixel.
    assert 0.1 < (~plain).mean() < 0.5
    assert differs.mean() < 0.05
    assert not (differs[:, 1:-1] & differs[:, 2:] & differs[:, :-2]).any()


def test_edges_are_ragged_by_the_published_amount() -> None:
    assert lateral_sigma_px(np.array([0.0, np.radians(60)])) == pytest.approx([0.8, 0.87])
    depth_m = object_before_wall(1.0, 1.1, 0, 200)
    rng, places = np.random.default_rng(4), []
    around = (np.zeros(SHAPE, np.float32), np.full(SHAPE, 9, np.float32))
    for _ in range(20):
        # Draws are alike along a row here, so that a row's edge is moved as a whole.
        drawn = np.broadcast_to(rng.standard_normal((150, 1)).astype(np.float32), (150, 200)).copy()
        source = displace(depth_m, around, drawn, np.zeros_like(drawn), np.ones(SHAPE, np.float32), NOISE)
        places.append((depth_m.ravel()[source] < 1.05).sum(axis=1)[::2])
    # Places are whole pixels, which adds a variance of 1/12.
    assert np.std(places) == pytest.approx(np.sqrt(0.8**2 + 1 / 12), rel=0.05)


def test_pixels_at_edges_are_lost_or_mixed_and_no_others() -> None:
    found = measured(rendering(object_before_wall(1.0, 1.5, 0, 200)))
    edge = found[:, 198:202]
    assert 0.05 < (edge == 0).mean() < 0.35
    between = (found > 1.1) & (found < 1.4)
    assert 0.005 < between[:, 197:203].mean() < 0.1
    assert not between[:, :190].any()
    assert not between[:, 210:].any()
    assert (found[:, :190] > 0).mean() > 0.99


def test_dark_and_grazing_surfaces_lose_more() -> None:
    shares = [lost(rendering(2.0, albedo=albedo)) for albedo in (0.6, 0.1, 0.05, 0.02)]
    assert shares[0] < 0.005
    assert np.all(np.diff(shares) > 0)
    # At the strength that is needed half is lost: albedo / z² = 0.008 / m².
    assert lost(rendering(2.0, albedo=0.032)) == pytest.approx(0.5, abs=0.05)
    grazing = [lost(rendering(1.0, cosine=np.cos(np.radians(angle)))) for angle in (60, 78, 80.2, 84)]
    assert np.all(np.diff(grazing) > 0)
    assert grazing[0] < 0.005
    assert grazing[2] == pytest.approx(0.5, abs=0.05)
    assert grazing[3] > 0.95


def test_holes_are_blobs() -> None:
    held = measured(rendering(2.0, albedo=0.032)) > 0
    same = np.mean(held[:, 4:] == held[:, :-4])
    assert same > 0.65  # pixels without a common cause agree in half of all cases


def test_the_sun_takes_depth_from_far_away_first() -> None:
    for depth_m in (1.5, 2.5, 3.5):
        shares = [lost(rendering(depth_m), sunlight=sun) for sun in (0.0, 0.3, 0.6, 1.0)]
        assert np.all(np.diff(shares) >= 0)
        assert shares[-1] > shares[0]
    assert lost(rendering(1.0), sunlight=1.0) < 0.05
    assert lost(rendering(3.5), sunlight=1.0) > 0.9
    # Half is lost where 0.6 / z² / (1 + 20 * 0.6) = 0.008: at 2.40 m.
    assert lost(rendering(2.402), sunlight=1.0) == pytest.approx(0.5, abs=0.05)


def test_distortion_is_smooth_and_has_its_size() -> None:
    none = draw_device(CAMERA, 0.0, 0.0, np.random.default_rng(0))
    assert not none.distortion_px.any()
    field = draw_device(CAMERA, 1.0, 0.0, np.random.default_rng(1)).distortion_px
    # 0.4 % of 4 m in disparity: 0.004 * 580 * 0.075 / 4.
    assert np.sqrt(np.mean(field**2)) == pytest.approx(0.0435, rel=1e-4)
    assert abs(field.mean()) < 0.001
    assert max(np.abs(np.diff(field, axis=axis)).max() for axis in (0, 1)) < 0.02
    twice = draw_device(CAMERA, 2.0, 0.0, np.random.default_rng(1)).distortion_px
    assert np.allclose(twice, 2 * field)


@pytest.mark.parametrize("depth_m", [1.0, 2.0, 4.0])
def test_distortion_grows_with_the_square_of_depth(depth_m: float) -> None:
    device = draw_device(CAMERA, 2.5, 0.0, np.random.default_rng(1))
    found = [measured_depth(rendering(depth_m), CAMERA, device, np.random.default_rng(s)) for s in range(12)]
    frames = np.where(np.stack(found) > 0, found, np.nan)[:, :, :-8]
    expected_m = -device.distortion_px[:, :-8] * depth_m**2 / (580 * 0.075)
    tiles = (slice(None, 296), slice(None, 392))
    found_m = (np.nanmean(frames, axis=0) - depth_m)[tiles].reshape(37, 8, 49, 8).mean(axis=(1, 3))
    expected_m = expected_m[tiles].reshape(37, 8, 49, 8).mean(axis=(1, 3))
    assert np.polyfit(expected_m.ravel(), found_m.ravel(), 1)[0] == pytest.approx(1.0, abs=0.06)


def plain_measure(
    seen_m: NDArray[np.float32],
    source: NDArray[np.int32],
    surface: tuple[NDArray[np.float32], NDArray[np.float32]],
    distortion_px: NDArray[np.float32],
    sunlight: float,
    drawn: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> NDArray[np.float64]:
    """The documented rules for whole arrays, in float64, for pixels that are not at edges."""
    z, cosine, albedo = (image.astype(np.float64).ravel()[source] for image in (seen_m, *surface))
    cosine = np.maximum(cosine, np.cos(np.radians(85)))
    safe = np.where(z > 0, z, 1.0)
    signal = albedo * cosine / safe**2 / (1 + NOISE.sun * sunlight * albedo)
    margin = np.minimum(
        np.log(np.maximum(signal, 1e-9) / NOISE.weakest_signal) / NOISE.signal_softness,
        (cosine - NOISE.graze_cos) / NOISE.graze_softness,
    )
    weak = np.repeat(np.repeat(drawn[1], 2, axis=0), 2, axis=1)
    kept = (weak <= np.minimum(margin, NOISE.any_margin)) & (z >= 0.4) & (z <= 4.5)
    sigma_m = axial_sigma_m(safe, np.arccos(np.minimum(cosine, 1)))
    sigma_m = np.sqrt(np.maximum(sigma_m**2 - depth_step_m(safe, NOISE) ** 2 / 12, 0))
    noisy = 1 / (1 / safe + distortion_px / (580 * 0.075)) + sigma_m * drawn[0]
    reported = 348 / np.maximum(np.round(348 / np.maximum(noisy, 0.1)), 1)
    reported = np.where(kept & (reported <= 4.5), reported, 0)
    reported[:, -BLIND:] = 0
    return reported


@pytest.mark.parametrize("sunlight", [0.0, 0.5])
def test_the_kernel_does_what_plain_numpy_does(sunlight: float) -> None:
    rng = np.random.default_rng(8)
    seen_m = rng.uniform(0.3, 5.0, SHAPE).astype(np.float32)
    source = np.arange(seen_m.size, dtype=np.int32).reshape(SHAPE)[::-1].copy()
    cosine, albedo = (rng.uniform(0.05, 1.0, SHAPE).astype(np.float32) for _ in range(2))
    surface = (cosine, albedo)
    drawn = (
        rng.standard_normal(SHAPE, dtype=np.float32),
        rng.standard_normal((150, 200), dtype=np.float32),
    )
    distortion_px = (0.1 * rng.standard_normal(SHAPE)).astype(np.float32)
    device = (NOISE, distortion_px, sunlight)
    found = sense(seen_m, (seen_m, seen_m), source, surface, device, drawn)
    plain = plain_measure(seen_m, source, surface, distortion_px, sunlight, drawn)
    assert 0.1 < (plain > 0).mean() < 0.9
    # The kernel calculates in float32; at the borders of two steps that may decide.
    assert np.mean(np.abs(found - plain) > 1e-5) < 2e-3
    both = (found > 0) & (plain > 0)
    assert np.all(np.abs(found - plain)[both] <= 1.2 * depth_step_m(plain[both], NOISE))


def test_the_seed_decides() -> None:
    first, same, other = (measured(rendering(1.5), distortion=1.0, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)
