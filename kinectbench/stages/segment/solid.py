"""A solid from an open surface: what is carved is empty, what is enclosed is inside."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import ShapeError
from kinectbench.core.geometry import Grid, TriangleMesh, transform_points
from kinectbench.core.geometry.mesh import isosurface
from kinectbench.core.types import Bools, Float32
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.evidence import Evidence, FloorLayers, weigh
from kinectbench.stages.segment.morphology import carried_up
from kinectbench.stages.segment.probability import (
    INTERIOR_SHARE,
    measured_probability,
    unseen_probability,
)

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
        doubtful_share: share of the solid that may be a hollow under a top (`enclosure.hollows`).
    """

    grid: Grid
    solid: Bools
    labels: NDArray[np.uint8]
    probability: Float32
    mesh: TriangleMesh
    doubtful_share: float = 0.0


def solidify(
    observation: Observation, excluded: Bools, layers: FloorLayers, ray_width_m: float = 0.0
) -> SolidShape:
    """The solid of what the frames say: `weigh`, then `make_solid`.

    Args:
        observation: TSDF and votes on an upright grid.
        excluded: bool, voxels that cannot be the object: neighbours, outside a given box.
        layers: of the grid's cells about the floor.
        ray_width_m: how wide the frames' rays are at the object, metres; 0 = narrow.

    Raises:
        ShapeError: nothing is left.
    """
    return make_solid(observation, weigh(observation, excluded, layers, ray_width_m), layers)


def make_solid(observation: Observation, evidence: Evidence, layers: FloorLayers) -> SolidShape:
    """Decide for every voxel whether it is occupied, and how that is known.

    A voxel is empty if it was carved: its TSDF is positive, or frames saw through it; or if it lies in a
    hollow behind an apron or under the object. It is occupied if it lies just behind a measured surface. What
    no frame saw is occupied if that is the more probable (`unseen_probability`). Near the floor what is
    connected to nothing higher is floor; where the two cannot be told apart, the lowest occupied layer and
    plates that hardly rise above it are extruded down to the floor. Legs whose upper end was hidden are
    carried up to the object. The signed field of this solid is smoothed by a Gaussian of 0.7 voxels, specks
    are dropped, and voids filled.

    Args:
        observation: TSDF and votes on an upright grid.
        evidence: what they say.
        layers: of the grid's cells about the floor.

    Raises:
        ShapeError: nothing is left.
    """
    from scipy import ndimage

    excluded, contact = evidence.excluded, evidence.contact
    voxel_m = observation.grid.voxel_size_m
    unseen = unseen_probability(evidence, voxel_m)
    inferred = evidence.unseen | evidence.openings.open
    solid = np.where(inferred, unseen > 0.5, evidence.behind) & ~excluded
    # Down to the floor, and for now beyond it, so that smoothing does not round the feet.
    standing = solid[:, :, contact.stop] | evidence.raised
    solid[:, :, : contact.stop] = standing[:, :, None] & ~excluded[:, :, : contact.stop]
    solid = carried_up(solid, evidence.carved | excluded, contact.stop, voxel_m)
    field = _smooth_field(evidence, _without_specks(solid), voxel_m)
    empty = excluded.copy()
    empty[:, :, : layers.below] = True
    # A void without a 6-connected way out is filled: nobody can have looked into it.
    solid = ndimage.binary_fill_holes(_without_specks((field < 0) & ~empty)) & ~empty
    if not solid.any():
        raise ShapeError("no solid shape: no surface of the object was measured; record it from all sides")
    labels = _label(observation, evidence, solid, layers.below)
    probability = _probability(voxel_m, evidence, unseen, solid)
    probability[:, :, : layers.below] = 0
    mesh = _closed_mesh(np.where(solid, -np.abs(field), np.abs(field)), observation.grid)
    doubtful = int((evidence.hollows.doubtful & solid).sum()) / int(solid.sum())
    return SolidShape(observation.grid, solid, labels, probability, mesh, doubtful)


def _label(observation: Observation, evidence: Evidence, solid: Bools, below: int) -> NDArray[np.uint8]:
    """One label per voxel, by what it rests on."""
    near = np.abs(evidence.signed_m) <= 1.5 * observation.grid.voxel_size_m
    measured = evidence.observed & near
    enclosed = evidence.behind | (evidence.unseen & (evidence.enclosed >= INTERIOR_SHARE))
    labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    labels[~solid & evidence.carved] = Label.FREE
    labels[~solid & ((evidence.behind & ~evidence.openings.open) | evidence.excluded)] = Label.OTHER
    labels[solid & enclosed & ~evidence.openings.open] = Label.INTERIOR
    labels[solid & evidence.hollows.doubtful] = Label.UNKNOWN
    contact = evidence.contact
    # What stands above goes on down to the floor, unless frames saw through, or it is open itself.
    carried = solid[:, :, contact] & ~evidence.carved[:, :, contact] & ~evidence.openings.open[:, :, contact]
    labels[:, :, contact][solid[:, :, contact]] = Label.UNKNOWN
    labels[:, :, contact][carried] = Label.INTERIOR
    labels[solid & measured & ~evidence.carved] = Label.SURFACE
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


def _probability(voxel_m: float, evidence: Evidence, unseen: Float32, solid: Bools) -> Float32:
    """Occupancy probability: `unseen` where nothing was measured, else from the signed distance."""
    inferred = evidence.unseen | evidence.hollows.sure | evidence.openings.open
    probability = np.where(inferred, unseen, measured_probability(evidence.signed_m, voxel_m))
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
