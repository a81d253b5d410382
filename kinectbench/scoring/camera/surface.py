"""A surface as samples with areas, on small flat patches, from which distances of points are measured.

Rules of this project: the patches of a mesh are its triangles. The patches of occupied cells are the faces
between occupied and free cells. The patches of signed distances are squares of one cell's size at the zero
crossings. A point of a cloud has no patch.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

from kinectbench.core import PredictionError
from kinectbench.core.geometry import invert_similarity, similarity_scale
from kinectbench.core.types import Bools, Float32, Float64, Int64
from kinectbench.core.voxels.pair_file import pack
from kinectbench.scoring.camera.kernels import faces_of_cells, mapped, outward, to_patches, zero_crossings
from kinectbench.scoring.camera.nearest import Samples
from kinectbench.scoring.camera_shape import CameraShape

# Number of samples of a mesh, of which each triangle has at least one. They are 5 mm apart on a chair of 1.5
# m^2 (chosen here; in the test of a mesh, distances are within 0.05 mm of exact ones).
MESH_SAMPLES = 60_000
# Share of the mean triangle's area. All smaller triangles together have at most this share of the whole area.
DUST = 0.01
# Maximum number of samples of cells, at some 250 bytes each. A cube that fills a grid of 512 a side has 1.6
# M.
MOST_SAMPLES = 2 << 20
# Steps of the sequence that places samples within a triangle. Source: M. Roberts, "The unreasonable
# effectiveness of quasirandom sequences" (2018): the inverse powers of the plastic number.
STEPS = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True)
class Surface:
    """Samples of a surface, metres, and the patches that they lie on.

    Attributes:
        points_m: (n, 3) the samples.
        areas: (n,) the area that each sample represents, square metres; 1 for points of a cloud.
        normals: (n, 3) unit normals, 0 where undefined; None for a cloud without normals.
        corner: (m, 3) one corner of each patch; (0, 3) for a cloud.
        first: (m, 3) an edge from that corner.
        second: (m, 3) the other edge from that corner.
        owner: (n,) index of each sample's patch.
        is_triangle: whether patches are triangles; otherwise they are rectangles.
        placed: for a transformed surface, (original surface, (4, 4) similarity from its frame), else None;
            the patches are in the original's frame, and its search tree is reused.
    """

    points_m: Float64
    areas: Float64
    normals: Float64 | None
    corner: Float64
    first: Float64
    second: Float64
    owner: Int64
    is_triangle: bool
    placed: "tuple[Surface, Float64] | None" = None

    def __len__(self) -> int:
        return len(self.points_m)

    @cached_property
    def samples(self) -> Samples:
        """The samples in a search tree, for nearest-neighbour queries."""
        return Samples(np.ascontiguousarray(self.points_m))

    @cached_property
    def center_m(self) -> Float64:
        """Area-weighted mean of the samples: (3,)."""
        center: Float64 = (self.areas[:, None] * self.points_m).sum(axis=0) / self.areas.sum()
        return center

    @cached_property
    def spread_m(self) -> float:
        """Area-weighted root mean square distance of the samples from their mean, metres."""
        squared = ((self.points_m - self.center_m) ** 2).sum(axis=1)
        return float(np.sqrt((self.areas * squared).sum() / self.areas.sum()))

    def chosen(self, which: Bools | Int64) -> "Surface":
        """Return the surface with only the samples that a mask or indices select; all patches stay."""
        if which.dtype == np.bool_:  # indexing by numbers takes half the time (measured)
            which = np.flatnonzero(which)
        if self.placed is not None:
            before, T = self.placed
            return before.chosen(which).transformed(T)
        normals = None if self.normals is None else self.normals[which]
        return replace(
            self,
            points_m=self.points_m[which],
            areas=self.areas[which],
            normals=normals,
            owner=self.owner[which],
        )

    @cached_property
    def drawn(self) -> dict[int, Int64]:
        """Cache of `metrics`: {number of samples: indices of the samples drawn to be measured}."""
        return {}

    @cached_property
    def _fewer(self) -> dict[int, "Surface"]:
        return {}

    def thinned(self, most: int) -> "Surface":
        """Return the surface with every k-th sample, at most `most` in all; the result is cached."""
        step = -(-len(self) // most)
        if step > 1 and most not in self._fewer:
            self._fewer[most] = self.chosen(np.arange(step // 2, len(self), step))
        return self._fewer[most] if step > 1 else self

    def transformed(self, T: Float64) -> "Surface":
        """Return the surface mapped by a similarity (4, 4)."""
        before, T_before = self.placed or (self, np.eye(4))
        scale = similarity_scale(T)
        return replace(
            self,
            points_m=mapped(self.points_m, T[:3]),
            areas=self.areas * scale**2 if len(self.corner) else self.areas,
            normals=None if self.normals is None else mapped(self.normals, T[:3] * [*[1 / scale] * 3, 0.0]),
            placed=(before, T @ T_before),
        )

    def nearest(self, points_m: Float64) -> tuple[Float64, Int64]:
        """Return each point's distance from the surface (n,), metres, and its nearest sample's index (n,).

        The distance is measured to the patch that the nearest sample lies on; for a cloud, to the sample.
        """
        before, T = self.placed or (self, np.eye(4))
        asked = mapped(points_m, invert_similarity(T)[:3]) if self.placed else np.ascontiguousarray(points_m)
        distances, found = before.samples.nearest(asked)
        if len(self.corner):
            owner = self.owner[found]
            distances = to_patches(asked, owner, self.corner, self.first, self.second, self.is_triangle)
        return distances * similarity_scale(T), found


def surface_of(shape: CameraShape) -> Surface:
    """Return the surface of a predicted shape, in the shape's frame.

    Raises:
        PredictionError: the surface of cells or distances has more than `MOST_SAMPLES` patches.
    """
    if shape.form == "mesh":
        return mesh_surface(shape.points_m, shape.faces)
    if shape.cells is None or shape.T_camera_grid is None or shape.voxel_size_m is None:
        return point_surface(shape.points_m, shape.normals)
    if shape.form == "voxels":
        own = cell_surface(shape.cells.astype(bool), shape.voxel_size_m)[0]
    else:
        own = _distance_surface(shape.cells.astype(np.float32), shape.voxel_size_m)
    return own.transformed(shape.T_camera_grid)


def point_surface(points_m: Float64, normals: Float64 | None) -> Surface:
    """Return points (n, 3), metres, without duplicates, as a surface; normals (n, 3) may have any length."""
    if len(points_m) > 1:  # remove duplicates: a tree of equal points is slow
        order = np.lexsort(points_m.T)
        again = (np.diff(points_m[order], axis=0) == 0).all(axis=1)
        kept = np.sort(order[np.concatenate([[True], ~again])])
        points_m, normals = points_m[kept], None if normals is None else normals[kept]
    if normals is not None:
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        finite = np.isfinite(lengths) & (lengths > 0)
        normals = np.where(finite, normals / np.where(finite, lengths, 1), 0.0)
    none = np.zeros((0, 3))
    owner = np.zeros(len(points_m), np.int64)
    return Surface(points_m, np.ones(len(points_m)), normals, none, none, none, owner, is_triangle=False)


def mesh_surface(vertices_m: Float64, faces: Int64) -> Surface:
    """Return a mesh, open or closed, as a surface: one sample per triangle, several in a large triangle.

    Triangles smaller than `DUST` times the mean area are dropped. Otherwise a mesh could gain by scattering
    tiny triangles: some would lie near any truth, and the area of the others, which counts as wrong, would be
    almost 0.

    Args:
        vertices_m: (v, 3) metres.
        faces: (m, 3) indices of the vertices.
    """
    corner, ahead, behind = (vertices_m[faces[:, n]] for n in range(3))
    first, second = ahead - corner, behind - corner
    across = np.cross(first, second)
    twice = np.linalg.norm(across, axis=1)
    kept = np.flatnonzero(twice >= DUST * twice.mean())
    if len(kept) < len(faces):
        faces, twice = faces[kept], twice[kept]
        corner, first, second, across = (part[kept] for part in (corner, first, second, across))
    normals = across / np.where(twice > 0, twice, 1)[:, None]
    total = twice.sum()
    # If a mesh has no area at all, all triangles count the same.
    areas = twice / 2 if total > 0 else np.ones(len(faces))
    most = MESH_SAMPLES if total > 0 else 0
    counts = np.maximum(1, np.rint(areas / areas.sum() * most)).astype(np.int64)
    points, owner = in_triangles(counts, corner, first, second, STEPS)
    return Surface(
        points, (areas / counts)[owner], normals[owner], corner, first, second, owner, is_triangle=True
    )


def cell_surface(cells: Bools, voxel_size_m: float) -> tuple[Surface, Int64]:
    """Return the faces between occupied and free cells as a surface, in the grid's frame.

    A normal points away from the occupied cells among the 7^3 cells around the face's cell. Faces form steps
    on an oblique surface, so a sample's area is its share of the oblique surface, not the area of its face.

    Args:
        cells: (i, j, k) bool.
        voxel_size_m: edge of a cell.

    Returns:
        The surface, and the indices (n, 3) of each face's occupied cell.
    """
    low, high = _box(cells)
    part = cells[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    packed = pack(np.pad(part, 1))
    inside, axes, signs = faces_of_cells(packed)
    _refuse_many(len(inside))
    normals = outward(packed, inside)
    centers_m, corner, first, second = squares_of_cells(inside, axes, signs, low, voxel_size_m)
    return _squares(centers_m, corner, first, second, normals, voxel_size_m), inside + low


def _distance_surface(cells: Float32, voxel_size_m: float) -> Surface:
    """Return the zero crossings of signed distances (i, j, k), negative inside, as a surface: grid frame.

    Space outside the grid is free, so a solid that extends beyond the grid is closed at the border.
    """
    padded = np.pad(cells, 1, constant_values=np.float32(np.abs(cells).max()))
    found = [zero_crossings(padded, axis) for axis in range(3)]
    points, normals = (np.concatenate(parts) for parts in zip(*found, strict=True))
    _refuse_many(len(points))
    # Two directions perpendicular to the normal, from the axis that is least parallel to it.
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    second = np.cross(normals, first)
    corner = (points - 0.5 - (first + second) / 2) * voxel_size_m
    centers_m, first, second = (part * voxel_size_m for part in (points - 0.5, first, second))
    return _squares(centers_m, corner, first, second, normals, voxel_size_m)


def _refuse_many(samples: int) -> None:
    if samples > MOST_SAMPLES:
        raise PredictionError(
            f"{samples} faces of cells at its surface: noise? reduce the grid", what="too-large"
        )


def _squares(
    centers_m: Float64,
    corner: Float64,
    first: Float64,
    second: Float64,
    normals: Float64,
    voxel_size_m: float,
) -> Surface:
    """Return squares of a cell's size as a surface, one sample each; arguments as fields of `Surface`.

    A sample's area is that of the oblique surface that its square represents, not that of the square.
    """
    # A plane with this normal has this many faces or crossings per area of a cell's face.
    steps = np.abs(normals).sum(axis=1)
    areas, owner = voxel_size_m**2 / np.where(steps > 0, steps, 1), np.arange(len(centers_m))
    return Surface(centers_m, areas, normals, corner, first, second, owner, is_triangle=False)


def _box(cells: Bools) -> tuple[Int64, Int64]:
    """Return the first index of occupied cells along each axis, and the last + 1: (3,) each; 0 if none."""
    columns = np.asarray(cells.any(axis=2))
    if not columns.any():
        return np.zeros(3, np.int64), np.zeros(3, np.int64)
    found = [
        np.flatnonzero(here) for here in (columns.any(axis=1), columns.any(axis=0), cells.any(axis=(0, 1)))
    ]
    return np.array([one[0] for one in found]), np.array([one[-1] + 1 for one in found])


@njit(cache=True, error_model="numpy", nogil=True)
def squares_of_cells(inside, axes, signs, low, size: float):  # type: ignore[no-untyped-def]
    """Return faces of cells as squares; coordinates are in the unit of `size`.

    Args:
        inside: (n, 3) index of the occupied cell of each face, relative to the cell `low`.
        axes: (n,) the axis normal to each face.
        signs: (n,) 1 if the free cell has the larger index along that axis, else -1.
        low: (3,) index of the first cell.
        size: edge of a cell.

    Returns:
        Four arrays (n, 3) float64: centres; one corner of each square; the two edges from that corner.
    """
    centers, corner = np.empty(inside.shape), np.empty(inside.shape)
    first, second = np.zeros(inside.shape), np.zeros(inside.shape)
    for n in range(len(inside)):
        across, along, beside = axes[n], (axes[n] + 1) % 3, (axes[n] + 2) % 3
        for axis in range(3):
            at = inside[n, axis] + low[axis] + 0.5 + (0.5 * signs[n] if axis == across else 0.0)
            centers[n, axis] = at * size
            corner[n, axis] = (at - (0.0 if axis == across else 0.5)) * size
        first[n, along] = second[n, beside] = size
    return centers, corner, first, second


@njit(cache=True, error_model="numpy", nogil=True)
def in_triangles(counts, corner, first, second, steps):  # type: ignore[no-untyped-def]
    """Place samples in triangles: one at the centroid, or several by a low-discrepancy sequence.

    Args:
        counts: (m,) number of samples in each triangle.
        corner: (m, 3) one corner of each triangle.
        first: (m, 3) an edge from that corner.
        second: (m, 3) the other edge from that corner.
        steps: the increments (2,) of the sequence, along the two edges.

    Returns:
        (n, 3) float64, the samples; (n,) int64, the index of each sample's triangle.
    """
    points, owner, n = np.empty((counts.sum(), 3)), np.empty(counts.sum(), np.int64), 0
    for f in range(len(counts)):
        for number in range(counts[f]):
            u, v = (0.5 + number * steps[0]) % 1, (0.5 + number * steps[1]) % 1
            if u + v > 1:
                u, v = 1 - u, 1 - v
            if counts[f] == 1:
                u = v = 1 / 3
            for axis in range(3):
                points[n, axis] = corner[f, axis] + u * first[f, axis] + v * second[f, axis]
            owner[n] = f
            n += 1
    return points, owner
