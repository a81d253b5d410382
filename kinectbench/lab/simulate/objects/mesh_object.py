"""The object of a simulated recording, read from a mesh file and closed if needed."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from manifold3d import Manifold, triangulate
from numpy.typing import NDArray
from open3d import geometry, utility
from scipy import ndimage

from kinectbench.core import RecordingError
from kinectbench.core.geometry import Grid, TriangleMesh, isosurface, join, raycaster, rigid, three_corners
from kinectbench.core.types import Float64, Int32, Int64
from kinectbench.core.voxels.open_mesh import voxelize_open
from kinectbench.lab.simulate.objects.shapes import (
    Piece,
    Subject,
    Vector3,
    solid,
    standing_shift,
    surface,
    union,
)

DEFAULT_RGB: Vector3 = (0.66, 0.60, 0.52)
ALBEDO = 0.6
# Plausible sizes: a mesh in millimetres would be larger.
SMALLEST_M, LARGEST_M = 0.01, 5.0
MOST_COLORS = 64
VOXELS_ACROSS = 300
SMALLEST_VOXEL_M = 0.002
MARGIN_CELLS = 4
# If a face cuts a cell's cube, the cell's centre is within half a cube diagonal of the face: 0.866 cells.
SKIN_CELLS = 0.9


def load_mesh_object(path: Path, up: Literal["y", "z"]) -> Subject:
    """Load a mesh file as a subject: z up, on z = 0, with its bounding box centred at x = y = 0.

    If all bodies of the mesh are closed or have only small holes, the holes are filled, and the solid is the
    exact union of the bodies. Any other mesh is voxelised by the paper authors' rule for open meshes
    (`voxelize_open`). If closing the mesh changed its surface, the camera sees the solid's surface, in the
    file's colours, so that images and truth agree. The file is obj, ply, stl, glb or off, in metres; its axis
    `up` points up.

    Returns:
        The subject, with a piece for each colour of the file. If the file has neither colours nor materials,
        the subject has one default colour. Its `origin` states how the solid was closed, with numbers.

    Raises:
        RecordingError: the file is missing, unreadable or empty, has infinite vertices or no volume, or is
            not in metres.
    """
    parts = _colored_parts(path)
    whole = join([mesh for mesh, _ in parts])
    _check(path, whole)
    T = np.eye(4)
    if up == "y":
        T[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    place = rigid(np.eye(3), standing_shift(whole.transformed(T))) @ T
    parts = [(mesh.transformed(place), color) for mesh, color in parts]
    whole = merged_vertices(whole.transformed(place))
    if (exact := _closed_by_filling(whole)) is not None:
        mesh, origin, as_drawn = exact
        pieces = [Piece(f"part {at + 1}", part, color, ALBEDO) for at, (part, color) in enumerate(parts)]
        return Subject(path.name, tuple(pieces if as_drawn else _painted(mesh, parts)), mesh, origin)
    mesh, origin = _closed_by_voxels(path, whole)
    # The solid is a little larger than the file's mesh.
    place = rigid(np.eye(3), standing_shift(mesh))
    pieces = [replace(piece, mesh=piece.mesh.transformed(place)) for piece in _painted(mesh, parts)]
    return Subject(path.name, tuple(pieces), mesh.transformed(place), origin)


def _closed_by_filling(whole: TriangleMesh) -> tuple[TriangleMesh, str, bool] | None:
    """Return the union of a mesh's bodies; None if a body is open and has more than small holes.

    Returns:
        The union, one line on how it was closed, and whether the file's own faces show the same surface.
    """
    if not (bodies := closed_bodies(whole)):
        return None
    mesh = surface(united(bodies))
    holes, edges = sum(body.holes for body in bodies), open_edges(whole)
    what = "one body" if len(bodies) == 1 else f"exact union of {len(bodies)} bodies"
    if not holes:
        return mesh, f"closed in its file: {what}", not any(body.reversed for body in bodies)
    return mesh, f"closed by filling {holes} holes ({edges} open edges): {what}", False


def _closed_by_voxels(path: Path, whole: TriangleMesh) -> tuple[TriangleMesh, str]:
    """Voxelise an open mesh by the paper authors' rule; return a closed surface 0.9 voxels outside it.

    The second value is one line on how it was closed.
    """
    low, high = whole.vertices.min(axis=0), whole.vertices.max(axis=0)
    voxel_m = max(float((high - low).max()) / VOXELS_ACROSS, SMALLEST_VOXEL_M)
    nx, ny, nz = (np.ceil((high - low) / voxel_m).astype(int) + 2 * MARGIN_CELLS).tolist()
    grid = Grid((nx, ny, -(-nz // 8) * 8), voxel_m, rigid(np.eye(3), low - MARGIN_CELLS * voxel_m))
    packed = voxelize_open(whole.vertices, whole.faces, grid)
    occupied = ndimage.binary_fill_holes(np.unpackbits(packed, axis=2).astype(bool))
    near = ndimage.binary_dilation(occupied, iterations=2) & ~ndimage.binary_erosion(occupied, iterations=2)
    cells = np.argwhere(near)
    distance_m, _ = _nearest(whole, cells * voxel_m + grid.T_world_grid[:3, 3] + voxel_m / 2)
    distance = distance_m / voxel_m
    field = np.where(occupied, -1.0, 1.0).astype(np.float32)
    inside = occupied[near] & (distance >= SKIN_CELLS)
    skin = np.clip(np.where(inside, -distance, distance - SKIN_CELLS), -1, 1)
    # A surface exactly through a cell's centre would have degenerate triangles.
    field[near] = np.where(np.abs(skin) < 1e-3, 1e-3, skin)
    level_set = isosurface(field)
    vertices = (level_set.vertices + 0.5) * voxel_m + grid.T_world_grid[:3, 3]
    shape = solid(vertices, level_set.faces)
    if shape is None:
        raise RecordingError(f"{path}: no closed solid can be made of it; repair the mesh", what="bad-mesh")
    # Simplified; no face is moved by more than a twentieth of a voxel.
    return surface(shape.simplify(voxel_m / 20)), (
        f"closed by voxelising at {voxel_m * 1000:.1f} mm: {open_edges(whole)} open edges; "
        f"its surface lies {SKIN_CELLS * voxel_m * 1000:.1f} mm outside"
    )


def _nearest(mesh: TriangleMesh, points: Float64) -> tuple[Float64, Int64]:
    """Return each point's distance (n,) in metres to its nearest face, and that face's index (n,)."""
    scene, tensor = raycaster(mesh)
    hits = scene.compute_closest_points(tensor(points.astype(np.float32)))
    nearest = hits["points"].numpy().astype(np.float64)
    return np.linalg.norm(nearest - points, axis=1), hits["primitive_ids"].numpy().astype(np.int64)


def _painted(mesh: TriangleMesh, parts: list[tuple[TriangleMesh, Vector3]]) -> list[Piece]:
    """Split a solid's surface into pieces of one colour: each face gets the colour of the nearest part."""
    drawn = join([part for part, _ in parts])
    owner = np.repeat(np.arange(len(parts)), [len(part.faces) for part, _ in parts])
    _, nearest = _nearest(drawn, mesh.vertices[mesh.faces].mean(axis=1))
    label = owner[nearest]
    return [
        Piece(f"part {at + 1}", mesh.keep_faces(label == at), color, ALBEDO)
        for at, (_, color) in enumerate(parts)
        if np.any(label == at)
    ]


def _check(path: Path, whole: TriangleMesh) -> None:
    if not np.isfinite(whole.vertices).all():
        raise RecordingError(f"{path}: vertices are not finite; export the mesh again", what="bad-mesh")
    used = whole.vertices[np.unique(whole.faces)]
    size = np.ptp(used, axis=0)
    if not SMALLEST_M <= size.max() <= LARGEST_M:
        raise RecordingError(
            f"{path}: its largest side is {size.max():.3g} m, not {SMALLEST_M} to {LARGEST_M:g} m; "
            "scale the mesh to metres",
            what="bad-mesh",
        )
    if size.min() <= 1e-4:
        raise RecordingError(
            f"{path}: the mesh is flat and has no volume; choose another one", what="bad-mesh"
        )


def _colored_parts(path: Path) -> list[tuple[TriangleMesh, Vector3]]:
    """Return the triangles of a mesh file in its own frame, as one (mesh, RGB in [0, 1]) for each colour."""
    if not path.is_file():
        raise RecordingError(
            f"{path}: no such file; give a mesh file (obj, ply, stl, glb or off)", what="bad-mesh"
        )
    try:
        scene = trimesh.load_scene(path, process=False)
        loaded = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
    except Exception as error:  # readers raise any exception
        what = " ".join(str(error).split())[:120] or type(error).__name__
        raise RecordingError(
            f"{path}: not a readable mesh ({what}); give an obj, ply, stl, glb or off file", what="bad-mesh"
        ) from error
    parts: dict[Vector3, list[TriangleMesh]] = {}
    for mesh in loaded:
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
        if not len(faces):
            continue
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise RecordingError(
                f"{path}: a face names a vertex that is not there; export the mesh again", what="bad-mesh"
            )
        colors, label = np.unique(_face_colors(mesh), axis=0, return_inverse=True)
        for at, (red, green, blue) in enumerate(colors.tolist()):
            part = TriangleMesh(vertices, faces).keep_faces(label.reshape(-1) == at)
            parts.setdefault((red / 255, green / 255, blue / 255), []).append(part)
    if not parts:
        raise RecordingError(f"{path}: the mesh is empty; choose another one", what="bad-mesh")
    return [(join(meshes), color) for color, meshes in parts.items()]


def _face_colors(mesh: trimesh.Trimesh) -> NDArray[np.uint8]:
    """Return RGB colours (m, 3) of a mesh's faces; more than 64 colours are reduced to at most 64."""
    visual = mesh.visual
    default = np.round(np.array(DEFAULT_RGB) * 255).astype(np.uint8)
    faces = len(mesh.faces)
    if visual.kind in ("face", "vertex"):
        colors = np.asarray(visual.face_colors, np.uint8)[:, :3]
        if len(np.unique(colors, axis=0)) > MOST_COLORS:
            # Reduced to four levels each of red, green and blue.
            colors = colors // 64 * 64 + 32
        return colors
    material = getattr(visual, "material", None)
    main = None if material is None else material.main_color
    return np.tile(default if main is None else np.asarray(main, np.uint8)[:3], (faces, 1))


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
