"""Figures as health.json holds them: rounded, in the units that people think in, None where not known."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Number = float | np.floating[Any]


def median(values: NDArray[np.float64]) -> float:
    """The median of the values (n,) that are known; NaN if none is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def mm(value_m: Number) -> float | None:
    """Metres as millimetres, to a hundredth; None for NaN."""
    return round(float(value_m) * 1000, 2) if np.isfinite(value_m) else None


def degrees(value_rad: Number) -> float | None:
    """Radians as degrees, to a hundredth; None for NaN."""
    return round(float(np.degrees(value_rad)), 2) if np.isfinite(value_rad) else None


def share(value: Number) -> float | None:
    """A share, a ratio or a rate, to four decimals; None for NaN."""
    return round(float(value), 4) if np.isfinite(value) else None


def seconds(elapsed_ns: int | np.integer[Any]) -> float:
    """Nanoseconds as seconds, to a millisecond."""
    return round(int(elapsed_ns) / 1e9, 3)
