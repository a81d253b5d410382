"""Axes of predicted grids that are swapped or turned round, by what the views measured."""

from collections.abc import Iterable
from itertools import permutations, product

import numpy as np

from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.scoring.counts import Prediction

# Order of the axes, and whether each is turned round.
Axes = tuple[tuple[int, int, int], tuple[bool, bool, bool]]
ALL_AXES: tuple[Axes, ...] = tuple(product(permutations(range(3)), product((False, True), repeat=3)))  # type: ignore[arg-type]
# So many predictions are looked at, those of one method have the same axes; of fewer nothing is said.
MOST_LOOKED_AT, LEAST_LOOKED_AT = 20, 10
# With right axes predictions fill at least this share of what they would with any other. Of 40 views true
# shapes and five baselines have 1.0, `silhouette` 0.73; true shapes with two axes swapped 0.16 to 0.27, with
# one turned round 0.3 to 0.55.
LEAST_RATIO = 0.6


def axes_problem(looked_at: Iterable[tuple[Prediction, Bools]]) -> str | None:
    """A line if a method's grids would fit what the views measured far better with other axes.

    A prediction of a whole object holds the surface that its view measured. With right axes it fills these
    cells at least as well as with the axes swapped or turned round.

    Args:
        looked_at: a prediction (n, n, n) each, and its view's partial, bool (m, m, m), in the same cube.
    """
    filled = [_filled(prediction, partial) for prediction, partial in looked_at]
    if len(filled) < LEAST_LOOKED_AT:
        return None
    mean = np.mean(filled, axis=0)
    best = int(np.argmax(mean))
    if mean[0] >= LEAST_RATIO * mean[best]:
        return None
    order, turned = ALL_AXES[best]
    swap = f"transpose({', '.join(map(str, np.argsort(order)))})" if order != (0, 1, 2) else ""
    flips = [f"axis {axis} turned round" for axis in range(3) if turned[axis]]
    return (
        f"the grids fill {mean[0]:.0%} of what the views measured, and {mean[best]:.0%} with "
        f"{' and '.join([*([swap] if swap else []), *flips])}: their axes are not those of the pairs"
    )


def _filled(prediction: Prediction, partial: Bools) -> Float64:
    """Mean prediction in the cells that a view measured, by each of `ALL_AXES`: (48,)."""
    n, m = len(prediction), len(partial)
    cells: Int64 = np.argwhere(partial)
    values = []
    for order, turned in ALL_AXES:
        there = np.where(turned, m - 1 - cells, cells)[:, list(order)]
        there = (2 * there + 1) * n // (2 * m)
        values.append(float(prediction[tuple(there.T)].mean(dtype=np.float64)) if len(cells) else 0.0)
    return np.array(values)
