"""Overlap of boolean images and grids."""

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]


def iou(a: Bools, b: Bools) -> float:
    """Intersection over union of two arrays of one shape; 1 if both are empty."""
    union = int(np.count_nonzero(a | b))
    return int(np.count_nonzero(a & b)) / union if union else 1.0


def known_iou(built: Bools, true: Bools, known: Bools) -> float | None:
    """IoU over the known cells; None if none of the true cells is known, since then it says nothing."""
    return iou(built & known, true & known) if bool(np.any(true & known)) else None


def share(part: Bools, of: Bools) -> float:
    """Share of the cells of `of` that lie in `part`, in [0, 1]; 0 if there are none."""
    cells = int(np.count_nonzero(of))
    return int(np.count_nonzero(part & of)) / cells if cells else 0.0
