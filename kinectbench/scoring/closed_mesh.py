"""Find whether a predicted mesh is closed, and refuse meshes that cannot be made solid."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kinectbench.core import PredictionError
from kinectbench.core.geometry import is_closed, joined_vertices, outwards, why_open
from kinectbench.core.types import Float64, Int32
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.mesh_prediction import MAX_FAR


@dataclass(frozen=True)
class ClosedMesh:
    """A mesh in which every edge has two faces; vertices (n, 3), faces (m, 3)."""

    vertices_m: Float64
    faces: Int32

    @cached_property
    def outward(self) -> tuple[Int32, float]:
        """The faces, with each connected piece oriented outwards, and the volume that they enclose, m^3."""
        faces = outwards(self.vertices_m, self.faces)
        a, b, c = (self.vertices_m[faces[:, corner]] for corner in range(3))
        return faces, abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6


def closed_mesh(shape: CameraShape) -> ClosedMesh | None:
    """Return a shape's mesh, duplicate vertices merged; None if the mesh is open, or the shape is no mesh."""
    if shape.form != "mesh":
        return None
    vertices, faces = joined_vertices(shape.points_m, shape.faces.astype(np.int32))
    return ClosedMesh(vertices, faces) if is_closed(faces) else None


def open_because(shape: CameraShape) -> str:
    """Return why a predicted mesh is not closed, in words; "" if it is closed, or the shape is no mesh."""
    if shape.form != "mesh":
        return ""
    return why_open(joined_vertices(shape.points_m, shape.faces.astype(np.int32))[1])


def refuse_mesh(vertices_m: Float64, faces: Int32, voxel_size_m: float) -> None:
    """Refuse a mesh that cannot be made solid in the cells of the truth.

    Args:
        vertices_m: (n, 3) in the frame of the truth's grid, metres.
        faces: (m, 3).
        voxel_size_m: edge of a cell.

    Raises:
        PredictionError: the mesh is too far away, or too many of its faces overlap each other.
    """
    from kinectbench.core.voxels.solid import costs_too_much

    vertices = in_cells(voxel_size_m, vertices_m)
    if costs_too_much(vertices[:, :2], faces, (FULL_CELLS, FULL_CELLS)):
        raise PredictionError(f"{len(faces)} faces across each other; simplify the mesh", what="too-large")


def in_cells(voxel_size_m: float, vertices_m: Float64) -> Float64:
    """Convert vertices (n, 3) from metres to units of the truth's cells.

    Raises:
        PredictionError: a coordinate is more than 16 times the grid's side.
    """
    vertices = vertices_m / voxel_size_m
    if np.abs(vertices).max() > MAX_FAR * FULL_CELLS:
        far_m = MAX_FAR * FULL_CELLS * voxel_size_m
        raise PredictionError(
            f"lies more than {far_m:.3g} m from the object; `kinectbench check` finds wrong units and axes",
            what="far-off",
        )
    return vertices
