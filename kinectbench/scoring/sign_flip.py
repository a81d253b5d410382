"""Tests of paired differences: exact sign flips, and Holm's correction for many comparisons."""

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

MAX_EXACT = 30
SAMPLES = 1_000_000
CHUNK = 8_000
SEED = 0
TIE = 1e-12


def sign_flip_ps(differences: Float64) -> list[float]:
    """Two-sided p-values of the hypotheses that every difference of a row is symmetric about zero.

    The share of all 2^n assignments of signs whose sum is at least as far from zero as the one observed;
    exact up to 30 differences (the sums of both halves are sorted and counted against each other), beyond
    that of a million assignments drawn with a fixed seed, the same for every row.

    Args:
        differences: (m, n) float64, n > 0: m tests; weights, if any, multiplied in.

    Source: Fisher, The Design of Experiments (1935), sect. 21.
    """
    scales = np.abs(differences).sum(axis=1)
    # equal sums in another order count as equal
    observed = np.abs(differences.sum(axis=1)) - TIE * scales
    if differences.shape[1] > MAX_EXACT:
        found = _sampled(differences, observed)
    else:
        found = [_exact(*test) for test in zip(differences, observed, strict=True)]
    return [p if scale > 0 else 1.0 for p, scale in zip(found, scales.tolist(), strict=True)]


def _exact(differences: Float64, observed: float) -> float:
    half = len(differences) // 2
    first, second = _sums(differences[:half]), _sums(differences[half:])
    above = len(second) - np.searchsorted(second, observed - first, side="left")
    below = np.searchsorted(second, -observed - first, side="right")
    return float(above.sum() + below.sum()) / 2.0 ** len(differences)


def _sums(differences: Float64) -> Float64:
    """The sums of all assignments of signs, rising: (2^n,)."""
    sums = np.zeros(1)
    for value in differences:
        sums = np.concatenate([sums - value, sums + value])
        sums.sort(kind="stable")  # merges the two
    return sums


def _sampled(differences: Float64, observed: Float64) -> list[float]:
    """P-values by drawn signs: each draw serves every test, by one product of matrices."""
    rng = np.random.default_rng(SEED)
    count = differences.shape[1]
    # A sum with signs s in {-1, 1} is twice that with (s + 1) / 2, less the sum of all.
    doubled, total = 2 * differences.T, differences.sum(axis=1)
    far = np.zeros(len(differences), np.int64)
    for _ in range(SAMPLES // CHUNK):
        drawn = np.frombuffer(rng.bytes(CHUNK * -(-count // 8)), np.uint8).reshape(CHUNK, -1)
        plus = np.unpackbits(drawn, axis=1, count=count).astype(np.float64)
        far += np.count_nonzero(np.abs(plus @ doubled - total) >= observed, axis=0)
    return [float(p) for p in (far + 1) / (SAMPLES + 1)]


def smallest_p(count: int) -> float:
    """The smallest p-value that `count` differences can give: all of one sign, 2^(1 - n)."""
    return min(1.0, 2.0 ** (1 - count))


def holm(p_values: list[float]) -> list[float]:
    """P-values corrected for their number (Holm, Scand. J. Statist. 6, 1979), in the same order."""
    adjusted = [0.0] * len(p_values)
    running = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        running = max(running, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = running
    return adjusted
