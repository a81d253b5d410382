"""The median of the values that are known."""

from collections.abc import Iterable
from statistics import median


def known_median(values: Iterable[float | None]) -> float | None:
    """Return the median of the values that are not None; None if there are none."""
    known = [value for value in values if value is not None]
    return median(known) if known else None
