"""The truth of a view as predictions in the camera frame are held to it."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.score_figures import ShapePart
from kinectbench.core.geometry import invert_rigid
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, unknown_share, unpack
from kinectbench.release import view_images
from kinectbench.release.release import Release, Target
from kinectbench.scoring.camera.surface import Surface, cell_surface
from kinectbench.scoring.surface import size_cells
from kinectbench.scoring.truth import read_parts

PARTS: tuple[ShapePart, ...] = ("whole", "visible", "occluded")


@dataclass(frozen=True)
class SpaceTruth:
    """The truth of a view, in its grid's frame, metres.

    Attributes:
        full: (256, 256, 32) uint8, packed: the solid.
        known: likewise, where the truth is trusted; what lies outside the grid is known to be free.
        seen: likewise, what the view saw; of what lies outside the grid nothing is.
        surface: of `full`: all its faces.
        is_known: (n,) of each face, whether its occupied cell is known.
        is_seen: (n,) likewise, whether it was seen.
        T_grid_camera: (4, 4).
        voxel_size_m: edge of a cell.
        size_m: the diagonal of the box of `full`.
        sigma_m: standard deviation of the true surface; 0 if it is exact or not known.
        K: (3, 3) of the view; None where it is not needed.
        mask: (height, width) bool, the object in the view; None where the release has none.
    """

    full: Packed
    known: Packed
    seen: Packed
    surface: Surface
    is_known: Bools
    is_seen: Bools
    T_grid_camera: Float64
    voxel_size_m: float
    size_m: float
    sigma_m: float = 0.0
    K: Float64 | None = None
    mask: Bools | None = None

    @cached_property
    def known_surface(self) -> Surface:
        """The faces that are known."""
        return self.surface.chosen(self.is_known)

    @cached_property
    def smoothed(self) -> dict[int, Surface]:
        """What `align` has made of the known surface, by how many samples it has."""
        return {}

    @property
    def unknown_share(self) -> float:
        """Share of the cells of `full` that are not known; 0 of an empty shape."""
        return unknown_share(self.full, self.known)

    def at(self, points_m: Float64) -> tuple[Bools, Bools]:
        """Whether points (n, 3) lie in known space, and in space that the view saw."""
        cells = np.floor(points_m / self.voxel_size_m)
        inside = np.asarray(((cells >= 0) & (cells < FULL_CELLS)).all(axis=1))
        at = np.where(inside[:, None], cells, 0).astype(np.int64)
        return ~inside | cells_set(self.known, at), inside & cells_set(self.seen, at)


def cells_set(packed: Packed, cells: Int64) -> Bools:
    """(n,) whether cells (n, 3) of a packed grid are set."""
    x, y, z = cells.T
    found: Bools = (packed[x, y, z >> 3] >> (7 - (z & 7))) & 1 == 1
    return found


@dataclass(frozen=True)
class ViewFiles:
    """What the truth of a view is read from.

    Attributes:
        pair: its pair file.
        sha256: what its bytes must hash to.
        mask: likewise of its mask; None where the release has none.
    """

    pair: Path
    sha256: str
    mask: tuple[Path, str] | None = None


def files_of(release: Release, target: Target) -> ViewFiles:
    """The files of a view."""
    return ViewFiles(release.pair_path(target), target.sha256, view_images.mask_file(release, target))


def read_space_truth(files: ViewFiles) -> SpaceTruth:
    """Read the truth of a view.

    Raises:
        ReleaseError: a file is missing, or not the published one.
    """
    names = (
        "full",
        "known",
        "seen",
        "T_world_grid",
        "T_world_camera",
        "voxel_size_m",
        "surface_sigma_m",
        "K",
    )
    full, known, seen, T_world_grid, T_world_camera, voxel_size_m, sigma_m, K = read_parts(
        files.pair, files.sha256, names
    )
    truth = space_truth(full, known, seen, invert_rigid(T_world_grid) @ T_world_camera, float(voxel_size_m))
    mask = None if files.mask is None else view_images.read_mask(*files.mask)
    return replace(truth, sigma_m=float(sigma_m), K=K, mask=mask)


def space_truth(
    full: Packed, known: Packed, seen: Packed, T_grid_camera: Float64, voxel_size_m: float
) -> SpaceTruth:
    """The same from packed grids (256, 256, 32)."""
    surface, cells = cell_surface(unpack(full), voxel_size_m)
    is_known, is_seen = cells_set(known, cells), cells_set(seen, cells)
    size_m = size_cells(full) * voxel_size_m
    return SpaceTruth(full, known, seen, surface, is_known, is_seen, T_grid_camera, voxel_size_m, size_m)
