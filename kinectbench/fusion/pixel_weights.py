"""What a frame's pixels say and how much: depth and weight of each."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera
from kinectbench.geometry.depth_noise import SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M, SIGMA_NEAR_M

BORDER_PX = 1
SLANT_REACH_PX = 2
MAX_SLANT = 10.0


def padded_shape(camera: Camera) -> tuple[int, int, int]:
    """Of what `pixel_weights` sets: the image with a border of one pixel, depth and weight."""
    return camera.height + 2 * BORDER_PX, camera.width + 2 * BORDER_PX, 2


def pixel_weights(
    depth_m: NDArray[np.float32],
    camera: Camera,
    pose_sigma_m: float,
    farthest_m: float,
    out: NDArray[np.float32],
) -> None:
    """Depth and weight of every pixel.

    The weight is 1 / (sigma / cos)^2 in 1/mm^2, and 0 where nothing was measured. sigma holds the noise of
    the depth and of the pose; what is an error of x along the surface's normal is x / cos along the viewing
    axis. 1 / cos is taken from pixels two to either side and is at most 10: its limit next to a depth edge,
    where pixels mix two surfaces. Beyond `farthest_m` the weight is negative: what lies well in front of it
    is free, and nothing more is said.

    Args:
        depth_m: (height, width) float32, metres along z, 0 = none.
        camera: pinhole intrinsics.
        pose_sigma_m: by how much the frame's pose may be off, metres.
        farthest_m: depth beyond it is not fused as a surface, metres.
        out: (height + 2, width + 2, 2) float32, set but for its border, which is to be 0.
    """
    noise_m = np.array([SIGMA_NEAR_M, SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M, pose_sigma_m], np.float32)
    slope = np.array([camera.fx, camera.fy], np.float32) / np.float32(2 * SLANT_REACH_PX)
    _pixel_weights(out, depth_m, slope, noise_m, np.float32(farthest_m))


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"})
def _pixel_weights(pixels, depth_m, slope, noise, farthest):  # type: ignore[no-untyped-def]
    """Row by row; slices, because indices that may be negative stop the compiler from vectorising."""
    f32 = np.float32
    height, width = depth_m.shape
    near, growth, near_depth, pose = noise[0], noise[1], noise[2], noise[3]
    padded = np.empty(width + 2 * SLANT_REACH_PX, np.float32)
    left, right = padded[: -2 * SLANT_REACH_PX], padded[2 * SLANT_REACH_PX :]
    for v in range(height):
        here = depth_m[v]
        above, below = depth_m[max(v - SLANT_REACH_PX, 0)], depth_m[min(v + SLANT_REACH_PX, height - 1)]
        padded[:SLANT_REACH_PX], padded[-SLANT_REACH_PX:] = here[0], here[-1]
        padded[SLANT_REACH_PX:-SLANT_REACH_PX] = here
        out = pixels[v + BORDER_PX, BORDER_PX:-BORDER_PX].reshape(-1)
        for u in range(width):
            d = here[u]
            inverse = f32(1) / max(d, f32(1e-3))
            across = (right[u] - left[u]) * slope[0] * inverse
            down = (below[u] - above[u]) * slope[1] * inverse
            slant = min(f32(1) + across * across + down * down, f32(MAX_SLANT * MAX_SLANT))
            sigma = near + growth * (d - near_depth) * (d - near_depth)
            weight = f32(1e-6) / ((sigma * sigma + pose * pose) * slant)
            out[2 * u] = d
            out[2 * u + 1] = (weight if d <= farthest else -weight) if d > 0 else f32(0)
