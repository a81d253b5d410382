"""Convert a submitted mesh to occupied voxels. The file is untrusted: its cost is bounded in advance."""

from typing import IO

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import PredictionError
from kinectbench.core.geometry import Grid, joined_vertices, outwards, why_open
from kinectbench.core.mesh_files import read_obj, read_ply
from kinectbench.core.types import Float64, Int32
from kinectbench.core.voxels.pair_file import FULL_CELLS, unpack
from kinectbench.scoring.mesh_outside import outside_share

MESHES = (".ply", ".obj")
READERS = {"ply": read_ply, "obj": read_obj}
MAX_MESH_BYTES = 64 << 20
MAX_FAR = 16  # grid sides

# How a mesh in the camera frame must be declared.
IN_CAMERA = "or declare 'frame': 'camera' in method.json"


def voxelised(file: IO[bytes], suffix: str, voxel_size_m: float) -> tuple[NDArray[np.bool_], float]:
    """Return the cells whose centre is inside a closed mesh, and the share of its volume outside the grid.

    Args:
        file: the mesh file, at most `MAX_MESH_BYTES`; coordinates are in metres from the grid's corner.
        suffix: .ply or .obj.
        voxel_size_m: edge of a voxel of the pair's 256-grid, metres.

    Returns:
        The cells, (256, 256, 256) bool; they are empty if the mesh is too thin to contain a cell's centre.
        And the share of the volume that lies outside the grid and is cut off.

    Raises:
        OSError: the file cannot be read.
        PredictionError: the mesh is unreadable, open, inconsistently oriented, too costly, too far away, or
            lies outside the grid; the message does not name the file.
    """
    from kinectbench.core.voxels.solid import costs_too_much, voxelize_solid

    grid = Grid((FULL_CELLS,) * 3, voxel_size_m, np.eye(4))
    vertices, faces = _parsed(file, suffix[1:])
    _refuse_far(vertices, grid)
    if ((vertices.max(axis=0) <= 0) | (vertices.min(axis=0) >= grid.size_m)).any():
        raise _outside(vertices, grid)
    vertices, faces = joined_vertices(vertices, faces)
    if costs_too_much(vertices[:, :2] / voxel_size_m, faces, (FULL_CELLS, FULL_CELLS)):
        raise PredictionError(
            f"{len(faces)} faces across each other; simplify the mesh, or submit a grid", what="too-large"
        )
    if why := why_open(faces):
        raise PredictionError(
            f"the mesh is not closed ({why}); close it, submit a grid, {IN_CAMERA}",
            what="open-mesh",
        )
    packed = voxelize_solid(vertices, faces, grid)
    # If no vertex is more than half a cell beyond the grid, no cell centre is cut off.
    if np.abs(vertices / voxel_size_m - FULL_CELLS / 2).max() <= (FULL_CELLS + 1) / 2:
        return unpack(packed), 0.0
    if not packed.any():
        raise _outside(vertices, grid)
    return unpack(packed), outside_share(vertices / voxel_size_m, outwards(vertices, faces), FULL_CELLS)


def _parsed(file: IO[bytes], kind: str) -> tuple[Float64, Int32]:
    """Read the vertices (n, 3) that faces use, and the faces (m, 3), which are triangles."""
    try:
        vertices, triangles = READERS[kind](file.read(MAX_MESH_BYTES))
    except ValueError as error:
        raise PredictionError(f"not a readable {kind} mesh: {error}", what="unreadable") from None
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    return vertices[used], (np.cumsum(used, dtype=np.int32) - 1)[triangles]


def _refuse_far(vertices: Float64, grid: Grid) -> None:
    far = MAX_FAR * float(grid.size_m[0])
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > far:
        raise PredictionError(
            f"vertices beyond {far:.3g} m; write the mesh in metres from the corner of the pair's grid",
            what="far-off",
        )


def _outside(vertices: Float64, grid: Grid) -> PredictionError:
    """Return the error for a mesh that lies outside the grid; its message states where the mesh lies."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    box = ", ".join(f"{axis} {a:.3g} to {b:.3g}" for axis, a, b in zip("xyz", low, high, strict=True))
    return PredictionError(
        f"the mesh lies outside the cube of its pair ({box} m, the cube is 0 to {grid.size_m[0]:.3g}): in "
        "another frame? Write it in metres from the corner of the pair's grid, in the grid's axes, "
        f"{IN_CAMERA}",
        what="far-off",
    )
