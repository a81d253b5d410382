"""Tests of paired differences: exact sign flips, and Holm's correction for many comparisons."""

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

MAX_EXACT = 40
SAMPLES = 1_000_000
CHUNK = 10_000
SEED = 0
TIE = 1e-12


def sign_flip_p(differences: Float64) -> float:
    """Two-sided p-value of the hypothesis that every difference is symmetric about zero.

    The share of all 2^n assignments of signs whose sum is at least as far from zero as the one observed;
    exact up to 40 differences (the sums of both halves are sorted and counted against each other), beyond
    that of a million assignments drawn with a fixed seed.

    Args:
        differences: (n,) float64, n > 0; weights, if any, multiplied in.

    Source: Fisher, The Design of Experiments (1935), sect. 21.
    """
    scale = float(np.abs(differences).sum())
    if scale == 0:
        return 1.0
    observed = abs(float(differences.sum())) - TIE * scale  # equal sums in another order count as equal
    if len(differences) > MAX_EXACT:
        return _sampled(differences, observed)
    half = len(differences) // 2
    first, second = _sums(differences[:half]), np.sort(_sums(differences[half:]))
    above = len(second) - np.searchsorted(second, observed - first, side="left")
    below = np.searchsorted(second, -observed - first, side="right")
    return float(above.sum() + below.sum()) / 2.0 ** len(differences)


def _sums(differences: Float64) -> Float64:
    """The sums of all assignments of signs: (2^n,)."""
    sums = np.zeros(1)
    for value in differences:
        sums = np.concatenate([sums - value, sums + value])
    return sums


def _sampled(differences: Float64, observed: float) -> float:
    rng = np.random.default_rng(SEED)
    far = 0
    for _ in range(SAMPLES // CHUNK):
        signs = rng.integers(0, 2, size=(CHUNK, len(differences)), dtype=np.int8) * 2 - 1
        far += int((np.abs(signs @ differences) >= observed).sum())
    return (far + 1) / (SAMPLES + 1)


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
