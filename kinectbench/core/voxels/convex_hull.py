"""The solid convex hull of some cells of a grid."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools

# Cell centres are integers: one that is off a facet is at least 1 / |integer normal| ~ 5e-6 cells off it.
TOLERANCE_CELLS = 1e-7


def filled_hull(occupied: Bools) -> Bools:
    """Fill the convex hull of the set cells' centres: (n, n, n) bool in and out.

    A cell is set if its centre lies in the hull or on it. Set cells that lie in a plane, or are fewer than
    four, are returned unchanged.
    """
    from scipy.spatial import ConvexHull, QhullError

    ends = _column_ends(occupied)
    try:
        solid, outline = ConvexHull(ends), ConvexHull(ends[:, :2])
    except (QhullError, ValueError):  # flat, or too few cells
        return occupied.copy()
    low, high = _intervals(ends[solid.simplices].astype(np.int64), solid.equations, occupied.shape)
    x, y = (np.arange(n, dtype=np.float64) for n in occupied.shape[:2])
    for a, b, d in outline.equations:  # columns beside the hull
        high[a * x[:, None] + b * y + d > TOLERANCE_CELLS] = -1
    start, stop = ends.min(axis=0).astype(int), ends.max(axis=0).astype(int) + 1
    box = tuple(slice(*span) for span in zip(start, stop, strict=True))
    z = np.arange(start[2], stop[2], dtype=np.int16)
    filled = np.zeros_like(occupied)
    filled[box] = (z >= low[box[:2]][..., None]) & (z <= high[box[:2]][..., None])
    return filled


def _column_ends(occupied: Bools) -> NDArray[np.float64]:
    """Return the first and the last set cell of every column along z, (m, 3); they hold all hull vertices."""
    x, y = np.nonzero(occupied.any(axis=2))
    columns = occupied[x, y]
    first, last = columns.argmax(axis=1), columns.shape[1] - 1 - columns[:, ::-1].argmax(axis=1)
    # In the order of x, y and z, and each cell once.
    ends = np.stack([x, y, first, x, y, last], axis=1).reshape(-1, 2, 3)
    twice = np.stack([np.zeros(len(x), np.bool_), first == last], axis=1)
    return np.asarray(ends[~twice], np.float64)


def _intervals(
    facets: NDArray[np.int64], planes: NDArray[np.float64], shape: tuple[int, ...]
) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Return the first and the last cell along z, (nx, ny) each, between a hull's lower and upper facets.

    They are valid for columns that cross the hull. Such a column meets one upper and one lower facet, which
    are its tightest bounds, so each plane is only applied to the columns in its facet's bounding rectangle.

    Args:
        facets: (f, 3, 3) corners of the triangles, cells.
        planes: (f, 4) their outward unit normals a, b, c and offsets d; inside is a x + b y + c z + d <= 0.
        shape: number of cells of the grid along each axis.
    """
    low, high = np.zeros(shape[:2]), np.full(shape[:2], shape[2] - 1.0)
    starts, stops = facets[..., :2].min(axis=1), facets[..., :2].max(axis=1) + 1
    x, y = np.arange(shape[0])[:, None], np.arange(shape[1])
    for (a, b, c, d), (i0, j0), (i1, j1) in zip(planes, starts.tolist(), stops.tolist(), strict=True):
        if abs(c) <= TOLERANCE_CELLS:
            continue
        bound = (TOLERANCE_CELLS - d - a * x[i0:i1] - b * y[j0:j1]) / c
        if c > 0:
            np.minimum(high[i0:i1, j0:j1], bound, out=high[i0:i1, j0:j1])
        else:
            np.maximum(low[i0:i1, j0:j1], bound, out=low[i0:i1, j0:j1])
    return np.ceil(low).astype(np.int16), np.floor(high).astype(np.int16)
