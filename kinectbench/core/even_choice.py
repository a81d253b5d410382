"""Choose evenly spaced indices and items."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from kinectbench.core.types import Int64

T = TypeVar("T")


def evenly(count: int, most: int) -> Int64:
    """Return at most `most` of the indices 0 to `count` - 1, evenly spaced, ascending: (n,) int64."""
    return np.linspace(0, count - 1, min(most, count)).astype(np.int64)


def spread(items: Sequence[T], most: int) -> list[T]:
    """Return at most `most` of the items, evenly spaced from the first to the last."""
    return [items[index] for index in evenly(len(items), most)]
