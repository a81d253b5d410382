"""Baselines that need no thought: nothing, a constant, the input itself."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.baselines.inputs import Inputs

CONSTANT_CELLS = 16
# float16 steps: a rate below the one would lose its digits, above the other would become 1
SMALLEST_RATE, LARGEST_RATE = 2.0**-14, 1 - 2.0**-11


def empty(inputs: Inputs) -> NDArray[np.bool_]:
    """Nothing anywhere: (16, 16, 16) bool."""
    return np.zeros((CONSTANT_CELLS,) * 3, np.bool_)


def constant(inputs: Inputs) -> NDArray[np.float16]:
    """The category's base rate everywhere: (16, 16, 16) float16, to within 0.05 % of it.

    It is held to what float16 can say near 0 and 1.
    """
    return np.full((CONSTANT_CELLS,) * 3, np.clip(inputs.base_rate, SMALLEST_RATE, LARGEST_RATE), np.float16)


def partial(inputs: Inputs) -> NDArray[np.bool_]:
    """The input itself: `partial_256`, (256, 256, 256) bool."""
    return inputs.partial
