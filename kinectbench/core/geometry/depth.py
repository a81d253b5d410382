"""Errors of depth cameras: the axial noise of a Kinect v1, and a smooth distortion over the image.

A structured-light sensor errs in disparity by a smooth function of the pixel (Herrera, Kannala and Heikkila,
PAMI 2012; Teichman, Miller and Thrun, RSS 2013). The correction is therefore one of inverse depth.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float32, Float64

Depth = TypeVar("Depth", float, NDArray[np.floating])

# Noise of a Kinect v1 (Nguyen et al. 2012, eq. 3); see `depth_sigma_m`.
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
# Degrees of the Legendre polynomials in column and row. The constant is left out: it would change the scale.
TERMS = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j > 0]


@dataclass(frozen=True)
class DepthCalibration:
    """The correction of depth over the image: `1 / true depth = 1 / depth + correction`.

    Attributes:
        coefficients_per_m: (number of terms,) float64, one for each polynomial in `TERMS`, 1/m.
    """

    coefficients_per_m: Float64

    @property
    def is_none(self) -> bool:
        """Whether the calibration leaves depth unchanged."""
        return not self.coefficients_per_m.any()

    def correction_per_m(self, width: int, height: int) -> Float32:
        """Return the correction to add to 1 / depth at each pixel: (height, width) float32, 1/m."""
        columns, rows = _polynomials(np.arange(width), width), _polynomials(np.arange(height), height)
        of_degrees = np.zeros((DEGREE + 1, DEGREE + 1))
        of_degrees[tuple(np.transpose(TERMS))] = self.coefficients_per_m
        return np.asarray(rows @ of_degrees.T @ columns.T, np.float32)


NO_CALIBRATION = DepthCalibration(np.zeros(len(TERMS)))


def corrected_depth_m(depth_m: Float32, correction_per_m: Float32) -> Float32:
    """Correct depth (height, width) float32 in metres by a correction (height, width) in 1/m; 0 stays 0.

    Depth that the correction would move to infinity or behind the camera becomes 0.
    """
    scale = 1 + depth_m * correction_per_m
    if scale.min(initial=1) > 0:  # without a mask, in a quarter of the time
        return depth_m / scale
    placed: Float32 = np.divide(depth_m, scale, out=np.zeros_like(depth_m), where=scale > 0)
    return placed


# Depth is published in millimetres of 16 bits.
MOST_MM = int(np.iinfo(np.uint16).max)
# In the warning about views with depth beyond that.
TOO_FAR = f"depth beyond {MOST_MM / 1000:g} m"


def depth_in_mm(depth_m: Float32) -> NDArray[np.uint16]:
    """Return depth of any shape in metres as whole millimetres, 0 = no measurement.

    Depth beyond 65.535 m does not fit into 16 bits and becomes 0. Clamping it would create a surface that was
    never measured.
    """
    depth_mm = np.rint(depth_m * 1000)
    return np.where((depth_mm > 0) & (depth_mm <= MOST_MM), depth_mm, 0).astype(np.uint16)


def too_far_for_mm(depth_m: Float32) -> float:
    """Return the share of measured pixels with depth, metres, beyond the range of `depth_in_mm`."""
    measured, too_far = (int(np.count_nonzero(of)) for of in (depth_m > 0, np.rint(depth_m * 1000) > MOST_MM))
    return too_far / max(measured, 1)


def legendre_terms(u: NDArray[np.floating], v: NDArray[np.floating], width: int, height: int) -> Float64:
    """Return Legendre products (m, number of terms) at pixels (m,); the image spans -1 ... 1 on both axes."""
    columns, rows = _polynomials(u, width), _polynomials(v, height)
    return np.stack([columns[:, i] * rows[:, j] for i, j in TERMS], axis=1)


def _polynomials(pixels: NDArray[np.number], size: int) -> Float64:
    """Legendre polynomials of degree 0 to 6 at pixels (m,) of `size` in a row or column: (m, 7)."""
    return np.asarray(np.polynomial.legendre.legvander(2 * (pixels + 0.5) / size - 1, DEGREE))
