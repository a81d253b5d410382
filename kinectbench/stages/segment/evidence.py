"""What the frames say of each voxel: seen through, behind a surface, or unseen; and could a camera see it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.sensor_limits import DEFAULT_LIMITS, SensorLimits
from kinectbench.core.types import Bools, Float32, Underside
from kinectbench.core.voxels.distance import distance_within_m
from kinectbench.core.voxels.lines_of_sight import FROM_BELOW
from kinectbench.core.voxels.observation import Observation, trust_in_votes, without_fringe
from kinectbench.stages.segment.sight import COARSE, FINE, look

# A voxel with less than this share of the surface's median weight has been grazed by a few rays at most.
LEAST_WEIGHT_SHARE = 0.015
# An unseen voxel is carved by so many frames, and by this share of those that look at the object: along
# edges depth wanders, and a few frames seem to see through the last millimetres of a board.
MIN_FREE_VOTES, MIN_FREE_SHARE = 2, 0.04
# A measured surface tells what lies so far behind it; deeper it may be the far side of a thin wall.
SHELL_M = 0.0125
# A line of sight ends so near to a measured surface, on both sides, voxels: not in all of the band behind it,
# which would narrow every opening. Nor does one slip through a sheet of a voxel.
SHEET_VOXELS = 1.2


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
class Rules:
    """What a solid is made by, beside what the frames saw; lengths in metres.

    Attributes:
        layers: of the grid's cells about the floor.
        ray_width_m: how wide the frames' rays are at the object; 0 = narrow.
        limits: of the sensor, by which air is defined.
        underside: what a person says of it.
        stands: False: there is no plane that the object stands on, and cameras may be anywhere.
    """

    layers: FloorLayers
    ray_width_m: float = 0.0
    limits: SensorLimits = DEFAULT_LIMITS
    underside: Underside = "unseen"
    stands: bool = True

    def enlarged(self, scale: float) -> "Rules":
        """The same in a world that is 1 / scale times as large."""
        return replace(self, ray_width_m=self.ray_width_m / scale, limits=self.limits.enlarged(scale))


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What the frames say of each voxel, in the grid's shape.

    Attributes:
        signed_m: float32, signed distance of the surface, corrected by the frames that saw through.
        observed: bool, some surface is near.
        carved: bool, seen to be empty.
        band: bool, behind a surface, and at most `SHELL_M` from it: of the object.
        excluded: bool, cannot be the object.
        unseen: bool, none of these three.
        sight: uint8, how a camera could see it past what was measured (`core.voxels.lines_of_sight`).
        closed: bool, unseen, and no camera could see it: of the object, by definition; or by a person's word.
        underside: bool, unseen, and only lines that look up reach it, whatever a person says.
        contact: the layers right above the floor.
        raised: bool (nx, ny), columns of a plate of the object that hardly rises above these layers.
        surface: bool, what ends a line of sight.
        heights_m: (nz,) float32, of the layers' middles above the plane it stands on; None: no plane.
    """

    signed_m: Float32
    observed: Bools
    carved: Bools
    band: Bools
    excluded: Bools
    unseen: Bools
    sight: NDArray[np.uint8]
    closed: Bools
    underside: Bools
    contact: slice
    raised: Bools
    surface: Bools
    heights_m: Float32 | None

    @property
    def unknown(self) -> Bools:
        """Unseen, and some camera could see it."""
        return self.unseen & ~self.closed


def weigh(observation: Observation, excluded: Bools, rules: Rules, *, roughly: bool = False) -> Evidence:
    """Carving, and what of the unseen some camera could see.

    Args:
        observation: TSDF and votes on an upright grid.
        excluded: bool, voxels that cannot be the object: neighbours, outside a given box.
        rules: what a solid is made by.
        roughly: with fewer lines of sight: for solids that are only compared with one another.
    """
    voxel_m, layers = observation.grid.voxel_size_m, rules.layers
    contact = slice(layers.below, layers.first)
    observed = _observed(observation)
    signed_m = _signed_distance_m(observation, rules.ray_width_m)
    carved = np.where(observed, signed_m > 0, observation.free >= _least_free_votes(observation))
    behind = observed & ~carved
    own = behind & ~excluded
    loose, raised = _loose(own, _raised(signed_m, own, carved, layers, voxel_m), layers)
    excluded = excluded | loose
    sheet_m = np.float32(SHEET_VOXELS * voxel_m)
    surface = (behind & (signed_m > -sheet_m)) | (observed & (np.abs(observation.tsdf) < sheet_m))
    surface &= ~excluded
    # Next to the floor nothing can be measured: what stands above goes on down to it.
    surface[:, :, : layers.first] = (surface[:, :, layers.first] | raised)[:, :, None]
    heights_m = None
    if rules.stands:
        layer = np.arange(observation.grid.shape[2]) - layers.below
        heights_m = ((layer + 0.5) * voxel_m).astype(np.float32)
    sight = look(surface, heights_m, voxel_m, rules.limits, COARSE if roughly else FINE)
    band = behind & ~excluded & ~_deep(behind, observed & carved, observation.tsdf, voxel_m)
    band[:, :, : layers.first] = False
    band[:, :, layers.first - 1] |= raised & ~excluded[:, :, layers.first - 1]
    unseen = ~(carved | band | excluded)
    unseen[:, :, : layers.below] = False
    underside = unseen & (sight == FROM_BELOW)
    closed = unseen & (sight == 0)
    standing = band[:, :, contact.stop] | unseen[:, :, contact.stop] | raised
    solid = band[:, :, contact.stop] | closed[:, :, contact.stop] | raised
    unseen[:, :, contact] &= standing[:, :, None]
    excluded[:, :, contact] |= ~standing[:, :, None] & ~carved[:, :, contact]
    closed[:, :, contact] = unseen[:, :, contact] & solid[:, :, None]
    underside[:, :, contact] = (
        unseen[:, :, contact] & underside[:, :, contact.stop, None] & ~solid[:, :, None]
    )
    if rules.underside == "closed":
        closed |= underside
    return Evidence(
        signed_m=signed_m,
        observed=observed,
        carved=carved,
        band=band,
        excluded=excluded,
        unseen=unseen,
        sight=sight,
        closed=closed,
        underside=underside,
        contact=contact,
        raised=raised,
        surface=surface,
        heights_m=heights_m,
    )


def _observed(observation: Observation) -> Bools:
    """Where some surface is near, and was not grazed by a few rays only."""
    near = np.abs(observation.tsdf) < observation.grid.voxel_size_m
    weights = observation.weight[near & (observation.weight > 0)]
    least = LEAST_WEIGHT_SHARE * float(np.median(weights)) if len(weights) else 0.0
    observed: Bools = observation.weight > least
    return observed


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
    shell_m = max(SHELL_M, 1.5 * voxel_m)
    # A surface lies half a voxel from the voxels on both of its sides.
    shown_m = shell_m + voxel_m / 2
    far = distance_within_m(in_front, voxel_m, shown_m + voxel_m) > shown_m
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
