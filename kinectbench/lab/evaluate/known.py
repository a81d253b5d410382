"""Compare the labels and probabilities of the object's voxels with the truth."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, transform_points
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.lab.evaluate.build import BuildRegistration
from kinectbench.lab.evaluate.measured import MeasuredSurface
from kinectbench.lab.evaluate.surface import ReferenceSurface
from kinectbench.lab.simulate.truth import TrueCells, Truth
from kinectbench.stages.segment.object_model import ObjectModel

# A wrong voxel farther than this from the true surface is a gross error, not noise. The same distance limits
# which voxels a measured surface determines.
GROSS_M = NEAR_M = 0.010
# Calibration uses voxels this near to the surface, and all unknown voxels, in this many bins.
CALIBRATED_M, BINS = 0.030, 10


@dataclass(frozen=True)
class Voxels:
    """The built object's voxels with their true states; all arrays have the shape of the object's fine grid.

    Attributes:
        grid: the grid, in the truth's world.
        solid: bool, the voxel is occupied in the build.
        known: bool, the voxel's label in the build is not `unknown`.
        probability: float32, the build's probability that the voxel is occupied.
        true: bool, the voxel's centre lies in the seeable solid (`core.voxels.seeable`): inside the true
            mesh, or in space that no camera could see.
        judged: bool, the voxel is evaluated. Slits are not evaluated: gaps that only a finer sensor could see
            into, and walls thinner than a voxel.
        distance_m: float32, distance of the centre from the seeable solid's surface; infinite beyond 30 mm.
        exact: bool, the centre lies inside the true mesh.
        exact_distance_m: float32, distance of the centre from the true mesh; infinite beyond 30 mm.
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
        """The same voxels with the true mesh's solid as their truth, and every voxel evaluated."""
        everywhere = np.ones_like(self.judged)
        return replace(self, true=self.exact, distance_m=self.exact_distance_m, judged=everywhere)


@dataclass(frozen=True)
class GrossErrors:
    """Volume of gross errors relative to the true volume.

    A gross error is a known voxel with a wrong state, more than 10 mm from the true surface.

    Attributes:
        known_gross_share: all gross errors, the sum of the two shares below.
        solid_called_air: gross errors inside the true solid: known voxels that are empty in the build.
        air_called_solid: gross errors outside the true solid: known voxels that are solid in the build.
    """

    known_gross_share: float
    solid_called_air: float
    air_called_solid: float


@dataclass(frozen=True)
class NearUnknown:
    """Share of voxels labelled unknown, among the voxels within 10 mm of measured true surface.

    Attributes:
        solid: the share among such voxels inside the true solid; None if there are none.
        air: the share among such voxels outside the true solid; None if there are none.
    """

    solid: float | None
    air: float | None


@dataclass(frozen=True)
class CalibrationBin:
    """One bin of voxels: mean built probability, share of its voxels in the true solid, number of voxels."""

    mean_probability: float
    inside_share: float
    count: int


def voxels_beside(
    model: ObjectModel, truth: Truth, registration: BuildRegistration, surface: MeasuredSurface
) -> Voxels:
    """Return the voxels of the object's fine grid, in the truth's world, with true states and distances.

    The model is in its own world. Distances are computed only near the samples of the true surface.
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
    """Return each cell's distance in metres from the seeable solid's surface, infinite beyond 30 mm.

    Some space counts as solid only because no camera could see it. Within 30 mm of such space, the distance
    is exact to half a voxel. Elsewhere it is the distance from the true mesh.

    Args:
        cells: true states of a grid's cells.
        exact_m: distances of the cells' centres from the true mesh, of the grid's shape; infinite beyond 30
            mm.
        voxel_m: edge of a cell, metres.
    """
    by_definition = cells.solid & ~cells.exact
    if not by_definition.any():
        return exact_m
    solid_m, air_m, added_m = (
        ndimage.distance_transform_edt(part, sampling=voxel_m) - voxel_m / 2
        for part in (cells.solid, ~cells.solid, ~by_definition)
    )
    counted = np.where(cells.solid, solid_m, air_m)
    counted = np.where(counted <= CALIBRATED_M, counted, np.inf)
    # Farther from the added parts than from the surface, the nearest surface is the exact one.
    return np.where(added_m > CALIBRATED_M, exact_m, counted).astype(np.float32)


def cells_around(grid: Grid, points_world: Float64, reach_m: float) -> Bools:
    """Mark the cells of a grid near points (n, 3).

    Every cell whose centre is within `reach_m` of a point is marked. Cells slightly farther away may be, too.
    """
    cells = np.floor(transform_points(grid.T_grid_world, points_world) / grid.voxel_size_m).astype(np.int64)
    # Points outside the grid may still be near one of its cells.
    reach = int(np.ceil(reach_m / grid.voxel_size_m)) + 1
    shape = np.array(grid.shape)
    cells = cells[np.all((cells >= -reach) & (cells < shape + reach), axis=1)] + reach
    marked = np.zeros(tuple((shape + 2 * reach).tolist()), dtype=np.uint8)
    marked[tuple(cells.T)] = 1
    around = ndimage.maximum_filter(marked, size=2 * reach + 1, mode="constant")
    return np.asarray(around[reach:-reach, reach:-reach, reach:-reach] > 0)


def centres(grid: Grid, cells: Bools) -> Float64:
    """Return the centres (n, 3) of the marked cells in the grid's world, metres, in C order of the cells."""
    return transform_points(grid.T_world_grid, (np.argwhere(cells) + 0.5) * grid.voxel_size_m)


def gross_errors(voxels: Voxels, true_volume_m3: float, beyond_m3: float = 0.0) -> GrossErrors:
    """Return the volumes of gross errors (see `GrossErrors`) as shares of the true volume.

    `beyond_m3`, the true solid outside the object's voxels that the build calls empty, is added to the
    errors.
    """
    wrong = voxels.known & voxels.judged & (voxels.distance_m > GROSS_M)
    cell_share = voxels.grid.voxel_size_m**3 / true_volume_m3
    missing = float(np.count_nonzero(wrong & voxels.true & ~voxels.solid)) * cell_share
    missing += beyond_m3 / true_volume_m3
    extra = float(np.count_nonzero(wrong & ~voxels.true & voxels.solid)) * cell_share
    return GrossErrors(missing + extra, missing, extra)


def called_air_beyond_m3(cube: Grid, lost: Bools, voxels: Voxels, truth: Truth) -> float:
    """Return the volume of true solid that the build calls empty, outside the object's voxel grid.

    Only cells more than 10 mm from the true mesh count. The cube around the true object is in the truth's
    world; `lost`, bool of its shape, are cells in the true solid that are known and empty in the build.
    """
    points = centres(cube, lost)
    cells = transform_points(voxels.grid.T_grid_world, points) / voxels.grid.voxel_size_m
    beyond = points[np.any((cells < 0) | (cells >= voxels.grid.shape), axis=1)]
    if not len(beyond):
        return 0.0
    far = ReferenceSurface(truth.mesh_world).distance_m(beyond) > GROSS_M
    return float(np.count_nonzero(far)) * cube.voxel_size_m**3


def unknown_near_measured(voxels: Voxels, surface: MeasuredSurface) -> NearUnknown:
    """Return the share of voxels labelled unknown, among voxels near measured surface.

    A voxel is near measured surface if it is within 10 mm of the true mesh, and the surface sample nearest to
    it was measured.
    """
    near = (voxels.exact_distance_m <= NEAR_M) & voxels.judged
    _, nearest = cKDTree(surface.points_world).query(centres(voxels.grid, near), workers=-1)
    measured = surface.measured[nearest]
    true, unknown = voxels.true[near][measured], ~voxels.known[near][measured]

    def share_of(some: Bools) -> float | None:
        return float(unknown[some].mean()) if some.any() else None

    return NearUnknown(solid=share_of(true), air=share_of(~true))


def calibration(voxels: Voxels) -> tuple[CalibrationBin, ...]:
    """Sort voxels by probability into ten bins of equal count.

    Only voxels that are labelled unknown or lie within 30 mm of the true surface are used. If voxels of equal
    probability fall into two bins, both bins get the mean share of these voxels inside the true solid.
    """
    asked = voxels.judged & (~voxels.known | np.isfinite(voxels.distance_m))
    probability, inside = voxels.probability[asked].astype(np.float64), voxels.true[asked]
    return equal_bins(probability, inside)


def equal_bins(probability: Float64, inside: NDArray[np.bool_]) -> tuple[CalibrationBin, ...]:
    """Return at most ten bins of equal count, by ascending probability; fewer if there are fewer voxels.

    Args:
        probability: (n,) probabilities.
        inside: (n,) bool, the voxel is inside the true solid.
    """
    values, group, counts = np.unique(probability, return_inverse=True, return_counts=True)
    if not len(values):
        return ()
    share = np.bincount(group, inside, len(values)) / counts
    # In sorted order each voxel gets the mean of its probability's voxels, so their order does not matter.
    ends = np.cumsum(counts)
    borders = np.unique(np.round(np.linspace(0, ends[-1], BINS + 1)).astype(np.int64))
    result = []
    for first, last in itertools.pairwise(borders.tolist()):
        taken = np.clip(ends, first, last) - np.clip(ends - counts, first, last)
        count = last - first
        result.append(CalibrationBin(float(taken @ values) / count, float(taken @ share) / count, count))
    return tuple(result)


def calibration_error(bins: tuple[CalibrationBin, ...]) -> float | None:
    """Return the mean over the bins of |mean probability - share inside|; None if there are no bins."""
    if not bins:
        return None
    return float(np.mean([abs(each.mean_probability - each.inside_share) for each in bins]))
