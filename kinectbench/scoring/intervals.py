"""Confidence intervals over objects: views of one object are not independent, objects are.

A mean is that of the objects' means, or, under the protocol `paper`, that of all pairs: then an object weighs
as much as it has pairs.
"""

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

LEVEL = 0.95
MIN_OBJECTS = 3
RESAMPLES = 10_000
SEED = 0
CHUNK = 1000


def student_interval(values: Float64, weights: Float64) -> Float64 | None:
    """Student's t interval of a weighted mean over the objects of one category.

    With weights w, mean m = sum w x / sum w and k objects its variance is
    k / (k - 1) * sum (w (x - m))^2 / (sum w)^2: that of a ratio (Cochran, Sampling Techniques, 1977,
    eq. 6.13), with equal weights the usual s^2 / k. Degrees of freedom: k - 1.

    Args:
        values: (k, m) float64, a row per object, a column per metric.
        weights: (k,) positive.

    Returns:
        (m, 2) lower and upper end; None with fewer than three objects.
    """
    from scipy.special import stdtrit

    count = len(values)
    if count < MIN_OBJECTS:
        return None
    mean = weights @ values / weights.sum()
    residuals = weights[:, None] * (values - mean)
    deviation = np.sqrt(count / (count - 1) * (residuals**2).sum(axis=0)) / weights.sum()
    half = float(stdtrit(count - 1, (1 + LEVEL) / 2)) * deviation
    return np.stack([mean - half, mean + half], axis=1)


def bootstrap_interval(groups: list[tuple[Float64, Float64]]) -> Float64 | None:
    """Percentile bootstrap interval of the mean over categories, resampling objects within each category.

    Args:
        groups: of each category `values` (k, m) and `weights` (k,) as in `student_interval`.

    Returns:
        (m, 2) lower and upper end; None if a category has fewer than three objects, since resampling one or
        two says nothing of how objects differ. The same for the same values: the seed is fixed.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), ch. 13; strata are an own rule.
    """
    if min(len(values) for values, _ in groups) < MIN_OBJECTS:
        return None
    rng = np.random.default_rng(SEED)
    means = np.zeros((RESAMPLES, groups[0][0].shape[1]))
    for values, weights in groups:
        for start in range(0, RESAMPLES, CHUNK):  # memory stays small
            drawn = rng.integers(len(values), size=(CHUNK, len(values)))
            drawn_weights = weights[drawn]
            sums = np.einsum("bk,bkm->bm", drawn_weights, values[drawn])
            means[start : start + CHUNK] += sums / drawn_weights.sum(axis=1, keepdims=True) / len(groups)
    tail = (1 - LEVEL) / 2
    return np.quantile(means, [tail, 1 - tail], axis=0).T
