"""The truth of a view, in the form that the protocols camera and aligned compare predictions with."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError, ReleaseError
from kinectbench.core.artefacts.score_figures import ShapePart
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.mesh_files import read_ply
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, packed_count, unknown_share, unpack
from kinectbench.release import view_images
from kinectbench.release.contents import surface_name
from kinectbench.release.published import published_bytes
from kinectbench.release.release import Release, Target
from kinectbench.scoring.camera.kernels import known_and_seen
from kinectbench.scoring.camera.surface import Surface, cell_surface, mesh_surface
from kinectbench.scoring.surface import size_cells
from kinectbench.scoring.truth import read_parts

# About this many cells of the truth are counted, at regular steps. At 256 cells a side, they are at most 4
# cells apart (chosen here; for a box that is cut in half, the share found is 0.500).
COUNTED = 100_000
PARTS: tuple[ShapePart, ...] = ("whole", "visible", "occluded")


@dataclass(frozen=True)
class SpaceTruth:
    """The truth of a view, to compare predictions with; coordinates are in its grid's frame, metres.

    Attributes:
        full: (256, 256, 32) uint8, packed: the true solid.
        known: (256, 256, 32) uint8, packed: cells where the truth is trusted; space outside the grid is known
            to be free.
        seen: (256, 256, 32) uint8, packed: cells that the view saw; space outside the grid counts as not
            seen.
        surface: all faces of `full`; or, if `is_open`, the open mesh.
        is_known: (n,) bool, for each sample of `surface`, whether its occupied cell is known.
        is_seen: (n,) bool, whether that cell was seen.
        T_grid_camera: (4, 4) from the camera's frame to the grid's.
        voxel_size_m: edge of a cell.
        size_m: diagonal of the bounding box of the true shape.
        sigma_m: standard deviation of the true surface's position; 0 if it is exact or not known.
        K: (3, 3) intrinsics of the view, pixels; None where they are not needed.
        mask: (height, width) bool, the pixels of the object in the view; None if the release has no masks.
        is_open: whether the truth is an open mesh: then it has no inside, and `full` is empty.
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
    is_open: bool = False

    @cached_property
    def known_surface(self) -> Surface:
        """The known part of the surface."""
        return self.surface if self.is_known.all() else self.surface.chosen(self.is_known)

    @cached_property
    def areas_m2(self) -> dict[ShapePart, tuple[float, float]]:
        """{part: (area of its surface, area of the known part of that surface)}, square metres."""
        every = np.ones_like(self.is_seen)
        parts = dict(zip(PARTS, (every, self.is_seen, ~self.is_seen), strict=True))
        areas = self.surface.areas
        return {
            part: (float(areas[here].sum()), float(areas[here & self.is_known].sum()))
            for part, here in parts.items()
        }

    @cached_property
    def counted(self) -> dict[str, tuple[Packed, int, int]]:
        """Cache of `metrics`: {part: (its known cells, their number, how many of them are solid)}."""
        return {}

    @cached_property
    def some_cells_m(self) -> Float64:
        """Centres of about `COUNTED` evenly chosen known cells of the solid: (n, 3), metres, camera frame."""
        cells = np.flatnonzero(unpack(self.full & self.known))
        # The step is odd: one that divides the side would always meet the same columns.
        cells = cells[:: max(len(cells) // COUNTED, 1) | 1]
        centers_m = (np.stack(np.unravel_index(cells, (FULL_CELLS,) * 3), axis=1) + 0.5) * self.voxel_size_m
        return transform_points(invert_rigid(self.T_grid_camera), centers_m)

    @cached_property
    def smoothed(self) -> dict[int, Surface]:
        """Cache of `align`: {number of samples: the known surface, thinned and smoothed}."""
        return {}

    @cached_property
    def solid_cells(self) -> int:
        """Number of cells of `full`."""
        return packed_count(self.full)

    @property
    def unknown_share(self) -> float:
        """Share of the cells of `full` that are not known; 0 for an empty shape."""
        return unknown_share(self.full, self.known)

    def at(self, points_m: Float64) -> tuple[Bools, Bools]:
        """Return which points (n, 3) lie in known space, and which in space seen by the view: bool (n,)."""
        found: tuple[Bools, Bools] = known_and_seen(points_m, self.voxel_size_m, self.known, self.seen)
        return found


@dataclass(frozen=True)
class ViewFiles:
    """The files that hold the truth of a view.

    Attributes:
        pair: the pair file.
        sha256: expected hash of the pair file.
        mask: (mask's file, its expected hash); None if the release has no masks.
        surface: (file of the open mesh that is the truth, its expected hash); None if the truth is in the
            pair file.
    """

    pair: Path
    sha256: str
    mask: tuple[Path, str] | None = None
    surface: tuple[Path, str] | None = None


def files_of(release: Release, target: Target) -> ViewFiles:
    """Return the files that hold the truth of a view."""
    mask, surface = view_images.mask_file(release, target), None
    if target.split in release.metadata.surface_truth:
        name = surface_name(target.recording)
        surface = (release.folder / name, release.sums.get(name, ""))
    return ViewFiles(release.pair_path(target), target.sha256, mask, surface)


def read_space_truth(files: ViewFiles) -> SpaceTruth:
    """Read the truth of a view.

    Raises:
        ReleaseError: a file is missing, or differs from the published one; or the truth has too many cell
            faces.
    """
    mask = None if files.mask is None else view_images.read_mask(*files.mask)
    if files.surface is not None:
        return replace(_open_truth(files, *files.surface), mask=mask)
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
    T_grid_camera = invert_rigid(T_world_grid) @ T_world_camera
    try:
        truth = space_truth(full, known, seen, T_grid_camera, float(voxel_size_m))
    except PredictionError as error:
        raise ReleaseError(f"{files.pair}: the truth has {error}", what="too-large") from error
    return replace(truth, sigma_m=float(sigma_m), K=K, mask=mask)


def _open_truth(files: ViewFiles, path: Path, sha256: str) -> SpaceTruth:
    """Read a truth that is an open mesh: its whole surface counts as known, and it has no inside."""
    names = ("seen", "T_world_grid", "T_world_camera", "voxel_size_m", "K")
    seen, T_world_grid, T_world_camera, voxel_size_m, K = read_parts(files.pair, files.sha256, names)
    try:
        vertices, faces = read_ply(published_bytes(path, sha256))
    except ValueError as error:
        raise ReleaseError(f"{path}: not a readable mesh ({error}); download it again") from error
    T_grid_world = invert_rigid(T_world_grid)
    vertices = transform_points(T_grid_world, vertices)
    surface, nothing = mesh_surface(vertices, faces), np.zeros_like(seen)
    truth = SpaceTruth(
        full=nothing,
        known=np.full_like(seen, 255),
        seen=seen,
        surface=surface,
        is_known=np.ones(len(surface), bool),
        is_seen=np.zeros(len(surface), bool),
        T_grid_camera=T_grid_world @ T_world_camera,
        voxel_size_m=float(voxel_size_m),
        size_m=float(np.linalg.norm(np.ptp(vertices, axis=0))),
        K=K,
        is_open=True,
    )
    return replace(truth, is_seen=truth.at(surface.points_m)[1])


def space_truth(
    full: Packed, known: Packed, seen: Packed, T_grid_camera: Float64, voxel_size_m: float
) -> SpaceTruth:
    """Return the truth of packed grids (256, 256, 32); it has no mask, no intrinsics, and a `sigma_m` of 0.

    Raises:
        PredictionError: it has more than `MOST_SAMPLES` cell faces at its surface.
    """
    surface, cells = cell_surface(unpack(full), voxel_size_m)
    is_known, is_seen = known_and_seen(cells + 0.5, 1.0, known, seen)
    size_m = size_cells(full) * voxel_size_m
    return SpaceTruth(full, known, seen, surface, is_known, is_seen, T_grid_camera, voxel_size_m, size_m)
