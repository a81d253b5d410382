"""Simulate the errors of a Kinect v1 on exact depth: noise, disparity steps, shadow, lost pixels.

Sources:
    Nguyen, Izadi, Lovell: Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking, 3DIMPVT
    2012 (axial and lateral noise). Khoshelham, Elberink: Accuracy and Resolution of Kinect Depth Data for
    Indoor Mapping Applications, Sensors 12(2), 2012 (depth from disparity, its eighths of a pixel). Herrera,
    Kannala, Heikkila: Joint Depth and Color Camera Calibration with Distortion Correction, PAMI 34(10), 2012,
    and Teichman, Miller, Thrun: Unsupervised Intrinsic Calibration of Depth Sensors via SLAM, RSS 2013 (depth
    distortion). Values without a source are marked "chosen here". Pixels are those of the image.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numba
import numpy as np

from kinectbench.core.geometry import Camera
from kinectbench.core.types import Float32, Float64
from kinectbench.lab.simulate.render import Rendering

# Beyond 85 degrees nothing is measured; this limit keeps the formulas finite there.
STEEPEST_COS = np.float32(0.0872)
SHADOW_DEPTH = np.float32(0.02)
# Focal length of the 640x480 images on which the pixel-valued parameters below were measured.
FOCAL_PX = 525.0
DISTORTION_WAVES = 4
DISTORTION_AT_M, DISTORTION_SHARE = 4.0, 0.004


@numba.njit(cache=True, error_model="numpy", nogil=True)
def projector_lit(depth_m, shift_px_m):  # type: ignore[no-untyped-def]
    """Return the mask of pixels that the projector lights, by a depth buffer over the projector's columns.

    The projector is beside the camera in +x. So a point at column u of the camera is at column u - f b / z of
    the projector, in the same row, and an object's shadow is to the left of the object.

    Args:
        depth_m: (height, width) float32, metres, 0 = nothing there.
        shift_px_m: focal length of the image times baseline, pixel metres.

    Returns:
        bool (height, width); false where there is no depth.
    """
    height, width = depth_m.shape
    lit = np.zeros((height, width), np.bool_)
    column, near = np.empty(width, np.float32), np.empty(width, np.float32)
    nearest = np.empty(2 * width, np.float32)
    for v in range(height):
        nearest[:] = 0
        for u in range(width):
            z = depth_m[v, u]
            near[u] = np.float32(1) / z if z > 0 else np.float32(0)
            # Projector columns are shifted by one image width; columns still farther left are outside the
            # view.
            column[u] = max(np.float32(width + u) - np.float32(shift_px_m) * near[u], np.float32(0))
        for u in range(width):
            first = last = int(column[u] + np.float32(0.5))
            # A surface continues to the next pixel, which the projector may see several columns away.
            if u + 1 < width and abs(near[u + 1] - near[u]) < SHADOW_DEPTH * near[u]:
                last = max(first, int(column[u + 1] + np.float32(0.5)))
            for k in range(first, last + 1):
                nearest[k] = max(nearest[k], near[u])
        for u in range(width):
            ahead = nearest[int(column[u] + np.float32(0.5))]
            lit[v, u] = near[u] > 0 and ahead <= near[u] * (np.float32(1) + SHADOW_DEPTH)
    return lit


@numba.njit(cache=True, error_model="numpy", nogil=True)
def displace(seen_m, around_m, right, down, cosine, noise):  # type: ignore[no-untyped-def]
    """Return for each pixel the index of the pixel whose depth it measures.

    This is the pixel itself or, near a depth edge, a random neighbour.

    Args:
        seen_m: (height, width) float32, metres, 0 where the sensor sees nothing.
        around_m: pair (smallest, largest) of the depth in each 5x5 window, the reach of the displacement.
        right: standard normal variates at half the resolution, for the displacement to the right.
        down: the same for the displacement downwards.
        cosine: (height, width) float32, cosine of incidence.
        noise: `KinectNoise`.

    Returns:
        (height, width) int32, indices in the flattened image.
    """
    height, width = seen_m.shape
    source = np.empty((height, width), np.int32)
    for v in range(height):
        for u in range(width):
            source[v, u] = v * width + u
            own = seen_m[v, u]
            if around_m[1][v, u] <= around_m[0][v, u] * (1 + noise.same_surface):
                continue
            sigma_px = _lateral_sigma_px(cosine[v, u])
            x = min(max(u + int(np.rint(sigma_px * right[v // 2, u // 2])), 0), width - 1)
            y = min(max(v + int(np.rint(sigma_px * down[v // 2, u // 2])), 0), height - 1)
            if abs(seen_m[y, x] - own) > noise.same_surface * own:
                source[v, u] = y * width + x
    return source


@numba.njit(cache=True, error_model="numpy", nogil=True)
def sense(seen_m, around_m, source, surface, device, drawn):  # type: ignore[no-untyped-def]
    """Return the depth that the sensor reports: (height, width) float32, metres, 0 = none.

    A pixel is lost if it is out of range, if its signal is too weak, or if it lies in the sensor's blind
    strip. At depth edges some pixels get a mix of near and far depth. After this, the depth of every
    remaining pixel is distorted, gets axial noise, and is quantised in disparity.

    Args:
        seen_m: (height, width) float32, metres, 0 where the sensor sees nothing.
        around_m: pair (smallest, largest) of the depth in each 3x3 window.
        source: (height, width) int32, from `displace`: index of the pixel whose depth each pixel measures.
        surface: pair (cosine of incidence, albedo), both (height, width) float32.
        device: triple (`KinectNoise`, distortion of disparity (height, width) float32 in pixels, sunlight).
        drawn: pair of standard normal variates, float32: (height, width) for depth noise, and at half the
            resolution for the required signal strength.
    """
    noise, distortion_px, sunlight = device
    axial, weak = drawn
    flat_m, cosines, albedos = seen_m.ravel(), surface[0].ravel(), surface[1].ravel()
    height, width = seen_m.shape
    reported = np.zeros((height, width), np.float32)
    scale = np.float32(noise.focal_px * noise.baseline_m)
    for v in range(height):
        for u in range(width - int(noise.blind_share * width + 0.5)):
            low, high = around_m[0][v, u], around_m[1][v, u]
            z, needed = flat_m[source[v, u]], weak[v // 2, u // 2]
            if z < noise.min_range_m or z > noise.max_range_m:
                continue
            at_edge = high > low * np.float32(1 + noise.same_surface)
            cosine = max(cosines[source[v, u]], STEEPEST_COS)
            margin = _margin(z, cosine, albedos[source[v, u]], noise, np.float32(sunlight))
            if needed > (min(margin, noise.edge_margin) if at_edge else margin):
                continue
            if at_edge and low > 0 and needed > noise.edge_margin - noise.edge_mix:
                z = 2 / (1 / low + 1 / high)
            steps_per_px = scale * np.float32(noise.steps_per_px)
            off = np.float32(1) / (np.float32(1) / z + distortion_px[v, u] / scale)
            noisy = off + _drawn_sigma_m(z, cosine, steps_per_px) * axial[v, u]
            steps = max(np.rint(steps_per_px / max(noisy, np.float32(0.1))), np.float32(1))
            if steps_per_px <= noise.max_range_m * steps:
                reported[v, u] = steps_per_px / steps
    return reported


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _lateral_sigma_px(cosine):  # type: ignore[no-untyped-def]
    """Return the lateral noise of an edge: its standard deviation in pixels (Nguyen et al. 2012, eq. 1)."""
    angle = np.arccos(max(cosine, STEEPEST_COS))
    return 0.8 + 0.035 * angle / (np.pi / 2 - angle)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _drawn_sigma_m(z, cosine, scale):  # type: ignore[no-untyped-def]
    """Return the standard deviation of the axial noise to draw, metres, before depth is quantised.

    It is the published value (Nguyen et al. 2012, eq. 3 and 4) at depth `z` and the given cosine of
    incidence, without the variance of rounding inverse depth to multiples of 1 / `scale`, which `sense` adds.
    """
    sigma = np.float32(0.0012) + np.float32(0.0019) * (z - np.float32(0.4)) ** 2
    if cosine < np.float32(0.5):
        angle = np.arccos(cosine)
        sigma += np.float32(0.0001) / np.sqrt(z) * (angle / (np.float32(np.pi / 2) - angle)) ** 2
    return np.sqrt(max(sigma**2 - (z * z / scale) ** 2 / np.float32(12), np.float32(0)))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _margin(z, cosine, albedo, noise, sunlight):  # type: ignore[no-untyped-def]
    """Return the pattern's signal strength, in standard deviations above the mean required strength.

    The signal is albedo * cos(incidence) / z², weakened by reflected sunlight (0 to 1). At grazing incidence
    the result is lower; it is at most `noise.any_margin`.
    """
    drowned = z * z * (np.float32(1) + np.float32(noise.sun) * sunlight * albedo)
    signal = max(albedo * cosine / drowned, np.float32(1e-9))
    strong = np.log(signal / np.float32(noise.weakest_signal)) / np.float32(noise.signal_softness)
    steep = (cosine - np.float32(noise.graze_cos)) / np.float32(noise.graze_softness)
    return min(strong, steep, np.float32(noise.any_margin))


class KinectNoise(NamedTuple):
    """Parameters of the sensor; the defaults are a Kinect v1.

    Attributes:
        min_range_m: nearer surfaces give no depth, metres.
        max_range_m: farther surfaces give no depth, metres.
        focal_px: focal length of the infrared camera at its own resolution, pixels (Khoshelham & Elberink).
        baseline_m: from camera to projector, which stands in +x (Khoshelham & Elberink).
        steps_per_px: disparity steps per pixel (Khoshelham & Elberink).
        smooth_share: share of the axial noise's variance that is correlated between neighbouring pixels.
            Chosen so that errors on planes correlate as in 7-Scenes' red kitchen
            (docs/evidence/simulation.md).
        smooth_px: standard deviation of the blur that correlates this share; chosen by the same measurement.
        same_surface: largest relative difference of depth between pixels of one surface.
        weakest_signal: albedo * cos(incidence) / z² in 1/m² at which half the pixels are lost (chosen here: a
            grey wall, albedo 0.6, is lost beyond 8.7 m, a black cushion, albedo 0.05, beyond 2.5 m).
        signal_softness: standard deviation of the logarithm of the required signal.
        sun: infrared light of full sun, relative to that of the pattern at 1 m (chosen here: in full sun the
            grey wall is lost beyond 2.4 m).
        graze_cos: cosine of incidence at which half the pixels are lost (chosen here: 80°).
        graze_softness: standard deviation of the cosine at which a pixel is lost.
        edge_margin: a pixel at an edge is lost if its standard normal variate exceeds this (chosen here: 31 %
            of the pixels at edges).
        edge_mix: a pixel at an edge mixes near and far depth if its variate is at most this much below
            `edge_margin` (chosen here: 7 % of the pixels at edges).
        hole_px: standard deviation of the blur of the variates, which makes holes coherent blobs.
        any_margin: any pixel is lost if its variate exceeds this (chosen here: 0.1 % of all pixels).
        blind_share: share of the width at the right without depth: 8 of 640 columns, as in 7-Scenes.
    """

    min_range_m: float = 0.4
    max_range_m: float = 4.5
    focal_px: float = 580.0
    baseline_m: float = 0.075
    steps_per_px: float = 8.0
    smooth_share: float = 0.85
    smooth_px: float = 1.9
    same_surface: float = 0.03
    weakest_signal: float = 0.008
    signal_softness: float = 0.5
    sun: float = 20.0
    graze_cos: float = 0.17
    graze_softness: float = 0.03
    edge_margin: float = 0.5
    edge_mix: float = 0.2
    hole_px: float = 4.0
    any_margin: float = 3.0
    blind_share: float = 8 / 640


@dataclass(frozen=True)
class KinectUnit:
    """One individual Kinect and the sunlight on its scene.

    Attributes:
        noise: parameters that all devices share.
        distortion_px: (height, width) float32, error of the device's disparity in pixels.
        sunlight: sunlight on the scene, 0 to 1.
    """

    noise: KinectNoise
    distortion_px: Float32
    sunlight: float


def draw_device(camera: Camera, distortion: float, sunlight: float, rng: np.random.Generator) -> KinectUnit:
    """Draw an individual Kinect, with a random disparity error that varies smoothly over the image.

    Herrera et al. correct disparity pixel by pixel, Teichman et al. find smooth maps whose effect grows with
    distance. Here the disparity error is a sum of cosines with up to two periods over the image and zero
    mean, the same at every distance: a disparity error e shifts depth by e z² / (f b). (In Herrera et al. e
    also decays with disparity; that is left out.) Its size is chosen here: at `distortion` 1, the root mean
    square error is 0.4 % of depth at 4 m: 16 mm there, 2 mm at 1.5 m, as a factory calibration may leave it.

    Args:
        camera: the camera whose depth is distorted.
        distortion: 1 for a typical device, 0 for none.
        sunlight: 0 to 1.
        rng: draws the error map.
    """
    noise = KinectNoise()
    # A smaller image is a reduced Kinect image: blurs cover fewer of its pixels.
    scale = camera.fx / FOCAL_PX
    noise = noise._replace(smooth_px=noise.smooth_px * scale, hole_px=noise.hole_px * scale)
    typical_px = DISTORTION_SHARE * noise.focal_px * noise.baseline_m / DISTORTION_AT_M
    field = smooth_error(camera, distortion * typical_px, rng)
    return KinectUnit(noise, field.astype(np.float32), sunlight)


def smooth_error(camera: Camera, spread: float, rng: np.random.Generator) -> Float64:
    """Draw a random map (height, width), smooth over the image, of mean 0 and root mean square `spread`."""
    waves = np.arange(DISTORTION_WAVES + 1)
    weights = rng.standard_normal((len(waves), len(waves)))
    weights /= 1 + waves[:, None] ** 2 + waves**2
    weights[0, 0] = 0
    down, across = (
        np.cos(np.pi * waves[:, None] * (np.arange(size) + 0.5) / size)
        for size in (camera.height, camera.width)
    )
    field = down.T @ weights @ across
    field *= spread / np.sqrt(np.mean(field**2))
    return np.asarray(field)


def measured_depth(
    rendering: Rendering, camera: Camera, device: KinectUnit, rng: np.random.Generator
) -> Float32:
    """Return a Kinect's depth image of a noise-free rendering: (height, width) metres, 0 = no measurement.

    The steps, in this order, for each pixel:
        1. Lateral noise: near a depth edge, a pixel measures the surface of a random neighbour, so that
           outlines are ragged.
        2. Lost pixels: there is no depth in the projector's shadow, out of range, in the blind columns, at
           grazing incidence, at some edges, and where albedo, incidence, distance and sunlight leave too weak
           a signal. The required signal varies smoothly over the image, so that holes are blobs.
        3. Mixed pixels: some edge pixels average the disparities of the nearest and the farthest surface in
           their 3x3 window.
        4. Distortion, axial noise, and quantised disparity. The published standard deviation was measured on
           real depth, which is quantised. So the variance of quantisation (a step squared over 12) is
           subtracted before noise is drawn, and the result has the published value.

    Args:
        rendering: the noise-free rendering.
        camera: the camera of the rendering.
        device: the Kinect.
        rng: draws all noise of this frame.
    """
    noise = device.noise
    height, width = rendering.depth_m.shape
    white = rng.standard_normal((height, width), dtype=np.float32)
    smooth = smooth_normal((height, width), noise.smooth_px, rng)
    white *= np.float32(np.sqrt(1 - noise.smooth_share))
    axial = white + np.float32(np.sqrt(noise.smooth_share)) * smooth
    # Half the resolution suffices for the fields that decide where an edge or a hole lies.
    half = ((height + 1) // 2, (width + 1) // 2)
    right, down = (smooth_normal(half, noise.smooth_px / 2, rng) for _ in range(2))
    weak = smooth_normal(half, noise.hole_px / 2, rng)
    lit = projector_lit(rendering.depth_m, camera.fx * noise.baseline_m)
    seen_m = rendering.depth_m * lit
    window = np.ones((3, 3), np.uint8)
    near = (cv2.erode(seen_m, window), cv2.dilate(seen_m, window))
    wide = (cv2.erode(near[0], window), cv2.dilate(near[1], window))
    source = displace(seen_m, wide, right, down, rendering.cos_incidence, noise)
    surface = (rendering.cos_incidence, rendering.albedo)
    settings = (noise, device.distortion_px, device.sunlight)
    return np.asarray(sense(seen_m, near, source, surface, settings, (axial, weak)))


def smooth_normal(shape: tuple[int, int], blur_px: float, rng: np.random.Generator) -> Float32:
    """Draw normal variates of standard deviation 1, correlated between pixels by a Gaussian blur: float32."""
    reach = int(np.ceil(3 * blur_px))
    kernel = cv2.getGaussianKernel(2 * reach + 1, blur_px)
    # A weighted sum of independent variates has the weights' norm as its standard deviation.
    kernel /= np.linalg.norm(kernel)
    # The border has variates of its own: mirrored ones would change the standard deviation there.
    field = rng.standard_normal((shape[0] + 2 * reach, shape[1] + 2 * reach), dtype=np.float32)
    return np.asarray(cv2.sepFilter2D(field, -1, kernel, kernel)[reach:-reach, reach:-reach])
