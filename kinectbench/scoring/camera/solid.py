"""Convert a predicted shape to a solid in the truth's grid; measure the solid's volume outside this grid."""

from dataclasses import dataclass

import numpy as np

from kinectbench.core import PredictionError
from kinectbench.core.geometry import Grid, poisson_surface, similarity_scale, transform_points
from kinectbench.core.types import Float64, Int32
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, pack
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.scoring.camera.kernels import inside_cells, inside_distances, mapped
from kinectbench.scoring.camera.surface import Surface
from kinectbench.scoring.camera.truth import SpaceTruth
from kinectbench.scoring.camera.winding import inside_winding
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.closed_mesh import ClosedMesh, in_cells, refuse_mesh
from kinectbench.scoring.mesh_prediction import outside_share

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
