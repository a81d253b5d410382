"""Depth with and without steps of disparity, in several units of depth."""

import numpy as np
import pytest
from analytic_scenes import CAMERA, MemoryFrames
from numpy.typing import NDArray

from kinectbench.core.own_pixels import by_own_pixels
from kinectbench.core.sequence import Sequence
from kinectbench.stages.segment.judge.depth_bias import shows_disparity_steps

# A Kinect v1: focal length in pixels, baseline in metres, steps of an eighth of a pixel.
FOCAL_BASELINE_PX_M, STEPS_PER_PX = 575.8 * 0.075, 8.0
FRAMES = np.arange(4)


def depths_m(nearest_m: float, farthest_m: float) -> NDArray[np.float64]:
    """Every depth of a range, in pixels anywhere."""
    return np.random.default_rng(1).uniform(nearest_m, farthest_m, (CAMERA.height, CAMERA.width))


def in_steps(depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
    steps = STEPS_PER_PX * FOCAL_BASELINE_PX_M
    return steps / np.rint(steps / depth_m)


def recorded(depth_m: NDArray[np.float64], depth_scale: float) -> Sequence:
    native = np.rint(depth_m * depth_scale).astype(np.uint16)
    stamps_ns = FRAMES * 10**8
    return Sequence(CAMERA, depth_scale, stamps_ns, False, None, MemoryFrames(lambda _: native))


@pytest.mark.parametrize("depth_scale", [256.0, 500.0, 1000.0, 1500.0, 5000.0, 10000.0])
def test_steps_of_disparity_are_told_from_every_value(depth_scale: float) -> None:
    smooth_m = depths_m(0.5, 4.0)
    assert shows_disparity_steps(recorded(in_steps(smooth_m), depth_scale), FRAMES)
    assert not shows_disparity_steps(recorded(smooth_m, depth_scale), FRAMES)


def test_noise_within_the_steps_hides_none() -> None:
    rng = np.random.default_rng(0)
    smooth_m = depths_m(0.8, 2.5)
    noisy_m = smooth_m + rng.normal(0, 0.002 * smooth_m**2)
    assert shows_disparity_steps(recorded(in_steps(noisy_m), 1000.0), FRAMES)
    assert not shows_disparity_steps(recorded(noisy_m, 1000.0), FRAMES)


def test_depth_that_is_too_near_shows_none() -> None:
    assert not shows_disparity_steps(recorded(in_steps(depths_m(0.4, 0.69)), 1000.0), FRAMES)


def test_the_whole_image_tells_of_a_masked_recording() -> None:
    nothing = np.zeros((CAMERA.height, CAMERA.width), bool)
    masked = by_own_pixels(recorded(in_steps(depths_m(0.5, 4.0)), 1000.0), lambda _: nothing)
    assert shows_disparity_steps(masked, FRAMES)
