"""The labels and probabilities of the object's voxels, compared with the truth."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, transform_points
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.lab.evaluate.build import BuildRegistration
from kinectbench.lab.evaluate.measured import MeasuredSurface
from kinectbench.lab.evaluate.surface import ReferenceSurface
from kinectbench.lab.simulate.truth import TrueCells, Truth
from kinectbench.stages.segment.object_model import ObjectModel

# What is farther than this from the true surface and wrong is no matter of noise; and so near lies what the
# sensor's measurements of a surface decide.
GROSS_M = NEAR_M = 0.010
# The probability is asked so near to the surface, and wherever the label is unknown; in so many bins.
CALIBRATED_M, BINS = 0.030, 10


@dataclass(frozen=True)
class Voxels:
    """The object's voxels on the fine grid, with the truth; all arrays have the grid's shape.

    Attributes:
        grid: in the truth's world.
        solid: bool, occupied.
        known: bool, the label is not `unknown`.
        probability: float32, that the voxel is occupied.
        true: bool, its centre lies in the seeable solid (`core.voxels.seeable`).
        judged: bool, it counts: it lies in no slit.
        distance_m: float32, of its centre from that solid's surface; infinite where that is more than 30 mm.
        exact: bool, its centre lies in the exact solid.
        exact_distance_m: float32, of its centre from the true mesh.
    """

    grid: Grid
    solid: Bools
    known: Bools
    probability: Float32
    true: Bools
    judged: Bools
    distance_m: Float32
    exact: Bools
    exact_distance_m: Float32

    @property
    def against_exact(self) -> "Voxels":
        """The same compared with the exact solid, every voxel judged."""
        everywhere = np.ones_like(self.judged)
        return replace(self, true=self.exact, distance_m=self.exact_distance_m, judged=everywhere)


@dataclass(frozen=True)
class GrossErrors:
    """Wrong known voxels more than 10 mm from the true surface, as shares of the true volume.

    Attributes:
        known_gross_share: all of them.
        solid_called_air: those inside the true solid.
        air_called_solid: those outside.
    """

    known_gross_share: float
    solid_called_air: float
    air_called_solid: float


@dataclass(frozen=True)
class NearUnknown:
    """Share of voxels labelled unknown within 10 mm of true surface that was measured.

    Attributes:
        solid: of those inside the true solid; None if there are none.
        air: of those outside.
    """

    solid: float | None
    air: float | None


@dataclass(frozen=True)
class CalibrationBin:
    """One of ten bins of equal count: mean probability, share of voxels inside, count."""

    mean_probability: float
    inside_share: float
    count: int


def voxels_beside(
    model: ObjectModel, truth: Truth, registration: BuildRegistration, surface: MeasuredSurface
) -> Voxels:
    """The object's fine grid in the truth's world, with point-to-triangle distances near the surface.

    Args:
        model: the built object, in its own world.
        truth: the true solid.
        registration: transform between the worlds.
        surface: samples of the true surface, which say where distances are worth computing.
    """
    shape = model.shape
    grid = replace(shape.grid, T_world_grid=registration.T_truth_built @ shape.grid.T_world_grid)
    near = cells_around(grid, surface.points_world, CALIBRATED_M)
    found_m = ReferenceSurface(truth.mesh_world).distance_m(centres(grid, near)).astype(np.float32)
    distance_m = np.full(grid.shape, np.inf, dtype=np.float32)
    distance_m[near] = np.where(found_m <= CALIBRATED_M, found_m, np.float32(np.inf))
    cells = truth.cells(grid)
    known = shape.labels != Label.UNKNOWN
    seeable_m = seeable_distance_m(cells, distance_m, grid.voxel_size_m)
    return Voxels(
        grid=grid,
        solid=shape.solid,
        known=known,
        probability=shape.probability,
        true=cells.solid,
        judged=cells.judged,
        distance_m=seeable_m,
        exact=cells.exact,
        exact_distance_m=distance_m,
    )


def seeable_distance_m(cells: TrueCells, exact_m: Float32, voxel_m: float) -> Float32:
    """Distance to the seeable solid's surface: to half a voxel near parts that only the definition adds."""
    from scipy import ndimage

    by_definition = cells.solid & ~cells.exact
    if not by_definition.any():
        return exact_m
    solid_m, air_m, added_m = (
        ndimage.distance_transform_edt(part, sampling=voxel_m) - voxel_m / 2
        for part in (cells.solid, ~cells.solid, ~by_definition)
    )
    counted = np.where(cells.solid, solid_m, air_m)
    counted = np.where(counted <= CALIBRATED_M, counted, np.inf)
    # Farther from it than the surface is, the nearest surface is the exact one.
    return np.where(added_m > CALIBRATED_M, exact_m, counted).astype(np.float32)


def cells_around(grid: Grid, points_world: Float64, reach_m: float) -> Bools:
    """Cells of a grid, among them all whose centre is at most `reach_m` from one of the points (n, 3)."""
    from scipy import ndimage

    cells = np.floor(transform_points(grid.T_grid_world, points_world) / grid.voxel_size_m).astype(np.int64)
    # Points beyond the grid may still be near a cell of it.
    reach = int(np.ceil(reach_m / grid.voxel_size_m)) + 1
    shape = np.array(grid.shape)
    cells = cells[np.all((cells >= -reach) & (cells < shape + reach), axis=1)] + reach
    marked = np.zeros(tuple((shape + 2 * reach).tolist()), dtype=np.uint8)
    marked[tuple(cells.T)] = 1
    around = ndimage.maximum_filter(marked, size=2 * reach + 1, mode="constant")
    return np.asarray(around[reach:-reach, reach:-reach, reach:-reach] > 0)


def centres(grid: Grid, cells: Bools) -> Float64:
    """Centres (n, 3) of the chosen cells of a grid in its world, metres, in C order."""
    return transform_points(grid.T_world_grid, (np.argwhere(cells) + 0.5) * grid.voxel_size_m)


def gross_errors(voxels: Voxels, true_volume_m3: float, beyond_m3: float = 0.0) -> GrossErrors:
    """Volumes of known voxels that are wrong by more than 10 mm, relative to the true volume.

    Args:
        voxels: the object's.
        true_volume_m3: of the true solid.
        beyond_m3: of the true solid beyond the voxels, that is known to be air and as far from the surface.
    """
    wrong = voxels.known & voxels.judged & (voxels.distance_m > GROSS_M)
    cell_share = voxels.grid.voxel_size_m**3 / true_volume_m3
    missing = float(np.count_nonzero(wrong & voxels.true & ~voxels.solid)) * cell_share
    missing += beyond_m3 / true_volume_m3
    extra = float(np.count_nonzero(wrong & ~voxels.true & voxels.solid)) * cell_share
    return GrossErrors(missing + extra, missing, extra)


def called_air_beyond_m3(cube: Grid, lost: Bools, voxels: Voxels, truth: Truth) -> float:
    """Volume of lost cells of a cube beyond the object's voxels, more than 10 mm from the true surface.

    Args:
        cube: around the true object, truth's world.
        lost: cells of it in the true solid that are known to be air.
        voxels: the object's.
        truth: the exact solid.
    """
    points = centres(cube, lost)
    cells = transform_points(voxels.grid.T_grid_world, points) / voxels.grid.voxel_size_m
    beyond = points[np.any((cells < 0) | (cells >= voxels.grid.shape), axis=1)]
    if not len(beyond):
        return 0.0
    far = ReferenceSurface(truth.mesh_world).distance_m(beyond) > GROSS_M
    return float(np.count_nonzero(far)) * cube.voxel_size_m**3


def unknown_near_measured(voxels: Voxels, surface: MeasuredSurface) -> NearUnknown:
    """The unknown share near measured surface, by the nearest surface sample."""
    from scipy.spatial import cKDTree

    near = (voxels.exact_distance_m <= NEAR_M) & voxels.judged
    _, nearest = cKDTree(surface.points_world).query(centres(voxels.grid, near), workers=-1)
    measured = surface.measured[nearest]
    true, unknown = voxels.true[near][measured], ~voxels.known[near][measured]

    def share_of(some: Bools) -> float | None:
        return float(unknown[some].mean()) if some.any() else None

    return NearUnknown(solid=share_of(true), air=share_of(~true))


def calibration(voxels: Voxels) -> tuple[CalibrationBin, ...]:
    """Ten bins of equal count, by probability, of the voxels that are unknown or within 30 mm of the surface.

    Of voxels of one probability that the border of two bins divides, each bin gets the same share inside.
    """
    asked = voxels.judged & (~voxels.known | np.isfinite(voxels.distance_m))
    probability, inside = voxels.probability[asked].astype(np.float64), voxels.true[asked]
    return equal_bins(probability, inside)


def equal_bins(probability: Float64, inside: NDArray[np.bool_]) -> tuple[CalibrationBin, ...]:
    """At most ten bins of equal count, ascending; fewer if there are fewer voxels.

    Args:
        probability: (n,).
        inside: (n,) bool.
    """
    values, group, counts = np.unique(probability, return_inverse=True, return_counts=True)
    if not len(values):
        return ()
    share = np.bincount(group, inside, len(values)) / counts
    # Sorted, each voxel has its value's mean: what order they would have among themselves does not matter.
    ends = np.cumsum(counts)
    borders = np.unique(np.round(np.linspace(0, ends[-1], BINS + 1)).astype(np.int64))
    result = []
    for first, last in itertools.pairwise(borders.tolist()):
        taken = np.clip(ends, first, last) - np.clip(ends - counts, first, last)
        count = last - first
        result.append(CalibrationBin(float(taken @ values) / count, float(taken @ share) / count, count))
    return tuple(result)


def calibration_error(bins: tuple[CalibrationBin, ...]) -> float | None:
    """Mean distance between probability and share inside over the bins; None without any."""
    if not bins:
        return None
    return float(np.mean([abs(each.mean_probability - each.inside_share) for each in bins]))
