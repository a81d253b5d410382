"""Simulate an active stereo camera, such as a RealSense D435, by matching two simulated infrared images.

A projector casts dots on the scene, and depth is found by matching the images of two cameras. So its errors
need no model of their own: windows that straddle an edge move it or find nothing, what one camera alone sees
has no depth or a wrong one, and noise is correlated over the window.

Sources:
    Keselman, Woodfill, Grunnet-Jepsen, Bhowmik: Intel RealSense Stereoscopic Depth Cameras, CVPR Workshops
    2017 (dots, baseline, matching). Intel: RealSense D400 Series Datasheet (D435: baseline of 50 mm, error of
    the distance at most 2 % at 2 m). Intel's engineers on librealsense's tracker, #999 (depth from 0.17 m on
    at 848x480). Konolige: Small Vision Systems: Hardware and Implementation, ISRR 1997 (the matching here, by
    OpenCV; the camera's own is not published). Values without a source are chosen here.

Not simulated: filters of depth, a projector that stands beside the left camera.
"""

from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera
from kinectbench.core.types import Float32
from kinectbench.lab.simulate.kinect import smooth_error, smooth_normal
from kinectbench.lab.simulate.render import Rendering

# Baseline (datasheet), and the range of depth: a little more than the camera's nearest, so that 112 pixels
# are searched, not 128; farther than 6 m, a disparity is below 3.5 pixels (both chosen here).
BASELINE_M, NEAREST_M, FARTHEST_M = 0.05, 0.195, 6.0
# Root mean square of a device's disparity error, pixels: 1 % of the distance at 2 m, half of the specified
# limit.
DISTORTION_PX = 0.1
# Light of the dots on a white surface that is met head-on at 1 m, and of the room, by which the cameras see
# textures, too; full sun is this many times as strong. A blur gives the dots a width of two to three pixels.
DOTS_AT_1M, ROOM, SUN, DOT_PX = 1.0, 0.5, 20.0, 0.8
# Exposure makes this share of the pixels darker than this value of 255; noise of the images, of 255.
EXPOSED_SHARE, EXPOSED_TO, NOISE = 0.995, 220.0, 2.0
# The matcher: edge of the window; the least sum of a window's gradients, which pure noise does not reach; the
# least lead of the best disparity in percent; the largest difference of both images' disparities; and the
# smallest patch of similar disparity. With this window the disparity of slanted planes at 1 and 2 m has a
# standard deviation of 0.08 pixels, which Intel calls typical; with 7 pixels 0.09, with 15 pixels 0.05.
WINDOW_PX, CONTRAST, LEAD_PERCENT, BOTH_PX, SPECKLE_PX, SPECKLE_STEP = 9, 700, 10, 1, 100, 1
# Steps of disparity in a pixel: 32 on the camera (librealsense), 16 of the matcher.
STEPS_PER_PX = 2 * cv2.StereoMatcher_DISP_SCALE


@dataclass(frozen=True)
class StereoUnit:
    """One individual stereo camera and the sunlight on its scene.

    Attributes:
        dots: (height, width) float32, light of the projector in the left image, 0 to 1.
        distortion_px: (height, width) float32, error of the disparity, pixels.
        sunlight: 0 to 1.
    """

    dots: Float32
    distortion_px: Float32
    sunlight: float


def draw_stereo(camera: Camera, distortion: float, sunlight: float, rng: np.random.Generator) -> StereoUnit:
    """Draw an individual stereo camera; `distortion` is 1 for a typical device, 0 for none."""
    field = smooth_error(camera, distortion * DISTORTION_PX, rng).astype(np.float32)
    dots = smooth_normal((camera.height, camera.width), DOT_PX, rng)
    return StereoUnit(np.clip(0.5 + 0.5 * dots, 0, 1).astype(np.float32), field, sunlight)


def match_stereo(
    rendering: Rendering, camera: Camera, device: StereoUnit, rng: np.random.Generator
) -> Float32:
    """Return the depth image of a noise-free rendering: (height, width) metres along z, 0 = no measurement.

    The rendering is that of the left camera; `rng` draws the noise of both images.
    """
    exact_m = rendering.depth_m
    away_m = np.where(exact_m > 0, exact_m, np.float32(FARTHEST_M))
    projected = DOTS_AT_1M * rendering.albedo * rendering.cos_incidence / (away_m * away_m)
    gray = cv2.cvtColor(rendering.color_rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    room = ROOM * (1 + SUN * device.sunlight) * gray
    left = (np.where(exact_m > 0, projected * device.dots, np.float32(0)) + room).astype(np.float32)
    hidden = rng.choice(left.reshape(-1), left.shape)
    disparity_px = (camera.fx * BASELINE_M / away_m + device.distortion_px).astype(np.float32)
    right = np.asarray(_right_image(left, disparity_px, hidden))
    images = [_exposed(image, rng) for image in (left, right)]
    found_px = _matched(images[0], images[1], camera.fx * BASELINE_M / NEAREST_M, rng)
    known = found_px > 0
    depth_m = camera.fx * BASELINE_M / np.where(known, found_px, np.float32(1))
    known &= (depth_m >= NEAREST_M) & (depth_m <= FARTHEST_M)
    return np.where(known, depth_m, 0).astype(np.float32)


def _exposed(image: Float32, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return an image of 255 brightnesses, with noise, of light of any unit."""
    gain = EXPOSED_TO / max(float(np.quantile(image, EXPOSED_SHARE)), 1e-6)
    noise = NOISE * rng.standard_normal(image.shape, dtype=np.float32)
    return np.asarray(np.clip(np.rint(gain * image + noise), 0, 255), np.uint8)


def _matched(
    left: NDArray[np.uint8], right: NDArray[np.uint8], largest_px: float, rng: np.random.Generator
) -> Float32:
    """Return the disparity of each left pixel, (height, width) float32 pixels, 0 where none is found."""
    searched_px = 16 * int(np.ceil(largest_px / 16))
    matcher = cv2.StereoBM.create(searched_px, WINDOW_PX)
    matcher.setPreFilterType(cv2.STEREO_BM_PREFILTER_XSOBEL)
    matcher.setTextureThreshold(CONTRAST)
    matcher.setUniquenessRatio(LEAD_PERCENT)
    matcher.setDisp12MaxDiff(BOTH_PX)
    matcher.setSpeckleWindowSize(SPECKLE_PX)
    matcher.setSpeckleRange(SPECKLE_STEP)
    # The matcher gives no disparity in so many columns at the left.
    wide = [cv2.copyMakeBorder(image, 0, 0, searched_px, 0, cv2.BORDER_CONSTANT) for image in (left, right)]
    found = matcher.compute(wide[0], wide[1])[:, searched_px:].astype(np.float32)
    # The matcher's sixteenths are on average half of one too large; the camera's steps are half as wide.
    steps = 2 * found - rng.integers(0, 3, found.shape).astype(np.float32)
    return np.where(found > 0, steps / np.float32(STEPS_PER_PX), np.float32(0))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _right_image(left, disparity_px, hidden):  # type: ignore[no-untyped-def]
    """Return the right camera's image: (height, width) float32.

    A surface goes on from a pixel to the next if their disparities differ by less than a pixel. What the left
    camera does not see is filled from `hidden` (height, width).
    """
    height, width = left.shape
    right = hidden.copy()
    nearest = np.zeros(width, np.float32)
    for v in range(height):
        nearest[:] = -1
        for u in range(width - 1):
            first, second = disparity_px[v, u], disparity_px[v, u + 1]
            if abs(second - first) >= 1:
                second = first
            begin, end = u - first, u + 1 - second
            for k in range(max(0, int(np.ceil(begin))), min(width - 1, int(np.floor(end))) + 1):
                t = (k - begin) / (end - begin)
                disparity = first + t * (second - first)
                if disparity > nearest[k]:
                    nearest[k] = disparity
                    right[v, k] = (1 - t) * left[v, u] + t * left[v, u + 1]
    return right
