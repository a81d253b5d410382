"""A surface as samples, each on a small flat patch: how far points are from it, and how much area each has.

Rules of this project. A mesh has its triangles as patches; occupied cells have the faces between them and
free ones; signed distances have a square of one cell at each zero crossing; a point has no extent.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kinectbench.core.errors import PredictionError
from kinectbench.core.geometry.rigid import invert_similarity, similarity_scale
from kinectbench.core.types import Bools, Float32, Float64, Int64
from kinectbench.core.voxels.pair_file import pack
from kinectbench.scoring.camera.nearest import Samples
from kinectbench.scoring.camera_shape import CameraShape

# Samples of a mesh beside one for each triangle: they are 5 mm apart on a chair of 1.5 m^2 (chosen here; the
# test of a mesh has 0.05 mm between it and exact distances).
MESH_SAMPLES = 60_000
# Of the mean triangle's area. All that is smaller has at most this share of the whole.
DUST = 0.01
# Of cells, at some 250 bytes each: a cube that fills a grid of 512 a side has 1.6 M.
MOST_SAMPLES = 2 << 20
# Steps of the sequence that places samples within a triangle. Source: M. Roberts, "The unreasonable
# effectiveness of quasirandom sequences" (2018): the inverse powers of the plastic number.
STEPS = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True)
class Surface:
    """Samples of a surface, in one frame, metres; the patches in that frame, or in the one of `placed`.

    Attributes:
        points_m: (n, 3).
        areas: (n,) what each stands for: square metres; of points 1 each.
        normals: (n, 3) of length 1, or 0 where there is none; None of points without normals.
        corner: (m, 3) a corner of each patch; (0, 3) of points.
        first: (m, 3) the edge from there.
        second: (m, 3) the other edge from there.
        owner: (n,) the patch of each sample.
        is_triangle: whether patches are triangles, else rectangles.
        placed: what it was before it was mapped, which finds its samples, and the (4, 4) from there.
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
        """The samples, to look for the nearest of many points."""
        return Samples(np.ascontiguousarray(self.points_m))

    @cached_property
    def center_m(self) -> Float64:
        """(3,) mean of the samples, by area."""
        center: Float64 = (self.areas[:, None] * self.points_m).sum(axis=0) / self.areas.sum()
        return center

    @cached_property
    def spread_m(self) -> float:
        """Root of the mean square of the distances of the samples from the middle, by area."""
        squared = ((self.points_m - self.center_m) ** 2).sum(axis=1)
        return float(np.sqrt((self.areas * squared).sum() / self.areas.sum()))

    def chosen(self, which: Bools | Int64) -> "Surface":
        """Some of the samples; patches stay."""
        if which.dtype == np.bool_:  # rows by number take half of the time (measured)
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
        """Which samples `metrics` has drawn to be measured, by how many."""
        return {}

    @cached_property
    def _fewer(self) -> dict[int, "Surface"]:
        return {}

    def thinned(self, most: int) -> "Surface":
        """About every so-manieth sample, so that at most `most` remain; these stand for all, and are kept."""
        step = -(-len(self) // most)
        if step > 1 and most not in self._fewer:
            self._fewer[most] = self.chosen(np.arange(step // 2, len(self), step))
        return self._fewer[most] if step > 1 else self

    def transformed(self, T: Float64) -> "Surface":
        """The surface mapped by a similarity (4, 4)."""
        from kinectbench.scoring.camera.kernels import mapped

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
        """The distance of points (n, 3) from the surface, metres, and the sample nearest to each.

        The distance is that from the patch of the nearest sample.
        """
        from kinectbench.scoring.camera.kernels import mapped, to_patches

        before, T = self.placed or (self, np.eye(4))
        asked = mapped(points_m, invert_similarity(T)[:3]) if self.placed else np.ascontiguousarray(points_m)
        distances, found = before.samples.nearest(asked)
        if len(self.corner):
            owner = self.owner[found]
            distances = to_patches(asked, owner, self.corner, self.first, self.second, self.is_triangle)
        return distances * similarity_scale(T), found


def surface_of(shape: CameraShape) -> Surface:
    """The surface of a predicted shape, in its frame."""
    if shape.form == "mesh":
        return mesh_surface(shape.points_m, shape.faces)
    if shape.cells is None or shape.T_camera_grid is None or shape.voxel_size_m is None:
        return point_surface(shape.points_m, shape.normals)
    if shape.form == "voxels":
        own = cell_surface(shape.cells.astype(bool), shape.voxel_size_m)[0]
    else:
        own = distance_surface(shape.cells.astype(np.float32), shape.voxel_size_m)
    return own.transformed(shape.T_camera_grid)


def point_surface(points_m: Float64, normals: Float64 | None) -> Surface:
    """A cloud of points (n, 3), metres, with normals (n, 3) of any length or without."""
    if len(points_m) > 1:  # a point that is there twice is one: a tree of equal points is slow
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
    """A mesh, closed or not: one sample at the middle of each triangle, or several in a large one.

    Triangles that are `DUST` of the mean are left out: spread through space they would find all of a truth,
    and cost nothing by their area.

    Args:
        vertices_m: (v, 3) metres.
        faces: (m, 3).
    """
    from kinectbench.scoring.camera.patches import in_triangles

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
    # Of a mesh without any area all triangles count alike.
    areas = twice / 2 if total > 0 else np.ones(len(faces))
    most = MESH_SAMPLES if total > 0 else 0
    counts = np.maximum(1, np.rint(areas / areas.sum() * most)).astype(np.int64)
    points, owner = in_triangles(counts, corner, first, second, STEPS)
    return Surface(
        points, (areas / counts)[owner], normals[owner], corner, first, second, owner, is_triangle=True
    )


def cell_surface(cells: Bools, voxel_size_m: float) -> tuple[Surface, Int64]:
    """The faces between occupied cells and free ones, in the grid's frame; and the occupied cell of each.

    Normals point away from the mass of the 7^3 cells around; the area of a face is that of the slanted
    surface that it is a step of.

    Args:
        cells: (i, j, k) bool.
        voxel_size_m: edge of a cell.

    Returns:
        The surface, and (n, 3) indices of cells.
    """
    from kinectbench.scoring.camera.kernels import faces_of_cells, outward
    from kinectbench.scoring.camera.patches import squares_of_cells

    low, high = _box(cells)
    part = cells[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    packed = pack(np.pad(part, 1))
    inside, axes, signs = faces_of_cells(packed)
    _refuse_many(len(inside))
    normals = outward(packed, inside)
    centers_m, corner, first, second = squares_of_cells(inside, axes, signs, low, voxel_size_m)
    return _squares(centers_m, corner, first, second, normals, voxel_size_m), inside + low


def distance_surface(cells: Float32, voxel_size_m: float) -> Surface:
    """The zero crossings of signed distances (i, j, k), negative inside, in the grid's frame.

    Outside the grid is free, so that a solid that goes on beyond it ends there.
    """
    from kinectbench.scoring.camera.kernels import zero_crossings

    padded = np.pad(cells, 1, constant_values=np.float32(np.abs(cells).max()))
    found = [zero_crossings(padded, axis) for axis in range(3)]
    points, normals = (np.concatenate(parts) for parts in zip(*found, strict=True))
    _refuse_many(len(points))
    # Two directions across the normal: from the axis that is least along it.
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
    """Squares with sides of a cell; each stands for what of the slanted surface it is a step of."""
    # A plane with this normal has as many steps or crossings for each cell of its area.
    steps = np.abs(normals).sum(axis=1)
    areas, owner = voxel_size_m**2 / np.where(steps > 0, steps, 1), np.arange(len(centers_m))
    return Surface(centers_m, areas, normals, corner, first, second, owner, is_triangle=False)


def _box(cells: Bools) -> tuple[Int64, Int64]:
    """The box of what is occupied: the first cells, and those after the last; of nothing both are 0."""
    columns = np.asarray(cells.any(axis=2))
    if not columns.any():
        return np.zeros(3, np.int64), np.zeros(3, np.int64)
    found = [
        np.flatnonzero(here) for here in (columns.any(axis=1), columns.any(axis=0), cells.any(axis=(0, 1)))
    ]
    return np.array([one[0] for one in found]), np.array([one[-1] + 1 for one in found])
