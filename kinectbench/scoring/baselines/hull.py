"""Baselines from one partial view: its convex hull, carved or not, and its silhouette extruded along rays."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools
from kinectbench.core.voxels.convex_hull import filled_hull
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.scoring.baselines.inputs import Inputs

PIXELS = 512


def hull(inputs: Inputs) -> Bools:
    """Return the solid convex hull of `partial_256`: (256, 256, 256) bool.

    A cell is set if its centre lies in or on the hull of the set cells' centres. If the partial view is flat,
    or has fewer than four cells, it is returned unchanged.
    """
    return filled_hull(inputs.partial)


def carved_hull(inputs: Inputs) -> Bools:
    """Return the convex hull of `partial_256`, minus observed free space: (256, 256, 256) bool.

    This is the tightest solid that one view gives without a shape prior. It may contain unseen free space.
    """
    carved: Bools = filled_hull(inputs.partial) & ~unpack(inputs.pair.seen) | inputs.partial
    return carved


def silhouette(inputs: Inputs) -> Bools:
    """Return the partial view's cells and all cells behind them, seen from the camera: (256, 256, 256) bool.

    Rays go from the camera's centre to 512 x 512 points on the grid's far side. A cell is set if the ray
    nearest to its centre has met a cell of the partial view.
    """
    pair = inputs.pair
    centre = np.linalg.inv(pair.T_world_grid) @ pair.T_world_camera[:, 3]
    return extruded(inputs.partial, centre[:3] / pair.voxel_size_m - 0.5)


def extruded(partial: Bools, camera_cells: NDArray[np.float64]) -> Bools:
    """Return a partial view (n, n, n) with all cells behind it set, seen from a camera at `camera_cells`.

    The camera's position (3,) is in cells, with cell centres at integers. If the camera is not in front of
    the grid (its z is not negative), rays are parallel to z.
    """
    from kinectbench.scoring.baselines.kernels import sweep_plane, transposed

    count = len(partial)
    far = np.linspace(-0.5, count - 0.5, PIXELS)
    cells = np.arange(count)
    hit = np.zeros((PIXELS, PIXELS), np.bool_)
    filled = transposed(partial.view(np.uint8).reshape(-1, count)).reshape(partial.shape).view(np.bool_)
    for k, plane in enumerate(filled):
        # Where the rays that end at `far` on the last plane cross this plane.
        share = 1.0 if camera_cells[2] >= 0 else (k - camera_cells[2]) / (count - 1 - camera_cells[2])
        crossings = [camera_cells[axis] * (1 - share) + far * share for axis in (0, 1)]
        crossed = [np.clip(np.rint(at).astype(np.int64), 0, count - 1) for at in crossings]
        inside = [np.abs(found - at) <= 0.5 for found, at in zip(crossed, crossings, strict=True)]
        # Which of these rays passes nearest to each cell's centre.
        passing = [
            np.rint((((cells - camera_cells[a] * (1 - share)) / share) + 0.5) / count * (PIXELS - 1))
            for a in (0, 1)
        ]
        rays = [np.clip(found, 0, PIXELS - 1).astype(np.int64) for found in passing]
        within = [found == ray for found, ray in zip(passing, rays, strict=True)]
        sweep_plane(hit, plane, *crossed, *inside, *rays, *within)
    turned = transposed(filled.view(np.uint8).reshape(count, -1))
    return np.asarray(turned.reshape(partial.shape).view(np.bool_))
