"""Compare the built solid and its labels with the true solid, on an upright cube around the true object.

The true solid is the seeable one (`core.voxels.seeable`): space that no camera could see counts as solid, in
the truth as in the build. The exact solid is the inside of the true mesh; metrics named `exact` refer to it.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from kinectbench.core import RecordingError
from kinectbench.core.geometry import Grid, rigid
from kinectbench.core.types import Bools
from kinectbench.core.voxels.known_cells import known_in
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.core.voxels.view_grids import object_cube
from kinectbench.lab.evaluate.build import BuildRegistration
from kinectbench.lab.evaluate.known import (
    CalibrationBin,
    NearUnknown,
    calibration,
    calibration_error,
    called_air_beyond_m3,
    gross_errors,
    unknown_near_measured,
    voxels_beside,
)
from kinectbench.lab.evaluate.measured import FaceBias, MeasuredSurface, face_bias
from kinectbench.lab.simulate.truth import Truth, mesh_occupancy
from kinectbench.stages.pairs import full_shape
from kinectbench.stages.segment.object_model import ObjectModel


def grid_iou(a: Bools, b: Bools) -> float:
    """Return the intersection over union of two arrays of one shape; 1 if both are empty."""
    union = int(np.count_nonzero(a | b))
    return int(np.count_nonzero(a & b)) / union if union else 1.0


def known_iou(built: Bools, true: Bools, known: Bools) -> float | None:
    """Return the IoU of two solids over the cells in `known`; None if no cell of the true solid is in it."""
    return grid_iou(built & known, true & known) if bool(np.any(true & known)) else None


def share(part: Bools, of: Bools) -> float:
    """Return the share of the cells of `of` that lie in `part`, in [0, 1]; 0 if `of` is empty."""
    cells = int(np.count_nonzero(of))
    return int(np.count_nonzero(part & of)) / cells if cells else 0.0


@dataclass(frozen=True)
class EvaluatedSolids:
    """True and built states of the cells of one cube: bool grids (n, n, n).

    Attributes:
        true: the cell's centre lies in the seeable solid.
        built: the cell's centre lies in the built closed mesh.
        known: the label of the nearest voxel is not `unknown`.
        judged: the cell is evaluated. Slits are not evaluated: gaps that only a finer sensor could see into,
            and walls thinner than a voxel.
        exact: the cell's centre lies in the exact solid.
    """

    true: Bools
    built: Bools
    known: Bools
    judged: Bools
    exact: Bools

    @property
    def against_exact(self) -> "EvaluatedSolids":
        """The same cells with the exact solid as their truth, and every cell evaluated."""
        return replace(self, true=self.exact, judged=np.ones_like(self.judged))


@dataclass(frozen=True)
class SolidOverlap:
    """Overlap of the built and the true solid on one grid, over its evaluated cells (`judged`), in [0, 1].

    Attributes:
        cells: number of cells along an edge of the grid.
        iou: IoU of the built and the true solid.
        known_iou: the same IoU over known cells; None if no cell of the true solid is known.
        true_unknown_share: share of the true solid that is labelled unknown.
        empty_unknown_share: share of the grid's truly empty cells that is labelled unknown.
    """

    cells: int
    iou: float
    known_iou: float | None
    true_unknown_share: float
    empty_unknown_share: float


@dataclass(frozen=True)
class SolidFigures:
    """Metrics of the built solid against the true one.

    Attributes:
        fine: overlap on 256^3 cells.
        coarse: overlap on 64^3 cells of the same cube. A coarse cell is set if more than half of its 4^3 fine
            cells are set. This IoU is not smooth: a small shift can add a whole layer of cells to thin
            upright parts, or remove one.
        exact_fine: same as `fine`, against the exact solid.
        exact_coarse: same as `coarse`, against the exact solid.
        line_width_m: width of the lines of sight that define the seeable solid.
        closed_by_definition_share: volume of the seeable solid outside the true mesh, relative to the exact
            solid.
        not_judged_share: volume that is not evaluated (gaps that only a finer sensor could see into, and
            walls thinner than a voxel), relative to the exact solid.
        true_volume_m3: volume enclosed by the true mesh.
        built_volume_m3: volume enclosed by the built mesh.
        built_outside_share: share of the built solid outside the cube, found in a cube of twice the side;
            other metrics ignore this part.
        known_gross_share: volume of voxels whose known state is wrong more than 10 mm from the seeable
            solid's surface, relative to the seeable solid.
        exact_known_gross_share: the same for the exact solid.
        solid_called_air: the part of `known_gross_share` inside the seeable solid, including the parts of it
            outside the object's voxel grid.
        air_called_solid: the part of `known_gross_share` outside the seeable solid.
        unknown_near_measured: share labelled unknown, of the voxels within 10 mm of measured surface.
        calibration_error: mean over the bins of |mean probability - share inside the seeable solid|.
        calibration_bins: ten bins of equal count, of voxels that are unknown or within 30 mm of the surface.
        face_bias_m: mean signed distance of the built mesh from measured surface, > 0: too far out.
        estimated_iou: the estimated IoU in quality.json; None if missing.
        estimated_iou_low: lower end of the estimate's interval in quality.json.
        estimated_iou_high: upper end of this interval.
        iou_in_interval: whether the IoU of `fine` lies in this interval; None if there is no interval.
        estimated_known_iou: the estimated IoU over known voxels in quality.json; None if missing.
        known_iou_in_interval: whether `known_iou` of `fine` lies in the interval of its estimate; None if
            there is no interval or no `known_iou`.
    """

    fine: SolidOverlap
    coarse: SolidOverlap
    exact_fine: SolidOverlap
    exact_coarse: SolidOverlap
    line_width_m: float
    closed_by_definition_share: float
    not_judged_share: float
    true_volume_m3: float
    built_volume_m3: float
    built_outside_share: float
    known_gross_share: float
    exact_known_gross_share: float
    solid_called_air: float
    air_called_solid: float
    unknown_near_measured: NearUnknown
    calibration_error: float | None
    calibration_bins: tuple[CalibrationBin, ...]
    face_bias_m: FaceBias
    estimated_iou: float | None
    estimated_iou_low: float | None
    estimated_iou_high: float | None
    iou_in_interval: bool | None
    estimated_known_iou: float | None
    known_iou_in_interval: bool | None


def canonical_cube(truth: Truth) -> Grid:
    """Return the 256^3 grid around the true object: along its axes, centred on its bounding box.

    The side of the cube is the box's longest extent times 256/252, as in framing `object`. The grid is placed
    in the truth's world.
    """
    return object_cube(truth.mesh_world.vertices, truth.T_world_object)


def check_fills_cells(truth: Truth) -> None:
    """Refuse a true object so thin that no cell's centre in the canonical cube lies inside it.

    Raises:
        RecordingError: the object is too thin.
    """
    grid = canonical_cube(truth)
    if not mesh_occupancy(truth.mesh_world, grid).any():
        cell_mm = grid.voxel_size_m * 1000
        raise RecordingError(
            f"{truth.folder}: the object is thinner than a cell ({cell_mm:.1f} mm) of the cube around it: "
            "no cell's centre lies inside; simulate a thicker one",
            what="bad-mesh",
        )


def compare_on(
    grid: Grid, model: ObjectModel, truth: Truth, registration: BuildRegistration
) -> EvaluatedSolids:
    """Sample the truth, the built mesh and its labels at the cells of one grid.

    The grid is a cube in the truth's world, a multiple of 8 cells a side; the model is in its own world.
    """
    in_built, cells = _in_built(grid, registration), truth.cells(grid)
    return EvaluatedSolids(
        true=cells.solid,
        judged=cells.judged,
        exact=cells.exact,
        built=_built_cells(model, in_built),
        known=unpack(known_in(*full_shape(model).known, in_built)),
    )


def solid_figures(
    model: ObjectModel, truth: Truth, registration: BuildRegistration, surface: MeasuredSurface
) -> SolidFigures:
    """Compare the solids on 256^3 and 64^3 cells of the canonical cube, and on the object's own voxels.

    The coarse cells are reduced from the fine cells. The centres of the coarse cells are not sampled, because
    the object's box ends exactly at some of them. The model is in its own world.
    """
    grid = canonical_cube(truth)
    fine = compare_on(grid, model, truth, registration)
    exact, coarse, seeable = fine.against_exact, reduced_solids(fine), truth.seeable
    figures, true_volume_m3 = overlap(fine), truth.mesh_world.volume_m3
    voxels = voxels_beside(model, truth, registration, surface)
    called_air = fine.known & ~fine.built
    beyond_m3, exact_beyond_m3 = (
        called_air_beyond_m3(grid, lost & called_air, voxels, truth)
        for lost in (fine.true & fine.judged, fine.exact)
    )
    gross = gross_errors(voxels, true_volume_m3 * (1 + seeable.closed_share), beyond_m3)
    exact_gross = gross_errors(voxels.against_exact, true_volume_m3, exact_beyond_m3)
    bins = calibration(voxels)
    quality = model.quality
    of_whole = (quality.estimated_iou_low, quality.estimated_iou_high)
    of_known = (quality.estimated_known_iou_low, quality.estimated_known_iou_high)
    return SolidFigures(
        fine=figures,
        coarse=overlap(coarse),
        exact_fine=overlap(exact),
        exact_coarse=overlap(reduced_solids(exact)),
        line_width_m=seeable.limits.line_width_m,
        closed_by_definition_share=seeable.closed_share,
        not_judged_share=seeable.slit_share,
        true_volume_m3=true_volume_m3,
        built_volume_m3=model.shape.mesh.volume_m3,
        built_outside_share=_outside_share(grid, model, registration),
        known_gross_share=gross.known_gross_share,
        exact_known_gross_share=exact_gross.known_gross_share,
        solid_called_air=gross.solid_called_air,
        air_called_solid=gross.air_called_solid,
        unknown_near_measured=unknown_near_measured(voxels, surface),
        calibration_error=calibration_error(bins),
        calibration_bins=bins,
        face_bias_m=face_bias(model.shape.mesh.transformed(registration.T_truth_built), truth, surface),
        estimated_iou=quality.estimated_iou,
        estimated_iou_low=of_whole[0],
        estimated_iou_high=of_whole[1],
        iou_in_interval=_lies_in(of_whole, figures.iou),
        estimated_known_iou=quality.estimated_known_iou,
        known_iou_in_interval=_lies_in(of_known, figures.known_iou),
    )


def _lies_in(interval: tuple[float | None, float | None], iou: float | None) -> bool | None:
    """Return whether an IoU lies in an interval; None if the IoU or an end is not known."""
    low, high = interval
    return None if low is None or high is None or iou is None else bool(low <= iou <= high)


def reduced_solids(solids: EvaluatedSolids) -> EvaluatedSolids:
    """Return grids reduced by 4 along each axis: a cell is set if more than half of its 4^3 cells are set."""
    return EvaluatedSolids(
        *(reduce_blocks(getattr(solids, field.name), "majority") for field in fields(solids))
    )


def overlap(solids: EvaluatedSolids) -> SolidOverlap:
    """Return the overlap of the built and the true solid on one grid."""
    built, known, judged = solids.built & solids.judged, solids.known, solids.judged
    true = solids.true & judged
    return SolidOverlap(
        cells=len(true),
        iou=grid_iou(built, true),
        known_iou=known_iou(built, true, known),
        true_unknown_share=share(~known, of=true),
        empty_unknown_share=share(~known, of=~solids.true & judged),
    )


def _in_built(grid: Grid, registration: BuildRegistration) -> Grid:
    """Return the same grid, placed in the build's world."""
    return replace(grid, T_world_grid=registration.T_built_truth @ grid.T_world_grid)


def _built_cells(model: ObjectModel, grid: Grid) -> Bools:
    mesh = model.shape.mesh
    return unpack(voxelize_solid(mesh.vertices, mesh.faces, grid))


def _outside_share(grid: Grid, model: ObjectModel, registration: BuildRegistration) -> float:
    """Return the share of the built solid that lies outside a cube.

    It is found on a grid of twice the cube's side around the cube.
    """
    n, side_m = grid.shape[0], grid.shape[0] * grid.voxel_size_m
    corner = rigid(np.eye(3), np.full(3, -side_m / 2))
    around = Grid(grid.shape, 2 * grid.voxel_size_m, grid.T_world_grid @ corner)
    built = _built_cells(model, _in_built(around, registration))
    outside = np.ones_like(built)
    outside[n // 4 : -n // 4, n // 4 : -n // 4, n // 4 : -n // 4] = False
    return share(outside, of=built)
