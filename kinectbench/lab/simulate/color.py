"""Simulate a colour camera on a rendered frame: motion blur, exposure, softness and grain."""

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, invert_rigid
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.path import draw_waves
from kinectbench.lab.simulate.render import Rendering

# Without a published source: a small lens and the interpolation of the colour filter soften a little; grain
# is in levels of 255, the same in a pixel's three colours.
SOFTNESS_PX = 0.6
GRAIN_LEVELS = 1.5
GAIN_HZ = np.array([0.1, 0.23, 0.4])
# Streaks up to a pixel are no blur; longer streaks than this are sampled at more than a pixel's distance.
MOST_TAPS = 16
SHIFT = 16
FIXED = 1 << SHIFT


def exposure_gains(time_s: Float64, drift: float, rng: np.random.Generator) -> Float64:
    """Return the brightness gain (n,) of an automatic exposure, which varies slowly with time.

    Args:
        time_s: (n,) times, seconds.
        drift: gains stay between 1 / (1 + drift) and 1 + drift.
        rng: draws the gain's random course.
    """
    course = np.clip(draw_waves(GAIN_HZ, 1, rng).at(time_s)[:, 0], -1, 1)
    return np.asarray((1 + drift) ** course)


def expose(
    rendering: Rendering,
    camera: Camera,
    T_room_cameras: tuple[Float64, Float64, Float64],
    gain: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return the colour image (height, width, 3) uint8 of one exposure, with blur, gain and grain.

    Motion blur averages the image rendered at mid-exposure along each pixel's streak: from where its surface
    point projects at the start of the exposure to where it projects at the end. So no rays are cast again.
    One effect is missing: a near object does not smear over the background beside it. Display values are
    averaged, not linear light.

    Args:
        rendering: noise-free rendering from the pose in the middle of the exposure.
        camera: the camera of the rendering.
        T_room_cameras: poses (4, 4) at the start, in the middle and at the end of the exposure.
        gain: factor on brightness; values above 255 saturate.
        rng: draws the grain.
    """
    start, middle, end = T_room_cameras
    soft = cv2.GaussianBlur(rendering.color_rgb, (3, 3), SOFTNESS_PX)
    homographies = np.stack([_pixels_to(camera, invert_rigid(T) @ middle) for T in (start, end)])
    homographies = homographies.astype(np.float32)
    grain = rng.standard_normal(rendering.depth_m.shape, dtype=np.float32)
    return np.asarray(_smear(soft, rendering.depth_m, homographies, grain, np.float32(gain)))


def _pixels_to(camera: Camera, T_then_now: Float64) -> Float64:
    """Return the (3, 4) matrix that maps (u, v, 1, 1 / z) of a point now to its homogeneous pixel then.

    Args:
        camera: intrinsics, the same at both times.
        T_then_now: (4, 4), camera frame now to camera frame then.
    """
    K = camera.K
    turned = K @ T_then_now[:3, :3] @ np.linalg.inv(K)
    return np.column_stack([turned, K @ T_then_now[:3, 3]])


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _smear(color_rgb, depth_m, homographies, grain, gain):  # type: ignore[no-untyped-def]
    """Average colours along streaks, multiply by the gain and add grain: (height, width, 3) uint8.

    Args:
        color_rgb: (height, width, 3) uint8.
        depth_m: (height, width), metres, 0 where nothing is hit.
        homographies: pair of matrices of `_pixels_to`, to the start and to the end of the exposure.
        grain: (height, width), standard normal variates.
        gain: factor on brightness.
    """
    height, width = depth_m.shape
    smeared = np.empty((height, width, 3), np.uint8)
    streaks = np.empty((width, 2), np.float32)
    for v in range(height):
        _streaks(homographies[0], homographies[1], v, depth_m[v], streaks)
        for u in range(width):
            along_u, along_v = streaks[u, 0], streaks[u, 1]
            taps = min(max(int(np.ceil(max(abs(along_u), abs(along_v)))), 1), MOST_TAPS)
            # Positions are in 65536ths of a pixel from the first tap on, so that a tap costs two additions.
            step_u = np.int64(FIXED * along_u / np.float32(taps))
            step_v = np.int64(FIXED * along_v / np.float32(taps))
            x = (u << SHIFT) + (FIXED >> 1) - (step_u * (taps - 1) >> 1)
            y = (v << SHIFT) + (FIXED >> 1) - (step_v * (taps - 1) >> 1)
            red = green = blue = np.int32(0)
            for _ in range(taps):
                column, line = min(max(x >> SHIFT, 0), width - 1), min(max(y >> SHIFT, 0), height - 1)
                red += color_rgb[line, column, 0]
                green += color_rgb[line, column, 1]
                blue += color_rgb[line, column, 2]
                x, y = x + step_u, y + step_v
            scale, offset = gain / np.float32(taps), np.float32(GRAIN_LEVELS) * grain[v, u]
            smeared[v, u, 0] = _level(scale * np.float32(red) + offset)
            smeared[v, u, 1] = _level(scale * np.float32(green) + offset)
            smeared[v, u, 2] = _level(scale * np.float32(blue) + offset)
    return smeared


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _level(value):  # type: ignore[no-untyped-def]
    return np.uint8(min(max(value, np.float32(0)), np.float32(255)) + np.float32(0.5))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _streaks(before, after, v, depth_m, streaks):  # type: ignore[no-untyped-def]
    """Write the motion (du, dv) of row v's pixels during the exposure into `streaks` (width, 2), pixels.

    `before` and `after` (3, 4) map (u, v, 1, 1 / z) in the middle of the exposure to homogeneous pixels at
    its start and end; `depth_m` (width,) is the row's depth.
    """
    one, y = np.float32(1), np.float32(v)
    for u in range(len(depth_m)):
        x, near = np.float32(u), one / depth_m[u] if depth_m[u] > 0 else np.float32(0)
        scale = one / (before[2, 0] * x + before[2, 1] * y + before[2, 2] + before[2, 3] * near)
        from_u = (before[0, 0] * x + before[0, 1] * y + before[0, 2] + before[0, 3] * near) * scale
        from_v = (before[1, 0] * x + before[1, 1] * y + before[1, 2] + before[1, 3] * near) * scale
        scale = one / (after[2, 0] * x + after[2, 1] * y + after[2, 2] + after[2, 3] * near)
        to_u = (after[0, 0] * x + after[0, 1] * y + after[0, 2] + after[0, 3] * near) * scale
        to_v = (after[1, 0] * x + after[1, 1] * y + after[1, 2] + after[1, 3] * near) * scale
        streaks[u, 0], streaks[u, 1] = to_u - from_u, to_v - from_v
