"""Numba kernels of the trilinear resampling. Import late: numba is slow to load."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def expand(plane: Float64, lower: Int64, upper: Int64, weight: Float64) -> Float64:
    """Interpolate a plane (n, n) along both axes to (side, side); taps and weights (side,) serve both."""
    n, side = plane.shape[0], len(lower)
    rows = np.empty((n, side))
    for i in range(n):
        for j in range(side):
            w = weight[j]
            rows[i, j] = plane[i, lower[j]] * (1.0 - w) + plane[i, upper[j]] * w
    out = np.empty((side, side))
    for i in range(side):
        blend(rows[lower[i]], rows[upper[i]], weight[i], out[i])
    return out


@njit(cache=True, error_model="numpy")
def blend(first: Float64, second: Float64, weight: float, out: Float64) -> None:
    """`out = first * (1 - weight) + second * weight`, cell by cell; C-contiguous arrays of one shape."""
    a, b, c = first.ravel(), second.ravel(), out.ravel()
    for i in range(len(a)):
        c[i] = a[i] * (1.0 - weight) + b[i] * weight
