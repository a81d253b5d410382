"""The connected pieces of a mesh. Import late: numba is slow to load."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def pieces_of(faces, vertices: int):  # type: ignore[no-untyped-def]
    """(m,) int64: for each face (m, 3) a vertex of its piece, the same for all faces that are connected.

    Args:
        faces: (m, 3) indices below `vertices`.
        vertices: their number.
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
    """The vertex that stands for a piece; the way there is halved."""
    while above[vertex] != vertex:
        above[vertex] = above[above[vertex]]
        vertex = above[vertex]
    return vertex
