"""Statistics for few objects: confidence intervals of means, tests of differences, Holm's correction.

Objects are independent, but views of one object are not. A mean is the mean over the objects of each object's
mean. Under the protocol `paper`, it is the mean of all pairs; then an object's weight is its number of pairs.

Groups of methods that cannot be distinguished are shown as letters, a compact letter display. Of three
methods, the first and the last may differ significantly while the middle one differs from neither. Ranks
cannot express that, but letters can: two methods share a letter if, and only if, they do not differ
significantly.

Source: Piepho, An algorithm for a letter-based representation of all-pairwise comparisons, J. Comput. Graph.
Stat. 13 (2004); here the groups are all maximal cliques, so the display is correct by construction.
"""

from collections.abc import Collection, Iterator, Sequence
from itertools import islice
from string import ascii_lowercase

import numpy as np

from kinectbench.core.types import Float64

LEVEL = 0.95
MIN_OBJECTS = 3
RESAMPLES = 10_000
SEED = 0
RESAMPLES_AT_ONCE = 1000
# Number of values drawn at a time: 32 MB; more would not be faster.
DRAWN_AT_ONCE = 1 << 22
# Maximum number of objects that are resampled; 2000 with twelve metrics take 1.5 s (measured).
MOST_RESAMPLED = 2000


def student_interval(values: Float64, weights: Float64) -> Float64 | None:
    """Return Student's t interval of a weighted mean over the objects of one category.

    With weights w, mean m = sum w x / sum w and k objects, the variance of the mean is k / (k - 1) * sum (w
    (x - m))^2 / (sum w)^2. This is the variance of a ratio (Cochran, Sampling Techniques, 1977, eq. 6.13);
    with equal weights it is the usual s^2 / k. There are k - 1 degrees of freedom.

    Args:
        values: (k, m) float64, a row per object, a column per metric.
        weights: (k,) positive.

    Returns:
        (m, 2) lower and upper end; None with fewer than three objects.
    """
    from scipy.special import stdtrit

    if len(values) < MIN_OBJECTS:
        return None
    mean, deviation = _mean_and_deviation(values, weights)
    half = float(stdtrit(len(values) - 1, (1 + LEVEL) / 2)) * deviation
    return np.stack([mean - half, mean + half], axis=1)


def _mean_and_deviation(values: Float64, weights: Float64) -> tuple[Float64, Float64]:
    """Return the weighted mean of each column and this mean's standard deviation (`student_interval`)."""
    count = len(values)
    mean = weights @ values / weights.sum()
    residuals = weights[:, None] * (values - mean)
    return mean, np.sqrt(count / (count - 1) * (residuals**2).sum(axis=0)) / weights.sum()


def bootstrap_interval(groups: list[tuple[Float64, Float64]]) -> Float64 | None:
    """Return the percentile bootstrap interval of the mean over categories, resampling objects in each.

    Args:
        groups: (`values` (k, m), `weights` (k,)) for each category, as in `student_interval`.

    Returns:
        (m, 2) lower and upper end; None if a category has fewer than three objects, since resampling one or
        two says little about how objects differ. The seed is fixed, so equal values give equal intervals.

    If there are more than 2000 objects in all, only categories with at most 2000 / (number of categories)
    objects are resampled. The means of larger categories are drawn from a normal distribution, which suits so
    many objects.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), ch. 13; strata are added here.
    """
    counts = [len(values) for values, _ in groups]
    if min(counts) < MIN_OBJECTS:
        return None
    most = MOST_RESAMPLED if sum(counts) <= MOST_RESAMPLED else MOST_RESAMPLED // len(groups)
    rng = np.random.default_rng(SEED)
    metrics = groups[0][0].shape[1]
    means = np.zeros((RESAMPLES, metrics))
    shift, variance = np.zeros(metrics), np.zeros(metrics)
    for values, weights in groups:
        if len(values) > most:
            mean, deviation = _mean_and_deviation(values, weights)
            shift += mean / len(groups)
            # The variance of resampled means is too small by (k - 1) / k; the normal distribution gets the
            # same factor.
            variance += (deviation / len(groups)) ** 2 * (len(values) - 1) / len(values)
        else:
            _add_resampled(means, rng, values, weights, len(groups))
    if max(counts) > most:
        means += shift + np.sqrt(variance) * rng.standard_normal(means.shape)
    tail = (1 - LEVEL) / 2
    return np.quantile(means, [tail, 1 - tail], axis=0).T


def _add_resampled(
    means: Float64, rng: np.random.Generator, values: Float64, weights: Float64, groups: int
) -> None:
    """Add resampled means of a category, divided by the number of `groups`, to `means` (resamples, m)."""
    rows = min(RESAMPLES_AT_ONCE, max(1, DRAWN_AT_ONCE // values.size))
    for start in range(0, RESAMPLES, rows):
        batch = means[start : start + rows]
        drawn = rng.integers(len(values), size=(len(batch), len(values)))
        drawn_weights = weights[drawn]
        sums = np.einsum("bk,bkm->bm", drawn_weights, values[drawn])
        batch += sums / drawn_weights.sum(axis=1, keepdims=True) / groups


MAX_EXACT = 30
SAMPLES, LEAST_SAMPLES = 1_000_000, 10_000
# Maximum number of signs drawn in all: a million assignments for 500 objects, which take 1.5 s (measured).
MOST_SIGNS = 500_000_000
# Maximum numbers of assignments and of signs drawn at a time: 128 MB.
ROWS_AT_ONCE, SIGNS_AT_ONCE = 8_000, 16_000_000
# Sums that differ by less, relative to the sum of absolute differences, are equal.
EQUAL = 1e-12


def sign_flip_ps(differences: Float64) -> list[float]:
    """Return two-sided p-values of sign-flip tests, one per row.

    The null hypothesis is that a row's differences are symmetric about zero. The p-value is the share, of all
    2^n assignments of signs, of those whose sum is at least as far from zero as the observed sum. Up to 30
    differences it is exact: the sums of each half are sorted, and counted against those of the other half.
    Beyond 30, `samples` assignments are drawn with a fixed seed, the same for every row.

    Args:
        differences: (m, n) float64, n > 0, for m tests; if there are weights, already multiplied by them.

    Source: Fisher, The Design of Experiments (1935), sect. 21.
    """
    scales = np.abs(differences).sum(axis=1)
    # Equal sums in another order count as equal.
    observed = np.abs(differences.sum(axis=1)) - EQUAL * scales
    if differences.shape[1] > MAX_EXACT:
        p_values = _sampled(differences, observed)
    else:
        p_values = [_exact(*test) for test in zip(differences, observed, strict=True)]
    return [p if scale > 0 else 1.0 for p, scale in zip(p_values, scales.tolist(), strict=True)]


def _exact(differences: Float64, observed: float) -> float:
    """Return the share of sign assignments whose sum is not strictly between -observed and observed.

    The sums in between are counted, and subtracted from all. So no sum counts in both tails, even if
    `observed` is tiny.
    """
    half = len(differences) // 2
    first, second = _sums(differences[:half]), _sums(differences[half:])
    up_to = np.searchsorted(second, observed - first, side="left")
    between = up_to - np.searchsorted(second, -observed - first, side="right")
    return 1.0 - float(np.maximum(between, 0).sum()) / 2.0 ** len(differences)


def _sums(differences: Float64) -> Float64:
    """Return the sums of all assignments of signs, ascending: (2^n,)."""
    sums = np.zeros(1)
    for value in differences:
        sums = np.concatenate([sums - value, sums + value])
        sums.sort(kind="stable")  # merges both sorted halves
    return sums


def _sampled(differences: Float64, observed: Float64) -> list[float]:
    """Return p-values estimated with random signs; one matrix product serves all tests."""
    rng = np.random.default_rng(SEED)
    count = differences.shape[1]
    # sum(s x) with signs s in {-1, 1} is 2 sum((s + 1) / 2 x) - sum(x).
    doubled, total = 2 * differences.T, differences.sum(axis=1)
    far = np.zeros(len(differences), np.int64)
    most = min(ROWS_AT_ONCE, max(1, SIGNS_AT_ONCE // count))
    for start in range(0, samples(count), most):
        rows = min(most, samples(count) - start)
        drawn = np.frombuffer(rng.bytes(rows * -(-count // 8)), np.uint8).reshape(rows, -1)
        plus = np.unpackbits(drawn, axis=1, count=count).astype(np.float64)
        far += np.count_nonzero(np.abs(plus @ doubled - total) >= observed, axis=0)
    return [float(p) for p in (far + 1) / (samples(count) + 1)]


def samples(count: int) -> int:
    """Return the number of sign assignments to draw for `count` differences: a million, fewer beyond 500."""
    return max(LEAST_SAMPLES, min(SAMPLES, MOST_SIGNS // count))


def smallest_p(count: int) -> float:
    """Return the smallest p-value that the test of n = `count` differences can give: 2^(1 - n).

    Beyond 30 differences, where signs are drawn, it is 1 / (`samples` + 1).
    """
    return min(1.0, 2.0 ** (1 - count)) if count <= MAX_EXACT else 1 / (samples(count) + 1)


def holm(p_values: list[float]) -> list[float]:
    """Return p-values corrected by Holm's method (Scand. J. Statist. 6, 1979), in the same order."""
    rising = np.argsort(p_values, kind="stable")
    corrected = np.minimum(1.0, np.arange(len(p_values), 0, -1) * np.array(p_values)[rising])
    adjusted = np.empty(len(p_values))
    adjusted[rising] = np.maximum.accumulate(corrected)
    return [float(p) for p in adjusted]


# With more groups, letters say less than the list of differences; n methods can have 3^(n / 3) groups (J. W.
# Moon, L. Moser, On cliques in graphs, 1965).
MOST_GROUPS = 2 * len(ascii_lowercase)


def significance_letters(names: Sequence[str], apart: Collection[frozenset[str]]) -> dict[str, str]:
    """Return the letters of each method; the best method has an `a`.

    `names` has the best first; `apart` are pairs of methods that differ significantly.

    Returns:
        {name: its letters, such as "ab"}; two methods share a letter if, and only if, the pair is not in
        `apart`. If this takes more than `MOST_GROUPS` letters, all are "".
    """
    place = {name: index for index, name in enumerate(names)}
    indistinct = {
        name: {other for other in names if other != name and frozenset((name, other)) not in apart}
        for name in names
    }
    cliques = list(islice(_maximal_cliques(indistinct), MOST_GROUPS + 1))
    by_name = dict.fromkeys(names, "")
    if len(cliques) > MOST_GROUPS:
        return by_name
    groups = sorted(sorted(place[name] for name in group) for group in cliques)
    for index, group in enumerate(groups):
        for member in group:
            by_name[names[member]] += _letter(index)
    return by_name


def _maximal_cliques(neighbours: dict[str, set[str]]) -> Iterator[set[str]]:
    """Yield all maximal cliques: sets of pairwise neighbours to which no node can be added.

    Source: Bron and Kerbosch, Commun. ACM 16 (1973), with Tomita's choice of the pivot.
    """
    waiting: list[tuple[set[str], set[str], set[str]]] = [(set(), set(neighbours), set())]
    while waiting:
        clique, candidates, done = waiting.pop()
        if not candidates and not done:
            yield clique
            continue
        pivot = max(candidates | done, key=lambda node: len(neighbours[node] & candidates))
        for node in sorted(candidates - neighbours[pivot]):
            waiting.append((clique | {node}, candidates & neighbours[node], done & neighbours[node]))
            candidates, done = candidates - {node}, done | {node}


def _letter(index: int) -> str:
    """Return a, b, … z, then (27), (28), …; the brackets separate the letters of a method."""
    return ascii_lowercase[index] if index < len(ascii_lowercase) else f"({index + 1})"
