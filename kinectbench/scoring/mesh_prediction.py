"""Convert a submitted mesh to occupied voxels. The file is untrusted: its cost is bounded in advance."""

from collections.abc import Iterator
from typing import IO

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import PredictionError
from kinectbench.core.geometry import Grid, joined_vertices, outwards, why_open
from kinectbench.core.mesh_files import read_obj, read_ply
from kinectbench.core.types import Float64, Int32
from kinectbench.core.voxels.pair_file import FULL_CELLS, unpack

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
            f"the mesh is not closed ({why}); close it, submit a grid, {IN_CAMERA}", what="open-mesh"
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


# Number of triangles processed at a time; with their pieces they take some 30 MB.
AT_ONCE = 1 << 16


def outside_share(vertices: Float64, faces: Int32, side: float) -> float:
    """Return the exact share of a closed mesh's volume that lies outside the cube [0, side]^3.

    The volume is the integral of the height z over the faces, projected along z; each face counts with the
    sign of its normal's z. For the part inside, faces are cut at the cube's walls, and heights are clipped to
    [0, side].

    Args:
        vertices: (n, 3) float64, in any unit.
        faces: (m, 3) int32, all oriented outwards or all inwards.
        side: the cube's side, in the same unit.

    Returns:
        A share from 0 to 1; 1 if the mesh has no volume.

    Source: the divergence theorem. A volume that several surfaces enclose counts once for each of them.
    """
    inside = whole = 0.0
    beyond = np.asarray(((vertices < 0) | (vertices > side)).any(axis=1))
    leaves = np.asarray(beyond[faces].any(axis=1))
    for begin in range(0, len(faces), AT_ONCE):
        triangles = vertices[faces[begin : begin + AT_ONCE]]
        under = _areas(triangles) * _mean(triangles[:, :, 2])
        whole += float(under.sum())
        inside += float(under[~leaves[begin : begin + AT_ONCE]].sum())
        for piece in _within_walls(triangles[leaves[begin : begin + AT_ONCE]], side):
            inside += float((_areas(piece) * _mean(np.clip(piece[:, :, 2], 0, side))).sum())
    return 1.0 if whole == 0 else float(np.clip(1 - inside / whole, 0, 1))


def _mean(heights: Float64) -> Float64:
    """Return each row's mean: (k, 3) to (k,). `numpy.mean` takes three times as long on so short an axis."""
    mean: Float64 = (heights[:, 0] + heights[:, 1] + heights[:, 2]) / 3
    return mean


def _areas(triangles: Float64) -> Float64:
    """Return the signed areas (k,) of triangles (k, 3, 3), projected along z."""
    a, b = (triangles[:, corner, :2] - triangles[:, 0, :2] for corner in (1, 2))
    areas: Float64 = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    return areas


def _within_walls(triangles: Float64, side: float) -> Iterator[Float64]:
    """Clip triangles to 0 <= x, y <= side; yield them in pieces that cross neither z = 0 nor z = side."""
    for axis in (0, 1):
        triangles = _cut(_cut(triangles, axis, 0)[1], axis, side)[0]
    below, above = _cut(triangles, 2, 0)
    yield below
    yield from _cut(above, 2, side)


def _cut(triangles: Float64, axis: int, at: float) -> tuple[Float64, Float64]:
    """Cut triangles (k, 3, 3) where coordinate `axis` equals `at`; return the pieces below and above."""
    height = triangles[:, :, axis] - at
    up, down = height > 0, height < 0
    count = np.add(np.add(up[:, 0], up[:, 1], dtype=np.int8), up[:, 2])
    mixed = (count > 0) & (down[:, 0] | down[:, 1] | down[:, 2])
    if not mixed.any():
        return triangles[count == 0], triangles[count > 0]
    below, above = triangles[~mixed & (count == 0)], triangles[~mixed & (count > 0)]
    # The corner that is alone on its side comes first; the orientation is kept.
    one_up = count[mixed] == 1
    alone = np.where(one_up, up[mixed].argmax(axis=1), up[mixed].argmin(axis=1))
    order = (alone[:, None] + np.arange(3)) % 3
    rows = np.arange(len(order))[:, None]
    corners, heights = triangles[mixed][rows, order], height[mixed][rows, order]
    a, b, c = (corners[:, n] for n in range(3))
    p, q = (
        a + (end - a) * (heights[:, :1] / (heights[:, :1] - heights[:, [n]])) for n, end in ((1, b), (2, c))
    )
    tip = np.stack([a, p, q], axis=1)
    remainder = np.concatenate([np.stack([p, b, c], axis=1), np.stack([p, c, q], axis=1)])
    twice = np.concatenate([one_up, one_up])
    return (
        np.concatenate([below, tip[~one_up], remainder[twice]]),
        np.concatenate([above, tip[one_up], remainder[~twice]]),
    )
