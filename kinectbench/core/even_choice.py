"""Some of many, evenly spread."""

import numpy as np

from kinectbench.core.types import Int64


def evenly(count: int, most: int) -> Int64:
    """At most so many of the indices 0 to `count` - 1, evenly spread: the first, the last, and some between.

    Returns:
        (min(most, count),) int64, ascending.
    """
    return np.linspace(0, count - 1, min(most, count)).astype(np.int64)
