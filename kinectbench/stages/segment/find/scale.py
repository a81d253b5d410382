"""Scale the lengths of this stage with the distance from which an object was recorded.

They were chosen on furniture recorded from 1 m and more. At a shorter distance, a depth camera's pixels
shrink in proportion, its noise shrinks with the square (Nguyen et al. 2012), and people record smaller
objects: cells, cuts and gaps shrink with `distance_scale`.
"""

import numpy as np

from kinectbench.core.geometry import OrientedBox
from kinectbench.core.types import Float64

# From the first distance on the rules hold as they were chosen. Below the second, the smallest distance of
# most depth cameras, nothing shrinks further.
REFERENCE_DISTANCE_M = 1.0
NEAREST_DISTANCE_M = 0.3
# Neighbouring vertices lie in cells that touch if these are this many times as wide as the spacing (chosen by
# hand: one suffices on average; the rest is for a surface seen at a slant).
SPACINGS = 1.5


def distance_scale(T_world_camera: Float64, focus_world: Float64) -> float:
    """Return the factor of all lengths for cameras (n, 4, 4) that look at a focus (3,).

    It is the median distance of the cameras from the focus in metres, clipped to 0.3 to 1.
    """
    distance_m = float(np.median(np.linalg.norm(T_world_camera[:, :3, 3] - focus_world, axis=1)))
    return float(np.clip(distance_m, NEAREST_DISTANCE_M, REFERENCE_DISTANCE_M) / REFERENCE_DISTANCE_M)


def cell_scale(scale: float, spacing_m: float, cell_m: float) -> float:
    """Return the smallest scale >= `scale` at which neighbouring vertices of a surface lie in touching cells.

    The vertices are `spacing_m` apart. The edge of a cell is `cell_m` times the result.
    """
    return max(scale, min(1.0, SPACINGS * spacing_m / cell_m))


def enlarged_box(box: OrientedBox, factor: float) -> OrientedBox:
    """Scale a box about the origin: multiply its centre and its size by `factor`, and drop its anchor."""
    x, y, z = (factor * value for value in box.center_m)
    a, b, c = (factor * value for value in box.size_m)
    return OrientedBox((x, y, z), (a, b, c), box.yaw_rad)


def enlarged_transform(T: Float64, scale: float) -> Float64:
    """Divide the translations of rigid transforms (..., 4, 4) by `scale`, for use in an enlarged world."""
    larger = T.copy()
    larger[..., :3, 3] /= scale
    return larger
