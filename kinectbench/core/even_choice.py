"""Choose evenly spaced indices."""

import numpy as np

from kinectbench.core.types import Int64


def evenly(count: int, most: int) -> Int64:
    """Return at most `most` of the indices 0 to `count` - 1, evenly spaced from the first to the last.

    Returns:
        (min(most, count),) int64, ascending.
    """
    return np.linspace(0, count - 1, min(most, count)).astype(np.int64)
