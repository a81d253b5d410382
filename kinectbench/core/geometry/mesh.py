"""Triangle meshes: their type, marching cubes, Poisson reconstruction, and binary PLY files."""

import importlib
import re
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import StorageError
from kinectbench.core.geometry.boxes import OrientedBox
from kinectbench.core.geometry.rigid import transform_points
from kinectbench.core.types import Bools, Float32, Float64, Int32, Int64
from kinectbench.core.untrusted import read_plain

if TYPE_CHECKING:
    from open3d.core import Tensor
    from open3d.t.geometry import RaycastingScene

# A function that makes an Open3D tensor from an array.
Tensors = Callable[[NDArray[np.generic]], "Tensor"]

# Two triangles for each side; corners are numbered as in `OrientedBox.corners_floor`.
BOX_FACES = np.array(
    [
        *([0, 2, 6], [6, 4, 0], [0, 4, 5], [5, 1, 0], [4, 6, 5], [5, 6, 7]),
        *([3, 2, 0], [0, 1, 3], [3, 6, 2], [7, 6, 3], [1, 5, 3], [3, 5, 7]),
    ],
    dtype=np.int32,
)

# The header that `write_ply` writes: vertices, optional lines of colours, and faces.
PLY_HEAD = re.compile(
    rb"ply\nformat binary_little_endian 1\.0\n(?:comment [^\n]{0,200}\n){0,20}"
    rb"element vertex ([0-9]{1,9})\nproperty float x\nproperty float y\nproperty float z\n"
    rb"((?:property uchar [a-z]{1,9}\n){0,4})"
    rb"element face ([0-9]{1,9})\nproperty list uchar int vertex_indices\nend_header\n"
)
# As large as a scene of forty million triangles.
PLY_BYTES = 1 << 30


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles over shared vertices.

    Attributes:
        vertices: (n, 3) float64, metres, in the frame that the owner states (`world` if it states none).
        faces: (m, 3) int32, counter-clockwise seen from outside.
        colors: (n, 3) uint8 RGB; None if there are none.
    """

    vertices: Float64
    faces: Int32
    colors: NDArray[np.uint8] | None = None

    @property
    def volume_m3(self) -> float:
        """Volume enclosed by a closed mesh (divergence theorem), cubic metres."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return float((a * np.cross(b, c)).sum() / 6.0)

    @property
    def vertex_normals(self) -> Float64:
        """Unit vertex normals (n, 3): area-weighted means of adjacent faces' normals; 0 without faces."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        doubled, corners = np.cross(b - a, c - a), self.faces.ravel()
        sums = [np.bincount(corners, along.repeat(3), len(self.vertices)) for along in doubled.T]
        normals: Float64 = np.stack(sums, axis=-1)
        lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
        normals /= np.where(lengths > 0, lengths, 1)
        return normals

    def keep_faces(self, mask: Bools) -> "TriangleMesh":
        """Return the mesh of the faces where mask (m,) is true; vertices that no face uses are dropped."""
        faces = self.faces[mask]
        used = np.zeros(len(self.vertices), dtype=bool)
        used[faces] = True
        renumber = np.cumsum(used, dtype=np.int32) - 1
        colors = None if self.colors is None else self.colors[used]
        return TriangleMesh(self.vertices[used], renumber[faces], colors)

    def transformed(self, T: Float64) -> "TriangleMesh":
        """Return the mesh with its vertices mapped by a rigid transform (4, 4)."""
        return replace(self, vertices=transform_points(T, self.vertices))


def join(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """All triangles of several meshes in one mesh, in order, without colours."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces).astype(np.int32)
    )


def box_mesh(box: OrientedBox) -> TriangleMesh:
    """Return the closed mesh of a box, in the frame `floor` of the box (z up), metres."""
    return TriangleMesh(box.corners_floor(), BOX_FACES)


def raycaster(*meshes: TriangleMesh, threads: int = 0) -> tuple["RaycastingScene", Tensors]:
    """Prepare meshes for ray casting in float32 (Open3D's RaycastingScene, which is Embree).

    Args:
        meshes: their geometry ids count from 0 in this order.
        threads: number of threads that build the structure; 0: all.

    Returns:
        The scene, and a function that makes Open3D's tensors from arrays.
    """
    o3d = _open3d()
    scene, tensor = o3d.t.geometry.RaycastingScene(nthreads=threads), o3d.core.Tensor.from_numpy
    for mesh in meshes:
        vertices, faces = mesh.vertices.astype(np.float32, "C"), mesh.faces.astype(np.uint32, "C")
        scene.add_triangles(tensor(vertices), tensor(faces))
    return scene, tensor


def isosurface(field: Float32, observed: Bools | None = None, level: float = 0.0) -> TriangleMesh:
    """Extract a surface from a dense field by marching cubes; the field is larger outside.

    Args:
        field: (nx, ny, nz) float32.
        observed: (nx, ny, nz); a cell with an unobserved corner gives no faces. None: all observed.
        level: value of the field on the surface.

    Returns:
        A mesh in index coordinates: vertex (i, j, k) is the centre of cell (i, j, k); faces look outward.
    """
    o3d = _open3d()
    values = o3d.core.Tensor.from_numpy(np.ascontiguousarray(field))
    extracted = o3d.t.geometry.TriangleMesh.create_isosurfaces(values, [level])
    if "indices" not in extracted.triangle or len(extracted.triangle.indices) == 0:
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    # Open3D takes the last array axis as x.
    vertices = extracted.vertex.positions.numpy()[:, ::-1].astype(np.float64)
    faces = extracted.triangle.indices.numpy().astype(np.int32)
    mesh = TriangleMesh(vertices, faces)
    if observed is None:
        return mesh
    cell = np.floor(vertices[mesh.faces].mean(axis=1)).astype(np.int64)
    x, y, z = np.clip(cell, 0, np.array(field.shape) - 2).T
    whole = np.ones(len(cell), dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        whole &= observed[x + corner[0], y + corner[1], z + corner[2]]
    return mesh.keep_faces(whole)


def poisson_surface(points: Float64, normals: Float64, depth: int, cube: float) -> TriangleMesh:
    """Screened Poisson surface reconstruction (M. Kazhdan and H. Hoppe 2013; Open3D).

    Args:
        points: (n, 3), not all at one point.
        normals: (n, 3) of length 1, outward.
        depth: depth of the octree: at most 2^depth cells along the cube, which bounds time and memory.
        cube: edge of the cube relative to the points' box; a surface that reaches the cube is open there.
    """
    o3d = _open3d()
    middle, size = (points.min(axis=0) + points.max(axis=0)) / 2, float(np.ptp(points, axis=0).max())
    # Open3D computes in float32, and ends the process if the points are equal in float32.
    vectors = o3d.utility.Vector3dVector
    cloud = o3d.geometry.PointCloud(vectors((points - middle) / size))
    cloud.normals = vectors(normals)
    # One thread gives the same bytes in each run; several threads sometimes crash (mkazhdan/PoissonRecon,
    # issue 298).
    made = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=depth, scale=cube, n_threads=1
    )[0]
    return TriangleMesh(np.asarray(made.vertices) * size + middle, np.asarray(made.triangles, np.int32))


@cache
def _open3d() -> ModuleType:
    """Import Open3D; its functions for plotly are imported only when one of them is called.

    These import dash and plotly: 0.42 of the 0.68 CPU s that `import open3d` takes (version 0.20), in every
    process that builds or scores. This package never calls them.
    """
    name = "open3d.visualization.draw_plotly"

    def later(function: str) -> Callable[..., object]:
        """Wrap a function so that its module is imported at the first call."""
        if function.startswith("__"):  # such as __file__, which `inspect` asks every module for
            raise AttributeError(function)

        def call(*args: object, **named: object) -> object:
            sys.modules.pop(name, None)
            return getattr(importlib.import_module(name), function)(*args, **named)

        return call

    if "open3d" not in sys.modules:
        stand_in = ModuleType(name)
        stand_in.__getattr__ = later  # type: ignore[method-assign]
        sys.modules[name] = stand_in
    return importlib.import_module("open3d")


def write_ply(mesh: TriangleMesh, path: Path) -> None:
    """Write vertices (float32, metres), faces and colours; the bytes are those that trimesh writes."""
    channels = () if mesh.colors is None else ("red", "green", "blue", "alpha")
    properties = [*(f"float {axis}" for axis in "xyz"), *(f"uchar {channel}" for channel in channels)]
    lines = [
        *("ply", "format binary_little_endian 1.0", "comment https://github.com/mikedh/trimesh"),
        *(f"element vertex {len(mesh.vertices)}", *(f"property {each}" for each in properties)),
        *(f"element face {len(mesh.faces)}", "property list uchar int vertex_indices", "end_header\n"),
    ]
    vertex, face = _ply_types(len(channels))
    vertices, faces = np.empty(len(mesh.vertices), vertex), np.empty(len(mesh.faces), face)
    vertices["xyz"], vertices["rest"] = mesh.vertices, 255  # opaque
    if mesh.colors is not None:
        vertices["rest"][:, :3] = mesh.colors
    faces["count"], faces["corners"] = 3, mesh.faces
    path.write_bytes("\n".join(lines).encode() + vertices.tobytes() + faces.tobytes())


def _ply_types(extra_bytes: int) -> tuple[np.dtype[np.void], np.dtype[np.void]]:
    """Return the dtypes of a PLY's vertex, with `extra_bytes` after its position, and of its triangle."""
    vertex = np.dtype([("xyz", "<f4", 3), ("rest", "u1", extra_bytes)])
    return vertex, np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def read_own_ply(path: Path, *, colors: bool = False) -> TriangleMesh:
    """Read a mesh that `write_ply` wrote, with its colours if `colors` is set.

    Raises:
        StorageError: the file is missing or damaged.
    """
    try:
        return parse_ply(read_plain(path, PLY_BYTES), colors=colors)
    except (OSError, ValueError) as error:
        raise StorageError(
            f"{path}: not a readable triangle mesh ({error}); `kinectbench build --force` makes it again"
        ) from error


def parse_ply(content: bytes, *, colors: bool = False) -> TriangleMesh:
    """Parse the bytes of a mesh that `write_ply` wrote, as untrusted input; see `read_own_ply`.

    Only what `write_ply` writes is read: binary triangles. Sizes are checked before memory is allocated, so
    the cost is at most that of the file. A general library would also parse text and lists of any length.

    Raises:
        ValueError: the bytes are no such file, a vertex is not finite, or a face names a missing vertex.
    """
    head = PLY_HEAD.match(content)
    if head is None:
        raise ValueError("not a binary PLY file of triangles as this package writes it")
    vertices, faces = int(head[1]), int(head[3])
    vertex, face = _ply_types(head[2].count(b"\n"))
    vertex_end = head.end() + vertices * vertex.itemsize
    claimed = vertex_end + faces * face.itemsize
    if len(content) != claimed:
        raise ValueError(f"{len(content)} bytes where its head claims {claimed}")
    of_vertices = np.frombuffer(content, vertex, vertices, head.end())
    xyz = of_vertices["xyz"].astype(np.float64)
    of_faces = np.frombuffer(content, face, faces, vertex_end)
    corners = of_faces["corners"].astype(np.int32)
    inside = (corners >= 0) & (corners < vertices)
    if not np.isfinite(xyz).all() or not inside.all() or (of_faces["count"] != 3).any():
        raise ValueError("a vertex is not finite, or a face has none")
    colored = colors and head[2].count(b"\n") >= 3
    return TriangleMesh(xyz, corners, of_vertices["rest"][:, :3].copy() if colored else None)


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


# 0 keeps the shape best, 10 is fastest. With real cabinets and simulated tables of 200,000 triangles, 4
# reduces to 60,000 within a tenth of the error of 3; and 3 stops at 8,000 triangles instead of 1,000.
AGGRESSIVENESS = 4
# The library keeps the mesh that it works on in a global variable.
_ONE_AT_A_TIME = threading.Lock()


def decimated(mesh: TriangleMesh, most_triangles: int) -> TriangleMesh:
    """Reduce a mesh to at most this many triangles, without colours; a mesh with fewer is unchanged.

    Edges collapse in the order of quadric error metrics (Garland and Heckbert, SIGGRAPH 1997), by
    fast-simplification in one thread, so that the same mesh gives the same result. It takes 1 µs a triangle,
    a tenth of Open3D's time. The result may touch itself at an edge. More triangles remain if no further edge
    can collapse; triangles that share no edge disappear.

    Args:
        mesh: in any frame.
        most_triangles: at least 4.
    """
    import fast_simplification

    if len(mesh.faces) <= most_triangles:
        return mesh
    # The library's thresholds are lengths: in a box of side 1, large and small objects keep equal detail.
    lowest = mesh.vertices.min(axis=0)
    side_m = float(np.ptp(mesh.vertices, axis=0).max()) or 1.0
    unit = (mesh.vertices - lowest) / side_m
    with _ONE_AT_A_TIME:
        vertices, faces = fast_simplification.simplify(
            unit, mesh.faces, target_count=most_triangles, agg=AGGRESSIVENESS
        )
    return TriangleMesh(vertices * side_m + lowest, np.asarray(faces, np.int32))


def surface_distances_m(points: Float64, mesh: TriangleMesh) -> Float32:
    """Distance of points (n, 3) from the surface of a mesh, both in one frame, metres: (n,) float32."""
    scene, tensor = raycaster(mesh)
    return np.asarray(scene.compute_distance(tensor(points.astype(np.float32))).numpy(), np.float32)
