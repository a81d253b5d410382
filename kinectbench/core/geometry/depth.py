"""How depth cameras err: the axial noise of a Kinect v1, and a distortion that varies over the image.

A structured-light sensor errs in disparity, by an amount that is a smooth function of the pixel (Herrera,
Kannala and Heikkila, PAMI 2012; Teichman, Miller and Thrun, RSS 2013): it is a correction of inverse depth.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float32, Float64

Depth = TypeVar("Depth", float, NDArray[np.floating])

# Of a Kinect v1 (Nguyen et al. 2012, eq. 3); see `depth_sigma_m`.
SIGMA_NEAR_M = 0.0012
SIGMA_GROWTH_PER_M = 0.0019
SIGMA_NEAR_DEPTH_M = 0.4


def depth_sigma_m(depth_m: Depth) -> Depth:
    """Standard deviation of depth along z, metres, for depth in metres.

    Source: Nguyen, Izadi, Lovell, "Modeling Kinect sensor noise" (3DIMPVT 2012), eq. 3:
    0.0012 + 0.0019 (z - 0.4)^2, fitted for 0.4-3 m.
    """
    return SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (depth_m - SIGMA_NEAR_DEPTH_M) ** 2


DEGREE = 6
# Degrees of the terms: Legendre polynomials of column and row. A constant would be a matter of scale.
TERMS = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j > 0]


@dataclass(frozen=True)
class DepthCalibration:
    """The correction of depth over the image: `1 / true depth = 1 / depth + correction`.

    Attributes:
        coefficients_per_m: (number of terms,) float64 of the polynomials in `TERMS`, 1/m.
    """

    coefficients_per_m: Float64

    @property
    def is_none(self) -> bool:
        """Whether depth stays as it is."""
        return not self.coefficients_per_m.any()

    def correction_per_m(self, width: int, height: int) -> Float32:
        """(height, width) float32: what is added to 1 / depth at each pixel, 1/m."""
        u, v = np.meshgrid(np.arange(width), np.arange(height))
        terms = legendre_terms(u.ravel().astype(float), v.ravel().astype(float), width, height)
        return np.asarray((terms @ self.coefficients_per_m).reshape(height, width), np.float32)


NO_CALIBRATION = DepthCalibration(np.zeros(len(TERMS)))


def corrected_depth_m(depth_m: Float32, correction_per_m: Float32) -> Float32:
    """Depth (height, width) float32 in metres, with a correction (height, width) in 1/m; 0 stays 0."""
    return depth_m / (1 + depth_m * correction_per_m)


def legendre_terms(u: NDArray[np.floating], v: NDArray[np.floating], width: int, height: int) -> Float64:
    """(m, number of terms): products of Legendre polynomials, pixels mapped to -1 ... 1."""
    columns = np.polynomial.legendre.legvander(2 * (u + 0.5) / width - 1, DEGREE)
    rows = np.polynomial.legendre.legvander(2 * (v + 0.5) / height - 1, DEGREE)
    return np.stack([columns[:, i] * rows[:, j] for i, j in TERMS], axis=1)
