"""Scale lengths by the cameras' distance: cells, cuts and gaps shrink in close recordings.

The rules of this stage were chosen on furniture recorded from 1 m and more. A depth camera's pixels shrink
with the distance and its noise with its square (Nguyen et al. 2012), and so do the things that people hold it
over.
"""

import numpy as np

from kinectbench.core.geometry import OrientedBox
from kinectbench.core.types import Float64

# From the first distance on the rules hold as they were chosen. Below the second, the least distance of most
# depth cameras, nothing shrinks further.
REFERENCE_DISTANCE_M = 1.0
NEAREST_DISTANCE_M = 0.3
# Neighbouring vertices lie in cells that touch if these are so many times as wide as the spacing (chosen by
# hand: one suffices on average; the rest is for a surface seen at a slant).
SPACINGS = 1.5


def distance_scale(T_world_camera: Float64, focus_world: Float64) -> float:
    """The factor of all lengths, 0.3 to 1: the cameras' (n, 4, 4) median distance from the focus over 1 m."""
    distance_m = float(np.median(np.linalg.norm(T_world_camera[:, :3, 3] - focus_world, axis=1)))
    return float(np.clip(distance_m, NEAREST_DISTANCE_M, REFERENCE_DISTANCE_M) / REFERENCE_DISTANCE_M)


def cell_scale(scale: float, spacing_m: float, cell_m: float) -> float:
    """`distance_scale`, but at least the surface's resolution.

    Its vertices, `spacing_m` apart, must touch in cells of `cell_m` after these shrink.
    """
    return max(scale, min(1.0, SPACINGS * spacing_m / cell_m))


def enlarged_box(box: OrientedBox, factor: float) -> OrientedBox:
    """A box in a floor frame whose lengths are multiplied."""
    x, y, z = (factor * value for value in box.center_m)
    a, b, c = (factor * value for value in box.size_m)
    return OrientedBox((x, y, z), (a, b, c), box.yaw_rad)


def enlarged_transform(T: Float64, scale: float) -> Float64:
    """A rigid transform, or poses, (..., 4, 4), in a world that is 1 / scale times as large."""
    larger = T.copy()
    larger[..., :3, 3] /= scale
    return larger
