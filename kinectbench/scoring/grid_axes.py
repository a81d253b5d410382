"""Find swapped or flipped axes of predicted grids, by comparing grids with the cells that views measured.

Grids of 1 - probability, in which empty and occupied are exchanged, are found, too; and grids that lie
elsewhere in the cube, as those of another frame, size or crop.
"""

from collections.abc import Iterable
from itertools import permutations, product

import numpy as np
from scipy import ndimage

from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.scoring.counts import Prediction

# (for each axis of a prediction, which axis of the pair it is; for each axis of the pair, whether it is
# flipped).
Axes = tuple[tuple[int, ...], tuple[bool, ...]]


def _changes(axes: Axes) -> int:
    order, turned = axes
    return sum(order[axis] != axis for axis in range(3)) + sum(turned)


# All axes, ordered by number of changes; the axes of the pairs are the first.
ALL_AXES: tuple[Axes, ...] = tuple(
    sorted(product(permutations(range(3)), product((False, True), repeat=3)), key=_changes)
)
# Maximum and minimum number of predictions that are compared; all predictions of a method have the same axes.
MOST_LOOKED_AT, LEAST_LOOKED_AT = 20, 10
# Number of measured cells that are compared, and distances in cells of 256 to the compared cells in front of
# each: beyond a Kinect's noise, before most other parts of an object.
MEASURED, BEFORE = 4000, (6, 9, 12, 15, 18)
# Other axes are reported if three conditions hold: at least this share of the views fits better with them;
# the mean fit with the pairs' axes is at most this share of the mean fit with the other axes; and the latter
# is at least this large. Measured on 11 drawn objects of ten views each (true shapes, four baselines, noisy
# and coarse grids of 16 and 32 cells): right axes reach .07 to 1, wrong ones at most .55 of that; shapes
# moved by 10 or 24 of 256 cells reach .11 with the best axes.
LEAST_BETTER, MOST_RATIO, LEAST_FIT = 0.9, 0.75, 0.12
# Grids in which empty and occupied are exchanged fit by at most -LEAST_FIT, and fill more than this share of
# the cube. Measured on 32 views of drawn objects: true shapes fill at most .19, baselines (silhouette) .44.
LEAST_EXCHANGED_FILLED = 0.5
# Grids lie elsewhere if they reach less than this share of their usual value in the cell of a grid of
# NEAR_SIDE^3 that holds a measured cell, and in those around it, and do not fit there. Of 16 views of four
# objects, true shapes (also moved by 10 cells), seven baselines and a network reach .95 to 1; in the median,
# shapes half or a quarter as large reach .03 to .10, and a corner that was cut out .06 and less.
LEAST_NEAR, NEAR_SIDE = 0.3, 32
# Axes that reach at least this share of the best fit count as equally good (symmetric objects); the simplest
# of them are named.
AS_WELL = 0.95


def axes_problem(looked_at: Iterable[tuple[Prediction, Bools]]) -> str | None:
    """Return a line if grids fit the measured cells far better with other axes, as 1 - grid, or not at all.

    A prediction of a whole object contains the surface that its view measured, and nothing in front of it.
    With fewer than ten predictions, or if nothing is wrong, the result is None.

    Args:
        looked_at: (prediction (n, n, n), its view's `partial_256`, bool (256, 256, 256)) pairs, both in the
            same cube; the camera looks along the last axis of `partial_256`.
    """
    found = [
        (_fits(grid, partial), float(grid.mean(dtype=np.float64)), _near(grid, partial))
        for grid, partial in looked_at
    ]
    if len(found) < LEAST_LOOKED_AT:
        return None
    fits, filled, near = (np.array(each) for each in zip(*found, strict=True))
    mean = fits.mean(axis=0)
    exchanged = int(((fits[:, 0] < 0) & (filled > LEAST_EXCHANGED_FILLED)).sum())
    if mean[0] <= -LEAST_FIT and exchanged >= LEAST_BETTER * len(fits):
        return (
            "the grids agree with their views' own depth if empty and occupied are exchanged, in "
            f"{exchanged} of {len(fits)} views; of arrays write 1 - grid"
        )
    best = float(mean.max())
    better = int((fits[:, mean.argmax()] > fits[:, 0]).sum())
    if best < LEAST_FIT or mean[0] > MOST_RATIO * best or better < LEAST_BETTER * len(fits):
        elsewhere = int((near < LEAST_NEAR).sum())
        line = (
            f"in {elsewhere} of {len(fits)} views the grids are empty near what the view measured: are they "
            "of another frame or size, or cut out? A grid is the whole cube of its pair"
        )
        return line if elsewhere >= LEAST_BETTER * len(fits) and mean[0] < LEAST_FIT else None
    order, turned = ALL_AXES[int(np.argmax(mean >= AS_WELL * best))]
    names = [f"{'-' * turned[axis]}{'xyz'[axis]}" for axis in order]
    minus = " (-: turned round)" * any(turned)
    return (
        f"the grids agree with their views' own depth if their axes are taken as {', '.join(names)}{minus}, "
        f"in {better} of {len(fits)} views; of arrays write {_remedy(order, turned)}"
    )


def _remedy(order: tuple[int, ...], turned: tuple[bool, ...]) -> str:
    """Return the numpy expression that corrects swapped (`order`) and flipped (`turned`) axes of a grid."""
    swapped = f".transpose({', '.join(map(str, np.argsort(order)))})" if order != (0, 1, 2) else ""
    return f"grid{swapped}" + f"[{', '.join('::-1' if one else ':' for one in turned)}]" * any(turned)


def _fits(prediction: Prediction, partial: Bools) -> Float64:
    """Return how well a prediction fits a view, -1 to 1, for 48 swaps and flips of its axes: (48,).

    The fit is the mean prediction in measured cells, minus that in empty cells in front of them, divided by
    the largest predicted value.
    """
    side, largest = len(partial), float(prediction.max())
    measured = _measured(partial)
    if not len(measured) or largest <= 0:
        return np.zeros(len(ALL_AXES))
    before = np.concatenate([measured - (0, 0, cells) for cells in BEFORE])
    before = before[before[:, 2] >= 0]
    before = before[~partial[tuple(before.T)]]
    fits = [
        _mean(prediction, measured, side, axes) - _mean(prediction, before, side, axes) for axes in ALL_AXES
    ]
    return np.array(fits) / largest


def _near(prediction: Prediction, partial: Bools) -> float:
    """Return the mean of a prediction's largest values near measured cells, by its usual one; 1 if empty.

    The usual value is the mean of all values, weighted by themselves. A few cells that are surer than the
    rest hardly change it.
    """
    blocks, measured = prediction.astype(np.float32, copy=False), _measured(partial)
    total = float(blocks.sum())
    if not len(measured) or total <= 0:
        return 1.0
    usual = float(np.vdot(blocks, blocks)) / total
    starts = np.arange(NEAR_SIDE) * len(blocks) // NEAR_SIDE
    for axis in range(3) if len(blocks) > NEAR_SIDE else ():
        if len(prediction) % NEAR_SIDE:
            blocks = np.maximum.reduceat(blocks, starts, axis=axis)
        else:  # a tenth of the time
            before, after = blocks.shape[:axis], blocks.shape[axis + 1 :]
            blocks = blocks.reshape(*before, NEAR_SIDE, -1, *after).max(axis=axis + 1)
    around = ndimage.maximum_filter(blocks, 3)
    return _mean(around, measured, len(partial), ALL_AXES[0]) / usual


def _measured(partial: Bools) -> Int64:
    """Return the indices (k, 3) of measured cells, evenly spread, at most `MEASURED`."""
    found = np.flatnonzero(partial)
    return np.stack(np.unravel_index(found[:: -(-len(found) // MEASURED) or 1], partial.shape), axis=1)


def _mean(prediction: Prediction, cells: Int64, side: int, axes: Axes) -> float:
    """Return the mean of a prediction over some cells, assuming that its axes are `axes`; 0 if k is 0.

    Args:
        prediction: (n, n, n).
        cells: (k, 3) indices, in the pair's axes, into a grid of the same cube.
        side: number of cells along an edge of that grid.
        axes: for each axis of the prediction, which axis of the pair it is; for each axis of the pair,
            whether it is flipped.
    """
    order, turned = axes
    there = np.where(turned, side - 1 - cells, cells)[:, list(order)]
    there = (2 * there + 1) * len(prediction) // (2 * side)
    return float(prediction[tuple(there.T)].mean(dtype=np.float64)) if len(cells) else 0.0
