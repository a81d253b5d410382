"""Meshes as a solid of few cells."""

from collections.abc import Sequence

import numpy as np

from kinectbench.core.geometry import Grid, TriangleMesh, rigid
from kinectbench.core.types import Bools
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import voxelize_solid


def solid_cells(meshes: Sequence[TriangleMesh], cells: int) -> Bools:
    """What is inside any of the closed meshes, with so many cells along the longest side and air around."""
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    low, sides_m = vertices.min(axis=0), np.ptp(vertices, axis=0)
    size_m = float(sides_m.max()) / cells
    nx, ny, nz = (int(count) + 2 for count in np.ceil(sides_m / size_m))
    # A packed byte has eight cells.
    grid = Grid((nx, ny, -(-nz // 8) * 8), size_m, rigid(np.eye(3), low - size_m))
    solids = [unpack(voxelize_solid(mesh.vertices, mesh.faces, grid)) for mesh in meshes]
    return np.asarray(np.logical_or.reduce(solids))
