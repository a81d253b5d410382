"""What the frames say of each voxel: seen through, behind a surface, never seen, and then how open it is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools, Float32
from kinectbench.core.voxels.observation import Observation, trust_in_votes, without_fringe
from kinectbench.stages.segment.enclosure import Hollows, Shadow, hollows, shadow
from kinectbench.stages.segment.openings import Openings, find_openings, opening_cells
from kinectbench.stages.segment.rays import INSIDE, NEUTRAL, OUTSIDE, UNSEEN, tally_rays

# A voxel with less than this share of the surface's median weight has been grazed by a few rays at most.
LEAST_WEIGHT_SHARE = 0.015
# An unseen voxel is carved by so many frames, and by this share of those that look at the object: along
# edges depth wanders, and a few frames seem to see through the last millimetres of a board.
MIN_FREE_VOTES, MIN_FREE_SHARE = 2, 0.04
# A measured surface tells what lies so far behind it; deeper it may be the far side of a thin wall.
SHELL_M = 0.0125
# So near a hollow what is unseen at its own height is of it: aprons are thin.
APRON_M = 0.015


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


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What the frames say of each voxel, in the grid's shape.

    Attributes:
        signed_m: float32, signed distance of the surface, corrected by the frames that saw through.
        observed: bool, some surface is near.
        carved: bool, seen to be empty.
        behind: bool, just behind a surface, as far as depth was fused.
        excluded: bool, cannot be the object.
        unseen: bool, none of these (in the contact layers also what is behind a surface), and in no hollow.
        enclosed: float32, of unseen voxels, the share of 26 directions that meets the object.
        hollows: behind an apron, as far as it.
        shadow: hidden by the object, and not of it.
        openings: what of the unseen, and of what is farther behind a surface than `SHELL_M`, is open.
        contact: the layers right above the floor.
        raised: bool (nx, ny), columns of a plate of the object that hardly rises above these layers.
        opening_cells: edge of the cube that passes through an opening, voxels.
        ray_width_m: how wide the frames' rays are at the object, metres; 0 = narrow.
    """

    signed_m: Float32
    observed: Bools
    carved: Bools
    behind: Bools
    excluded: Bools
    unseen: Bools
    enclosed: Float32
    hollows: Hollows
    shadow: Shadow
    openings: Openings
    contact: slice
    raised: Bools
    opening_cells: int
    ray_width_m: float


def weigh(observation: Observation, excluded: Bools, layers: FloorLayers, ray_width_m: float) -> Evidence:
    """Carving, and what lies around the voxels that no frame saw.

    Args:
        observation: TSDF and votes on an upright grid.
        excluded: bool, voxels that cannot be the object: neighbours, outside a given box.
        layers: of the grid's cells about the floor.
        ray_width_m: how wide the frames' rays are at the object, metres; 0 = narrow.
    """
    voxel_m = observation.grid.voxel_size_m
    contact = slice(layers.below, layers.first)
    observed = _observed(observation)
    signed_m = _signed_distance_m(observation, ray_width_m)
    carved = np.where(observed, signed_m > 0, observation.free >= _least_free_votes(observation))
    behind = observed & ~carved
    own = behind & ~excluded
    loose, raised = _loose(own, _raised(signed_m, own, carved, layers, voxel_m), layers)
    excluded = excluded | loose
    surface_near = observed & (np.abs(observation.tsdf) < 2 * voxel_m)
    state = _state(behind, carved | excluded, raised, surface_near, layers)
    tally = tally_rays(state)
    found = hollows(state, tally, voxel_m)
    hollow = _to_the_apron(found.sure, state == UNSEEN, voxel_m)
    hollow[:, :, : contact.stop] = False
    unseen = (state == UNSEEN) & ~hollow
    deep = _deep(behind, observed & carved, observation.tsdf, voxel_m)
    cells = opening_cells(ray_width_m, voxel_m)
    return Evidence(
        signed_m=signed_m,
        observed=observed,
        carved=carved,
        behind=behind,
        excluded=excluded,
        unseen=unseen,
        enclosed=tally.enclosed,
        hollows=Hollows(hollow, found.doubtful),
        shadow=shadow(state, tally),
        openings=find_openings(state, unseen, behind, deep, contact, voxel_m, cells),
        contact=contact,
        raised=raised,
        opening_cells=cells,
        ray_width_m=ray_width_m,
    )


def _observed(observation: Observation) -> Bools:
    """Where some surface is near, and was not grazed by a few rays only."""
    near = np.abs(observation.tsdf) < observation.grid.voxel_size_m
    weights = observation.weight[near & (observation.weight > 0)]
    least = LEAST_WEIGHT_SHARE * float(np.median(weights)) if len(weights) else 0.0
    observed: Bools = observation.weight > least
    return observed


def _state(
    behind: Bools, outside: Bools, raised: Bools, surface_near: Bools, layers: FloorLayers
) -> NDArray[np.uint8]:
    """The state of each voxel, for `tally_rays`.

    Args:
        behind: bool, just behind a surface.
        outside: bool, seen empty, or not the object's.
        raised: bool (nx, ny), columns of a plate of the object that hardly rises above the contact layers.
        surface_near: bool, some surface was measured near.
        layers: about the floor.
    """
    contact = slice(layers.below, layers.first)
    state = np.full(behind.shape, UNSEEN, np.uint8)
    state[behind] = INSIDE
    state[:, :, contact][behind[:, :, contact]] = UNSEEN
    state[:, :, layers.first - 1][raised] = INSIDE
    state[outside] = OUTSIDE
    # Below the object no camera sees the floor: walking down says nothing there.
    floor_seen = surface_near[:, :, : layers.first].any(axis=2)
    state[:, :, : layers.below] = np.where(floor_seen, OUTSIDE, NEUTRAL)[:, :, None]
    return state


def _to_the_apron(hollow: Bools, unseen: Bools, voxel_m: float) -> Bools:
    """A hollow with what lies between it and the aprons around it, unseen and at its own height."""
    from scipy import ndimage

    if not hollow.any():
        return hollow
    level = np.ones((3, 3, 1), dtype=bool)
    reached: Bools = ndimage.binary_dilation(
        hollow, level, iterations=max(1, round(APRON_M / voxel_m)), mask=unseen
    )
    return reached


def _deep(behind: Bools, in_front: Bools, tsdf_m: Float32, voxel_m: float) -> Bools:
    """What lies farther behind a surface than what it tells: `SHELL_M`, or one and a half voxels.

    By the fused distance, and by the way to the nearest voxel that was measured to lie in front of a surface:
    the fused distance is nearly that to the frames that see the least of it hidden, and too short far behind.

    Args:
        behind: bool, behind a surface.
        in_front: bool, observed in front of one.
        tsdf_m: fused signed distances.
        voxel_m: edge of a voxel, metres.
    """
    from scipy import ndimage

    shell_m = max(SHELL_M, 1.5 * voxel_m)
    # A surface lies half a voxel from the voxels on both of its sides.
    far = ndimage.distance_transform_edt(~in_front, sampling=voxel_m) > shell_m + voxel_m / 2
    deep: Bools = behind & (far | (tsdf_m < -np.float32(shell_m)))
    return deep


def _raised(signed_m: Float32, behind: Bools, carved: Bools, layers: FloorLayers, voxel_m: float) -> Bools:
    """Columns (nx, ny) whose surface lies above the contact layers, and below the middle of the next.

    Of a plate that ends there no voxel above the contact layers is behind a surface.

    Args:
        signed_m: of the surface.
        behind: bool, just behind one.
        carved: bool, seen empty.
        layers: about the floor.
        voxel_m: edge of a voxel, metres.
    """
    if layers.contact == 0:
        return np.zeros(behind.shape[:2], bool)
    top = layers.first - 1
    above = signed_m[:, :, top] < -np.float32(voxel_m / 2)
    raised: Bools = behind[:, :, top] & carved[:, :, layers.first] & above
    return raised


def _loose(behind: Bools, raised: Bools, layers: FloorLayers) -> tuple[Bools, Bools]:
    """What lies low and is connected (26 neighbours) to nothing above it: not the object's.

    Args:
        behind: bool, just behind a surface.
        raised: bool, columns.
        layers: about the floor.

    Returns:
        Of `behind` what is loose in the low layers, and of `raised` what is not.
    """
    from scipy import ndimage

    loose = np.zeros_like(behind)
    # One layer above them is enough to see what goes on there.
    low = np.concatenate([raised[:, :, None], behind[:, :, layers.first : layers.cut + 1]], axis=2)
    pieces, count = ndimage.label(low, np.ones((3, 3, 3)))
    held = np.zeros(count + 1, dtype=bool)
    held[pieces[:, :, -1]] = True
    held[0] = False
    loose[:, :, layers.first : layers.cut] = (low & ~held[pieces])[:, :, 1:-1]
    return loose, held[pieces[:, :, 0]]


def _signed_distance_m(observation: Observation, ray_width_m: float) -> Float32:
    """Of the surface, where a voxel was observed."""
    voxel_m = observation.grid.voxel_size_m
    trust = trust_in_votes(ray_width_m, voxel_m)
    return without_fringe(observation.tsdf, observation.free, observation.surface, voxel_m, trust)


def _least_free_votes(observation: Observation) -> int:
    """How many frames must have seen through a voxel that was never observed near a surface."""
    looking = int((observation.free.astype(np.uint32) + observation.surface).max())
    return max(MIN_FREE_VOTES, round(MIN_FREE_SHARE * looking))
