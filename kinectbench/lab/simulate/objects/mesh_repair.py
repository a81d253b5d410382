"""Repair a mesh into closed bodies: merge vertices, make windings consistent, fill small holes."""

from dataclasses import dataclass

import numpy as np
import trimesh
from manifold3d import Manifold, triangulate
from open3d import geometry, utility

from kinectbench.core.geometry import TriangleMesh, three_corners
from kinectbench.core.types import Float64, Int32, Int64
from kinectbench.lab.simulate.objects.shapes import solid, surface, union

MERGE_M = 1e-7
# A hole is small if its area is at most this share of the body's area around it (chosen here).
HOLE_SHARE = 1 / 3
# A body with a smaller mean thickness is a sheet.
SHEET_M = 1e-4


@dataclass(frozen=True)
class Body:
    """One closed body of a mesh, after repair.

    Attributes:
        shape: the closed solid, oriented outwards.
        reversed: whether the mesh's faces were oriented inwards.
        holes: number of filled holes.
    """

    shape: Manifold
    reversed: bool
    holes: int


def merged_vertices(mesh: TriangleMesh) -> TriangleMesh:
    """Merge vertices that are equal if rounded to 1e-7 m; drop faces that no longer have three corners."""
    keys = np.round(mesh.vertices / MERGE_M).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces].astype(np.int32)
    return TriangleMesh(mesh.vertices[first], faces[three_corners(faces)])


def open_edges(mesh: TriangleMesh) -> int:
    """Return the number of a mesh's edges that do not have exactly two faces."""
    _, faces_at_edge = np.unique(_edges(mesh.faces)[1], return_counts=True)
    return int((faces_at_edge != 2).sum())


def closed_bodies(mesh: TriangleMesh) -> list[Body] | None:
    """Split a mesh with merged vertices into closed bodies; None if a body is open and cannot be repaired.

    A mesh that is closed with consistent winding is not changed; its bodies may touch at edges and vertices.
    Otherwise each connected part gets a consistent winding, and its holes are filled with planar patches. A
    part with a hole larger than a third of its area cannot be repaired.
    """
    if (whole := _outward(mesh.vertices, mesh.faces)) is not None:
        # A mesh that is entirely inside out was turned over.
        closed = [_body(surface(shape), 0) for shape in whole[0].decompose()]
    else:
        # Faces are connected by edges with exactly two faces.
        pairs = trimesh.graph.face_adjacency(mesh.faces)
        label = trimesh.graph.connected_component_labels(pairs, node_count=len(mesh.faces))
        closed = [_repaired(mesh.keep_faces(label == which)) for which in range(label.max(initial=-1) + 1)]
    bodies = [body for body in closed if body is not None]
    return bodies if len(bodies) == len(closed) else None


def _outward(vertices: Float64, faces: Int32) -> tuple[Manifold, bool] | None:
    """Return a closed mesh as a solid of positive volume, and whether faces were flipped; None if open."""
    for inside_out in (False, True):
        shape = solid(vertices, faces[:, ::-1] if inside_out else faces)
        if shape is None or shape.volume() > 0:
            return None if shape is None else (shape, inside_out)
    return None


def _body(mesh: TriangleMesh, holes: int) -> Body | None:
    """Return a closed mesh as a body with `holes` filled holes; None if it is open or has no volume."""
    body = _outward(mesh.vertices, mesh.faces)
    if body is None or body[0].volume() < SHEET_M * body[0].surface_area() / 2:
        return None
    return Body(*body, holes)


def _repaired(part: TriangleMesh) -> Body | None:
    """Close one connected part: make its winding consistent, and fill its small holes; None if impossible."""
    faces = _one_winding(part)
    loops = None if faces is None else _hole_loops(faces)
    if faces is None or loops is None:
        return None
    a, b, c = (part.vertices[faces[:, corner]] for corner in range(3))
    most_m2 = HOLE_SHARE * float((np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2).sum())
    patches = [_patch(part.vertices, loop, most_m2) for loop in loops]
    filled = [patch for patch in patches if patch is not None]
    if len(filled) < len(loops):
        return None
    return _body(TriangleMesh(part.vertices, np.concatenate([faces, *filled])), len(loops))


def united(parts: list[Body]) -> Manifold:
    """Return the union of bodies; a reversed body inside the others is subtracted as a cavity."""
    outer = [part.shape for part in parts if not part.reversed]
    turned = [part.shape for part in parts if part.reversed]
    whole = union(outer)
    cavities = [shape for shape in turned if (shape ^ whole).volume() > 0.999 * shape.volume()]
    more = [shape for shape in turned if all(shape is not cavity for cavity in cavities)]
    whole = union([whole, *more])
    return whole - union(cavities) if cavities else whole


def _edges(faces: Int32) -> tuple[Int64, Int64]:
    """Return the edges of all faces as vertex pairs (3m, 2), and keys (3m,) that ignore their direction."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    return edges, edges.min(axis=1) * (int(faces.max(initial=0)) + 1) + edges.max(axis=1)


def _one_winding(part: TriangleMesh) -> Int32 | None:
    """Return the faces (m, 3) of one connected part, flipped to the winding of its first face.

    The result is None if the part is not orientable, or an edge has more than two faces.
    """
    corners = utility.Vector3iVector(part.faces)
    shell = geometry.TriangleMesh(utility.Vector3dVector(part.vertices), corners)
    if not shell.is_edge_manifold() or not shell.orient_triangles():
        return None
    turned = (np.asarray(shell.triangles) != part.faces).any(axis=1)
    return np.where((turned != turned[0])[:, None], part.faces[:, ::-1], part.faces)


def _hole_loops(faces: Int32) -> list[Int64] | None:
    """Return the loop of vertex indices around each hole; None if two loops share a vertex.

    A loop runs in the direction of the winding of the patch that fills the hole.
    """
    edges, number = _edges(faces)
    _, edge, faces_at_edge = np.unique(number, return_inverse=True, return_counts=True)
    lone = edges[faces_at_edge[edge] == 1]
    following = dict(lone[:, ::-1].tolist())
    if len(following) < len(lone):
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


def _patch(vertices: Float64, loop: Int64, most_m2: float) -> Int32 | None:
    """Return triangles (k, 3) that fill a loop of vertices; None if its area exceeds `most_m2`.

    The loop is triangulated in its mean plane.
    """
    points = vertices[loop] - vertices[loop].mean(axis=0)
    # Newell's normal has twice the loop's area as its length.
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
