"""A depth camera's distortion: a correction of inverse depth that varies smoothly over the image.

A structured-light sensor errs in disparity, by an amount that is a smooth function of the pixel (Herrera,
Kannala and Heikkila, PAMI 2012; Teichman, Miller and Thrun, RSS 2013).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

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

    def correction_per_m(self, width: int, height: int) -> NDArray[np.float32]:
        """(height, width) float32: what is added to 1 / depth at each pixel, 1/m."""
        u, v = np.meshgrid(np.arange(width), np.arange(height))
        terms = legendre_terms(u.ravel().astype(float), v.ravel().astype(float), width, height)
        return np.asarray((terms @ self.coefficients_per_m).reshape(height, width), np.float32)


NO_CALIBRATION = DepthCalibration(np.zeros(len(TERMS)))


def corrected_depth_m(
    depth_m: NDArray[np.float32], correction_per_m: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Depth (height, width) float32 in metres, with a correction (height, width) in 1/m; 0 stays 0."""
    return depth_m / (1 + depth_m * correction_per_m)


def legendre_terms(u: NDArray[np.floating], v: NDArray[np.floating], width: int, height: int) -> Float64:
    """(m, number of terms): products of Legendre polynomials, pixels mapped to -1 ... 1."""
    columns = np.polynomial.legendre.legvander(2 * (u + 0.5) / width - 1, DEGREE)
    rows = np.polynomial.legendre.legvander(2 * (v + 0.5) / height - 1, DEGREE)
    return np.stack([columns[:, i] * rows[:, j] for i, j in TERMS], axis=1)
