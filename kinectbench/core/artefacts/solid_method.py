"""The constants by which a solid was made, as quality.json keeps them under `method`."""

from pydantic import Field

from kinectbench.core.artefacts.stored import Part

Curve = tuple[tuple[float, float], ...]


class RuleProbabilities(Part):
    """Probabilities that a voxel is occupied, where a rule says so."""

    hollow: float = Field(description="in a hollow behind an apron")
    doubtful: float = Field(description="in what may be a hollow")
    under: float = Field(description="under the object")
    under_empty: float = Field(description="under the object, and called empty")
    beside_empty: float = Field(description="elsewhere, and called empty")


class OpenProbabilities(Part):
    """Probabilities that a voxel is occupied that lies open to free space, and that no frame saw."""

    among_m: float = Field(description="edge of the cube in which sealed voxels are counted, metres")
    among: Curve = Field(description="[share of sealed voxels among those not seen, probability]")
    crack: tuple[float, ...] = Field(description="by how many of nine directions upwards are open")
    beside: tuple[float, ...] = Field(description="by how many of eight level directions are open")
    below: tuple[float, ...] = Field(description="the same where most directions downwards are open, too")
    open_below: int | None = Field(None, description="so many of nine are most directions downwards")
    cavity: tuple[float, ...] = Field(description="in a cavity, by how many directions upwards are open")
    hung: float | None = Field(None, description="in a thick body that hangs high in the air, at most")
    right_below_m: float | None = Field(
        None, description="so far below what a measured surface tells, metres, a board may go on"
    )
    right_below_max_ray_m: float | None = Field(
        None, description="where the frames' rays are narrower than this, metres"
    )
    right_below: tuple[float, ...] | None = Field(
        None, description="there, by how many of eight level directions are open, at least"
    )


class CarriedLegs(Part):
    """When a piece on the floor is a leg whose upper end was hidden, and goes on up to the object."""

    min_height_m: float = Field(description="its least height, metres")
    max_gap_m: float = Field(description="how far below the object it ends at most, metres")
    end_layers: int = Field(description="its upper end is in so many layers, voxels")
    min_share: float = Field(description="so many of its columns there at least find the object above them")


class FrontierMethod(Part):
    """Which openings that nobody looked into are told, and from where one would look into them."""

    least_share: float = Field(description="of the solid's volume, that lies behind one at least")
    around_corner_share: float | None = Field(
        None, description="of what lies around a corner, less than so much leads straight out"
    )
    least_area_m2: float = Field(description="its least area, square metres")
    least_probability: float = Field(description="of being inside, of what counts as behind one")
    first: tuple[float, float] = Field(
        description="how much more a way out counts that leads upwards, or to the side, than one down"
    )


class EstimateMethod(Part):
    """How the IoU to the unknown truth is estimated, and what widens its interval."""

    off_m: float = Field(description="how far the surface is off whatever was measured, metres")
    off_if_thin_m: float = Field(
        description="how much farther, times the share of the volume that 1 mm of surface is, metres"
    )
    off_per_sigma: float = Field(description="how much farther, of the surface's standard deviation")
    off_per_pose: float = Field(description="how much farther, of what a usual pose may be off by")
    missed_more: float = Field(description="of what is estimated to be missing, that may be missing, too")
    missed_less: float = Field(description="of what is estimated to be missing, that may not be missing")
    missed_least: float = Field(description="of the solid, that may be missing or not, besides")
    doubted_share: float = Field(description="of the variance of what is unknown, that may be amiss")
    max_volume_share_per_mm: float = Field(
        description="of the volume, that 1 mm of surface is before thin parts are a reason"
    )
    max_shifted_share: float = Field(
        description="of the volume, that a usual pose's error moves before poses are a reason"
    )


class SolidMethod(Part):
    """The constants by which a solid was made from what the frames saw."""

    name: str = Field(description="its steps, in words")
    occupied_share: float | None = Field(
        None, description="of 26 directions that enclose an unseen voxel: it is occupied from so many on"
    )
    interior_share: float | None = Field(None, description="the same for the label interior")
    level_enclosed: int | None = Field(
        None, description="of the 8 level directions: so many enclose what is not under the object"
    )
    empty_under: int | None = Field(
        None,
        description="of the 17 directions that do not go up: at most so many enclose what is empty under it",
    )
    empty_share: float | None = Field(
        None, description="of 26 directions that enclose an unseen voxel elsewhere: below it is empty"
    )
    hollow_overhang_m: float | None = Field(
        None, description="least overhang of a top over the apron that it rests on, metres"
    )
    hollow_full_overhang: float | None = Field(
        None,
        description="least overhang over a hollow's uppermost layer, as a share of that over the next one",
    )
    hollow_height_m: tuple[float, float] | None = Field(
        None, description="least height, and greatest depth under the top, metres"
    )
    doubtful_height_m: float | None = Field(
        None, description="greatest height of what may be a hollow, metres"
    )
    hollow_enclosed_height_m: float | None = Field(
        None, description="least height of a hollow's part that would otherwise be interior, metres"
    )
    hollow_beneath_share: tuple[float, float] | None = Field(
        None, description="of 26 directions, right under a hollow: most if it is open, least behind an apron"
    )
    hollow_open_below: int | None = Field(None, description="of 9 ways down, so many at least lead outside")
    hollow_enclosed_share: float | None = Field(
        None, description="of 26 directions that enclose a voxel: from so many on it would not be empty"
    )
    hollow_apron_m: float | None = Field(
        None, description="a hollow reaches its aprons if they are so near at its own height, metres"
    )
    hollow_lean: tuple[float, float] | None = Field(
        None, description="most that an apron leans in, as a share of the way down, and how far down, metres"
    )
    least_weight_share: float | None = Field(
        None, description="of the surface's median weight: a voxel with less was not observed"
    )
    min_free_votes: int | None = Field(None, description="frames that must see through to carve a voxel")
    min_free_share: float | None = Field(None, description="of the frames that look there, that must do so")
    free_by_noise: tuple[float, float] | None = Field(
        None, description="share of frames that may see through what lies behind, and its growth a voxel"
    )
    voxels_per_free_share: float | None = Field(
        None, description="how far the other frames that see through move the surface inward, voxels"
    )
    trust_in_votes: tuple[tuple[float, ...], tuple[float, ...]] | None = Field(
        None, description="widths of the frames' rays in voxels, and what part of the votes is believed"
    )
    smoothing_voxels: float | None = Field(None, description="sigma of the Gaussian, voxels")
    speck_share: float | None = Field(
        None, description="of the largest piece's volume: pieces with less are dropped"
    )
    carried_legs: CarriedLegs | None = Field(None, description="of legs whose upper end was hidden")
    probability_by_enclosure: Curve | None = Field(
        None, description="[share of 26 enclosing directions, probability] of unseen voxels"
    )
    probability_by_signed_voxels: Curve | None = Field(
        None, description="[signed distance in voxels, probability] of observed voxels"
    )
    shell_m: float | None = Field(
        None, description="a surface tells what lies so far behind it, metres; deeper it is unseen"
    )
    opening_m: float | None = Field(
        None, description="edge of the cube that passes through an opening, metres; a narrower one is none"
    )
    opening_rays: float | None = Field(
        None, description="so many widths of the frames' rays, if that is less: edge of that cube"
    )
    wide_open_above: int | None = Field(
        None, description="of nine ways up, so many lead outside below the mouth of a cavity"
    )
    hung: tuple[float, float, float] | None = Field(
        None,
        description="a body hangs high if it is thicker, metres, hangs so many of its widths high, "
        "and so much of it ends in free air below",
    )
    probability_open: OpenProbabilities | None = Field(
        None, description="of what lies open to free space through an opening that nobody looked into"
    )
    room: tuple[float, ...] | None = Field(
        None, description="cube in it, m; walls in 8 level, 9 upward ways; doorway's shares; times around"
    )
    stand_m: float | None = Field(
        None,
        description="what lies no higher above the floor is open: a thing may stand on its edges; metres",
    )
    probability_by_rule: RuleProbabilities | None = Field(None, description="where a rule says so")
    lengths_at_voxel_m: float | None = Field(
        None,
        description="edge of the voxels that these lengths are for, metres; where no setting gave voxels, "
        "smaller ones make them smaller in proportion",
    )
    voxel_size_by_recording: tuple[float, float, int] | None = Field(
        None,
        description="where no setting gave it: least edge, and steps, metres; how many an object is long",
    )
    frontiers: FrontierMethod | None = Field(None, description="of openings that nobody looked into")
    estimate: EstimateMethod | None = Field(None, description="of the IoU to the unknown truth")
    chosen_on: str | None = Field(None, description="the data that the constants were chosen on")
