"""What a Kinect v1 makes of exact depth: noise, quantised disparity, drop-outs.

Sources: Nguyen, Izadi, Lovell: Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking,
3DIMPVT 2012 (axial noise); Khoshelham, Elberink: Accuracy and Resolution of Kinect Depth Data, Sensors 12(2),
2012 (disparity in eighths of a pixel). Drop-outs at edges and grazing angles are own rules.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


@dataclass(frozen=True)
class KinectNoise:
    """Parameters of the sensor; the defaults are a Kinect v1.

    Attributes:
        min_range_m: nearer surfaces give no depth, metres.
        max_range_m: farther surfaces give no depth, metres.
        focal_px: focal length of the infrared camera at its own resolution, pixels.
        baseline_m: from projector to camera, metres.
        steps_per_px: disparity steps per pixel.
        edge_jump: relative change of depth in 3x3 pixels that counts as an edge.
        edge_drop: share of edge pixels that give no depth.
        graze_cos: below this cosine of incidence pixels begin to drop out; at half of it all have.
        random_drop: share of all pixels that give no depth.
    """

    min_range_m: float = 0.4
    max_range_m: float = 4.5
    focal_px: float = 580.0
    baseline_m: float = 0.075
    steps_per_px: float = 8.0
    edge_jump: float = 0.04
    edge_drop: float = 0.6
    graze_cos: float = 0.25
    random_drop: float = 0.002


def axial_sigma_m(depth_m: Float, incidence_rad: Float) -> Float:
    """Standard deviation of depth in metres (Nguyen et al. 2012, eq. 3 and 4).

    Args:
        depth_m: depth along z, metres, > 0.
        incidence_rad: angle between ray and surface normal, radians in [0, π/2).
    """
    facing = 0.0012 + 0.0019 * (depth_m - 0.4) ** 2
    graze = 0.0001 / np.sqrt(depth_m) * (incidence_rad / (np.pi / 2 - incidence_rad)) ** 2
    return np.asarray(facing + np.where(incidence_rad > np.pi / 3, graze, 0.0), dtype=np.float64)


def depth_step_m(depth_m: Float, noise: KinectNoise) -> Float:
    """Distance between depths that the sensor can report, metres (Khoshelham & Elberink 2012)."""
    return depth_m**2 / (noise.focal_px * noise.baseline_m * noise.steps_per_px)


def quantise(depth_m: Float, noise: KinectNoise) -> Float:
    """Round depth in metres to the nearest disparity step; depth > 0."""
    scale = noise.focal_px * noise.baseline_m * noise.steps_per_px
    return scale / np.maximum(np.round(scale / depth_m), 1.0)


def kinect_depth(
    depth_m: NDArray[np.float32],
    cos_incidence: NDArray[np.float32],
    noise: KinectNoise,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Exact depth (height, width) in metres to what the sensor reports; 0 = no measurement.

    The published standard deviation was measured on real, that is quantised, depth. So the variance that
    rounding adds (a step squared over 12) is taken off before the noise is drawn, and the sum has the
    published value.

    Args:
        depth_m: exact depth along z, metres, 0 = nothing there.
        cos_incidence: (height, width), cosine between ray and surface normal.
        noise: parameters of the sensor.
        rng: draws noise and drop-outs.
    """
    valid = depth_m > 0
    z = np.where(valid, depth_m, 1.0).astype(np.float64)
    # Beyond 85 degrees nothing is measured; the clip keeps the noise finite there.
    incidence_rad = np.arccos(np.clip(cos_incidence.astype(np.float64), np.cos(np.radians(85)), 1.0))
    variance = axial_sigma_m(z, incidence_rad) ** 2 - depth_step_m(z, noise) ** 2 / 12
    noisy = z + rng.standard_normal(z.shape) * np.sqrt(np.maximum(variance, 0))
    measured = quantise(np.maximum(noisy, 0.1), noise)
    valid &= (z >= noise.min_range_m) & (z <= noise.max_range_m) & (measured <= noise.max_range_m)
    valid &= rng.random(z.shape) >= _drop_share(depth_m, cos_incidence, noise)
    return np.where(valid, measured, 0.0).astype(np.float32)


def _drop_share(
    depth_m: NDArray[np.float32], cos_incidence: NDArray[np.float32], noise: KinectNoise
) -> NDArray[np.float32]:
    """Probability (height, width) that a pixel gives no depth."""
    import cv2

    around = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(depth_m, around) - cv2.erode(depth_m, around) > noise.edge_jump * depth_m
    graze = np.clip(2 - 2 * cos_incidence / noise.graze_cos, 0, 1)
    kept = (1 - noise.random_drop) * (1 - noise.edge_drop * edge) * (1 - graze)
    return np.asarray(1 - kept, dtype=np.float32)
