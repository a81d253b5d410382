"""Axes of predicted grids that are swapped or turned round, by what the views measured."""

from collections.abc import Iterable
from itertools import permutations, product

import numpy as np

from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.scoring.counts import Prediction

# The coordinate along each axis of a grid, and whether each coordinate is turned round.
Axes = tuple[tuple[int, ...], tuple[bool, ...]]


def _changes(axes: Axes) -> int:
    order, turned = axes
    return sum(order[axis] != axis for axis in range(3)) + sum(turned)


# The fewest changes first, that is the axes of the pairs.
ALL_AXES: tuple[Axes, ...] = tuple(
    sorted(product(permutations(range(3)), product((False, True), repeat=3)), key=_changes)
)
# So many predictions are looked at, those of one method have the same axes; of fewer nothing is said.
MOST_LOOKED_AT, LEAST_LOOKED_AT = 20, 10
# Measured cells that are looked at, and cells of 256 in front of each: beyond a Kinect's noise, before most
# other parts of an object.
MEASURED, BEFORE = 4000, (6, 9, 12, 15, 18)
# Other axes are named if at least this share of the views fits better with them, the mean fit with the axes
# of the pairs is at most this share of theirs, and theirs is at least so good. Of 11 drawn objects, ten views
# each, true shapes, four baselines, noisy and coarse (16, 32 cells) ones with right axes reach .07 to 1, with
# any other at most .55 of that; shapes moved by 10 or 24 of 256 cells reach .11 with the best of all axes.
LEAST_BETTER, MOST_RATIO, LEAST_FIT = 0.9, 0.75, 0.12
# Axes that fit about as well as the best, of a symmetric object: the simplest are named.
AS_WELL = 0.95


def axes_problem(looked_at: Iterable[tuple[Prediction, Bools]]) -> str | None:
    """A line if a method's grids would fit what the views measured far better with other axes.

    A prediction of a whole object holds the surface that its view measured, and nothing in front of it.

    Args:
        looked_at: a prediction (n, n, n) each, and its view's `partial_256`, bool (256, 256, 256), in the
            same cube; the camera looks along its last axis.
    """
    fits = np.array([_fits(prediction, partial) for prediction, partial in looked_at])
    if len(fits) < LEAST_LOOKED_AT:
        return None
    mean = fits.mean(axis=0)
    best = float(mean.max())
    better = int((fits[:, mean.argmax()] > fits[:, 0]).sum())
    if best < LEAST_FIT or mean[0] > MOST_RATIO * best or better < LEAST_BETTER * len(fits):
        return None
    order, turned = ALL_AXES[int(np.argmax(mean >= AS_WELL * best))]
    names = [f"{'-' * turned[axis]}{'xyz'[axis]}" for axis in order]
    minus = " (-: turned round)" * any(turned)
    return (
        f"the grids agree with their views' own depth if their axes are taken as {', '.join(names)}{minus}, "
        f"in {better} of {len(fits)} views; of arrays write {_remedy(order, turned)}"
    )


def _remedy(order: tuple[int, ...], turned: tuple[bool, ...]) -> str:
    """What brings a grid with these axes into those of the pairs, in numpy's words."""
    swapped = f".transpose({', '.join(map(str, np.argsort(order)))})" if order != (0, 1, 2) else ""
    return f"grid{swapped}" + f"[{', '.join('::-1' if one else ':' for one in turned)}]" * any(turned)


def _fits(prediction: Prediction, partial: Bools) -> Float64:
    """How well a prediction fits a view with each of `ALL_AXES`: (48,), from -1 to 1.

    Its mean in cells that the view measured, less that in the cells in front of them, which are empty, as a
    share of its largest value.
    """
    side, largest = len(partial), float(prediction.max())
    found = np.flatnonzero(partial)
    if not len(found) or largest <= 0:
        return np.zeros(len(ALL_AXES))
    measured: Int64 = np.stack(np.unravel_index(found[:: -(-len(found) // MEASURED)], partial.shape), axis=1)
    before = np.concatenate([measured - (0, 0, cells) for cells in BEFORE])
    before = before[before[:, 2] >= 0]
    before = before[~partial[tuple(before.T)]]
    fits = [
        _mean(prediction, measured, side, axes) - _mean(prediction, before, side, axes) for axes in ALL_AXES
    ]
    return np.array(fits) / largest


def _mean(prediction: Prediction, cells: Int64, side: int, axes: Axes) -> float:
    """Mean of a prediction with some axes in cells (k, 3) of a grid with another side; 0 without cells."""
    order, turned = axes
    there = np.where(turned, side - 1 - cells, cells)[:, list(order)]
    there = (2 * there + 1) * len(prediction) // (2 * side)
    return float(prediction[tuple(there.T)].mean(dtype=np.float64)) if len(cells) else 0.0
