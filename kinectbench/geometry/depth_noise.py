"""How noisy depth is: the axial standard deviation of a Kinect v1."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Depth = TypeVar("Depth", float, NDArray[np.floating])

SIGMA_NEAR_M = 0.0012
SIGMA_GROWTH_PER_M = 0.0019
SIGMA_NEAR_DEPTH_M = 0.4


def depth_sigma_m(depth_m: Depth) -> Depth:
    """Standard deviation of depth along z, metres, for depth in metres.

    Source: Nguyen, Izadi, Lovell, "Modeling Kinect sensor noise" (3DIMPVT 2012), eq. 3:
    0.0012 + 0.0019 (z - 0.4)^2, fitted for 0.4-3 m.
    """
    return SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (depth_m - SIGMA_NEAR_DEPTH_M) ** 2
