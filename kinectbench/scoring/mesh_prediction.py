"""A submitted mesh as occupied voxels. The file is untrusted: what it costs is known before it is spent."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import PredictionError
from kinectbench.core.geometry import Grid
from kinectbench.core.untrusted import read_plain
from kinectbench.core.voxels.pair_file import FULL_CELLS, unpack
from kinectbench.scoring.mesh_files import read_obj, read_ply

MESHES = (".ply", ".obj")
READERS = {"ply": read_ply, "obj": read_obj}
MAX_MESH_BYTES = 64 << 20
MAX_FAR = 16  # grid sides
MAX_CROSSINGS = 1 << 24
MAX_IN_A_COLUMN = 4096


def voxelised(path: Path, voxel_size_m: float) -> NDArray[np.bool_]:
    """The cells whose centre is inside a closed mesh.

    Args:
        path: .ply or .obj, in grid coordinates and metres: the grid's corner is the origin.
        voxel_size_m: of the pair's 256-grid.

    Returns:
        (256, 256, 256) bool. What lies beyond the grid is cut off.

    Raises:
        OSError: it cannot be read, or is no plain file.
        PredictionError: not a readable, closed, evenly oriented mesh, or one that would cost too much;
            without the file's name.
    """
    from kinectbench.core.voxels.solid import voxelize_solid

    content = read_plain(path, MAX_MESH_BYTES)
    mesh = _parsed(content, path.suffix[1:])
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    grid = Grid((FULL_CELLS,) * 3, voxel_size_m, np.eye(4))
    _refuse_far(vertices, grid)
    _refuse_costly(vertices[:, :2] / voxel_size_m, faces)
    if not mesh.is_watertight or not mesh.is_winding_consistent:
        raise PredictionError("the mesh is not closed, or not oriented alike; close it, or submit a grid")
    return unpack(voxelize_solid(vertices, faces, grid))


def _parsed(content: bytes, kind: str) -> Any:
    """The mesh, vertices at the same place made one, as trimesh's."""
    import trimesh

    try:
        vertices, triangles = READERS[kind](content)
    except ValueError as error:
        raise PredictionError(f"not a readable {kind} mesh: {error}") from None
    with np.errstate(all="ignore"):
        mesh = trimesh.Trimesh(vertices, triangles, process=False)
        mesh.merge_vertices()
    return mesh


def _refuse_far(vertices: NDArray[np.float64], grid: Grid) -> None:
    far = MAX_FAR * float(grid.size_m[0])
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > far:
        raise PredictionError(
            f"vertices beyond {far:.3g} m; write the mesh in metres from the corner of the pair's grid"
        )


def _refuse_costly(vertices_cells: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
    """Bound the columns of cells that each face can cross, by its rectangle."""
    corners = np.clip(vertices_cells, -1, FULL_CELLS)[faces]  # (m, 3, 2)
    low = np.floor(corners.min(axis=1)).astype(np.int64) + 1
    high = np.floor(corners.max(axis=1)).astype(np.int64) + 2
    total = int(((high - low)[:, 0] * (high - low)[:, 1]).sum())
    steps = np.zeros((FULL_CELLS + 3, FULL_CELLS + 3), np.int64)
    for x, y, sign in ((low, low, 1), (high, high, 1), (low, high, -1), (high, low, -1)):
        np.add.at(steps, (x[:, 0], y[:, 1]), sign)
    if total > MAX_CROSSINGS or steps.cumsum(axis=0).cumsum(axis=1).max() > MAX_IN_A_COLUMN:
        raise PredictionError(f"{len(faces)} faces across each other; simplify the mesh, or submit a grid")
