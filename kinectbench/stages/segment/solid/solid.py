"""Make a closed solid: free voxels are air, and voxels that no camera could see are the object."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import ShapeError
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, TriangleMesh, isosurface, transform_points
from kinectbench.core.types import Bools, Float32
from kinectbench.core.voxels.morphology import from_beyond, piece_sizes, values_of_pieces
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.solid.evidence import Rules, VoxelEvidence, classify_voxels
from kinectbench.stages.segment.solid.guess import inside_probability, measured_probability

# A wider Gaussian thins slats, a narrower one leaves the sensor's noise.
SMOOTHING_VOXELS = 0.7
# Smallest absolute value of a voxel's field before smoothing, and after it: an exact 0 would make triangles
# without area.
LEAST_FIELD, LEAST_SMOOTHED = 0.1, 0.02
# Probability of a voxel that a rule calls solid, or air, against what was measured there.
RULED_SOLID, RULED_AIR = 0.75, 0.05
# A voxel this near to a measured surface, in voxels, is measured.
MEASURED_VOXELS = 1.5
# A piece with less than this share of the largest one's voxels is noise.
SPECK_SHARE = 0.02
# A lower piece on the floor may be noise; a piece that ends farther below the object carries something else.
LEG_HEIGHT_M, LEG_GAP_M = 0.05, 0.1
# The upper end of a piece: its columns in this many layers below its highest cell.
LEG_END_LAYERS = 3
# This share of these columns must find the object above them.
LEG_SHARE = 0.5


@dataclass(frozen=True)
class SolidBody:
    """The object as a solid, without labels: enough to compare solids.

    Attributes:
        grid: upright; a cell boundary lies at z = 0 of the floor.
        solid: bool in the grid's shape, occupied.
        mesh: closed surface of `solid`, smooth where it was measured, world frame, metres.
    """

    grid: Grid
    solid: Bools
    mesh: TriangleMesh

    def restored(self, grid: Grid, scale: float) -> Self:
        """Return the same solid in a world that is `scale` times as large, on the grid given."""
        if scale == 1:
            return self
        return replace(self, grid=grid, mesh=TriangleMesh(self.mesh.vertices * scale, self.mesh.faces))


@dataclass(frozen=True)
class SolidShape(SolidBody):
    """The object as a solid, and how each voxel is known; all arrays have the grid's shape.

    Attributes:
        labels: uint8, see `Label`.
        probability: float32 in [0, 1], that the voxel is occupied.
        underside: bool, unseen, and a camera could see it only from below.
    """

    labels: NDArray[np.uint8]
    probability: Float32
    underside: Bools

    @property
    def underside_share(self) -> float:
        """The share of the solid that depends on whether the user states the underside as closed."""
        return int((self.underside & self.solid).sum()) / max(1, int(self.solid.sum()))


@dataclass(frozen=True)
class Solids:
    """The solids of all, of the odd and of the even frames.

    Attributes:
        whole: from all frames.
        odd: from the odd frames alone.
        even: from the even frames alone.
        surface_sigma_m: standard deviation of the surface of all frames, metres.
        frames: how many frames were fused.
    """

    whole: SolidShape
    odd: SolidBody
    even: SolidBody
    surface_sigma_m: float
    frames: int


def solidify(
    observation: Observation, neighbours: Bools, rules: Rules, beyond_box: Bools | None = None
) -> SolidBody:
    """Make a solid from some frames, for comparison: classify roughly, then decide as `make_solid`.

    Raises:
        ShapeError: no voxel is occupied.
    """
    evidence = classify_voxels(observation, neighbours, rules, beyond_box, roughly=True)
    guess = inside_probability(evidence, rules, observation.grid.voxel_size_m)
    return _body(observation, evidence, guess, rules)


def make_solid(observation: Observation, evidence: VoxelEvidence, rules: Rules) -> SolidShape:
    """Decide for every voxel whether it is occupied, and label how that is known.

    A free voxel is empty. A voxel right behind a measured surface is occupied, and so is one that no camera
    could see. An unknown voxel is occupied if its probability (`guess`) exceeds 0.5. Near the floor nothing
    is measured: the layer above `contact` is extruded down to the floor. Legs whose upper end was hidden are
    extended up to the object. The signed field of this solid is smoothed by a Gaussian of 0.7 voxels, specks
    are dropped, and voids are filled. The observation is on an upright grid.

    Raises:
        ShapeError: no voxel is occupied.
    """
    voxel_m, below = observation.grid.voxel_size_m, rules.layers.below
    guess = inside_probability(evidence, rules, voxel_m)
    body = _body(observation, evidence, guess, rules)
    labels = _voxel_labels(evidence, body.solid, voxel_m, below)
    probability = _probability(voxel_m, evidence, guess, body.solid)
    probability[:, :, :below] = 0
    return SolidShape(body.grid, body.solid, body.mesh, labels, probability, evidence.underside)


def _body(observation: Observation, evidence: VoxelEvidence, guess: Float32, rules: Rules) -> SolidBody:
    """Find the occupied voxels and their closed surface, by the rules of `make_solid`."""
    excluded, contact = evidence.excluded, evidence.contact
    voxel_m = observation.grid.voxel_size_m
    solid = evidence.near_surface | evidence.closed | (evidence.unknown & (guess > 0.5))
    # Extruded down to the floor, and for now beyond it, so that smoothing does not round the feet.
    solid[:, :, : contact.stop] = solid[:, :, contact.stop, None] & ~excluded[:, :, : contact.stop]
    solid = carried_up(solid, evidence.free | excluded, contact.stop, voxel_m)
    field = _smooth_field(evidence, _without_specks(solid), voxel_m)
    empty = excluded.copy()
    empty[:, :, : rules.layers.below] = True
    # A void without a 6-connected way out is filled: no camera can have looked into it.
    solid = ~from_beyond(~_without_specks((field < 0) & ~empty)) & ~empty
    if not solid.any():
        raise ShapeError(
            "no solid shape: no surface of the object was measured above what counts as floor; record it "
            "from all sides, or if it is flat, try `segmentation.floor_cut_m: 0.01` (for all recordings)"
        )
    mesh = _closed_mesh(np.where(solid, -np.abs(field), np.abs(field)), observation.grid)
    return SolidBody(observation.grid, solid, mesh)


def _voxel_labels(evidence: VoxelEvidence, solid: Bools, voxel_m: float, below: int) -> NDArray[np.uint8]:
    """Return a label (`Label`) for each voxel by its evidence, uint8; `below` layers lie below the floor.

    A voxel behind a measured surface is UNKNOWN if smoothing removed it from the solid, because no frame saw
    it empty; and if the surface may be a gap that the sensor blurred.
    """
    near = np.abs(evidence.signed_m) <= MEASURED_VOXELS * voxel_m
    measured = evidence.observed & near & ~evidence.free
    labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    labels[~solid & evidence.free] = Label.FREE
    labels[~solid & evidence.excluded] = Label.OTHER
    labels[solid & evidence.closed] = Label.INTERIOR
    sure = (evidence.near_surface | measured) & ~(evidence.unknown | evidence.blurred)
    labels[solid & sure] = Label.SURFACE
    labels[:, :, :below] = Label.OTHER
    return labels


def _without_specks(solid: Bools) -> Bools:
    """Drop 6-connected pieces smaller than 2 % of the largest."""
    from scipy import ndimage

    pieces, count = ndimage.label(solid)
    sizes = piece_sizes(pieces, count)
    sizes[0] = 0
    return values_of_pieces(pieces, (sizes > 0) & (sizes >= SPECK_SHARE * sizes.max()))


def _probability(voxel_m: float, evidence: VoxelEvidence, guess: Float32, solid: Bools) -> Float32:
    """Return the occupancy probability: by the signed distance where measured, elsewhere `guess`.

    Where it contradicts `solid`, which also follows other rules, it is set to 0.75 in the solid and 0.05
    outside.
    """
    probability, measured = guess.copy(), ~evidence.unseen
    probability[measured] = measured_probability(evidence.signed_m[measured], voxel_m)
    # Decisions of the rules above (floor contact, specks, neighbours) stay.
    decided = np.where(solid, probability <= 0.5, probability >= 0.5)
    return np.where(decided, np.where(solid, np.float32(RULED_SOLID), np.float32(RULED_AIR)), probability)


def _smooth_field(evidence: VoxelEvidence, solid: Bools, voxel_size_m: float) -> Float32:
    """Make a smoothed signed field, metres, negative in `solid`.

    Before smoothing, its magnitude is the distance where that was measured, else one voxel. The Gaussian
    takes the sensor's noise off the surface; a wider one would thin slats and narrow the masks.
    """
    from scipy import ndimage

    step = np.float32(voxel_size_m)
    # The distance is trusted only next to the surface; farther away it belongs to another surface.
    distance_m = np.abs(evidence.signed_m)
    magnitude = np.where(evidence.observed & (distance_m < 2 * step), distance_m, step)
    magnitude = np.clip(magnitude, np.float32(LEAST_FIELD) * step, step)
    field = np.where(solid, -magnitude, magnitude)
    return np.asarray(ndimage.gaussian_filter(field, SMOOTHING_VOXELS, mode="nearest", truncate=3.0))


def _closed_mesh(field: Float32, grid: Grid) -> TriangleMesh:
    """Marching cubes of a signed field padded by empty cells, so that the surface is closed."""
    step = np.float32(grid.voxel_size_m)
    least = LEAST_SMOOTHED * step
    away = np.where(field < 0, np.minimum(field, -least), np.maximum(field, least))
    mesh = isosurface(np.pad(away, 1, constant_values=step).astype(np.float32))
    points_grid = (mesh.vertices - 0.5) * grid.voxel_size_m
    return TriangleMesh(transform_points(grid.T_world_grid, points_grid), mesh.faces)


def carried_up(solid: Bools, seen_empty: Bools, floor_layer: int, voxel_size_m: float) -> Bools:
    """Extend legs, which end in unseen space below the largest piece, straight up to it.

    From above, a seat hides the upper ends of legs that stand back from its edge: only the seat and the lower
    parts of the legs are measured, with a gap between them.

    Args:
        solid: bool (nx, ny, nz), upright; extruded down to the floor.
        seen_empty: bool, cells that cannot be filled, because they are free or excluded.
        floor_layer: the lowest layer above the floor in which pieces are separate.
        voxel_size_m: edge of a cell.
    """
    from scipy import ndimage

    pieces, count = ndimage.label(solid)
    if count < 2:
        return solid
    sizes = piece_sizes(pieces, count)
    sizes[0] = 0
    main = int(np.argmax(sizes))
    largest = pieces == main
    reach = round(LEG_GAP_M / voxel_size_m)
    filled = solid.copy()
    for piece, (x, y, z) in enumerate(ndimage.find_objects(pieces), start=1):
        stands = z.start <= floor_layer and (z.stop - floor_layer) * voxel_size_m >= LEG_HEIGHT_M
        if piece == main or not stands:
            continue
        end = slice(max(0, z.stop - LEG_END_LAYERS), z.stop)
        columns = (pieces[x, y, end] == piece).any(axis=2)
        gap = slice(end.start, z.stop + reach)
        above = np.logical_or.accumulate(largest[x, y, gap], axis=2)
        open_below = ~np.logical_or.accumulate(seen_empty[x, y, gap] & (pieces[x, y, gap] != piece), axis=2)
        carried = columns & (above & open_below).any(axis=2)
        if carried.sum() >= LEG_SHARE * columns.sum():
            filled[x, y, gap] |= carried[:, :, None] & ~above
    return filled
