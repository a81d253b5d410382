"""A solid from an open surface: what was seen through is air, what no camera could see is the object."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import ShapeError
from kinectbench.core.geometry import Grid, TriangleMesh, transform_points
from kinectbench.core.geometry.mesh import isosurface
from kinectbench.core.types import Bools, Float32
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.evidence import Evidence, Rules, weigh
from kinectbench.stages.segment.guess import inside_probability, measured_probability
from kinectbench.stages.segment.morphology import carried_up

SMOOTHING_VOXELS = 0.7
SPECK_SHARE = 0.02


@dataclass(frozen=True)
class SolidShape:
    """The object as a solid; all arrays have the grid's shape.

    Attributes:
        grid: upright, cells aligned with the floor: a cell boundary lies at z = 0.
        solid: bool, occupied.
        labels: uint8, see `Label`.
        probability: float32 in [0, 1], that the voxel is occupied.
        mesh: closed surface of `solid`, smooth where it was measured, world frame, metres.
        underside: bool, nobody saw it, and only lines of sight that look up reach it: one word decides it.
    """

    grid: Grid
    solid: Bools
    labels: NDArray[np.uint8]
    probability: Float32
    mesh: TriangleMesh
    underside: Bools

    @property
    def underside_share(self) -> float:
        """Of the solid, what a word about its underside decides."""
        return int((self.underside & self.solid).sum()) / max(1, int(self.solid.sum()))


def solidify(observation: Observation, excluded: Bools, rules: Rules) -> SolidShape:
    """The solid of what some of the frames say, for comparison: `weigh` roughly, then `make_solid`.

    Args:
        observation: TSDF and votes on an upright grid.
        excluded: bool, voxels that cannot be the object: neighbours, outside a given box.
        rules: what a solid is made by.

    Raises:
        ShapeError: nothing is left.
    """
    return make_solid(observation, weigh(observation, excluded, rules, roughly=True), rules)


def make_solid(observation: Observation, evidence: Evidence, rules: Rules) -> SolidShape:
    """Decide for every voxel whether it is occupied, and how that is known.

    A voxel is empty if it was carved: its TSDF is positive, or frames saw through it. It is occupied if it
    lies just behind a measured surface, and if no camera could see it. What is unknown is occupied if that is
    the more probable (`guess`). Next to the floor, where it and the object cannot be told apart, the lowest
    occupied layer and plates that hardly rise above it are extruded down to the floor. Legs whose upper end
    was hidden are carried up to the object. The signed field of this solid is smoothed by a Gaussian of 0.7
    voxels, specks are dropped, and voids filled.

    Args:
        observation: TSDF and votes on an upright grid.
        evidence: what they say.
        rules: what a solid is made by.

    Raises:
        ShapeError: nothing is left.
    """
    from scipy import ndimage

    excluded, contact, below = evidence.excluded, evidence.contact, rules.layers.below
    voxel_m = observation.grid.voxel_size_m
    guess = inside_probability(evidence, rules, voxel_m)
    solid = evidence.band | evidence.closed | (evidence.unknown & (guess > 0.5))
    # Down to the floor, and for now beyond it, so that smoothing does not round the feet.
    standing = solid[:, :, contact.stop] | evidence.raised
    solid[:, :, : contact.stop] = standing[:, :, None] & ~excluded[:, :, : contact.stop]
    solid = carried_up(solid, evidence.carved | excluded, contact.stop, voxel_m)
    field = _smooth_field(evidence, _without_specks(solid), voxel_m)
    empty = excluded.copy()
    empty[:, :, :below] = True
    # A void without a 6-connected way out is filled: nobody can have looked into it.
    solid = ndimage.binary_fill_holes(_without_specks((field < 0) & ~empty)) & ~empty
    if not solid.any():
        raise ShapeError("no solid shape: no surface of the object was measured; record it from all sides")
    labels = _label(observation, evidence, solid, below)
    probability = _probability(voxel_m, evidence, guess, solid)
    probability[:, :, :below] = 0
    mesh = _closed_mesh(np.where(solid, -np.abs(field), np.abs(field)), observation.grid)
    return SolidShape(observation.grid, solid, labels, probability, mesh, evidence.underside)


def _label(observation: Observation, evidence: Evidence, solid: Bools, below: int) -> NDArray[np.uint8]:
    """One label per voxel, by what it rests on."""
    near = np.abs(evidence.signed_m) <= 1.5 * observation.grid.voxel_size_m
    measured = evidence.observed & near & ~evidence.carved
    labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    labels[~solid & evidence.carved] = Label.FREE
    labels[~solid & (evidence.band | evidence.excluded)] = Label.OTHER
    labels[solid & evidence.closed] = Label.INTERIOR
    labels[solid & (evidence.band | measured) & ~evidence.unknown] = Label.SURFACE
    labels[:, :, :below] = Label.OTHER
    return labels


def _without_specks(solid: Bools) -> Bools:
    """Drop 6-connected pieces smaller than 2 % of the largest."""
    from scipy import ndimage

    pieces, _ = ndimage.label(solid)
    sizes = np.bincount(pieces.reshape(-1))
    sizes[0] = 0
    keep = (sizes > 0) & (sizes >= SPECK_SHARE * sizes.max())
    kept: Bools = keep[pieces]
    return kept


def _probability(voxel_m: float, evidence: Evidence, guess: Float32, solid: Bools) -> Float32:
    """Occupancy probability: the guess where nothing was measured, else from the signed distance."""
    probability = np.where(evidence.unseen, guess, measured_probability(evidence.signed_m, voxel_m))
    # What the rules above decided otherwise (floor contact, specks, neighbours) stays decided.
    decided = np.where(solid, probability <= 0.5, probability >= 0.5)
    return np.where(decided, np.where(solid, np.float32(0.75), np.float32(0.05)), probability)


def _smooth_field(evidence: Evidence, solid: Bools, voxel_size_m: float) -> Float32:
    """A signed field, negative inside, in metres: the distance where measured, a constant step elsewhere.

    Its sign is that of `solid`; then it is smoothed by a Gaussian, which takes the sensor's noise off
    the surface; a wider one would thin slats and narrow the masks.
    """
    from scipy import ndimage

    step = np.float32(voxel_size_m)
    # Only the inner band next to a surface is trusted; the far one belongs to another surface.
    distance_m = np.abs(evidence.signed_m)
    magnitude = np.where(evidence.observed & (distance_m < 2 * step), distance_m, step)
    magnitude = np.clip(magnitude, np.float32(0.1) * step, step)
    field = np.where(solid, -magnitude, magnitude)
    smooth: Float32 = ndimage.gaussian_filter(field, SMOOTHING_VOXELS, mode="nearest", truncate=3.0)
    return smooth


def _closed_mesh(field: Float32, grid: Grid) -> TriangleMesh:
    """Marching cubes of a signed field padded by empty cells, so that the surface is closed."""
    step = np.float32(grid.voxel_size_m)
    # A field of exactly 0 would make triangles without area.
    away = np.where(field < 0, np.minimum(field, -0.02 * step), np.maximum(field, 0.02 * step))
    mesh = isosurface(np.pad(away, 1, constant_values=step).astype(np.float32))
    points_grid = (mesh.vertices - 0.5) * grid.voxel_size_m
    return TriangleMesh(transform_points(grid.T_world_grid, points_grid), mesh.faces)
