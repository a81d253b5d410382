"""Convert a predicted shape to a solid in the truth's grid; measure the solid's volume outside this grid.

Open meshes become solids by generalised winding numbers. Source: A. Jacobson et al., "Robust inside-outside
segmentation using generalized winding numbers" (2013); far triangles are approximated together after G.
Barill et al., "Fast winding numbers for soups and clouds" (2018).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from kinectbench.core import PredictionError
from kinectbench.core.geometry import Grid, poisson_surface, similarity_scale, transform_points
from kinectbench.core.types import Bools, Float64, Int32
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, pack
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.scoring.camera.kernels import inside_cells, inside_distances, mapped
from kinectbench.scoring.camera.surface import Surface
from kinectbench.scoring.camera.truth import SpaceTruth
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.closed_mesh import ClosedMesh, in_cells, refuse_mesh
from kinectbench.scoring.mesh_prediction import outside_share

# Number of triangles in a leaf of the tree; 4 to 16 take the same time (chosen here).
LEAF = 4
# The triangles in a ball are approximated together if the ball is farther away than twice its radius (Barill,
# section 4).
FAR_RADII = 2.0
# The winding number is harmonic away from the triangles. So in a ball of radius R without triangles, at a
# distance r from the centre, it differs from its value at the centre by at most 1.5 r / R, if its range is at
# most 2, as where two parts overlap. Source: Schwarz's lemma for harmonic functions (Axler et al., "Harmonic
# Function Theory", chapter 6).
STEEPEST = 1.5
# Outside the grid, only the volume is needed: at most this many blocks are used along the mesh's box (chosen
# here).
BLOCKS_OUTSIDE = 64
# Longest edge, in cells, and maximum number of triangles after splitting. Near large triangles, no block can
# be decided: a chair of 230 faces took 12 s unsplit, and 4 s with edges of 16 cells; 8 cells gained less than
# a second.
LONGEST, MOST_HALVED = 16.0, 1 << 18
# Maximum number of nodes and triangles that are examined in all. Open balls, sheets, chairs, tables of 150 to
# 210,000 faces, smooth and noisy, take 0.4 to 2 billion at 256 cells (2 to 15 s of a busy core); a soup of
# 20,000 triangles across each other takes 30 or more.
MOST_STEPS = 3 * 10**9


def inside_winding(vertices: Float64, faces: Int32, side: int) -> tuple[Bools, float] | None:
    """Return the cells whose centre is inside a mesh: the winding number there is above 1/2 or below -1/2.

    So the faces of a mesh may also be oriented inwards.

    Args:
        vertices: (n, 3), in cells, from the corner of the grid.
        faces: (m, 3); the mesh may be open, self-intersecting, or a soup.
        side: number of cells of the grid along each axis.

    Returns:
        The cells, (side, side, side) bool; and the volume inside the mesh but outside the grid, in cells,
        with a resolution of about 1/64 of the mesh's box. None if it would take more than `MOST_STEPS` steps.
    """
    corners = vertices[faces]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    found = np.zeros((side,) * 3, np.bool_)
    reach = float(max((high - low).max(), 1.0))
    root = side * 2 ** max(0, int(np.ceil(np.log2(reach / side))))
    coarse = 2 ** max(0, int(np.ceil(np.log2(reach / BLOCKS_OUTSIDE))))
    outside = _fill(found, *_tree(_halved(corners)), low, high, root, coarse, MOST_STEPS)
    return None if np.isnan(outside) else (found, float(outside))


def _halved(corners: Float64) -> Float64:
    """Split triangles (n, 3, 3) until no edge exceeds `LONGEST`, but into at most `MOST_HALVED` triangles.

    Each is split at its longest edge, which does not change any winding number.
    """
    while True:
        lengths = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2)
        long = lengths.max(axis=1) > LONGEST
        if not long.any() or len(corners) + long.sum() > MOST_HALVED:
            return corners
        first = lengths[long].argmax(axis=1)
        a, b, c = (corners[long, (first + k) % 3] for k in range(3))
        middle = (a + b) / 2
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.concatenate([corners[~long], *halves])


def _tree(corners: Float64) -> tuple[Float64, Float64, Float64, Float64]:
    """Build a complete binary tree over triangles (n, 3, 3): the children of node i are 2 i and 2 i + 1.

    Returns:
        triangles: sorted, padded with triangles without area. The k leaves are the nodes from k on; node 1 is
            the root.
        total: (2 k, 3) for each node, the sum of the area-weighted normals of its triangles.
        middle: (2 k, 3) centre of a ball around the node's triangles.
        radius: (2 k,) radius of this ball.
    """
    leaves = 1 << max(0, int(np.ceil(np.log2(len(corners) / LEAF))))
    filling = np.broadcast_to(corners[-1, 0], (leaves * LEAF - len(corners), 3, 3))
    triangles = np.concatenate([corners, filling])
    middles, order = triangles.mean(axis=1), np.arange(len(triangles))[None]
    while len(order) < leaves:  # split across the longest side; stable, so that machines agree
        at = middles[order]
        along = (at.max(axis=1) - at.min(axis=1)).argmax(axis=1)
        rank = np.take_along_axis(at, along[:, None, None], axis=2)[..., 0].argsort(axis=1, kind="stable")
        order = np.take_along_axis(order, rank, axis=1).reshape(2 * len(order), -1)
    triangles = triangles[order.ravel()]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
    areas = np.linalg.norm(normals, axis=1)[:, None] + 1e-12  # no division by 0 for a node without area
    weighted = areas * triangles.mean(axis=1)
    total, middle, radius = (np.zeros((2 * leaves, *end)) for end in ((3,), (3,), ()))
    count = leaves
    while count:  # level by level, the root last
        sums = [part.reshape(count, -1, part.shape[1]).sum(axis=1) for part in (normals, areas, weighted)]
        level = slice(count, 2 * count)
        total[level], middle[level] = sums[0], sums[2] / sums[1]
        away = triangles.reshape(count, -1, 3) - middle[level, None]
        radius[level] = np.sqrt((away**2).sum(axis=2).max(axis=1))
        count //= 2
    return triangles, total, middle, radius


@njit(cache=True, error_model="numpy", nogil=True)
def _fill(found, triangles, total, middle, radius, low, high, root, coarse, most):  # type: ignore[no-untyped-def]
    """Set the cells of `found` that are inside the mesh; return the mesh's volume outside the grid, in cells.

    Space is processed in cubic blocks. A block is subdivided unless the winding number at its centre is
    certain to decide for the whole block. The result is NaN if this takes more than `most` steps.

    `triangles`, `total`, `middle` and `radius` are as `_tree` returns them; `low` and `high` (3,) are corners
    of the mesh's box. `root` is the side of the largest blocks, `coarse` that of the smallest blocks outside
    the grid.
    """
    side, outside, steps = found.shape[0], 0.0, 0
    first, last = np.floor(low / root).astype(np.int64), np.floor(high / root).astype(np.int64)
    stack = np.empty((8 * 64, 4), np.int64)
    nodes = np.empty(128, np.int64)
    for a in range(first[0], last[0] + 1):
        for b in range(first[1], last[1] + 1):
            for c in range(first[2], last[2] + 1):
                stack[0] = (a * root, b * root, c * root, root)
                top = 1
                while top:
                    top -= 1
                    i, j, k, size = stack[top]
                    if (i > high[0] or j > high[1] or k > high[2]) or (
                        i + size < low[0] or j + size < low[1] or k + size < low[2]
                    ):
                        continue
                    # A larger block at the corner contains the whole grid.
                    within = (i >= 0 and j >= 0 and k >= 0) and (i < side and j < side and k < side)
                    half = size / 2
                    number, clear, more = _number(
                        i + half, j + half, k + half, triangles, total, middle, radius, nodes
                    )
                    steps += more
                    if steps > most:
                        return np.nan
                    sure = abs(abs(number) - 0.5) * clear > STEEPEST * half * np.sqrt(3.0)
                    if not sure and size > (1 if within else coarse):
                        for child in range(8):
                            stack[top] = (
                                i + (child >> 2) * size // 2,
                                j + (child >> 1 & 1) * size // 2,
                                k + (child & 1) * size // 2,
                                size // 2,
                            )
                            top += 1
                    elif abs(number) > 0.5 and within:
                        found[i : i + size, j : j + size, k : k + size] = True
                        outside += np.float64(size) ** 3 - np.float64(min(size, side)) ** 3
                    elif abs(number) > 0.5:
                        outside += np.float64(size) ** 3
    return outside


@njit(cache=True, error_model="numpy", nogil=True)
def _number(x, y, z, triangles, total, middle, radius, nodes):  # type: ignore[no-untyped-def]
    """Return a point's winding number, a lower bound of its distance to the mesh, and the steps taken.

    `triangles`, `total`, `middle` and `radius` are as `_tree` returns them; `nodes` is overwritten.
    """
    leaves = len(total) // 2
    found, clear, top, steps = 0.0, np.inf, 1, 0
    nodes[0] = 1
    while top:
        top -= 1
        steps += 1
        node = nodes[top]
        p, q, r = middle[node, 0] - x, middle[node, 1] - y, middle[node, 2] - z
        distance = np.sqrt(p * p + q * q + r * r)
        if distance > FAR_RADII * radius[node]:
            product = total[node, 0] * p + total[node, 1] * q + total[node, 2] * r
            found += product / (distance * distance * distance)
        elif node < leaves:
            nodes[top], nodes[top + 1] = 2 * node, 2 * node + 1
            top += 2
            continue
        else:
            for n in range((node - leaves) * LEAF, (node - leaves + 1) * LEAF):
                steps += 1
                angle, near = _solid_angle(triangles[n], x, y, z)
                found += angle
                clear = min(clear, max(near, distance - radius[node]))
            continue
        clear = min(clear, distance - radius[node])
    return found / (4 * np.pi), max(clear, 0.0), steps


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _solid_angle(triangle, x, y, z):  # type: ignore[no-untyped-def]
    """Return the solid angle of a triangle seen from a point, and a lower bound of its distance to the point.

    The angle is positive if the point lies behind the triangle.

    Source: A. van Oosterom and J. Strackee, "The solid angle of a plane triangle" (1983).
    """
    a, b, c = triangle[0, 0] - x, triangle[0, 1] - y, triangle[0, 2] - z
    d, e, f = triangle[1, 0] - x, triangle[1, 1] - y, triangle[1, 2] - z
    g, h, i = triangle[2, 0] - x, triangle[2, 1] - y, triangle[2, 2] - z
    one, two = np.sqrt(a * a + b * b + c * c), np.sqrt(d * d + e * e + f * f)
    three = np.sqrt(g * g + h * h + i * i)
    across = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    below = one * two * three + (a * d + b * e + c * f) * three
    below += (d * g + e * h + f * i) * one + (g * a + h * b + i * c) * two
    longest = max((a - d) ** 2 + (b - e) ** 2 + (c - f) ** 2, (d - g) ** 2 + (e - h) ** 2 + (f - i) ** 2)
    longest = max(longest, (g - a) ** 2 + (h - b) ** 2 + (i - c) ** 2)
    # Every point of a triangle is within longest edge / sqrt 3 of one of its corners.
    return 2 * np.arctan2(across, below), min(one, two, three) - np.sqrt(longest / 3)


# Poisson reconstruction: number of samples, depth of the octree, side of its cube relative to the shape. So
# cells are 1/64 of the shape, and openings are closed (measured; docs/evidence/scoring.md, "Ways to close a
# mesh").
POISSON_SAMPLES, POISSON_DEPTH, POISSON_CUBE = 30_000, 7, 2.0


@dataclass(frozen=True)
class Solid:
    """A solid in the truth's grid.

    Attributes:
        cells: (256, 256, 32) uint8, packed: the cells whose centre is inside the solid.
        outside: volume of the solid outside the grid, in units of the truth's cells.
    """

    cells: Packed
    outside: float


def to_be_closed(shape: CameraShape, surface: Surface, close: str) -> CameraShape | None:
    """Return the mesh that `solid_in` turns into the solid of an open shape; None if there is none.

    Args:
        shape: an open mesh, or points.
        surface: the shape's surface, in the shape's frame.
        close: one of `CLOSINGS`. "winding" returns an open mesh unchanged, because `solid_in` closes it.
            "poisson" reconstructs a mesh, which is nearly always closed, from samples that have normals.
    """
    if close == "winding":
        return shape if shape.form == "mesh" else None

    if surface.normals is None:
        return None
    some = surface.chosen(np.flatnonzero(surface.normals.any(axis=1))).thinned(POISSON_SAMPLES)
    if some.normals is None or not len(some) or not np.ptp(some.points_m, axis=0).any():
        return None
    mesh = poisson_surface(some.points_m, some.normals, POISSON_DEPTH, POISSON_CUBE)
    return CameraShape("mesh", mesh.vertices, mesh.faces.astype(np.int64)) if len(mesh.faces) else None


def solid_in(
    truth: SpaceTruth,
    shape: CameraShape,
    mesh: ClosedMesh | None,
    T_grid_prediction: Float64,
    close: str | None = None,
) -> Solid | None:
    """Return a predicted solid in the truth's cells; None for points, and for an open mesh without `close`.

    A cell is set if its centre lies inside the mesh, in an occupied cell, or where the linearly interpolated
    distance is negative, depending on the shape's form.

    Args:
        truth: the truth of the view.
        shape: the predicted shape.
        mesh: result of `closed_mesh` for the shape; None if it is open or no mesh.
        T_grid_prediction: (4, 4) similarity from the shape's frame to the truth's grid frame.
        close: if not None, an open mesh is made solid by winding numbers, whatever the value.

    Raises:
        PredictionError: the mesh is too far away, or too many of its faces overlap each other.
    """
    if shape.form == "mesh" and (mesh is not None or close is not None):
        if mesh is not None:
            return _of_mesh(truth, mesh, T_grid_prediction)
        return _by_winding(truth, mapped(shape.points_m, T_grid_prediction[:3]), shape.faces.astype(np.int32))
    if shape.cells is None or shape.T_camera_grid is None or shape.voxel_size_m is None:
        return None
    T = T_grid_prediction @ shape.T_camera_grid
    # From cell coordinates of the truth to those of the prediction.
    T_cells = (
        np.diag([*[1 / shape.voxel_size_m] * 3, 1])
        @ np.linalg.inv(T)
        @ np.diag([*[truth.voxel_size_m] * 3, 1])
    )
    is_same_place = np.abs(T_cells - np.eye(4)).max() < 1e-6
    if shape.form == "voxels" and shape.cells.shape == (FULL_CELLS,) * 3 and is_same_place:
        return Solid(pack(shape.cells.astype(bool)), 0.0)
    inside = inside_cells if shape.form == "voxels" else inside_distances
    found = inside(shape.cells, np.ascontiguousarray(T_cells[:3]), FULL_CELLS)
    return Solid(pack(found), _cells_outside(truth, shape, T))


def _of_mesh(truth: SpaceTruth, mesh: ClosedMesh, T_grid_mesh: Float64) -> Solid:
    vertices_m, faces = mapped(mesh.vertices_m, T_grid_mesh[:3]), mesh.faces
    refuse_mesh(vertices_m, faces, truth.voxel_size_m)
    grid = Grid((FULL_CELLS,) * 3, truth.voxel_size_m, np.eye(4))
    vertices = vertices_m / truth.voxel_size_m
    cells = voxelize_solid(vertices_m, faces, grid)
    if vertices.min() >= 0 and vertices.max() <= FULL_CELLS:
        return Solid(cells, 0.0)
    faces, volume_m3 = mesh.outward  # a similarity keeps the orientation of faces
    volume = volume_m3 * (similarity_scale(T_grid_mesh) / truth.voxel_size_m) ** 3
    return Solid(cells, volume * outside_share(vertices, faces, FULL_CELLS))


def _by_winding(truth: SpaceTruth, vertices_m: Float64, faces: Int32) -> Solid:
    found = inside_winding(in_cells(truth.voxel_size_m, vertices_m), faces, FULL_CELLS)
    if found is None:
        raise PredictionError(f"{len(faces)} faces across each other; simplify the mesh", what="too-large")
    return Solid(pack(found[0]), found[1])


def _cells_outside(truth: SpaceTruth, shape: CameraShape, T_grid_own: Float64) -> float:
    """Return the volume of predicted cells centred outside the truth's grid, in units of its cells."""
    assert shape.cells is not None and shape.voxel_size_m is not None
    limit_m, outside = FULL_CELLS * truth.voxel_size_m, 0
    for number, plane in enumerate(shape.cells):  # one plane is in memory at a time
        occupied = np.argwhere(plane if shape.form == "voxels" else plane < 0)
        cells = np.column_stack([np.full(len(occupied), number), occupied])
        centers_m = transform_points(T_grid_own, (cells + 0.5) * shape.voxel_size_m)
        outside += int(((centers_m < 0) | (centers_m >= limit_m)).any(axis=1).sum())
    return outside * (similarity_scale(T_grid_own) * shape.voxel_size_m / truth.voxel_size_m) ** 3
