"""How much smaller what is recorded from near may be: cells, cuts and gaps shrink with the cameras' distance.

The rules of this stage were chosen on furniture that is recorded from 1 m and more. A depth camera's pixels
shrink with the distance and its noise with its square (Nguyen et al. 2012), and so do the things that people
hold it over.
"""

import numpy as np

from kinectbench.core.geometry import OrientedBox
from kinectbench.core.types import Float64

# From here on every rule holds as it was chosen; nearer than the other nothing shrinks further: it is the
# least distance of most depth cameras.
USUAL_DISTANCE_M = 1.0
NEAREST_DISTANCE_M = 0.3
# Neighbouring vertices lie in cells that touch if these are so many times as wide (own choice: one would do
# on average; the rest is for a surface that is seen at a slant).
SPACINGS = 1.5


def near_scale(T_world_camera: Float64, focus_world: Float64) -> float:
    """By what lengths are multiplied, 0.3 to 1 (own rule): the median distance from the focus over 1 m.

    Args:
        T_world_camera: (n, 4, 4), n > 0.
        focus_world: (3,) where the cameras look.
    """
    distance_m = float(np.median(np.linalg.norm(T_world_camera[:, :3, 3] - focus_world, axis=1)))
    return float(np.clip(distance_m, NEAREST_DISTANCE_M, USUAL_DISTANCE_M) / USUAL_DISTANCE_M)


def cell_scale(scale: float, spacing_m: float, cell_m: float) -> float:
    """`near_scale`, but no less than the surface resolves: its vertices must touch in the smaller cells.

    Args:
        scale: by the cameras' distance.
        spacing_m: how far apart the surface's vertices are.
        cell_m: edge of the cells that are to shrink.
    """
    return max(scale, min(1.0, SPACINGS * spacing_m / cell_m))


def enlarged_box(box: OrientedBox, factor: float) -> OrientedBox:
    """A box in a floor frame whose lengths are multiplied."""
    x, y, z = (factor * value for value in box.center_m)
    a, b, c = (factor * value for value in box.size_m)
    return OrientedBox((x, y, z), (a, b, c), box.yaw_rad)


def enlarged_transform(T: Float64, scale: float) -> Float64:
    """A rigid transform, or poses, (..., 4, 4), between worlds that are 1 / scale times as large."""
    larger = T.copy()
    larger[..., :3, 3] /= scale
    return larger
