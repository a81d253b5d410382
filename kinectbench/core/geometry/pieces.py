"""The connected pieces of a mesh, and its edges. Import late: numba is slow to load."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def sorted_edges(faces):  # type: ignore[no-untyped-def]
    """Return the edges of faces (m, 3) as sorted numbers: (3 m,) int64.

    A number is `lower vertex << 32 | higher vertex << 1`, plus 1 if the edge starts at the higher vertex.
    """
    vertices, edges = 1 + np.int64(faces.max()), np.empty(faces.size, np.int64)
    for f in range(len(faces)):
        for corner in range(3):
            begin, end = np.int64(faces[f, corner]), np.int64(faces[f, (corner + 1) % 3])
            edges[3 * f + corner] = min(begin, end) << 32 | max(begin, end) << 1 | (begin > end)
    # Sort by the higher vertex and the direction first, then by the lower vertex; each pass is stable.
    edges = _counted(edges, 0, 2 * vertices)
    return _counted(edges, 32, vertices)


@njit(cache=True, nogil=True)
def _counted(numbers, shift, digits):  # type: ignore[no-untyped-def]
    """Return `numbers` (n,) int64 after one pass of a radix sort, which is stable.

    The sort key is the 32 bits of each number from bit `shift` on. Every key must be less than `digits`.
    """
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
