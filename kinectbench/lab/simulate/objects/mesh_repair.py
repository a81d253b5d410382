"""A mesh that somebody drew to closed bodies: merged vertices, one winding, small holes filled."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.types import Int64
from kinectbench.lab.simulate.objects.shapes import surface, union

if TYPE_CHECKING:
    from manifold3d import Manifold

Faces = NDArray[np.int32]

MERGE_M = 1e-7
# A hole is small if it has at most this share of the area of the body around it: own choice.
HOLE_SHARE = 1 / 3
# A body that is thinner than this on average is a sheet.
SHEET_M = 1e-4


@dataclass(frozen=True)
class Body:
    """A closed body.

    Attributes:
        shape: closed, outward.
        reversed: it was inside out.
        holes: how many were filled.
    """

    shape: "Manifold"
    reversed: bool
    holes: int


def merged(mesh: TriangleMesh) -> TriangleMesh:
    """A mesh whose vertices within 1e-7 m are one, without faces that then have no three corners."""
    keys = np.round(mesh.vertices / MERGE_M).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces].astype(np.int32)
    corners = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return TriangleMesh(mesh.vertices[first], faces[corners])


def open_edges(mesh: TriangleMesh) -> int:
    """How many edges have no second face, or more than two."""
    _, counts = np.unique(_edge_keys(mesh.faces), return_counts=True)
    return int((counts != 2).sum())


def closed_bodies(mesh: TriangleMesh) -> list[Body] | None:
    """The closed bodies of a merged mesh, or None where one cannot be closed without inventing shape.

    A mesh that is closed with one winding is taken as it is; its bodies may touch at edges and vertices.
    Otherwise each part whose faces hang together is given one winding, and its holes, if each has at most a
    third of the area around it, are filled in their plane. Own rule.
    """
    if (whole := _outward(mesh.vertices, mesh.faces)) is not None:
        # A mesh that is inside out as a whole has been turned over.
        found = [_body(surface(shape), 0) for shape in whole[0].decompose()]
    else:
        found = [_repaired(part) for part in _parts(mesh)]
    bodies = [body for body in found if body is not None]
    return bodies if len(bodies) == len(found) else None


def _outward(vertices: NDArray[np.float64], faces: Faces) -> "tuple[Manifold, bool] | None":
    """A closed mesh as a solid of positive volume, and whether it was turned over; None if it is open."""
    from manifold3d import Error, Manifold, Mesh64

    for inside_out in (False, True):
        corners = faces[:, ::-1] if inside_out else faces
        shape = Manifold(Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(corners, np.uint64)))
        if shape.status() != Error.NoError or shape.is_empty():
            return None
        if shape.volume() > 0:
            return shape, inside_out
    return None


def _body(mesh: TriangleMesh, holes: int) -> Body | None:
    """A closed mesh as a body; None if it is not closed, or a folded sheet without volume."""
    found = _outward(mesh.vertices, mesh.faces)
    if found is None or found[0].volume() < SHEET_M * found[0].surface_area() / 2:
        return None
    return Body(*found, holes)


def _parts(mesh: TriangleMesh) -> list[TriangleMesh]:
    """The parts of a mesh whose faces hang together by edges of exactly two faces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    left, right, _ = _neighbours(mesh.faces)
    graph = coo_array((np.ones(len(left), np.int8), (left, right)), shape=(len(mesh.faces),) * 2)
    count, label = connected_components(graph, directed=False)
    return [mesh.keep_faces(label == which) for which in range(count)]


def _repaired(part: TriangleMesh) -> Body | None:
    """One part with one winding and its small holes filled."""
    if _most_faces_at_an_edge(part.faces) > 2:
        return None
    faces = _one_winding(part.faces)
    loops = None if faces is None else _hole_loops(faces)
    if faces is None or loops is None:
        return None
    most_m2 = HOLE_SHARE * float(_areas(part.vertices, faces).sum())
    patches = [_patch(part.vertices, loop, most_m2) for loop in loops]
    filled = [patch for patch in patches if patch is not None]
    if len(filled) < len(loops):
        return None
    return _body(TriangleMesh(part.vertices, np.concatenate([faces, *filled])), len(loops))


def united(parts: list[Body]) -> "Manifold":
    """The union of bodies; one that is inside out and lies within the others is a cavity in them."""
    outer = [part.shape for part in parts if not part.reversed]
    turned = [part.shape for part in parts if part.reversed]
    whole = union(outer)
    cavities = [shape for shape in turned if (shape ^ whole).volume() > 0.999 * shape.volume()]
    more = [shape for shape in turned if all(shape is not cavity for cavity in cavities)]
    whole = union([whole, *more])
    return whole - union(cavities) if cavities else whole


def _edge_keys(faces: Faces) -> Int64:
    """One number for each of the (3m) half-edges, the same for both directions."""
    starts, ends = _half_edges(faces)
    return np.minimum(starts, ends) * (int(faces.max(initial=0)) + 1) + np.maximum(starts, ends)


def _half_edges(faces: Faces) -> tuple[Int64, Int64]:
    """First and last vertex of the (3m) half-edges, face by face."""
    starts = faces.reshape(-1).astype(np.int64)
    return starts, np.roll(faces, -1, axis=1).reshape(-1).astype(np.int64)


def _most_faces_at_an_edge(faces: Faces) -> int:
    return int(np.unique(_edge_keys(faces), return_counts=True)[1].max(initial=0))


def _neighbours(faces: Faces) -> tuple[Int64, Int64, NDArray[np.bool_]]:
    """Pairs of faces at edges of exactly two, and whether both run along the edge the same way."""
    keys, (starts, _) = _edge_keys(faces), _half_edges(faces)
    _, group, counts = np.unique(keys, return_inverse=True, return_counts=True)
    paired = np.flatnonzero(counts[group] == 2)
    order = paired[np.argsort(keys[paired], kind="stable")]
    left, right = order[::2], order[1::2]
    return left // 3, right // 3, starts[left] == starts[right]


def _one_winding(faces: Faces) -> Faces | None:
    """The faces of one body, turned over where they run against the first; None if it has but one side."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order

    left, right, same = _neighbours(faces)
    if not same.any():
        return faces
    pairs = (np.concatenate([left, right]), np.concatenate([right, left]))
    graph = coo_array((np.ones(2 * len(left), np.int8), pairs), shape=(len(faces),) * 2).tocsr()
    against = {(int(a), int(b)): bool(s) for a, b, s in zip(*pairs, np.tile(same, 2), strict=True)}
    order, before = breadth_first_order(graph, 0)
    turned = np.zeros(len(faces), dtype=bool)
    for face in order[1:].tolist():
        turned[face] = turned[before[face]] ^ against[int(before[face]), face]
    if np.any((turned[left] ^ turned[right]) != same):
        return None
    return np.where(turned[:, None], faces[:, ::-1], faces)


def _hole_loops(faces: Faces) -> list[Int64] | None:
    """Closed rows of vertices around each hole, in the direction of its patch; None if two of them touch."""
    starts, ends = _half_edges(faces)
    _, group, counts = np.unique(_edge_keys(faces), return_inverse=True, return_counts=True)
    lone = counts[group] == 1
    following = dict(zip(ends[lone].tolist(), starts[lone].tolist(), strict=True))
    if len(following) < int(lone.sum()):
        return None
    loops = []
    while following:
        loop = [next(iter(following))]
        while (after := following.pop(loop[-1], None)) is not None and after != loop[0]:
            loop.append(after)
        if after is None:
            return None
        loops.append(np.array(loop, dtype=np.int64))
    return loops


def _patch(vertices: NDArray[np.float64], loop: Int64, most_m2: float) -> Faces | None:
    """Triangles (k, 3) that fill a loop, drawn in the plane that fits it best; None if it is too large."""
    from manifold3d import triangulate

    points = vertices[loop] - vertices[loop].mean(axis=0)
    # Newell's normal: twice the area that the loop encloses.
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    length = float(np.linalg.norm(normal))
    if length / 2 > most_m2:
        return None
    if len(loop) == 3:
        return loop[None].astype(np.int32)
    if length == 0:
        return None
    normal = normal / length
    side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    side /= np.linalg.norm(side)
    flat = np.column_stack([points @ side, points @ np.cross(normal, side)])
    return np.asarray(loop[triangulate([flat])], dtype=np.int32)


def _areas(vertices: NDArray[np.float64], faces: Faces) -> NDArray[np.float64]:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
