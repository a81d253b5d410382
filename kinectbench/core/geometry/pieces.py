"""The connected pieces of a mesh, and its edges. Import late: numba is slow to load."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def sorted_edges(faces):  # type: ignore[no-untyped-def]
    """(3 m,) int64, rising: the edges of faces (m, 3) by number: even, or odd in the other direction."""
    vertices, edges = 1 + np.int64(faces.max()), np.empty(faces.size, np.int64)
    for f in range(len(faces)):
        for corner in range(3):
            begin, end = np.int64(faces[f, corner]), np.int64(faces[f, (corner + 1) % 3])
            edges[3 * f + corner] = min(begin, end) << 32 | max(begin, end) << 1 | (begin > end)
    # By the larger vertex and the direction, then by the smaller vertex: each pass keeps the order of equals.
    edges = _counted(edges, 0, 2 * vertices)
    return _counted(edges, 32, vertices)


@njit(cache=True, nogil=True)
def _counted(numbers, shift, digits):  # type: ignore[no-untyped-def]
    """The numbers sorted by 32 of their bits, which are below `digits`: a pass of a radix sort."""
    begin, found = np.zeros(digits + 1, np.int64), np.empty(len(numbers), np.int64)
    for number in numbers:
        begin[(number >> shift & 0xFFFFFFFF) + 1] += 1
    begin = np.cumsum(begin)
    for number in numbers:
        digit = number >> shift & 0xFFFFFFFF
        found[begin[digit]] = number
        begin[digit] += 1
    return found


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
