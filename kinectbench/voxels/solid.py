"""A closed triangle mesh to a solid voxel grid, by signed-winding scanlines."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Grid
from kinectbench.voxels.crossings import SUBCELL, crossings, snapped_cells


def voxelize_solid(
    vertices_world: NDArray[np.float64], faces: NDArray[np.int32], grid: Grid
) -> NDArray[np.uint8]:
    """Which cells of a grid have their centre inside a closed mesh.

    Every column of cells along z is crossed by the triangles above and below it; a cell is inside
    where the signed crossings below its centre do not cancel (non-zero winding number). Own rule;
    exact for closed, outward-oriented meshes up to the snapping of 2^-16 cell.

    Args:
        vertices_world: (n, 3) float64, metres, world frame.
        faces: (m, 3) int32, counter-clockwise seen from outside.
        grid: where to voxelise; its last side must be a multiple of 8.

    Returns:
        (nx, ny, nz / 8) uint8: bits packed along z, most significant first.
    """
    fixed = snapped_cells(vertices_world, grid)
    return np.asarray(_fill(fixed, np.ascontiguousarray(faces, dtype=np.int32), *grid.shape))


@numba.njit(cache=True, error_model="numpy")
def _fill(fixed, faces, nx, ny, nz):  # type: ignore[no-untyped-def]
    lines, heights, signs = crossings(fixed, faces, (0, 1, 2), SUBCELL // 2, (nx, ny), False)
    first = np.zeros(nx * ny + 1, np.int64)
    for line in lines:
        first[line + 1] += 1
    first = np.cumsum(first)
    # The crossings of each column, sorted: each begins at the first centre on or above it.
    cells = np.empty(len(lines), np.int64)
    steps = np.empty(len(lines), np.int8)
    filled = first[:-1].copy()
    for n in range(len(lines)):
        cell = min(nz, max(0, int(np.ceil(heights[n] - 0.5))))
        at = filled[lines[n]]
        filled[lines[n]] += 1
        while at > first[lines[n]] and cells[at - 1] > cell:
            cells[at], steps[at] = cells[at - 1], steps[at - 1]
            at -= 1
        cells[at], steps[at] = cell, signs[n]
    packed = np.zeros((nx, ny, nz // 8), np.uint8)
    for column in range(nx * ny):
        winding = 0
        for n in range(first[column], first[column + 1] - 1):
            winding += steps[n]
            if winding != 0:
                _set(packed[column // ny, column % ny], cells[n], cells[n + 1])
        # A mesh that is not closed ends no solid: it goes on to the end of the column.
        if first[column + 1] > first[column] and winding + steps[first[column + 1] - 1] != 0:
            _set(packed[column // ny, column % ny], cells[first[column + 1] - 1], nz)
    return packed


@numba.njit(cache=True, inline="always")
def _set(row, begin, end):  # type: ignore[no-untyped-def]
    """Set the bits [begin, end) of a packed row."""
    while begin < end and begin & 7:
        row[begin >> 3] |= 128 >> (begin & 7)
        begin += 1
    while begin + 8 <= end:
        row[begin >> 3] = 255
        begin += 8
    while begin < end:
        row[begin >> 3] |= 128 >> (begin & 7)
        begin += 1
