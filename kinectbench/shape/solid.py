"""A solid from an open surface: what is carved is empty, what is enclosed is inside."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import ShapeError
from kinectbench.fusion.mesh import isosurface
from kinectbench.fusion.reconstruction import Observation
from kinectbench.geometry import Grid, TriangleMesh, transform_points
from kinectbench.shape.enclosure import INSIDE, NEUTRAL, OUTSIDE, UNSEEN, enclosure
from kinectbench.shape.labels import Label

Bools = NDArray[np.bool_]

# Chosen on simulated furniture (12 objects of 4 families). The share of enclosing directions from which on
# unseen voxels are inside more often than not, and from which on they nearly always are (95 %).
OCCUPIED_SHARE = 15 / 26
INTERIOR_SHARE = 17 / 26
# Logistic fit of how many unseen voxels are inside, against that share.
PROBABILITY_CENTRE = 15.1 / 26
PROBABILITY_SLOPE = 35.0
# A voxel with less than this share of the surface's median weight has been grazed by a few rays at most.
LEAST_WEIGHT_SHARE = 0.015
MIN_FREE_VOTES = 2
FREE_OVER_SURFACE = 3
SMOOTHING_VOXELS = 0.7
SPECK_SHARE = 0.02
METHOD = {
    "name": "carving + 26-direction enclosure + floor contact + smoothing",
    "occupied_share": round(OCCUPIED_SHARE, 4),
    "interior_share": round(INTERIOR_SHARE, 4),
    "least_weight_share": LEAST_WEIGHT_SHARE,
    "min_free_votes": MIN_FREE_VOTES,
    "free_over_surface": FREE_OVER_SURFACE,
    "smoothing_voxels": SMOOTHING_VOXELS,
}


@dataclass(frozen=True)
class SolidShape:
    """The object as a solid; all arrays have the grid's shape.

    Attributes:
        grid: upright, cells aligned with the floor: a cell boundary lies at z = 0.
        solid: bool, occupied.
        labels: uint8, see `Label`.
        probability: float32 in [0, 1], that the voxel is occupied.
        mesh: closed surface of `solid`, smooth where it was measured, world frame, metres.
    """

    grid: Grid
    solid: Bools
    labels: NDArray[np.uint8]
    probability: NDArray[np.float32]
    mesh: TriangleMesh


@dataclass(frozen=True)
class _Evidence:
    """What the frames say of each voxel, in the grid's shape; `contact` is the zone above the floor."""

    observed: Bools
    carved: Bools
    behind: Bools
    enclosed: NDArray[np.float32]
    unseen: Bools
    contact: slice


def solidify(observation: Observation, excluded: Bools, floor_layers: int, cut_layers: int) -> SolidShape:
    """Decide for every voxel whether it is occupied, and how that is known.

    A voxel is empty if it was carved: its TSDF is positive, or frames saw through it. It is occupied
    if it lies just behind a measured surface, or was never seen but is enclosed by such voxels in
    58 % of all directions. Near the floor, where floor and object cannot be told apart, the lowest
    occupied layer is extruded down to the floor. The signed field of this solid is smoothed by a
    Gaussian of 0.7 voxels, and specks are dropped.

    Args:
        observation: TSDF and votes on an upright grid.
        excluded: bool, voxels that cannot be the object: neighbours, outside a given box.
        floor_layers: cells along z below the floor.
        cut_layers: cells along z above it that count as floor.

    Raises:
        ShapeError: nothing is left.
    """
    evidence = _weigh(observation, excluded, floor_layers, cut_layers)
    solid = (evidence.behind & ~excluded) | (evidence.unseen & (evidence.enclosed >= OCCUPIED_SHARE))
    contact = evidence.contact
    # Down to the floor, and for now beyond it, so that smoothing does not round the feet.
    solid[:, :, : contact.stop] = solid[:, :, contact.stop, None] & ~excluded[:, :, : contact.stop]
    field = _smooth_field(observation, _without_specks(solid), evidence.observed)
    field[:, :, :floor_layers] = np.abs(field[:, :, :floor_layers])
    solid = _without_specks(field < 0)
    if not solid.any():
        raise ShapeError("no solid shape: no surface of the object was measured; record it from all sides")
    labels = _label(observation, evidence, solid, excluded, floor_layers)
    probability = _probability(observation, evidence, solid)
    mesh = _closed_mesh(np.where(solid, field, np.abs(field)), observation.grid)
    return SolidShape(observation.grid, solid, labels, probability, mesh)


def _weigh(observation: Observation, excluded: Bools, floor_layers: int, cut_layers: int) -> _Evidence:
    """Carving and enclosure."""
    near = np.abs(observation.tsdf) < observation.grid.voxel_size_m
    weights = observation.weight[near & (observation.weight > 0)]
    least = LEAST_WEIGHT_SHARE * float(np.median(weights)) if len(weights) else 0.0
    observed = observation.weight > least
    seen_through = (observation.free >= MIN_FREE_VOTES) & (
        observation.free > FREE_OVER_SURFACE * observation.surface.astype(np.uint32)
    )
    carved = (observed & (observation.tsdf > 0)) | seen_through
    behind = observed & ~carved
    contact = slice(floor_layers, floor_layers + cut_layers)

    state = np.full(observation.grid.shape, UNSEEN, np.uint8)
    state[behind] = INSIDE
    state[:, :, contact][behind[:, :, contact]] = UNSEEN
    state[carved | excluded] = OUTSIDE
    # Below the object no camera sees the floor: walking down says nothing there.
    measured = observed & (np.abs(observation.tsdf) < 2 * observation.grid.voxel_size_m)
    floor_seen = measured[:, :, : contact.stop].any(axis=2)
    state[:, :, :floor_layers] = np.where(floor_seen, OUTSIDE, NEUTRAL)[:, :, None]
    return _Evidence(observed, carved, behind, enclosure(state), state == UNSEEN, contact)


def _label(
    observation: Observation, evidence: _Evidence, solid: Bools, excluded: Bools, floor_layers: int
) -> NDArray[np.uint8]:
    """One label per voxel, by what it rests on."""
    near = np.abs(observation.tsdf) <= 1.5 * observation.grid.voxel_size_m
    measured = evidence.observed & near
    enclosed = evidence.unseen & (evidence.enclosed >= INTERIOR_SHARE)
    labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    labels[~solid & evidence.carved] = Label.FREE
    labels[~solid & (evidence.behind | excluded)] = Label.OTHER
    labels[solid & (evidence.behind | enclosed)] = Label.INTERIOR
    contact = evidence.contact
    labels[:, :, contact][solid[:, :, contact]] = Label.INTERIOR
    labels[solid & measured] = Label.SURFACE
    labels[:, :, :floor_layers] = Label.OTHER
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


def _probability(observation: Observation, evidence: _Evidence, solid: Bools) -> NDArray[np.float32]:
    """Occupancy probability: from the enclosure where unseen, from the signed distance where measured."""
    from scipy.special import expit

    inferred = expit(np.float32(PROBABILITY_SLOPE) * (evidence.enclosed - np.float32(PROBABILITY_CENTRE)))
    softness_m = np.float32(0.35 * observation.grid.voxel_size_m)
    measured = expit(-observation.tsdf / softness_m)
    probability = np.where(evidence.unseen, inferred, measured)
    # What the rules above decided otherwise (floor contact, specks, neighbours) stays decided.
    decided = solid != (probability > 0.5)
    return np.where(decided, np.where(solid, np.float32(0.75), np.float32(0.05)), probability)


def _smooth_field(observation: Observation, solid: Bools, observed: Bools) -> NDArray[np.float32]:
    """A signed field, negative inside, in metres: the TSDF where measured, a constant step elsewhere.

    Its sign is that of `solid`; then it is smoothed by a Gaussian, which takes the sensor's noise off
    the surface; a wider one would thin slats and narrow the masks.
    """
    from scipy import ndimage

    step = np.float32(observation.grid.voxel_size_m)
    # Only the inner band next to a surface is trusted; the far one belongs to another surface.
    use = observed & (np.abs(observation.tsdf) < 2 * step)
    magnitude = np.clip(np.where(use, np.abs(observation.tsdf), step), np.float32(0.1) * step, step)
    field = np.where(solid, -magnitude, magnitude)
    smooth: NDArray[np.float32] = ndimage.gaussian_filter(
        field, SMOOTHING_VOXELS, mode="nearest", truncate=3.0
    )
    return smooth


def _closed_mesh(field: NDArray[np.float32], grid: Grid) -> TriangleMesh:
    """Marching cubes of a signed field padded by empty cells, so that the surface is closed."""
    step = np.float32(grid.voxel_size_m)
    # A field of exactly 0 would make triangles without area.
    away = np.where(field < 0, np.minimum(field, -0.02 * step), np.maximum(field, 0.02 * step))
    mesh = isosurface(np.pad(away, 1, constant_values=step).astype(np.float32))
    points_grid = (mesh.vertices - 0.5) * grid.voxel_size_m
    return TriangleMesh(transform_points(grid.T_world_grid, points_grid), mesh.faces)
