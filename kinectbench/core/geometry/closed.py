"""Join equal vertices of a mesh, test whether it is closed, and turn its faces outwards."""

import numpy as np

from kinectbench.core.types import Bools, Float64, Int32, Int64

# Vertices closer than this differ by rounding alone; trimesh joins them at the same distance.
SAME_PLACE_M = 1e-8


def joined_vertices(vertices: Float64, faces: Int32) -> tuple[Float64, Int32]:
    """Return the mesh with vertices at equal positions merged, and without faces that degenerate by merging.

    A collapsed face has no area, and its edges have no partner. Marching cubes makes such faces where a value
    lies exactly on the level, and a sphere of latitudes and longitudes has them at its poles.
    """
    places = np.round(vertices / SAME_PLACE_M).astype(np.int64)
    order = np.lexsort(places.T).astype(np.int32)
    is_first = np.ones(len(order), bool)
    is_first[1:] = (np.diff(places[order], axis=0) != 0).any(axis=1)
    joined = np.empty(len(order), np.int32)
    joined[order] = np.cumsum(is_first, dtype=np.int32) - 1
    faces = joined[faces]
    return vertices[order[is_first]], faces[three_corners(faces)]


def three_corners(faces: Int32) -> Bools:
    """Return which faces (m, 3) have three different corners: bool (m,)."""
    a, b, c = faces.T
    return np.asarray((a != b) & (b != c) & (c != a))


def is_closed(faces: Int32) -> bool:
    """Whether each edge belongs to exactly two triangles that run along it in opposite directions.

    A mesh without faces is not closed.
    """
    if not len(faces):
        return False
    edges = _sorted_edges(faces)
    forwards, backwards = edges[:-1:2], edges[1::2]
    paired = len(edges) % 2 == 0 and (forwards % 2 == 0).all() and (backwards == forwards + 1).all()
    return bool(paired and (np.diff(edges) > 0).all())


def why_open(faces: Int32) -> str:
    """Return why a mesh is not closed, in words; "" if it `is_closed`."""
    if not len(faces):
        return "no face has an area"
    edges, counts = np.unique(_sorted_edges(faces) >> 1, return_counts=True)
    one, more = int((counts == 1).sum()), int((counts > 2).sum())
    found = [f"{one} of {len(edges)} edges with one face: holes"] if one else []
    if more:
        found.append(f"{more} of {len(edges)} edges with more than two faces: doubled triangles?")
    if not found and not is_closed(faces):
        found.append("neighbouring faces that run in opposite senses: not consistently oriented")
    return ", ".join(found)


def _sorted_edges(faces: Int32) -> Int64:
    """Return the edges of faces (m, 3) as sorted numbers: (3 m,).

    A number is `lower vertex << 32 | higher vertex << 1`, plus 1 if the edge starts at the higher vertex.
    """
    begin, end = faces.astype(np.int64), np.roll(faces, -1, axis=1).astype(np.int64)
    edges = np.minimum(begin, end) << 32 | np.maximum(begin, end) << 1 | (begin > end)
    return np.sort(edges, axis=None)


def outwards(vertices: Float64, faces: Int32) -> Int32:
    """Return the faces (m, 3) of a closed mesh with each connected piece oriented outwards.

    A void inside a piece is a piece of its own. Its faces turn outwards too, so it counts as solid.
    """
    from kinectbench.core.geometry.pieces import pieces_of

    piece = pieces_of(faces, len(vertices))
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    volumes = np.bincount(piece, weights=np.einsum("ij,ij->i", a, np.cross(b, c)))
    turned: Int32 = np.where((volumes < 0)[piece, None], faces[:, ::-1], faces)
    return turned
