"""A solid from an open surface: what is carved is empty, what is enclosed is inside."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object import Curve, RuleProbabilities, SolidMethod
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import ShapeError
from kinectbench.core.geometry import Grid, TriangleMesh, transform_points
from kinectbench.core.geometry.mesh import isosurface
from kinectbench.core.types import Bools, Float32
from kinectbench.core.voxels.observation import (
    RAY_WIDTHS_VOXELS,
    TRUST_IN_VOTES,
    USUAL_FREE_SHARE,
    USUAL_FREE_SHARE_PER_VOXEL,
    VOXELS_PER_FREE_SHARE,
    Observation,
    trust_in_votes,
    without_fringe,
)
from kinectbench.stages.segment.enclosure import (
    APRON_BENEATH,
    EMPTY_BESIDE,
    EMPTY_UNDER,
    ENCLOSED,
    FULL_OVERHANG,
    INSIDE,
    LEVEL_ENCLOSED,
    MAX_DOUBTFUL_M,
    MAX_HOLLOW_M,
    MIN_ENCLOSED_HOLLOW_M,
    MIN_HOLLOW_M,
    NEUTRAL,
    OPEN_BELOW,
    OPEN_BENEATH,
    OUTSIDE,
    OVERHANG_M,
    UNSEEN,
    Shadow,
    enclosure,
    hollows,
    shadow,
)
from kinectbench.stages.segment.morphology import carried_up

# How many of the unseen voxels are inside, by the number of enclosing directions of 26: counted on simulated
# furniture (28 objects of 4 families, seeds 18 to 24). From 15 on about half are, from 16 on most.
INTERIOR_SHARE = 15.5 / 26
ENCLOSING = np.array([0, 2, 5, 8, 10, 12, 14, 15, 16, 17, 20, 22, 26], np.float32) / 26
INSIDE_SHARE = np.array(
    [0.0, 0.02, 0.02, 0.04, 0.17, 0.34, 0.34, 0.52, 0.7, 0.89, 0.89, 0.89, 1.0], np.float32
)
HOLLOW_INSIDE_SHARE = np.float32(0.05)
# Under the object, by its enclosure, and what is called empty there and elsewhere (`enclosure.shadow`).
UNDER_INSIDE_SHARE, EMPTY_UNDER_SHARE, EMPTY_BESIDE_SHARE = (np.float32(p) for p in (0.12, 0.07, 0.01))
# Of ten simulated things with flush sides under a seat seven were slabs throughout (seeds 4 to 18).
DOUBTFUL_INSIDE_SHARE = np.float32(0.75)
# A voxel with less than this share of the surface's median weight has been grazed by a few rays at most.
LEAST_WEIGHT_SHARE = 0.015
# An unseen voxel is carved by so many frames, and by this share of those that look at the object: along
# edges depth wanders, and a few frames seem to see through the last millimetres of a board.
MIN_FREE_VOTES, MIN_FREE_SHARE = 2, 0.04
# How many of the observed voxels are inside, by their signed distance in voxels; the same 28 objects.
SIGNED_VOXELS = np.array([-3, -2, -1, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 1, 2, 3], np.float32)
SIGNED_INSIDE_SHARE = np.array(
    [0.98, 0.975, 0.94, 0.885, 0.775, 0.5, 0.125, 0.05, 0.02, 0.014, 0.003, 0.001], np.float32
)
SMOOTHING_VOXELS = 0.7
SPECK_SHARE = 0.02


def _curve(at: NDArray[np.floating], share: NDArray[np.floating]) -> Curve:
    """Support points and values of an interpolated probability, for the record."""
    return tuple((round(float(x), 4), round(float(y), 4)) for x, y in zip(at, share, strict=True))


METHOD = SolidMethod(
    name="carving + hollows behind aprons + 26-direction enclosure + floor contact + smoothing",
    occupied_share=round(ENCLOSED, 4),
    interior_share=round(INTERIOR_SHARE, 4),
    level_enclosed=LEVEL_ENCLOSED,
    empty_under=EMPTY_UNDER,
    empty_share=round(EMPTY_BESIDE, 4),
    hollow_overhang_m=OVERHANG_M,
    hollow_full_overhang=FULL_OVERHANG,
    hollow_height_m=(MIN_HOLLOW_M, MAX_HOLLOW_M),
    doubtful_height_m=MAX_DOUBTFUL_M,
    hollow_enclosed_height_m=MIN_ENCLOSED_HOLLOW_M,
    hollow_beneath_share=(round(OPEN_BENEATH, 4), round(APRON_BENEATH, 4)),
    hollow_open_below=OPEN_BELOW,
    least_weight_share=LEAST_WEIGHT_SHARE,
    min_free_votes=MIN_FREE_VOTES,
    min_free_share=MIN_FREE_SHARE,
    free_by_noise=(USUAL_FREE_SHARE, USUAL_FREE_SHARE_PER_VOXEL),
    voxels_per_free_share=VOXELS_PER_FREE_SHARE,
    trust_in_votes=(RAY_WIDTHS_VOXELS, TRUST_IN_VOTES),
    smoothing_voxels=SMOOTHING_VOXELS,
    probability_by_enclosure=_curve(ENCLOSING, INSIDE_SHARE),
    probability_by_signed_voxels=_curve(SIGNED_VOXELS, SIGNED_INSIDE_SHARE),
    probability_by_rule=RuleProbabilities(
        hollow=round(float(HOLLOW_INSIDE_SHARE), 4),
        doubtful=round(float(DOUBTFUL_INSIDE_SHARE), 4),
        under=round(float(UNDER_INSIDE_SHARE), 4),
        under_empty=round(float(EMPTY_UNDER_SHARE), 4),
        beside_empty=round(float(EMPTY_BESIDE_SHARE), 4),
    ),
    chosen_on="simulated furniture of 4 families, seeds 1 to 27",
)


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


@dataclass(frozen=True)
class FloorLayers:
    """Layers of an upright grid's cells about the floor, from the grid's bottom up.

    Attributes:
        below: layers below the floor.
        contact: layers above it in which floor and object cannot be told apart.
        low: layers above those in which a surface is the object's only where it goes on above them.
    """

    below: int
    contact: int
    low: int = 0

    @property
    def first(self) -> int:
        """The first layer in which surface may be the object's."""
        return self.below + self.contact

    @property
    def cut(self) -> int:
        """The first layer in which whatever stands there is not the floor."""
        return self.first + self.low


@dataclass(frozen=True)
class _Evidence:
    """What the frames say of each voxel, in the grid's shape.

    `signed_m` is the signed distance of the surface, corrected by the frames that saw through; `excluded`
    cannot be the object; `doubtful` may be a hollow; `contact` lies right above the floor.
    """

    signed_m: Float32
    observed: Bools
    carved: Bools
    behind: Bools
    excluded: Bools
    hollow: Bools
    doubtful: Bools
    enclosed: Float32
    unseen: Bools
    shadow: Shadow
    contact: slice


def solidify(
    observation: Observation, excluded: Bools, layers: FloorLayers, ray_width_m: float = 0.0
) -> SolidShape:
    """Decide for every voxel whether it is occupied, and how that is known.

    A voxel is empty if it was carved: its TSDF is positive, or frames saw through it; or if it lies in a
    hollow behind an apron or under the object. It is occupied if it lies just behind a measured
    surface, or was never seen but is enclosed by such voxels in 15 of 26 directions and not open to the
    sides. Near the floor what is connected to nothing higher is floor; where the two cannot be told apart,
    the lowest occupied layer is extruded down to the floor. Legs whose upper end was hidden are carried up to
    the object. The signed field of this solid is smoothed by a Gaussian of 0.7 voxels, specks are dropped,
    and voids filled.

    Args:
        observation: TSDF and votes on an upright grid.
        excluded: bool, voxels that cannot be the object: neighbours, outside a given box.
        layers: of the grid's cells about the floor.
        ray_width_m: how wide the frames' rays are at the object, metres; 0 = narrow.

    Raises:
        ShapeError: nothing is left.
    """
    from scipy import ndimage

    evidence = _weigh(observation, excluded, layers, ray_width_m)
    excluded = evidence.excluded
    solid = (evidence.behind & ~excluded) | (
        evidence.unseen & ~evidence.shadow.under & (evidence.enclosed >= ENCLOSED)
    )
    contact = evidence.contact
    # Down to the floor, and for now beyond it, so that smoothing does not round the feet.
    solid[:, :, : contact.stop] = solid[:, :, contact.stop, None] & ~excluded[:, :, : contact.stop]
    voxel_m = observation.grid.voxel_size_m
    solid = carried_up(solid, evidence.carved | excluded, contact.stop, voxel_m)
    field = _smooth_field(evidence, _without_specks(solid), voxel_m)
    empty = excluded.copy()
    empty[:, :, : layers.below] = True
    # A void without a 6-connected way out is filled: nobody can have looked into it.
    solid = ndimage.binary_fill_holes(_without_specks((field < 0) & ~empty)) & ~empty
    if not solid.any():
        raise ShapeError("no solid shape: no surface of the object was measured; record it from all sides")
    labels = _label(observation, evidence, solid, layers.below)
    probability = _probability(observation, evidence, solid)
    probability[:, :, : layers.below] = 0
    mesh = _closed_mesh(np.where(solid, -np.abs(field), np.abs(field)), observation.grid)
    doubtful = int((evidence.doubtful & solid).sum()) / int(solid.sum())
    return SolidShape(observation.grid, solid, labels, probability, mesh, doubtful)


def _weigh(observation: Observation, excluded: Bools, layers: FloorLayers, ray_width_m: float) -> _Evidence:
    """Carving and enclosure."""
    voxel_m = observation.grid.voxel_size_m
    near = np.abs(observation.tsdf) < voxel_m
    weights = observation.weight[near & (observation.weight > 0)]
    least = LEAST_WEIGHT_SHARE * float(np.median(weights)) if len(weights) else 0.0
    observed = observation.weight > least
    contact = slice(layers.below, layers.first)
    signed_m = _signed_distance_m(observation, ray_width_m)
    carved = np.where(observed, signed_m > 0, observation.free >= _least_free_votes(observation))
    behind = observed & ~carved
    excluded = excluded | _loose(behind & ~excluded, layers)

    state = np.full(observation.grid.shape, UNSEEN, np.uint8)
    state[behind] = INSIDE
    state[:, :, contact][behind[:, :, contact]] = UNSEEN
    state[carved | excluded] = OUTSIDE
    # Below the object no camera sees the floor: walking down says nothing there.
    measured = observed & (np.abs(observation.tsdf) < 2 * voxel_m)
    floor_seen = measured[:, :, : contact.stop].any(axis=2)
    state[:, :, : layers.below] = np.where(floor_seen, OUTSIDE, NEUTRAL)[:, :, None]
    enclosed = enclosure(state)
    found = hollows(state, enclosed, voxel_m)
    hollow = found.sure
    hollow[:, :, : contact.stop] = False
    unseen = (state == UNSEEN) & ~hollow
    return _Evidence(
        signed_m,
        observed,
        carved,
        behind,
        excluded,
        hollow,
        found.doubtful,
        enclosed,
        unseen,
        shadow(state, enclosed),
        contact,
    )


def _loose(behind: Bools, layers: FloorLayers) -> Bools:
    """What lies behind a surface in the low layers and is connected (26 neighbours) to nothing above them."""
    from scipy import ndimage

    loose = np.zeros_like(behind)
    if layers.low:
        # One layer above them is enough to see what goes on there.
        low = behind[:, :, layers.first : layers.cut + 1]
        pieces, count = ndimage.label(low, np.ones((3, 3, 3)))
        held = np.zeros(count + 1, dtype=bool)
        held[pieces[:, :, -1]] = True
        loose[:, :, layers.first : layers.cut] = (low & ~held[pieces])[:, :, :-1]
    return loose


def _signed_distance_m(observation: Observation, ray_width_m: float) -> Float32:
    """Of the surface, where a voxel was observed."""
    voxel_m = observation.grid.voxel_size_m
    trust = trust_in_votes(ray_width_m, voxel_m)
    return without_fringe(observation.tsdf, observation.free, observation.surface, voxel_m, trust)


def _least_free_votes(observation: Observation) -> int:
    """How many frames must have seen through a voxel that was never observed near a surface."""
    looking = int((observation.free.astype(np.uint32) + observation.surface).max())
    return max(MIN_FREE_VOTES, round(MIN_FREE_SHARE * looking))


def _label(observation: Observation, evidence: _Evidence, solid: Bools, below: int) -> NDArray[np.uint8]:
    """One label per voxel, by what it rests on."""
    near = np.abs(evidence.signed_m) <= 1.5 * observation.grid.voxel_size_m
    measured = evidence.observed & near
    enclosed = evidence.unseen & (evidence.enclosed >= INTERIOR_SHARE)
    labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    labels[~solid & evidence.carved] = Label.FREE
    empty = evidence.behind | evidence.excluded | evidence.hollow | (evidence.unseen & evidence.shadow.empty)
    labels[~solid & empty] = Label.OTHER
    labels[solid & (evidence.behind | enclosed)] = Label.INTERIOR
    labels[solid & evidence.doubtful] = Label.UNKNOWN
    contact = evidence.contact
    labels[:, :, contact][solid[:, :, contact]] = Label.INTERIOR
    labels[solid & measured] = Label.SURFACE
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


def _probability(observation: Observation, evidence: _Evidence, solid: Bools) -> Float32:
    """Occupancy probability: from the enclosure where unseen, from the signed distance where measured."""
    inferred = evidence.unseen | evidence.hollow
    probability = np.empty(solid.shape, np.float32)
    signed_voxels = evidence.signed_m[~inferred] / np.float32(observation.grid.voxel_size_m)
    probability[~inferred] = np.interp(signed_voxels, SIGNED_VOXELS, SIGNED_INSIDE_SHARE)
    probability[inferred] = np.interp(evidence.enclosed[inferred], ENCLOSING, INSIDE_SHARE)
    under, empty = evidence.shadow.under, evidence.shadow.empty
    for where, share in (
        (under, UNDER_INSIDE_SHARE),
        (under & empty, EMPTY_UNDER_SHARE),
        (empty & ~under, EMPTY_BESIDE_SHARE),
        (evidence.doubtful, DOUBTFUL_INSIDE_SHARE),
    ):
        where = where & inferred
        probability[where] = np.minimum(probability[where], share)
    probability[evidence.hollow] = HOLLOW_INSIDE_SHARE
    # What the rules above decided otherwise (floor contact, specks, neighbours) stays decided.
    decided = solid != (probability > 0.5)
    return np.where(decided, np.where(solid, np.float32(0.75), np.float32(0.05)), probability)


def _smooth_field(evidence: _Evidence, solid: Bools, voxel_size_m: float) -> Float32:
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
