"""The connected pieces of a mesh. Import late: numba is slow to load."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def pieces_of(faces, vertices: int):  # type: ignore[no-untyped-def]
    """Return for each face (m, 3) one vertex that identifies its connected piece: (m,) int64.

    Faces that share vertices, directly or by other faces, get the same vertex.

    Args:
        faces: (m, 3) indices below `vertices`.
        vertices: number of vertices.
    """
    above = np.arange(vertices)
    for f in range(len(faces)):
        one = _top(above, faces[f, 0])
        for corner in range(1, 3):
            other = _top(above, faces[f, corner])
            above[max(one, other)] = one = min(one, other)
    found = np.empty(len(faces), np.int64)
    for f in range(len(faces)):
        found[f] = _top(above, faces[f, 0])
    return found


@njit(cache=True, nogil=True, inline="always")
def _top(above, vertex):  # type: ignore[no-untyped-def]
    """Return a vertex's root in a union-find forest, and halve the path; `above` (n,) has the parents."""
    while above[vertex] != vertex:
        above[vertex] = above[above[vertex]]
        vertex = above[vertex]
    return vertex
