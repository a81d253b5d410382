"""Small motions as twists: a rotation vector (radians) and a translation (metres), stacked."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import closest_rotation, rigid

Float64 = NDArray[np.float64]


def rigid_from_twist(twist: NDArray[np.floating]) -> Float64:
    """(4, 4) from a rotation vector (radians) and a translation (metres), stacked (6,)."""
    import cv2

    return rigid(np.asarray(cv2.Rodrigues(twist[:3])[0]), twist[3:])


def on_so3(T: Float64) -> Float64:
    """T (4, 4) with its rotation on SO(3): products of many drift off it, and ever faster."""
    return rigid(closest_rotation(T[:3, :3]), T[:3, 3])


def twist_from_rigid(T: Float64) -> Float64:
    """The inverse of `rigid_from_twist`: (6,)."""
    import cv2

    return np.concatenate([cv2.Rodrigues(np.ascontiguousarray(T[:3, :3]))[0].ravel(), T[:3, 3]])
