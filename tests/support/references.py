"""Definitions written out plainly, which tests and benchmarks hold the package's kernels against."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinectbench.core.voxels.pair_file import FULL_CELLS, pack
from kinectbench.core.voxels.resample import HALF_PIXEL, Values, upsampled_planes
from kinectbench.lab.simulate.kinect import KinectNoise

Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]


def shell_of(solid: Bools) -> NDArray[np.uint8]:
    """Occupied cells with an empty 6-neighbour, packed along z; outside the grid is empty.

    Args:
        solid: (nx, ny, nz) bool, nz a multiple of 8.
    """
    neighbours = ndimage.generate_binary_structure(3, 1)
    return pack(solid & ~ndimage.binary_erosion(solid, neighbours, border_value=0))


def occupy(cells: NDArray[np.int64], shape: tuple[int, int, int]) -> Bools:
    """A grid with the cells (n, 3) set; cells beyond its bounds are left out."""
    inside = np.all((cells >= 0) & (cells < np.array(shape)), axis=1)
    occupied = np.zeros(shape, dtype=bool)
    occupied[tuple(cells[inside].T)] = True
    return occupied


def upsample(values: Values, side: int = FULL_CELLS, convention: str = HALF_PIXEL) -> Float64:
    """The whole cube (side, side, side) of `upsampled_planes`, whose planes share one buffer."""
    return np.stack([plane.copy() for plane in upsampled_planes(values, side, convention)])


def axial_sigma_m(depth_m: Float64, incidence_rad: Float64) -> Float64:
    """Standard deviation of depth in metres (Nguyen et al. 2012, eq. 3 and 4).

    Args:
        depth_m: depth along z, metres, > 0.
        incidence_rad: angle between ray and surface normal, radians in [0, π/2).
    """
    facing = 0.0012 + 0.0019 * (depth_m - 0.4) ** 2
    graze = 0.0001 / np.sqrt(depth_m) * (incidence_rad / (np.pi / 2 - incidence_rad)) ** 2
    return np.asarray(facing + np.where(incidence_rad > np.pi / 3, graze, 0.0), dtype=np.float64)


def lateral_sigma_px(incidence_rad: Float64) -> Float64:
    """Standard deviation of an edge's place in the image, pixels (Nguyen et al. 2012, eq. 1).

    Args:
        incidence_rad: angle between ray and surface normal, radians in [0, π/2).
    """
    return np.asarray(0.8 + 0.035 * incidence_rad / (np.pi / 2 - incidence_rad), dtype=np.float64)


def depth_step_m(depth_m: Float64, noise: KinectNoise) -> Float64:
    """Distance between depths that the sensor can report, metres (Khoshelham & Elberink 2012)."""
    return depth_m**2 / (noise.focal_px * noise.baseline_m * noise.steps_per_px)
