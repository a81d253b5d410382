"""The truth of a view as predictions in the camera frame are held to it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core.geometry import invert_rigid
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, unpack
from kinectbench.scoring.camera.surface import Surface, cell_surface
from kinectbench.scoring.surface import size_cells
from kinectbench.scoring.truth import read_parts

PARTS = ("whole", "visible", "occluded")


@dataclass(frozen=True)
class SpaceTruth:
    """The truth of a view, in its grid's frame, metres.

    Attributes:
        full: (256, 256, 256) bool, the solid.
        known: likewise, where the truth is trusted; what lies outside the grid is known to be free.
        seen: likewise, what the view saw; of what lies outside the grid nothing is.
        surface: of `full`: all its faces.
        is_known: (n,) of each face, whether its occupied cell is known.
        is_seen: (n,) likewise, whether it was seen.
        T_grid_camera: (4, 4).
        voxel_size_m: edge of a cell.
        size_m: the diagonal of the box of `full`.
    """

    full: Bools
    known: Bools
    seen: Bools
    surface: Surface
    is_known: Bools
    is_seen: Bools
    T_grid_camera: Float64
    voxel_size_m: float
    size_m: float

    @property
    def unknown_share(self) -> float:
        """Share of the cells of `full` that are not known; 0 of an empty shape."""
        cells = int(self.full.sum())
        return int((self.full & ~self.known).sum()) / cells if cells else 0.0

    def at(self, points_m: Float64) -> tuple[Bools, Bools]:
        """Whether points (n, 3) lie in known space, and in space that the view saw."""
        cells = np.floor(points_m / self.voxel_size_m)
        inside = ((cells >= 0) & (cells < FULL_CELLS)).all(axis=1)
        at = tuple(np.where(inside[:, None], cells, 0).astype(np.int64).T)
        known: Bools = ~inside | self.known[at]
        seen: Bools = inside & self.seen[at]
        return known, seen


def read_space_truth(path: Path, sha256: str) -> SpaceTruth:
    """Read the truth of a view.

    Args:
        path: its pair file.
        sha256: what its bytes must hash to.

    Raises:
        ReleaseError: the file is missing, or not the published one.
    """
    names = ("full", "known", "seen", "T_world_grid", "T_world_camera", "voxel_size_m")
    full, known, seen, T_world_grid, T_world_camera, voxel_size_m = read_parts(path, sha256, names)
    T_grid_camera = invert_rigid(T_world_grid) @ T_world_camera
    return space_truth(full, known, seen, T_grid_camera, float(voxel_size_m))


def space_truth(
    full: Packed, known: Packed, seen: Packed, T_grid_camera: Float64, voxel_size_m: float
) -> SpaceTruth:
    """The same from packed grids (256, 256, 32)."""
    solid, trusted, looked_at = unpack(full), unpack(known), unpack(seen)
    surface, cells = cell_surface(solid, voxel_size_m)
    at = tuple(cells.T)
    size_m = size_cells(full) * voxel_size_m
    is_known, is_seen = trusted[at], looked_at[at]
    return SpaceTruth(
        solid, trusted, looked_at, surface, is_known, is_seen, T_grid_camera, voxel_size_m, size_m
    )
