"""Numba kernels of the trilinear resampling, one axis at a time. Import late: numba is slow to load."""

import numpy as np
from numba import njit

from kinectbench.core.types import Float64, Int64


@njit(cache=True, error_model="numpy", nogil=True)
def expand_rows(plane: Float64, lower: Int64, upper: Int64, weight: Float64) -> Float64:
    """Interpolate a plane along its last axis.

    Args:
        plane: (n, m) values.
        lower: (side,) the first of the two columns that each new one lies between.
        upper: (side,) the second.
        weight: (side,) of the second, in [0, 1].

    Returns:
        (n, side).
    """
    n, side = plane.shape[0], len(lower)
    rows = np.empty((n, side))
    for i in range(n):
        for j in range(side):
            w = weight[j]
            rows[i, j] = plane[i, lower[j]] * (1.0 - w) + plane[i, upper[j]] * w
    return rows


@njit(cache=True, error_model="numpy", nogil=True)
def plane_between(
    first: Float64, second: Float64, share: float, lower: Int64, upper: Int64, weight: Float64, out: Float64
) -> None:
    """Interpolate between two planes of rows, and then between the rows.

    Args:
        first: (n, side), as `expand_rows` makes them.
        second: likewise, of the next plane.
        share: of the second plane, in [0, 1].
        lower: (side,) of the rows, as for `expand_rows`.
        upper: likewise.
        weight: likewise.
        out: (side, side), receives the result.
    """
    rows = np.empty(first.shape)
    for i in range(len(rows)):
        _blend(first[i], second[i], share, rows[i])
    for i in range(len(out)):
        _blend(rows[lower[i]], rows[upper[i]], weight[i], out[i])


@njit(cache=True, error_model="numpy", nogil=True)
def _blend(first: Float64, second: Float64, weight: float, out: Float64) -> None:
    """`out = first * (1 - weight) + second * weight`, cell by cell."""
    complement = 1.0 - weight
    for i in range(len(out)):
        out[i] = first[i] * complement + second[i] * weight
