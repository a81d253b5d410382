"""Decode 16-bit depth whose values are no plain distances along the axis."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera
from kinectbench.core.types import DepthCode
from kinectbench.stages.ingest.images import quantised
from kinectbench.stages.ingest.rotated_depth import unrotated

UInt16 = NDArray[np.uint16]


def read_by_code(code: DepthCode, depth: UInt16, camera: Camera) -> UInt16:
    """Depth along the axis, (height, width) uint16, 0 = none; of float16 in steps of 1 / FLOAT_SCALE m.

    Args:
        code: how it is stored.
        depth: as it is stored, 0 = none.
        camera: its intrinsics.
    """
    if code == "rotated":
        return unrotated(depth)
    if code == "float16":
        return quantised(float16_m(depth))
    if code == "ray_distance" and depth.shape == (camera.height, camera.width):
        return np.rint(depth / ray_lengths(camera)).astype(np.uint16)
    return depth


def float16_m(depth: UInt16) -> NDArray[np.float32]:
    """Metres of depth that is the bits of a float16, as CO3D stores it; any shape; 0 = none."""
    metres = depth.view(np.float16).astype(np.float32)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0))


def ray_lengths(camera: Camera) -> NDArray[np.float64]:
    """Ratio of ray length to axial depth at each pixel: (height, width), at least 1."""
    return np.asarray(np.linalg.norm(camera.rays(), axis=-1))
