"""Points in cubic cells, without a dense grid: numbers of cells, one point a cell, and cells that touch.

The memory grows with the number of cells and not with their extent: one pose half a kilometre off would make
a dense grid of a scene too large. Also here: even samples of a mesh, and the spacing of its vertices.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.types import Bools, Float64, Int32, Int64

# The spacing is taken of this many faces, evenly drawn. Chosen by hand.
JUDGED_FACES = 20_000


def cell_numbers(cells: Int64 | Int32) -> Int64:
    """Return one integer per cell; its order is that of the cells by first, then second ... coordinate.

    Integers are sorted 17 times as fast as rows, and sorting a million rows keeps signals waiting for 2 s.

    Args:
        cells: (n, k) integer coordinates; their bounding box holds fewer than 2^63 cells.

    Returns:
        (n,) int64; equal cells have equal numbers.
    """
    if not len(cells):
        return np.zeros(0, np.int64)
    shifted = cells.astype(np.int64) - cells.min(axis=0).astype(np.int64)
    numbers = shifted[:, 0]
    for axis in range(1, shifted.shape[1]):
        numbers = numbers * (shifted[:, axis].max() + 1) + shifted[:, axis]
    return np.asarray(numbers)


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
        owner: (v,) int64, for each vertex of the mesh the index of its cell's point.
    """

    points: Float64
    normals: Float64
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
    _, owner, counts = np.unique(cell_numbers(of_points), return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    points, mean_normals = np.zeros((2, len(counts), 3))
    for axis in range(3):
        points[:, axis] = np.bincount(owner, weights=points_world[:, axis], minlength=len(counts)) / counts
        mean_normals[:, axis] = np.bincount(owner, weights=normals_world[:, axis], minlength=len(counts))
    mean_normals /= np.maximum(np.linalg.norm(mean_normals, axis=1, keepdims=True), 1e-12)
    return SurfacePoints(points, mean_normals, owner)


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


def connected(points: Float64, cell_m: float, through_faces: bool = False) -> Int32:
    """Label each point with the connected piece of cells that it belongs to.

    Args:
        points: (n, 3), metres, n > 0.
        cell_m: edge of the cubic cells, metres; touching cells with points in them are connected.
        through_faces: whether touching cells must share a face; else a corner suffices.

    Returns:
        (n,) int32, the piece's number, from 1; pieces are in the order of their first cell by x, then y, z.
    """
    which, pairs = touching_cells(points, cell_m, through_faces)
    labels: Int32 = pieces_of_cells(pairs, int(which.max()) + 1) + np.int32(1)
    return labels[which]


def touching_cells(points: Float64, cell_m: float, through_faces: bool = False) -> tuple[Int64, Int64]:
    """Return the cell of each point, and the pairs of cells with points that touch.

    Args:
        points: (n, 3), metres, n > 0; their bounding box holds fewer than 2^63 cells.
        cell_m: edge of the cells, metres.
        through_faces: whether cells must share a face to touch; else an edge or a corner suffices.

    Returns:
        (n,) index of each point's cell among the cells with points, sorted by x, then y, then z; and (k, 2)
        indices of touching cells.
    """
    cells = np.floor(points / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    # An empty cell at the end of each row: the first of one row does not touch the last of the row before.
    _, rows, columns = (cells.max(axis=0) + 2).tolist()
    strides = np.array([rows * columns, columns, 1])
    found, which = np.unique(cells @ strides, return_inverse=True)
    pairs = []
    for step in product((-1, 0, 1), repeat=3):
        if step <= (0, 0, 0) or (through_faces and sum(map(abs, step)) > 1):
            continue
        wanted = found + np.array(step) @ strides
        at = np.minimum(np.searchsorted(found, wanted), len(found) - 1)
        (here,) = np.nonzero(found[at] == wanted)
        pairs.append(np.stack([here, at[here]], axis=-1))
    return which.reshape(-1), np.concatenate(pairs)


def pieces_of_cells(pairs: Int64, count: int) -> Int32:
    """Label each cell with its connected piece: (count,), from 0, in the order of the pieces' first cells.

    Args:
        pairs: (k, 2) indices of cells that touch.
        count: number of cells.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    joins = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(joins, directed=False)[1], np.int32)


def far_apart(points: Float64, most_m: float) -> Bools:
    """Return which points (n, 3), n > 0, are not in the largest group; groups are over `most_m` apart."""
    label = connected(points, most_m)
    return np.asarray(label != np.argmax(np.bincount(label)))
