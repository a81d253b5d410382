"""Whether the frames of a recording follow each other, or are views in no order of time."""

import numpy as np

from kinectbench.core.geometry import rotation_angle_rad
from kinectbench.core.types import Float64

# From one frame to the next the view changes by less than this share of what it does between frames far
# apart. Own choice: walks have .01 to .15 of it, even with a view every 15 degrees; views in no order 1.
STEP_SHARE = 0.5
# Views this near each other (1 m apart counts as much as 1 rad turned) follow each other in any case: a
# camera that stands still has steps as large as its whole way. Own choice.
NEAR = 0.1
# Fewer steps have no median to rely on (own choice).
FEWEST = 6


def in_order_of_time(T_world_camera: Float64) -> bool:
    """Whether frames show what the frame before them shows, as those of a film do (own rule).

    Renderings and sets of views often have exact poses, but no such order: what one frame shows says nothing
    of the next. Fewer than 6 poses are taken for a film.

    Args:
        T_world_camera: (n, 4, 4), NaN where a frame has no pose.
    """
    T = T_world_camera[np.isfinite(T_world_camera[:, 0, 0])]
    if len(T) < FEWEST:
        return True
    step = float(np.median(views_apart(T[:-1], T[1:])))
    far = np.concatenate([views_apart(T, np.roll(T, len(T) // k, axis=0)) for k in (2, 3, 5)])
    return step < max(NEAR, STEP_SHARE * float(np.median(far)))


def views_apart(T_a: Float64, T_b: Float64) -> Float64:
    """(n,) how far apart views (n, 4, 4) are: metres between the cameras, and radians of the turn, added."""
    apart_m = np.linalg.norm(T_a[:, :3, 3] - T_b[:, :3, 3], axis=1)
    turn_rad = rotation_angle_rad(np.swapaxes(T_a[:, :3, :3], 1, 2) @ T_b[:, :3, :3])
    return np.asarray(apart_m + turn_rad)
