"""A solid from an open surface: what is carved is empty, what is enclosed is inside."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import ShapeError
from kinectbench.fusion.mesh import TriangleMesh, isosurface
from kinectbench.fusion.reconstruction import Observation
from kinectbench.geometry import Grid, transform_points
from kinectbench.shape.enclosure import INSIDE, NEUTRAL, OUTSIDE, UNSEEN, enclosure
from kinectbench.shape.labels import Label

Bools = NDArray[np.bool_]

# Chosen on simulated furniture (12 objects of 4 families): the share of enclosing directions from which
# on unseen voxels are inside more often than not, and from which on they nearly always are (95 %).
OCCUPIED_SHARE = 15 / 26
INTERIOR_SHARE = 17 / 26
# Logistic fit of how many unseen voxels are inside, against that share.
PROBABILITY_CENTRE = 15.1 / 26
PROBABILITY_SLOPE = 35.0
MIN_FREE_VOTES = 2
FREE_OVER_SURFACE = 3
SPECK_SHARE = 0.02
METHOD = {
    "name": "carving + 26-direction enclosure + floor contact",
    "occupied_share": round(OCCUPIED_SHARE, 4),
    "interior_share": round(INTERIOR_SHARE, 4),
    "min_free_votes": MIN_FREE_VOTES,
    "free_over_surface": FREE_OVER_SURFACE,
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


def solidify(observation: Observation, excluded: Bools, floor_layers: int, cut_layers: int) -> SolidShape:
    """Decide for every voxel whether it is occupied, and how that is known.

    A voxel is empty if it was carved: its TSDF is positive, or frames saw through it. It is occupied
    if it lies just behind a measured surface, or was never seen but is enclosed by such voxels in
    58 % of all directions. Near the floor, where floor and object cannot be told apart, the lowest
    occupied layer is extruded down to the floor. Specks are dropped.

    Args:
        observation: TSDF and votes on an upright grid.
        excluded: bool, voxels that cannot be the object: neighbours, outside a given box.
        floor_layers: cells along z below the floor.
        cut_layers: cells along z above it that count as floor.

    Raises:
        ShapeError: nothing is left.
    """
    observed = observation.weight > 0
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
    enclosed = enclosure(state)

    unseen = state == UNSEEN
    solid = (state == INSIDE) | (unseen & (enclosed >= OCCUPIED_SHARE))
    solid[:, :, contact] = solid[:, :, contact.stop, None] & ~excluded[:, :, contact]
    solid = _without_specks(solid)
    if not solid.any():
        raise ShapeError("no solid shape: no surface of the object was measured from two sides")

    labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    labels[unseen & solid & (enclosed >= INTERIOR_SHARE)] = Label.INTERIOR
    labels[behind & solid] = Label.INTERIOR
    near = np.abs(observation.tsdf) <= 1.5 * observation.grid.voxel_size_m
    labels[behind & solid & near] = Label.SURFACE
    labels[carved & ~solid] = Label.FREE
    labels[(behind & ~solid) | excluded] = Label.OTHER
    labels[:, :, :floor_layers] = Label.OTHER
    labels[:, :, contact] = np.where(
        solid[:, :, contact],
        np.where(labels[:, :, contact] == Label.SURFACE, Label.SURFACE, Label.INTERIOR),
        labels[:, :, contact],
    )
    probability = _probability(observation, enclosed, solid, unseen)
    return SolidShape(
        observation.grid, solid, labels, probability, _closed_mesh(observation, solid, observed)
    )


def _without_specks(solid: Bools) -> Bools:
    """Drop 6-connected pieces smaller than 2 % of the largest."""
    from scipy import ndimage

    pieces, _ = ndimage.label(solid)
    sizes = np.bincount(pieces.reshape(-1))
    sizes[0] = 0
    keep = (sizes > 0) & (sizes >= SPECK_SHARE * sizes.max())
    kept: Bools = keep[pieces]
    return kept


def _probability(
    observation: Observation, enclosed: NDArray[np.float32], solid: Bools, unseen: Bools
) -> NDArray[np.float32]:
    """Occupancy probability: from the enclosure where unseen, from the signed distance where measured."""
    from scipy.special import expit

    inferred = expit(np.float32(PROBABILITY_SLOPE) * (enclosed - np.float32(PROBABILITY_CENTRE)))
    softness_m = 0.35 * observation.grid.voxel_size_m
    measured = expit(-observation.tsdf / np.float32(softness_m))
    probability = np.where(unseen, inferred, measured)
    # What the rules above decided otherwise (floor contact, specks, neighbours) stays decided.
    decided = solid != (probability > 0.5)
    return np.where(decided, np.where(solid, np.float32(0.75), np.float32(0.05)), probability)


def _closed_mesh(observation: Observation, solid: Bools, observed: Bools) -> TriangleMesh:
    """Marching cubes of a signed field: the TSDF where measured, a constant step elsewhere.

    Its sign is `solid` everywhere, and it is padded by empty cells, so the surface is closed.
    """
    voxel_m = observation.grid.voxel_size_m
    step = np.float32(voxel_m)
    least = np.float32(0.1 * voxel_m)
    # Only the inner band next to a surface is trusted; the far one belongs to another surface.
    use = observed & (np.abs(observation.tsdf) < 2 * step)
    magnitude = np.clip(np.where(use, np.abs(observation.tsdf), step), least, step)
    field = np.pad(np.where(solid, -magnitude, magnitude), 1, constant_values=step)
    mesh = isosurface(field.astype(np.float32))
    points_grid = (mesh.vertices - 0.5) * voxel_m
    return TriangleMesh(transform_points(observation.grid.T_world_grid, points_grid), mesh.faces)
