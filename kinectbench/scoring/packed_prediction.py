"""Probabilities in 8 bits: an npz of `codes`, indices into `levels`; no code's range spans a threshold.

A voxel is above a searched threshold after packing exactly if it was before: IoU at each of them is the same.
That holds where predictions are counted as they are, at 256^3; coarser ones are interpolated, and not packed.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Arrays
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.scoring.counts import CE_CLIP, STEPS, THRESHOLDS, Prediction

# The names of the two arrays say how the file is coded.
CODES, LEVELS = "codes", "levels"
# As many as a byte has.
MOST_LEVELS = 256
HALF_ONE = 0x3C00
# Levels between neighbouring thresholds; and beyond the outermost ones by how much the logits of their bounds
# grow from one to the next. The demo's 16 views by `recae-small`: 6.3 MB a view, of 25.9 MB in float16; its
# cross-entropy changes by 0.05 %, 0.1 % at most. On six of them, with middles as levels, 4 and 1.04 took 1.4
# times as much for 0.02 % at most, 3 and 1.15 three quarters of it for 0.25 %.
PARTS, GROWTH = 2, 1.08
# What a value that does not occur counts, so that a level of such values lies among them, too.
UNUSED = 1e-9
OUTERMOST_LOGIT = float(np.log(THRESHOLDS[-1] / (1 - THRESHOLDS[-1])))


def packed(probability: NDArray[np.float16]) -> Arrays | None:
    """The arrays of a packed prediction's npz.

    A level is the mean of the values that it stands for: their middle changed the cross-entropy of a network
    that had learnt for two steps, and gave nearly one value everywhere, by 2 %.

    Args:
        probability: (256, 256, 256), values in [0, 1].

    Returns:
        `levels` (m,) float16 ascending, m at most 256, and `codes` (256, 256, 256) uint8: a voxel's value is
        `levels[code]`. None where a prediction must be kept as it is: another side, or values that are not
        in [0, 1], which whoever reads them refuses by name.
    """
    bits = probability.view(np.uint16) & 0x7FFF  # -0 is 0
    if probability.shape != (FULL_CELLS,) * 3 or bits.max() > HALF_ONE or probability.min() < 0:
        return None
    codes = _codes()
    # Plane by plane: counting needs eight bytes a voxel.
    counts = sum(np.bincount(plane.ravel(), minlength=len(codes)) for plane in bits)
    weights = np.maximum(counts, UNUSED)
    values = _values().astype(np.float64)
    levels = np.bincount(codes, weights * values) / np.bincount(codes, weights)
    return {LEVELS: levels.astype(np.float16), CODES: codes[bits]}


def unpacked(levels: NDArray[np.generic], codes: NDArray[np.uint8]) -> Prediction:
    """The values of a packed prediction, (n, n, n) of the type of `levels`; every code is one of theirs."""
    values: Prediction = np.take(levels, codes)
    return values


def _values() -> NDArray[np.float16]:
    """All float16 from 0 to 1, ascending: each at the place that its bits say."""
    return np.arange(HALF_ONE + 1, dtype=np.uint16).view(np.float16)


@cache
def _codes() -> NDArray[np.uint8]:
    """The code of each of `_values`: from one to the next it is the same, or one more."""
    exact = _values().astype(np.float64)
    clipped = np.clip(exact, CE_CLIP, 1 - CE_CLIP)
    logits = np.abs(np.log(clipped / (1 - clipped)))
    above = np.searchsorted(THRESHOLDS, exact)  # how many thresholds lie below a value
    is_between = (above > 0) & (above < len(THRESHOLDS))
    beyond = np.log(np.maximum(logits / OUTERMOST_LOGIT, 1)) / np.log(GROWTH)
    part = np.where(is_between, np.ceil(exact * STEPS * PARTS), np.floor(beyond))
    keys = np.stack([above, part, exact == 0, exact == 1])  # 0 and 1 have their own
    is_new = np.append(False, (np.diff(keys) != 0).any(axis=0))
    return is_new.cumsum(dtype=np.uint8)
