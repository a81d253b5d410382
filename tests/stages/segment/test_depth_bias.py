"""The steps of inverse depth, in several units of depth, and whose they are."""

import numpy as np
import pytest
from analytic_scenes import CAMERA, MemoryFrames
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera
from kinectbench.core.own_pixels import by_own_pixels
from kinectbench.core.sequence import Sequence
from kinectbench.stages.segment.judge.depth_bias import inverse_depth_steps, is_of_kinect

# Focal length in pixels, baseline in metres, and steps a pixel.
KINECT = 575.8 * 0.075 * 8
FRAMES = np.arange(4)


def depths_m(nearest_m: float, farthest_m: float) -> NDArray[np.float64]:
    """Every depth of a range, in pixels anywhere."""
    return np.random.default_rng(1).uniform(nearest_m, farthest_m, (CAMERA.height, CAMERA.width))


def in_steps(depth_m: NDArray[np.float64], steps: float = KINECT) -> NDArray[np.float64]:
    return steps / np.rint(steps / depth_m)


def recorded(depth_m: NDArray[np.float64], depth_scale: float = 1000.0) -> Sequence:
    native = np.rint(depth_m * depth_scale).astype(np.uint16)
    stamps_ns = FRAMES * 10**8
    return Sequence(CAMERA, depth_scale, stamps_ns, False, None, MemoryFrames(lambda _: native))


@pytest.mark.parametrize("depth_scale", [256.0, 500.0, 1000.0, 1500.0, 5000.0, 10000.0])
def test_a_kinect_is_told_from_sensors_without_steps(depth_scale: float) -> None:
    smooth_m = depths_m(0.5, 4.0)
    found = inverse_depth_steps(recorded(in_steps(smooth_m), depth_scale), FRAMES)
    assert found == pytest.approx(KINECT, rel=0.1) and is_of_kinect(found, CAMERA)
    smooth = inverse_depth_steps(recorded(smooth_m, depth_scale), FRAMES)
    assert smooth is not None and smooth > 2 * KINECT and not is_of_kinect(smooth, CAMERA)


@pytest.mark.parametrize("width", [424, 480, 640, 848])
def test_a_realsense_is_none(width: int) -> None:
    """Small images have a Kinect's steps, but are wider."""
    steps = width / 2 * 0.05 * 32
    found = inverse_depth_steps(recorded(in_steps(depths_m(0.5, 4.0), steps)), FRAMES)
    camera = Camera(width, 240, width / 2, width / 2, width / 2, 119.5)
    assert found == pytest.approx(steps, rel=0.05) and not is_of_kinect(found, camera)


def test_noise_within_the_steps_hides_none() -> None:
    rng = np.random.default_rng(0)
    smooth_m = depths_m(0.8, 2.5)
    noisy_m = smooth_m + rng.normal(0, 0.002 * smooth_m**2)
    assert is_of_kinect(inverse_depth_steps(recorded(in_steps(noisy_m)), FRAMES), CAMERA)
    assert not is_of_kinect(inverse_depth_steps(recorded(noisy_m), FRAMES), CAMERA)


def test_depth_that_is_too_near_tells_nothing() -> None:
    found = inverse_depth_steps(recorded(in_steps(depths_m(0.4, 0.9))), FRAMES)
    assert found is None and not is_of_kinect(found, CAMERA)


def test_the_whole_image_tells_of_a_masked_recording() -> None:
    nothing = np.zeros((CAMERA.height, CAMERA.width), bool)
    masked = by_own_pixels(recorded(in_steps(depths_m(0.5, 4.0))), lambda _: nothing)
    assert is_of_kinect(inverse_depth_steps(masked, FRAMES), CAMERA)
