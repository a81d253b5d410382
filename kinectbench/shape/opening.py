"""Morphology on large grids."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]


def opened(mask: Bools, size: Sequence[int]) -> Bools:
    """Binary opening by a box: what some box of set cells covers.

    As `scipy.ndimage.binary_opening` with a structure of ones, several times as fast: a box is a run along
    each axis, and a long run is two shorter ones.

    Args:
        mask: bool; what lies outside of it is not set.
        size: cells of the box along each axis, at least 1.
    """
    if any(length > n for length, n in zip(size, mask.shape, strict=True)):
        return np.zeros_like(mask)
    fits = mask
    for axis, length in enumerate(size):
        fits = _runs(fits, axis, length)
    # The last cell of a box that begins at one place is the first of one that begins length - 1 before it.
    apart = ~np.pad(fits, [(length - 1, length - 1) for length in size])
    for axis, length in enumerate(size):
        apart = _runs(apart, axis, length)
    return ~apart


def _runs(mask: Bools, axis: int, length: int) -> Bools:
    """Where a run of so many set cells along an axis begins."""
    runs, done = np.moveaxis(mask, axis, 0), 1
    while done < length:
        step = min(done, length - done)
        runs = runs[:-step] & runs[step:]
        done += step
    return np.moveaxis(runs, 0, axis)
