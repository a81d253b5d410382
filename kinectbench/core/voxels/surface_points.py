"""Even surface samples, and the spacing of vertices."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.types import Float64, Int64
from kinectbench.core.voxels.morphology import cell_numbers

# The spacing is taken of this many faces, evenly drawn. Chosen by hand.
JUDGED_FACES = 20_000


def spacing_m(mesh: TriangleMesh) -> float:
    """Return the spacing of a mesh's vertices, metres: 95 % of its edges are shorter.

    With smaller cells, neighbouring vertices of a continuous surface might not lie in touching cells. A
    mesh without faces has spacing 0.
    """
    corners = mesh.vertices[mesh.faces[:: max(1, len(mesh.faces) // JUDGED_FACES)]]
    edges_m = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    return float(np.quantile(edges_m, 0.95)) if edges_m.size else 0.0


@dataclass(frozen=True)
class SurfacePoints:
    """Points spread evenly over a surface: one per cubic cell that it passes through.

    Attributes:
        points: (n, 3) float64, metres: mean of the mesh vertices in the cell.
        normals: (n, 3) float64, unit vectors: mean normal of these vertices.
        cells: (n, 3) int64, index of each point's cell along x, y and z.
        owner: (v,) int64, for each vertex of the mesh the index of its cell's point.
    """

    points: Float64
    normals: Float64
    cells: Int64
    owner: Int64


def surface_points(mesh: TriangleMesh, cell_m: float) -> SurfacePoints:
    """Thin a mesh's vertices to one point a cell (`thinned`); normals are weighted by the faces' area."""
    corners = mesh.vertices[mesh.faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(mesh.vertices)
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(
                mesh.faces[:, corner], weights=face_normals[:, axis], minlength=len(mesh.vertices)
            )
    return thinned(mesh.vertices, normals, cell_m)


def thinned(points_world: Float64, normals_world: Float64, cell_m: float) -> SurfacePoints:
    """Replace the points (n, 3) in each cubic cell of edge `cell_m` by their mean, so that they lie evenly.

    The normals (n, 3) of a cell are averaged, too; each counts by its length.
    """
    of_points = np.floor(points_world / cell_m).astype(np.int64)
    _, first, owner, counts = np.unique(
        cell_numbers(of_points), return_index=True, return_inverse=True, return_counts=True
    )
    cells, owner = of_points[first], owner.reshape(-1)
    points, mean_normals = np.zeros((len(cells), 3)), np.zeros((len(cells), 3))
    for axis in range(3):
        points[:, axis] = np.bincount(owner, weights=points_world[:, axis], minlength=len(cells)) / counts
        mean_normals[:, axis] = np.bincount(owner, weights=normals_world[:, axis], minlength=len(cells))
    mean_normals /= np.maximum(np.linalg.norm(mean_normals, axis=1, keepdims=True), 1e-12)
    return SurfacePoints(points, mean_normals, cells, owner)


def sample_surface(
    vertices: Float64, faces: NDArray[np.int32], count: int, rng: np.random.Generator
) -> tuple[Float64, Float64]:
    """Draw points evenly by area over a mesh, one from each of `count` equal shares of it (stratified).

    Args:
        vertices: (v, 3), metres.
        faces: (f, 3), vertex indices.
        count: number of points.
        rng: random numbers for the points.

    Returns:
        Points (count, 3) and their faces' unit normals (count, 3), in the mesh's frame.
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    crossed = np.cross(b - a, c - a)
    double_area = np.linalg.norm(crossed, axis=1)
    reached = np.cumsum(double_area)
    wanted = (np.arange(count) + rng.random(count)) / count * reached[-1]
    chosen = np.minimum(np.searchsorted(reached, wanted, side="right"), len(faces) - 1)
    root, share = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    points = (1 - root) * a[chosen] + root * (1 - share) * b[chosen] + root * share * c[chosen]
    return points, crossed[chosen] / np.maximum(double_area[chosen, None], 1e-30)
