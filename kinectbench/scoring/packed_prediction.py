"""Store probabilities in 8 bits, as an npz of `levels` and of `codes`, which are indices into the levels.

The values that share a code are all on the same side of each threshold, so packing does not change the IoU at
any threshold. This holds for predictions at 256^3, which are counted without interpolation; coarser
predictions are not packed.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.provenance import STEPS
from kinectbench.core.types import Arrays
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.scoring.counts import CE_CLIP, THRESHOLDS, Prediction

# Arrays of these names mark a packed prediction.
CODES, LEVELS = "codes", "levels"
# Number of values of a byte.
MOST_LEVELS = 256
HALF_ONE = 0x3C00
# First number: levels between neighbouring thresholds. Second: beyond the outermost thresholds, the factor
# between the logits of successive bounds of levels. The demo's 16 views by `recae-small` take 6.3 MB per
# view, instead of 25.9 MB in float16; the cross-entropy changes by 0.05 %, at most by 0.1 %. On six of the
# views, with middles as levels, (4, 1.04) took 1.4 times the space and changed it by at most 0.02 %; (3,
# 1.15) took three quarters of the space and changed it by 0.25 %.
PARTS, GROWTH = 2, 1.08
# Weight of a value that does not occur, so that a level of only such values also lies among them.
UNUSED = 1e-9
OUTERMOST_LOGIT = float(np.log(THRESHOLDS[-1] / (1 - THRESHOLDS[-1])))


def packed(probability: NDArray[np.float16]) -> Arrays | None:
    """Pack a prediction into the arrays of its npz.

    A level is the mean of the values that share its code. With the middle of their range instead, the
    cross-entropy of a network that was trained for two steps, and predicted nearly the same value everywhere,
    changed by 2 %.

    Args:
        probability: (256, 256, 256), values in [0, 1].

    Returns:
        `levels` (m,) float16 ascending, m at most 256, and `codes` (256, 256, 256) uint8: a voxel's value is
        `levels[code]`. None if the prediction cannot be packed: its side is not 256, or a value is not in [0,
        1] (the reader reports such a value).
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
    """Return the values of a packed prediction, (n, n, n), in the dtype of `levels`; codes must be valid."""
    values: Prediction = np.take(levels, codes)
    return values


def _values() -> NDArray[np.float16]:
    """Return all float16 values from 0 to 1, ascending; so the index of a value is its bit pattern."""
    return np.arange(HALF_ONE + 1, dtype=np.uint16).view(np.float16)


@cache
def _codes() -> NDArray[np.uint8]:
    """Return the code of each of `_values`, ascending; each code is that of the previous value, or 1 more."""
    exact = _values().astype(np.float64)
    clipped = np.clip(exact, CE_CLIP, 1 - CE_CLIP)
    logits = np.abs(np.log(clipped / (1 - clipped)))
    above = np.searchsorted(THRESHOLDS, exact)  # number of thresholds below each value
    is_between = (above > 0) & (above < len(THRESHOLDS))
    beyond = np.log(np.maximum(logits / OUTERMOST_LOGIT, 1)) / np.log(GROWTH)
    part = np.where(is_between, np.ceil(exact * STEPS * PARTS), np.floor(beyond))
    keys = np.stack([above, part, exact == 0, exact == 1])  # 0 and 1 have codes of their own
    is_new = np.append(False, (np.diff(keys) != 0).any(axis=0))
    return is_new.cumsum(dtype=np.uint8)
