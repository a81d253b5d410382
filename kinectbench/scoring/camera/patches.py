"""Square patches on the faces of cells, and samples in triangles. Import late: numba is slow to load."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def squares_of_cells(inside, axes, signs, low, size: float):  # type: ignore[no-untyped-def]
    """Return faces of cells as squares; coordinates are in the unit of `size`.

    Args:
        inside: (n, 3) index of the occupied cell of each face, relative to the cell `low`.
        axes: (n,) the axis normal to each face.
        signs: (n,) 1 if the free cell has the larger index along that axis, else -1.
        low: (3,) index of the first cell.
        size: edge of a cell.

    Returns:
        Four arrays (n, 3) float64: centres; one corner of each square; the two edges from that corner.
    """
    centers, corner = np.empty(inside.shape), np.empty(inside.shape)
    first, second = np.zeros(inside.shape), np.zeros(inside.shape)
    for n in range(len(inside)):
        across, along, beside = axes[n], (axes[n] + 1) % 3, (axes[n] + 2) % 3
        for axis in range(3):
            at = inside[n, axis] + low[axis] + 0.5 + (0.5 * signs[n] if axis == across else 0.0)
            centers[n, axis] = at * size
            corner[n, axis] = (at - (0.0 if axis == across else 0.5)) * size
        first[n, along] = second[n, beside] = size
    return centers, corner, first, second


@njit(cache=True, error_model="numpy", nogil=True)
def in_triangles(counts, corner, first, second, steps):  # type: ignore[no-untyped-def]
    """Place samples in triangles: one at the centroid, or several by a low-discrepancy sequence.

    Args:
        counts: (m,) number of samples in each triangle.
        corner: (m, 3) one corner of each triangle.
        first: (m, 3) an edge from that corner.
        second: (m, 3) the other edge from that corner.
        steps: the increments (2,) of the sequence, along the two edges.

    Returns:
        (n, 3) float64, the samples; (n,) int64, the index of each sample's triangle.
    """
    points, owner, n = np.empty((counts.sum(), 3)), np.empty(counts.sum(), np.int64), 0
    for f in range(len(counts)):
        for number in range(counts[f]):
            u, v = (0.5 + number * steps[0]) % 1, (0.5 + number * steps[1]) % 1
            if u + v > 1:
                u, v = 1 - u, 1 - v
            if counts[f] == 1:
                u = v = 1 / 3
            for axis in range(3):
                points[n, axis] = corner[f, axis] + u * first[f, axis] + v * second[f, axis]
            owner[n] = f
            n += 1
    return points, owner
