"""What the partial bounds: its convex hull, and its silhouette extruded away from the camera."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools
from kinectbench.scoring.baselines.inputs import Inputs

# Cell centres are integers: one that is off a facet is at least 1 / |integer normal| ~ 5e-6 cells off it.
TOLERANCE_CELLS = 1e-7


def hull(inputs: Inputs) -> Bools:
    """The solid convex hull of `partial_256`: (256, 256, 256) bool.

    A cell is set if its centre lies in the hull of the set cells' centres or on it. Where the partial is
    flat, or is fewer than four cells, it is its own hull.

    Source: own rule.
    """
    return filled_hull(inputs.partial)


def filled_hull(occupied: Bools) -> Bools:
    """Fill the convex hull of the set cells' centres; see `hull`. (n, n, n) bool in and out."""
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
    """First and last set cell of every column along z, (m, 3): they hold every vertex of the hull."""
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
    """First and last cell along z between the lower and the upper facets, for columns that cross the hull.

    A column meets one upper and one lower facet, which are the tightest bounds on it: each plane is only
    applied to the columns in its facet's own rectangle.

    Args:
        facets: (f, 3, 3) corners of the triangles, cells.
        planes: (f, 4) their outward unit normals a, b, c and offsets d; inside is a x + b y + c z + d <= 0.
        shape: of the grid.
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


PIXELS = 512


def silhouette(inputs: Inputs) -> Bools:
    """Every cell whose ray from the camera met the partial before: (256, 256, 256) bool.

    Rays go from the camera's centre through cell centres, on to the grid's far side. They are looked up in an
    image of 512 x 512 rays over the grid's far side. Own rule.
    """
    pair = inputs.pair
    centre = np.linalg.inv(pair.T_world_grid) @ pair.T_world_camera[:, 3]
    return extruded(inputs.partial, centre[:3] / pair.voxel_size_m - 0.5)


def extruded(partial: Bools, camera_cells: NDArray[np.float64]) -> Bools:
    """Extrude along the rays from a camera at cell coordinates (3,); along z if it is not before the grid."""
    from kinectbench.scoring.baselines.kernels import sweep_plane, transposed

    count = len(partial)
    far = np.linspace(-0.5, count - 0.5, PIXELS)
    cells = np.arange(count)
    hit = np.zeros((PIXELS, PIXELS), np.bool_)
    # Plane by plane.
    filled = transposed(partial.view(np.uint8).reshape(-1, count)).reshape(partial.shape).view(np.bool_)
    for k, plane in enumerate(filled):
        # where the rays that end at `far` on the last plane cross this plane
        share = 1.0 if camera_cells[2] >= 0 else (k - camera_cells[2]) / (count - 1 - camera_cells[2])
        crossings = [camera_cells[axis] * (1 - share) + far * share for axis in (0, 1)]
        crossed = [np.clip(np.rint(at).astype(np.int64), 0, count - 1) for at in crossings]
        inside = [np.abs(found - at) <= 0.5 for found, at in zip(crossed, crossings, strict=True)]
        # and which of these rays passes next to each cell's centre
        passing = [
            np.rint((((cells - camera_cells[a] * (1 - share)) / share) + 0.5) / count * (PIXELS - 1))
            for a in (0, 1)
        ]
        rays = [np.clip(found, 0, PIXELS - 1).astype(np.int64) for found in passing]
        within = [found == ray for found, ray in zip(passing, rays, strict=True)]
        sweep_plane(hit, plane, *crossed, *inside, *rays, *within)
    turned = transposed(filled.view(np.uint8).reshape(count, -1))
    return np.asarray(turned.reshape(partial.shape).view(np.bool_))
