"""What one view says about the cells of its grid: the partial shape, and what the view has seen.

The grid's axes are the view's optical axes, so camera and grid frames differ by a shift only.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, Grid, transform_points
from kinectbench.geometry.depth_noise import depth_sigma_m


def depth_cells(
    depth_m: NDArray[np.float32],
    mask: NDArray[np.bool_],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    grid: Grid,
) -> NDArray[np.int64]:
    """The cells, also beyond the grid's bounds, that each pixel of a view's masked depth falls into.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        mask: (height, width) bool, pixels of the object.
        camera: intrinsics.
        T_world_camera: (4, 4).
        grid: any grid in the world.

    Returns:
        (n, 3) int64, one row a pixel.
    """
    points_camera = camera.backproject(depth_m)[mask & (depth_m > 0)]
    points_grid = transform_points(grid.T_grid_world @ T_world_camera, points_camera)
    cells: NDArray[np.int64] = np.floor(points_grid / grid.voxel_size_m).astype(np.int64)
    return cells


def occupy(cells: NDArray[np.int64], shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """A grid with the cells (n, 3) set; cells beyond its bounds are left out."""
    inside = np.all((cells >= 0) & (cells < np.array(shape)), axis=1)
    occupied = np.zeros(shape, dtype=bool)
    occupied[tuple(cells[inside].T)] = True
    return occupied


def seen_cells(
    depth_m: NDArray[np.float32], camera: Camera, T_world_camera: NDArray[np.float64], grid: Grid
) -> NDArray[np.uint8]:
    """Cells in the view's frustum with a valid depth d and z <= d + 2 sigma(d) + one voxel.

    The whole image counts, unmasked; a pixel without depth sees nothing.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        camera: intrinsics.
        T_world_camera: (4, 4); must have the grid's orientation.
        grid: a grid in the view's optical axes.

    Returns:
        (nx, ny, nz / 8) uint8, packed along z.
    """
    offset_m = (grid.T_world_grid[:3, 3] - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    reach_m = np.where(depth_m > 0, depth_m + 2 * depth_sigma_m(depth_m) + grid.voxel_size_m, -np.inf)
    x, y, z = (offset_m[axis] + (np.arange(grid.shape[axis]) + 0.5) * grid.voxel_size_m for axis in range(3))
    ahead = np.maximum(z, 1e-6)
    columns = np.rint(camera.fx * x[:, None] / ahead + camera.cx)
    rows = np.rint(camera.fy * y[:, None] / ahead + camera.cy)
    columns = np.where((columns >= 0) & (columns < camera.width) & (z > 0), columns, -1).astype(np.int32)
    rows = np.where((rows >= 0) & (rows < camera.height) & (z > 0), rows, -1).astype(np.int32)
    return np.asarray(_seen(reach_m, columns, rows, z))


@numba.njit(cache=True, error_model="numpy")
def _seen(reach, columns, rows, z):  # type: ignore[no-untyped-def]
    nx, ny, nz = columns.shape[0], rows.shape[0], columns.shape[1]
    packed = np.zeros((nx, ny, nz // 8), np.uint8)
    for i in range(nx):
        for j in range(ny):
            for byte in range(nz // 8):
                bits = 0
                for k in range(byte * 8, byte * 8 + 8):
                    u, v = columns[i, k], rows[j, k]
                    bits = (bits << 1) | (1 if u >= 0 and v >= 0 and z[k] <= reach[v, u] else 0)
                packed[i, j, byte] = bits
    return packed
