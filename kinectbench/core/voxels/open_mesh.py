"""Convert a triangle mesh, which need not be closed, to a solid voxel grid by the paper authors' rule."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Grid
from kinectbench.core.types import Float64, Int32
from kinectbench.core.voxels.solid import SUBCELL, crossings, snapped_cells


def voxelize_open(vertices_world: Float64, faces: Int32, grid: Grid) -> NDArray[np.uint8]:
    """Return the cells on a mesh's surface, or enclosed by it along all axes.

    A cell is occupied if an edge of its cube crosses a face, or if the rays from its centre along +x, -x,
    +y, -y, +z and -z all hit one. Faces may lie anywhere, be open, doubled or turned inside out. Edges and
    faces are taken with their ends, so a face in the plane between two cells occupies both; a face seen
    edge-on is not hit. Vertices are snapped to 2^-16 cell.

    Source: the rule of the paper's authors (3D-RecGAN++, Sec. 3.6, on meshes that are not watertight). For
    a closed mesh it holds the exact solid, the surface's cells, and concave parts that are shut off along
    the three axes.

    Args:
        vertices_world: (n, 3) float64, metres, world frame.
        faces: (m, 3) int32, in any orientation.
        grid: where to voxelise; its last side must be a multiple of 8. What lies beyond the grid still
            shuts off cells within.

    Returns:
        (nx, ny, nz / 8) uint8: bits packed along z, most significant first.
    """
    fixed = snapped_cells(vertices_world, grid)
    triangles = np.ascontiguousarray(faces, dtype=np.int32)
    packed = voxelize_surface(vertices_world, faces, grid)
    x = _between(fixed, triangles, (1, 2, 0), grid.shape)
    y = _between(fixed, triangles, (0, 2, 1), grid.shape)
    z = _between(fixed, triangles, (0, 1, 2), grid.shape)
    _mark_enclosed(*x, *y, *z, packed)
    return packed


def voxelize_surface(vertices_world: Float64, faces: Int32, grid: Grid) -> NDArray[np.uint8]:
    """Return the cells whose edges cross a face of the mesh; arguments and result as in `voxelize_open`."""
    fixed = snapped_cells(vertices_world, grid)
    triangles = np.ascontiguousarray(faces, dtype=np.int32)
    packed = np.zeros((grid.shape[0], grid.shape[1], grid.shape[2] // 8), np.uint8)
    for u, v, w in ((1, 2, 0), (0, 2, 1), (0, 1, 2)):
        _mark_edges(fixed, triangles, (u, v, w), grid.shape, packed)
    return packed


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _mark_edges(fixed, faces, axes, shape, packed):  # type: ignore[no-untyped-def]
    """Set the four cells around every cell edge along w that crosses a face; arguments as in `crossings`."""
    u, v, w = axes
    nu, nv, nw = shape[u], shape[v], shape[w]
    lines, heights, _ = crossings(fixed, faces, axes, 0, (nu + 1, nv + 1), True)
    cell = np.empty(3, np.int64)
    for n in range(len(lines)):
        i, j = lines[n] // (nv + 1), lines[n] % (nv + 1)
        # A crossing on a corner is the end of two edges.
        for k in range(max(0, int(np.ceil(heights[n])) - 1), min(nw - 1, int(np.floor(heights[n]))) + 1):
            cell[w] = k
            for cell[u] in range(max(0, i - 1), min(nu, i + 1)):
                for cell[v] in range(max(0, j - 1), min(nv, j + 1)):
                    packed[cell[0], cell[1], cell[2] >> 3] |= 128 >> (cell[2] & 7)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _between(fixed, faces, axes, shape):  # type: ignore[no-untyped-def]
    """In each row of cells along w, find the cells whose centre lies between two crossings of the mesh.

    Arguments as in `crossings`.

    Returns:
        first, last: (nu, nv) int16, indices of the first and the last such cell; first > last: none.
    """
    u, v, w = axes
    nu, nv, nw = shape[u], shape[v], shape[w]
    lines, heights, _ = crossings(fixed, faces, axes, SUBCELL // 2, (nu, nv), True)
    first = np.full(nu * nv, np.int16(nw))
    last = np.full(nu * nv, np.int16(-1))
    for n in range(len(lines)):
        # The rows' centres lie at half cells.
        first[lines[n]] = min(first[lines[n]], max(0, int(np.ceil(heights[n] - 0.5))))
        last[lines[n]] = max(last[lines[n]], min(nw - 1, int(np.floor(heights[n] - 0.5))))
    return first.reshape(nu, nv), last.reshape(nu, nv)


@numba.njit(cache=True, nogil=True)
def _mark_enclosed(x_first, x_last, y_first, y_last, z_first, z_last, packed):  # type: ignore[no-untyped-def]
    """Set in `packed` the cells that are enclosed along all three axes.

    `x_first` and `x_last` are the result of `_between` for w = x: a cell is enclosed along x from the first
    to the last of them. The others are the same for y and z.
    """
    nx, ny = z_first.shape
    for i in range(nx):
        for j in range(ny):
            begin, end = z_first[i, j], z_last[i, j]
            for byte in range(begin >> 3, (end >> 3) + 1):
                bits = 0
                for k in range(byte * 8, byte * 8 + 8):
                    # No branches: they could not be predicted.
                    inside = (x_first[j, k] <= i) & (i <= x_last[j, k])
                    inside &= (y_first[i, k] <= j) & (j <= y_last[i, k]) & (begin <= k) & (k <= end)
                    bits = (bits << 1) | inside
                packed[i, j, byte] |= bits
