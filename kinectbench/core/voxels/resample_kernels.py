"""Numba kernels of the trilinear resampling, one axis at a time. Import late: numba is slow to load."""

import numpy as np
from numba import njit

from kinectbench.core.types import Float64, Int64


@njit(cache=True, error_model="numpy", nogil=True)
def expand_rows(plane: Float64, lower: Int64, upper: Int64, weight: Float64) -> Float64:
    """Interpolate a plane along its last axis.

    Args:
        plane: (n, m) values.
        lower: (side,) index of the input column at or before each output column.
        upper: (side,) index of the input column after it.
        weight: (side,) weight of the `upper` column, in [0, 1]; that of `lower` is 1 - weight.

    Returns:
        (n, side) values.
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
    """Interpolate between two planes of a cube, and within the resulting plane between its rows.

    Args:
        first: (n, side), a plane that `expand_rows` has made `side` wide.
        second: the next plane, made wide in the same way.
        share: weight of `second`, in [0, 1].
        lower: (side,) index of the input row at or before each output row.
        upper: (side,) index of the input row after it.
        weight: (side,) weight of the `upper` row, in [0, 1].
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
