"""The cube of a pair: where its grid lies in the world."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Grid, rigid
from kinectbench.voxels.pair_file import FULL_CELLS

# Two cells of margin on either side of the shape's longest extent.
OBJECT_SCALE = FULL_CELLS / (FULL_CELLS - 4)
VIEW_SCALE = 1.4
VIEW_FRONT_MARGIN = 0.1


def object_cube(vertices_world: NDArray[np.float64], T_world_camera: NDArray[np.float64]) -> Grid:
    """Framing `object` (the paper's): a cube centred on the full shape's box in the view's axes.

    Its side is the box's longest extent x 256/252.

    Args:
        vertices_world: (n, 3) of the full shape, metres.
        T_world_camera: (4, 4), the view.
    """
    low, high = _extent(np.ascontiguousarray(vertices_world), T_world_camera)
    return _cube((low + high) / 2, float((high - low).max()) * OBJECT_SCALE, T_world_camera)


def view_cube(points_camera: NDArray[np.float64], T_world_camera: NDArray[np.float64]) -> Grid:
    """Framing `view`: a cube from the partial view alone, so that it tells nothing of the hidden part.

    With the box of the partial's points in the view's axes (0.5 % left out on every side): side =
    1.4 x its longest extent; centred on the box in x and y; in z it begins 0.1 side in front of it.

    Args:
        points_camera: (n, 3) the view's points on the object, camera frame, metres.
        T_world_camera: (4, 4), the view.
    """
    low, high = np.quantile(points_camera, [0.005, 0.995], axis=0)
    side_m = VIEW_SCALE * float((high - low).max())
    centre = (low + high) / 2
    centre[2] = low[2] + (0.5 - VIEW_FRONT_MARGIN) * side_m
    origin_rotated = T_world_camera[:3, 3] @ T_world_camera[:3, :3]
    return _cube(centre + origin_rotated, side_m, T_world_camera)


def _cube(centre_rotated: NDArray[np.float64], side_m: float, T_world_camera: NDArray[np.float64]) -> Grid:
    """A 256-cube in the view's axes around a centre given in those axes, origin at the world's."""
    rotation = T_world_camera[:3, :3]
    corner_world = rotation @ (centre_rotated - side_m / 2)
    return Grid((FULL_CELLS,) * 3, side_m / FULL_CELLS, rigid(rotation, corner_world))


@numba.njit(cache=True)
def _extent(points_world, T_world_camera):  # type: ignore[no-untyped-def]
    """The least and the largest coordinates (3,) of points (n, 3), turned into the view's axes."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for n in range(len(points_world)):
        x, y, z = points_world[n, 0], points_world[n, 1], points_world[n, 2]
        for axis in range(3):
            turned = x * T_world_camera[0, axis] + y * T_world_camera[1, axis] + z * T_world_camera[2, axis]
            low[axis], high[axis] = min(low[axis], turned), max(high[axis], turned)
    return low, high
