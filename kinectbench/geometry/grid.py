"""A regular voxel grid: its shape, voxel size and place in the world."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry.rigid import invert_rigid


@dataclass(frozen=True)
class Grid:
    """Axes x, y, z in C order; the centre of cell i is `(i + 0.5) * voxel_size_m` in frame `grid`.

    Attributes:
        shape: number of cells along x, y, z.
        voxel_size_m: edge of a cell in metres.
        T_world_grid: (4, 4) float64, maps the grid's own frame to the world.
    """

    shape: tuple[int, int, int]
    voxel_size_m: float
    T_world_grid: NDArray[np.float64]

    @property
    def T_grid_world(self) -> NDArray[np.float64]:
        """(4, 4), maps the world to the grid's own frame."""
        return invert_rigid(self.T_world_grid)

    @property
    def size_m(self) -> NDArray[np.float64]:
        """Edge lengths (3,) of the whole grid in metres."""
        return np.array(self.shape, dtype=np.float64) * self.voxel_size_m

    def coarser(self, factor: int) -> "Grid":
        """The grid over the same box whose cells are `factor` times as large (shape must divide)."""
        nx, ny, nz = (n // factor for n in self.shape)
        return Grid((nx, ny, nz), self.voxel_size_m * factor, self.T_world_grid)
