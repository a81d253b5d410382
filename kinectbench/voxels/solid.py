"""A closed triangle mesh to a solid voxel grid, by signed-winding scanlines."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Grid, transform_points

# Vertices are snapped to 2^-16 of a cell, so that the inside tests on shared edges are exact integers.
SUBCELL = 1 << 16


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
    cells = transform_points(grid.T_grid_world, vertices_world) / grid.voxel_size_m
    return np.asarray(_scan(cells, np.ascontiguousarray(faces, dtype=np.int32), *grid.shape))


@numba.njit(cache=True, error_model="numpy")
def _scan(cells, faces, nx, ny, nz):  # type: ignore[no-untyped-def]
    crossings = np.zeros((nx, ny, nz), np.int8)
    fixed = np.empty((len(cells), 2), np.int64)
    for n in range(len(cells)):
        # Column centres lie on whole multiples of SUBCELL.
        fixed[n, 0] = np.int64(np.floor((cells[n, 0] - 0.5) * SUBCELL + 0.5))
        fixed[n, 1] = np.int64(np.floor((cells[n, 1] - 0.5) * SUBCELL + 0.5))
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, bx, by, cx, cy = fixed[a, 0], fixed[a, 1], fixed[b, 0], fixed[b, 1], fixed[c, 0], fixed[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        # A face that looks up ends the solid below it, one that looks down begins it.
        sign = -1
        if area < 0:
            b, c, bx, by, cx, cy = c, b, cx, cy, bx, by
            area = -area
            sign = 1
        i0 = max(0, -((-min(ax, bx, cx)) // SUBCELL))
        i1 = min(nx - 1, max(ax, bx, cx) // SUBCELL)
        j0 = max(0, -((-min(ay, by, cy)) // SUBCELL))
        j1 = min(ny - 1, max(ay, by, cy) // SUBCELL)
        for i in range(i0, i1 + 1):
            px = i * SUBCELL
            for j in range(j0, j1 + 1):
                py = j * SUBCELL
                wa = (cx - bx) * (py - by) - (cy - by) * (px - bx)
                wb = (ax - cx) * (py - cy) - (ay - cy) * (px - cx)
                wc = area - wa - wb
                if wa < 0 or wb < 0 or wc < 0:
                    continue
                # A centre on an edge belongs to one side of it only (top-left rule).
                if wa == 0 and not (cy < by or (cy == by and cx > bx)):
                    continue
                if wb == 0 and not (ay < cy or (ay == cy and ax > cx)):
                    continue
                if wc == 0 and not (by < ay or (by == ay and bx > ax)):
                    continue
                z = (wa * cells[a, 2] + wb * cells[b, 2] + wc * cells[c, 2]) / area
                k = int(np.ceil(z - 0.5))
                if k < nz:
                    crossings[i, j, max(k, 0)] += sign
    packed = np.zeros((nx, ny, nz // 8), np.uint8)
    for i in range(nx):
        for j in range(ny):
            winding = 0
            for byte in range(nz // 8):
                bits = 0
                for bit in range(8):
                    winding += crossings[i, j, byte * 8 + bit]
                    bits = (bits << 1) | (1 if winding != 0 else 0)
                packed[i, j, byte] = bits
    return packed
