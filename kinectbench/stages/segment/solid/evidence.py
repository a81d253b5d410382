"""Classify voxels as free, near a surface or unseen, and find the voxels that a camera could see."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Grid
from kinectbench.core.sensor_limits import DEFAULT_LIMITS, SensorLimits
from kinectbench.core.types import Bools, Float32, Underside
from kinectbench.core.voxels.lines_of_sight import Space
from kinectbench.core.voxels.morphology import dilated, distance_within_m
from kinectbench.core.voxels.observation import Observation, trust_in_votes, without_fringe
from kinectbench.core.voxels.open_below import underside_over_open_space
from kinectbench.core.voxels.sight import seen_past, swept_from_outside

# A voxel with less than this share of the surface's median weight was grazed by a few rays at most.
LEAST_WEIGHT_SHARE = 0.015
# An unseen voxel is free if this many frames, and this share of the frames that look at the object, see
# through it: along edges depth wanders, and a few frames seem to see through the last millimetres of a board.
MIN_FREE_VOTES, MIN_FREE_SHARE = 2, 0.04
# A voxel that lies farther behind a measured surface may be on the far side of a thin wall.
SHELL_M = 0.0125
# The same in voxels, where these are large.
SHELL_VOXELS = 1.5
# A line of sight ends within this many voxels of a measured surface, on both sides. If it ended in the whole
# band behind the surface, every opening would narrow. It does not pass through a sheet of one voxel.
SHEET_VOXELS = 1.2
# Within this of an underside over open space, four level rays are enough: a leg stops the others.
BESIDE_LEG_M = 0.05
# Number of lines of sight: for the solid, and for solids that are only compared with one another.
FINE: Final = 1600
COARSE: Final = 400  # a quarter of the time
# Lines of this share of the width reach slits that whole lines do not reach. The voxels there are unknown,
# not air: a gap that was measured too narrow, by up to half a line, stays a gap. A camera keeps this share of
# its size, too, however large voxels are.
NARROWER = 0.5
# The sensor's blur may close a gap between floor and object that is less than this many pixels high. A phone
# closes one of 40 mm (7.6 pixels), not one of 60 mm (11 pixels).
BLURRED_PIXELS = 8
# The surface that closes such a gap recedes below the object by more than this many voxels. By a simulated
# phone's depth it recedes by 18 to 56 mm, and the sides of one box that stands flat by 7 mm at most.
RECEDING_VOXELS = 2
# A gap is measured narrower than it is by this many voxels: by the sheet (1.2) and rounding (.5) on both
# sides, and by noise at edges. A gap of 173 mm between two doors was measured as 148 mm (voxels of 5 mm).
NARROWED_VOXELS = 5


@dataclass(frozen=True)
class FloorLayers:
    """How many layers of an upright grid lie below, at and just above the floor, from the grid's bottom up.

    Attributes:
        below: number of layers below the floor.
        contact: number of layers above it in which the floor and the object look the same.
        low: number of layers above those. Surface there belongs to the object only if it continues above
            them.
    """

    below: int
    contact: int
    low: int = 0

    @property
    def first(self) -> int:
        """Index of the lowest layer whose surface may belong to the object."""
        return self.below + self.contact

    @property
    def cut(self) -> int:
        """Index of the lowest layer above the floor that holds no surface of the floor."""
        return self.first + self.low


@dataclass(frozen=True)
class Rules:
    """The parameters of a solid; lengths in metres.

    Attributes:
        layers: how many layers of the grid lie below, at and just above the floor.
        ray_width_m: width of a pixel's ray at the object, including the error of the poses; 0: negligible.
        blurred_m: height up to which the sensor may close a gap between floor and object; 0: negligible.
        limits: of the sensor and of its positions, which define air.
        underside: what the user states about the object's underside: closed, open or unseen (nothing).
        stands: whether the object stands on a plane; if not, cameras may be anywhere.
    """

    layers: FloorLayers
    ray_width_m: float = 0.0
    blurred_m: float = 0.0
    limits: SensorLimits = DEFAULT_LIMITS
    underside: Underside = "unseen"
    stands: bool = True

    def enlarged(self, scale: float) -> "Rules":
        """Return the same rules in a world that is 1 / scale times as large."""
        return replace(
            self,
            ray_width_m=self.ray_width_m / scale,
            blurred_m=self.blurred_m / scale,
            limits=self.limits.enlarged(scale),
        )


@dataclass(frozen=True, kw_only=True)
class VoxelEvidence:
    """The class of each voxel, in the grid's shape.

    Attributes:
        signed_m: float32, signed distance of the surface, corrected by the frames that saw through.
        observed: bool, a surface is near.
        free: bool, seen to be empty.
        near_surface: bool, behind a surface by at most `SHELL_M`, or 1.5 voxels if more: part of the object.
        blurred: bool, surface there may be a gap below the object that the sensor blurred. It ends no line.
        excluded: bool, cannot belong to the object.
        unseen: bool, above the floor and none of `free`, `near_surface` and `excluded`.
        sight: uint8, how a camera could see the voxel past the measured surfaces
            (`Sight.any_way`).
        closed: bool, unseen and part of the object: no camera could see it, or a camera could see it only
            from below and the user states that the underside is closed.
        underside: bool, unseen, and a camera could see it only from below (`Sight.only_from_below`) through
            the object's underside (`seen_past`), whatever the user states. In the layers `contact`: the
            voxels below such voxels.
        contact: slice of the layers right above the floor, whose classes follow the layer above them.
        space: where lines of sight pass and cameras can be.
        lower: `space` without the camera positions that are reached only by rising through unseen space.
    """

    signed_m: Float32
    observed: Bools
    free: Bools
    near_surface: Bools
    blurred: Bools
    excluded: Bools
    unseen: Bools
    sight: NDArray[np.uint8]
    closed: Bools
    underside: Bools
    contact: slice
    space: Space
    lower: Space

    @property
    def unknown(self) -> Bools:
        """Unseen voxels that a camera could see."""
        return self.unseen & ~self.closed


def classify_voxels(
    observation: Observation,
    neighbours: Bools,
    rules: Rules,
    beyond: Bools | None = None,
    roughly: bool = False,
) -> VoxelEvidence:
    """Classify the voxels, and find the unseen voxels that a camera could see.

    The grid is upright. `neighbours` are voxels near a neighbour's surface; unmeasured ones may be of the
    object. `beyond` are voxels outside a given box. If `roughly`, fewer lines are tried: to compare solids.
    """
    voxel_m, layers, observed = observation.grid.voxel_size_m, rules.layers, _observed(observation)
    contact = slice(layers.below, layers.first)
    signed_m = _signed_distance_m(observation, rules.ray_width_m)
    free = np.where(observed, signed_m > 0, observation.free >= _least_free_votes(observation))
    behind = observed & ~free
    excluded = neighbours & observed if beyond is None else (neighbours & observed) | beyond
    excluded |= _detached(behind & ~excluded, layers)
    surface = _measured_sheet(observation, observed, signed_m) & ~excluded
    blurred = _blurred_gap(surface, free, rules, voxel_m)
    surface &= ~blurred
    # Next to the floor nothing can be measured: objects above continue down to it.
    surface[:, :, : layers.first] = surface[:, :, layers.first, None]
    count, closer = (COARSE, None) if roughly else (FINE, rules.limits)
    lines = _heights_m(observation.grid, rules), voxel_m, narrow(rules.limits, voxel_m), count, closer
    sight = swept_from_outside(surface, free, *lines)
    near_surface = behind & ~excluded & ~_beyond_band(behind, observed & free, observation.tsdf, voxel_m)
    near_surface[:, :, : layers.first] = False
    unseen = ~(free | near_surface | excluded)
    unseen[:, :, : layers.below] = False
    closed = unseen & (sight.any_way == 0)
    underside = unseen & sight.only_from_below
    bottom = _bottom(underside, near_surface | closed, free, surface, rules, voxel_m)
    underside &= bottom.any() and ~seen_past(bottom, surface, underside, *lines)
    # In contact with the floor nothing is measured: these layers follow the layer above them.
    of_object, unseen_there = near_surface[:, :, layers.first], unseen[:, :, layers.first]
    solid = of_object | closed[:, :, layers.first]
    standing, from_below = of_object | unseen_there, underside[:, :, layers.first] & ~solid
    unseen[:, :, contact] &= standing[:, :, None]
    excluded[:, :, contact] |= ~standing[:, :, None] & ~free[:, :, contact]
    closed[:, :, contact] = unseen[:, :, contact] & solid[:, :, None]
    underside[:, :, contact] = unseen[:, :, contact] & from_below[:, :, None]
    if rules.underside == "closed":
        closed |= underside
    return VoxelEvidence(
        signed_m=signed_m,
        observed=observed,
        free=free,
        near_surface=near_surface,
        blurred=blurred,
        excluded=excluded,
        unseen=unseen,
        sight=sight.any_way,
        closed=closed,
        underside=underside,
        contact=contact,
        space=sight.space,
        lower=sight.lower,
    )


def _bottom(part: Bools, body: Bools, free: Bools, obstacle: Bools, rules: Rules, voxel_m: float) -> Bools:
    """Return the underside of a part seen only from below (`underside_over_open_space`)."""
    above_floor, bottom = np.s_[:, :, rules.layers.first :], np.zeros_like(part)
    bottom[above_floor] = underside_over_open_space(
        *(each[above_floor] for each in (part, body, free, obstacle)),
        height=max(1, round(rules.limits.camera_size_m / voxel_m)),
        beside=round(BESIDE_LEG_M / voxel_m),
        line=max(1, round(rules.limits.line_width_m / 2 / voxel_m)),
    )
    return bottom


def _heights_m(grid: Grid, rules: Rules) -> Float32 | None:
    """Heights of the layers' middles above the plane that the object stands on, metres; None: no plane."""
    if not rules.stands:
        return None
    return np.asarray((np.arange(grid.shape[2]) - rules.layers.below + 0.5) * grid.voxel_size_m, np.float32)


def _observed(observation: Observation) -> Bools:
    """Whether each voxel has more than 1.5 % of the surface's median weight: not just a few grazing rays."""
    near = np.abs(observation.tsdf) < observation.grid.voxel_size_m
    weights = observation.weight[near & (observation.weight > 0)]
    least = LEAST_WEIGHT_SHARE * float(np.median(weights)) if len(weights) else 0.0
    return np.asarray(observation.weight > least)


def _measured_sheet(observation: Observation, observed: Bools, signed_m: Float32) -> Bools:
    """Return which voxels lie right at a measured surface, on both of its sides."""
    sheet_m = np.float32(SHEET_VOXELS * observation.grid.voxel_size_m)
    right_behind = (signed_m <= 0) & (signed_m > -sheet_m)
    return np.asarray(observed & (right_behind | (np.abs(observation.tsdf) < sheet_m)))


def _blurred_gap(surface: Bools, free: Bools, rules: Rules, voxel_m: float) -> Bools:
    """Return where surface near the floor may be a gap below the object that the sensor blurred.

    Such surface leads from an edge of the object inwards to the floor, below unseen space. The sides of an
    object that stands flat lead straight down; sides that lean above that height, too, lean themselves.
    """
    blurred = np.zeros_like(surface)
    zone = round(rules.blurred_m / voxel_m)
    top = min(rules.layers.below + zone, surface.shape[2] - 1)
    if rules.stands and rules.blurred_m > rules.limits.line_width_m:  # lines do not enter lower gaps
        below = _below_inside(surface[:, :, : top + 1], free[:, :, : top + 1])
        above = slice(top, top + zone + 1)
        leaning = surface[:, :, top] & _below_inside(surface[:, :, above], free[:, :, above]).any(axis=2)
        reach = zone + 2 * RECEDING_VOXELS
        below &= ~dilated(leaning, (reach, reach))[:, :, None]
        receding = dilated(surface[:, :, : top + 1] & below, (RECEDING_VOXELS,) * 3)
        blurred[:, :, :top] = (receding | below)[:, :, :top]
    return blurred


def _below_inside(surface: Bools, free: Bools) -> Bools:
    """Return which voxels have, above them, one inside the object: over two voxels beside its surface."""
    inside = ~free & ~dilated(surface, (RECEDING_VOXELS, RECEDING_VOXELS, 0))
    at_or_below = np.logical_or.accumulate(inside[:, :, ::-1], axis=2)[:, :, ::-1]
    return np.pad(at_or_below[:, :, 1:], ((0, 0), (0, 0), (0, 1)))


def _beyond_band(behind: Bools, in_front: Bools, tsdf_m: Float32, voxel_m: float) -> Bools:
    """Return which of the voxels `behind` a surface are too far behind it to belong to the object.

    The limit is `SHELL_M`, or one and a half voxels if that is more. It is applied to the fused distance, and
    to the distance from the nearest voxel `in_front` of a surface, because far behind a surface the fused
    distance is too short.
    """
    shell_m = max(SHELL_M, SHELL_VOXELS * voxel_m)
    # A surface lies half a voxel from the voxels on both of its sides.
    shown_m = shell_m + voxel_m / 2
    far = distance_within_m(in_front, voxel_m, shown_m + voxel_m) > shown_m
    return np.asarray(behind & (far | (tsdf_m < -np.float32(shell_m))))


def _detached(behind: Bools, layers: FloorLayers) -> Bools:
    """Return which voxels of the low layers are not 26-connected to higher voxels, so are not the object."""
    from scipy import ndimage

    detached = np.zeros_like(behind)
    # One layer above them is enough to test continuity.
    low = behind[:, :, layers.first : layers.cut + 1]
    pieces, count = ndimage.label(low, np.ones((3, 3, 3)))
    held = np.zeros(count + 1, dtype=bool)
    held[pieces[:, :, -1]] = True
    held[0] = False
    detached[:, :, layers.first : layers.cut] = (low & ~held[pieces])[:, :, :-1]
    return detached


def _signed_distance_m(observation: Observation, ray_width_m: float) -> Float32:
    """Return the signed distance to the surface in observed voxels, corrected by the frames' votes."""
    voxel_m = observation.grid.voxel_size_m
    trust = trust_in_votes(ray_width_m, voxel_m)
    return without_fringe(observation.tsdf, observation.free, observation.surface, voxel_m, trust)


def _least_free_votes(observation: Observation) -> int:
    """Return the smallest number of frames that make a voxel free by seeing through it.

    It applies to voxels without a measured surface nearby.
    """
    looking = int((observation.free.astype(np.uint32) + observation.surface).max())
    return max(MIN_FREE_VOTES, round(MIN_FREE_SHARE * looking))


def narrow(limits: SensorLimits, voxel_m: float) -> SensorLimits:
    """Return the limits with half the width of lines of sight and a smaller camera, for measured surfaces.

    These also pass gaps that were measured too narrow. `voxel_m` is the edge of a voxel, metres.
    """
    line_m = NARROWER * limits.line_width_m
    camera_m = limits.camera_size_m - NARROWED_VOXELS * voxel_m
    camera_m = max(line_m, NARROWER * limits.camera_size_m, camera_m)
    return replace(limits, line_width_m=line_m, camera_size_m=camera_m)


def rim_voxels(limits: SensorLimits, voxel_m: float) -> int:
    """Return half the width of a `narrow` line of sight, in voxels, at least one."""
    return max(1, round(NARROWER * limits.line_width_m / 2 / voxel_m))
