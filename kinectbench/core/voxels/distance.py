"""Distances between voxels up to a limit."""

import math

import numba
import numpy as np

from kinectbench.core.types import Bools, Float32


def distance_within_m(of: Bools, voxel_size_m: float, within_m: float) -> Float32:
    """Return the distance of each voxel to the nearest set voxel: exact, and infinite beyond a limit.

    Squared distances are separable: along each axis in turn, each voxel takes the minimum, over its
    neighbours, of their value plus the squared distance to them (Felzenszwalb, Huttenlocher: Distance
    Transforms of Sampled Functions, 2012). Only the few neighbours within the limit are tried, one by one.
    For 11 M voxels and a limit of 15 voxels, this takes a tenth of the time of scipy's
    `distance_transform_edt`, which has no limit.

    Args:
        of: (nx, ny, nz) bool, the set voxels.
        voxel_size_m: edge of a voxel, metres.
        within_m: the limit, metres, rounded down to whole voxels; larger distances are infinite.

    Returns:
        (nx, ny, nz) float32, metres.
    """
    # No two voxels are farther apart than the grid's diagonal.
    reach = min(math.floor(within_m / voxel_size_m + 1e-6), math.ceil(math.hypot(*of.shape)))
    kind = np.uint16 if 2 * reach * reach < np.iinfo(np.uint16).max else np.int32
    squared = np.empty(of.shape, kind)
    _along_last(np.ascontiguousarray(of), reach, squared)
    squared = _across(_across(squared, reach, 1), reach, 0)
    roots = voxel_size_m * np.sqrt(np.arange(reach * reach + 2, dtype=np.float64))
    roots[-1] = np.inf
    return np.asarray(_looked_up(squared, roots.astype(np.float32)))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _along_last(cells, reach, squared):  # type: ignore[no-untyped-def]
    """Write each cell's squared distance, voxels, to the nearest set cell along the last axis into `squared`.

    `cells` and `squared` are (nx, ny, nz). A distance larger than `reach` is written as reach^2 + 1.
    """
    nx, ny, nz = cells.shape
    beyond = reach * reach + 1
    for i in range(nx):
        for j in range(ny):
            since = reach + 1
            for k in range(nz):
                since = 0 if cells[i, j, k] else since + 1
                squared[i, j, k] = since * since if since <= reach else beyond
            since = reach + 1
            for k in range(nz - 1, -1, -1):
                since = 0 if cells[i, j, k] else since + 1
                if since <= reach:
                    squared[i, j, k] = min(squared[i, j, k], squared.dtype.type(since * since))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _across(squared, reach, axis):  # type: ignore[no-untyped-def]
    """Return squared distances, in voxels, after one more pass along axis 0 or 1.

    Each voxel gets the minimum of value plus squared offset over the voxels within `reach` along the axis.
    """
    nx, ny, nz = squared.shape
    least = np.empty_like(squared)
    kind, count = squared.dtype.type, squared.shape[axis]
    for n in range(nx * ny):
        # Along the axis, so that rows that are looked at several times lie in the cache.
        i, j = (n % nx, n // nx) if axis == 0 else (n // ny, n % ny)
        own, at = least[i, j], i if axis == 0 else j
        own[:] = squared[i, j]
        for step in range(1, reach + 1):
            way = step * step
            for neighbour in (at - step, at + step):
                if 0 <= neighbour < count:
                    other = squared[neighbour, j] if axis == 0 else squared[i, neighbour]
                    for k in range(nz):
                        own[k] = min(own[k], kind(other[k] + way))
    return least


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _looked_up(squared, roots_m):  # type: ignore[no-untyped-def]
    """Return the entries of `roots_m`, metres, at squared distances in voxels; beyond it, its last entry."""
    distance_m = np.empty(squared.shape, np.float32)
    flat, into = squared.reshape(-1), distance_m.reshape(-1)
    last = len(roots_m) - 1
    for n in range(len(flat)):
        into[n] = roots_m[min(flat[n], last)]
    return distance_m
