"""Whether the frames of a recording are consecutive, or are views in no order of time."""

import numpy as np

from kinectbench.core.geometry import rotation_angle_rad
from kinectbench.core.types import Float64

# Between consecutive frames the view changes by less than this ratio of the change between distant frames.
# Measured: 0.01 to 0.15 for walks, even with a view every 15 degrees; 1 for views in no order.
STEP_SHARE = 0.5
# Views closer than this (1 m of distance counts as 1 rad of rotation) always count as consecutive: the steps
# of a still camera are as large as its whole path. Chosen by hand.
NEAR = 0.1
# Fewer poses have no reliable median step.
FEWEST = 6


def in_order_of_time(T_world_camera: Float64) -> bool:
    """Whether consecutive frames show similar views, as in a video.

    Renderings and sets of views often have exact poses, but no order: a frame does not predict the next one.
        Fewer than 6 poses count as a video.

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
    """(n,) distance of views (n, 4, 4): metres between the cameras plus radians of rotation."""
    apart_m = np.linalg.norm(T_a[:, :3, 3] - T_b[:, :3, 3], axis=1)
    turn_rad = rotation_angle_rad(np.swapaxes(T_a[:, :3, :3], 1, 2) @ T_b[:, :3, :3])
    return np.asarray(apart_m + turn_rad)
