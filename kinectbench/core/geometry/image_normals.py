"""Normals of a depth image, from differences of neighbouring pixels."""

import numpy as np

from kinectbench.core.types import Float32, Float64


def image_normals(surface: Float64, depth_m: Float32, reach_px: int = 1) -> Float64:
    """Return unit normals towards the camera, from neighbouring pixels; NaN if a neighbour is missing.

    Args:
        surface: (height, width, 3) points, camera axes.
        depth_m: (height, width), 0 without measurement.
        reach_px: distance of the neighbours, pixels.

    Returns:
        (height, width, 3).
    """
    known = np.where((depth_m > 0)[..., None], surface, np.nan)
    across, down = np.full(surface.shape, np.nan), np.full(surface.shape, np.nan)
    across[:, reach_px:-reach_px] = known[:, 2 * reach_px :] - known[:, : -2 * reach_px]
    down[reach_px:-reach_px] = known[2 * reach_px :] - known[: -2 * reach_px]
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, np.nan))
