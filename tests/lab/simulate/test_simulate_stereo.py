"""A simulated stereo camera against Intel's figures, and the errors that come of matching windows."""

import numpy as np
import pytest
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.lab.simulate.render import Rendering
from kinectbench.lab.simulate.simulate import prepare, record_frame
from kinectbench.lab.simulate.stereo import (
    BASELINE_M,
    DISTORTION_PX,
    FARTHEST_M,
    NEAREST_M,
    draw_stereo,
    match_stereo,
)

CAMERA = Camera(424, 240, 424.0, 424.0, 211.5, 119.5)
SCALE_PX_M = CAMERA.fx * BASELINE_M
# Left of this column the right camera does not see what lies at a metre.
SEEN_BY_BOTH = 60


def rendering(depth_m: NDArray[np.float64]) -> Rendering:
    shape = (CAMERA.height, CAMERA.width)
    depth = np.broadcast_to(depth_m, shape).astype(np.float32)
    ones = np.ones(shape, np.float32)
    return Rendering(depth, np.zeros((*shape, 3), np.uint8), np.zeros(shape, bool), ones, 0.5 * ones)


def measured(
    depth_m: NDArray[np.float64], distortion: float = 0.0, sunlight: float = 0.0
) -> NDArray[np.float64]:
    device = draw_stereo(CAMERA, distortion, sunlight, np.random.default_rng(0))
    found = match_stereo(rendering(depth_m), CAMERA, device, np.random.default_rng(1))
    return found.astype(np.float64)


def slanted(middle_m: float) -> NDArray[np.float64]:
    """A plane with every fraction of a pixel of disparity."""
    right = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    return np.asarray(middle_m / (1 - 0.3 * right), np.float64)


@pytest.mark.parametrize("middle_m", [0.7, 1.0, 2.0])
def test_the_disparity_of_a_plane_is_as_exact_as_published(middle_m: float) -> None:
    exact_m = slanted(middle_m)
    found_m = measured(exact_m)[:, SEEN_BY_BOTH:-9]
    known = found_m > 0
    assert known.mean() > 0.9
    errors_px = (SCALE_PX_M / np.where(known, found_m, np.nan) - SCALE_PX_M / exact_m[SEEN_BY_BOTH:-9])[known]
    usual_px = errors_px[np.abs(errors_px) < 1]
    assert len(usual_px) > 0.99 * len(errors_px)
    assert 0.05 < usual_px.std() < 0.12
    assert abs(usual_px.mean()) < 0.02


def test_a_devices_error_is_at_most_that_of_the_specification() -> None:
    device = draw_stereo(CAMERA, 1.0, 0.0, np.random.default_rng(3))
    assert np.sqrt((device.distortion_px**2).mean()) == pytest.approx(DISTORTION_PX)
    # 2 % at 2 m are 0.2 pixels.
    assert np.quantile(np.abs(device.distortion_px), 0.8) < 0.02 * SCALE_PX_M / 2
    plain_m, shifted_m = measured(slanted(1.0)), measured(slanted(1.0), distortion=2.0)
    both = (plain_m > 0) & (shifted_m > 0)
    shifts_px = (SCALE_PX_M / shifted_m[both]) - (SCALE_PX_M / plain_m[both])
    assert shifts_px.std() == pytest.approx(2 * DISTORTION_PX, rel=0.3)


def test_windows_blur_edges_and_what_one_camera_sees_alone_is_not_measured() -> None:
    """A bar of 40 columns at 0.7 m before a wall at 1.5 m; its shadow, on its left, is 16 pixels wide."""
    exact_m = np.full(CAMERA.width, 1.5)
    bar = slice(200, 240)
    exact_m[bar] = 0.7
    found_m = measured(exact_m)
    near = (found_m > 0) & (np.abs(found_m - 0.7) < 0.05)
    wall = (found_m > 0) & (np.abs(found_m - 1.5) < 0.1)
    assert near[:, 204:236].mean() > 0.95 and near[:, :196].mean() + near[:, 244:].mean() < 0.01
    assert wall[:, 60:180].mean() > 0.95 and wall[:, 250:400].mean() > 0.95
    assert wall[:, 185:198].mean() < 0.1
    # At an edge, some rows have it on either side.
    assert 0.2 < near[:, 239].mean() < 0.9 and 0.02 < near[:, 240:244].mean() < 0.5


def test_depth_has_a_range() -> None:
    for depth_m in (0.8 * NEAREST_M, 1.5 * FARTHEST_M):
        found_m = measured(np.full(CAMERA.width, depth_m))
        assert not ((found_m > 0) & (np.abs(found_m / depth_m - 1) < 0.05)).any()
    nothing = measured(np.zeros(CAMERA.width))
    assert (nothing > 0).mean() < 0.02


def test_frames_of_the_preset_are_repeatable() -> None:
    spec = preset_spec("stereo-v1", {"path": {"frames": 3}, "sensor": {"width": 212, "height": 120}})
    simulation = prepare(spec)
    once, again = (record_frame(simulation, 1).frame.depth_m for _ in range(2))
    np.testing.assert_array_equal(once, again)
    assert (once > 0).mean() > 0.25
