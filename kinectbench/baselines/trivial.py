"""Baselines that need no thought: nothing, a constant, the input itself."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.voxels.pair_file import Pair, unpack

CONSTANT_CELLS = 16
# float16 steps: a rate below the one would lose its digits, above the other would become 1
SMALLEST_RATE, LARGEST_RATE = 2.0**-14, 1 - 2.0**-11


def empty(pair: Pair, base_rate: float) -> NDArray[np.bool_]:
    """Nothing anywhere: (16, 16, 16) bool. Neither argument matters."""
    return np.zeros((CONSTANT_CELLS,) * 3, np.bool_)


def constant(pair: Pair, base_rate: float) -> NDArray[np.float16]:
    """The category's base rate everywhere: (16, 16, 16) float16, to within 0.05 % of it.

    Args:
        pair: does not matter.
        base_rate: share of occupied voxels, in [0, 1]; held to what float16 can say near 0 and 1.
    """
    return np.full((CONSTANT_CELLS,) * 3, np.clip(base_rate, SMALLEST_RATE, LARGEST_RATE), np.float16)


def partial(pair: Pair, base_rate: float) -> NDArray[np.bool_]:
    """The input itself: `partial_256`, (256, 256, 256) bool. The base rate does not matter."""
    return unpack(pair.partial_256)
