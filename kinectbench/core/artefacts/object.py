"""What `object/` holds of a recording (floor.json, quality.json, volume.npz, surround.npz), and candidates.

mesh.ply beside them is binary PLY (`core.geometry.mesh`): the closed surface in the world frame, metres.
"""

from typing import Literal, Self

from pydantic import Field

from kinectbench.core.artefacts.stored import DegreesInFile, Matrix4, Part, ScaledPart, Stored, Vector4
from kinectbench.core.geometry import OrientedBox
from kinectbench.core.types import Split

Triple = tuple[float, float, float]
# What the ends of the estimate's interval are, wherever they are told; docs/ground-truth.md has the rule, and
# in how many simulated objects the IoU lay between them.
INTERVAL_LOW = "lower end of its interval: more is missing, and every guess behind an opening wrong; no bound"
INTERVAL_HIGH = (
    "upper end of its interval: less is missing, and every guess behind an opening right; no bound"
)
# Before the lines of `estimated_iou_reasons`, where an estimate is told with its interval in brackets.
REASONS_FOLLOW = "the interval in brackets is so wide because of"
Curve = tuple[tuple[float, float], ...]


class BoxPart(Part):
    """An upright box in the floor frame, as benchmark.yaml writes it."""

    center_m: Triple = Field(description="centre, floor frame, metres")
    size_m: Triple = Field(description="edge lengths, metres")
    yaw_rad: float = Field(description="turn about z, radians, counter-clockwise seen from above")

    @classmethod
    def of(cls, box: OrientedBox, decimals_m: int, decimals_rad: int) -> Self:
        """A box rounded to so many decimals of metres and of radians."""
        x, y, z = (round(value, decimals_m) for value in box.center_m)
        length, width, height = (round(value, decimals_m) for value in box.size_m)
        return cls(
            center_m=(x, y, z), size_m=(length, width, height), yaw_rad=round(box.yaw_rad, decimals_rad)
        )

    def box(self) -> OrientedBox:
        """The box itself."""
        return OrientedBox(self.center_m, self.size_m, self.yaw_rad)


class FloorFile(Stored):
    """objects/<recording>/floor.json."""

    FILE = "floor.json"

    format_version: Literal[1] = Field(1, description="of this file's format")
    plane_world: Vector4 = Field(description="[a, b, c, d]: a x + b y + c z + d = 0, (a, b, c) up; metres")
    T_floor_world: Matrix4 = Field(description="(4, 4), metres; frame floor: z up, floor at z = 0")
    noise_m: float = Field(description="of the points on the floor, metres")
    inlier_share: float = Field(description="of the scene's surface, that lies on the plane")
    tilt_rad: float | None = Field(
        None, description="between its normal and up as the cameras were held, radians"
    )
    found: bool | None = Field(None, description="false: no floor was found, and a box was given")


class LabelCounts(Part):
    """Voxels of each label (`Label`)."""

    free: int = Field(description="seen through, voxels")
    other: int = Field(description="not the object, voxels")
    surface: int = Field(description="measured on the object, voxels")
    interior: int = Field(description="enclosed by its surface, voxels")
    unknown: int = Field(description="never seen or never decided, voxels")


class UnseenSidePart(ScaledPart):
    """The widest range of directions from which no camera looked at the object."""

    gap_rad: DegreesInFile = Field(description="its width, degrees, 0 to 360")
    towards_rad: DegreesInFile = Field(
        description="its middle, seen from the object, degrees from the floor's x axis, counter-clockwise"
    )
    share: float = Field(description="of all upright directions: those that no camera would have seen")


class MovingPart(Part):
    """Frames in which something stands before the scene that the others do not see."""

    judged: int = Field(description="frames looked at")
    frames: tuple[int, ...] = Field(description="indices of those in which something moves")
    largest_share: float = Field(description="of a frame's pixels, that lie before the scene")


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
    frontiers: FrontierMethod | None = Field(None, description="of openings that nobody looked into")
    estimate: EstimateMethod | None = Field(None, description="of the IoU to the unknown truth")
    chosen_on: str | None = Field(None, description="the data that the constants were chosen on")


class FrontierPart(Part):
    """An opening that nobody looked into: unseen space borders on free space without any surface."""

    direction: Literal["up", "side", "down"] = Field(description="from the unseen region outward")
    area_m2: float = Field(
        description="of its faces along that direction, square metres: what is open of the box `size_m`, "
        "and more than the box where some of its faces lie behind others"
    )
    size_m: tuple[float, float] = Field(
        description="of the box around its faces: seen from above the longer and the shorter side; at the "
        "side width and height; metres"
    )
    center_m: Triple = Field(description="its middle, floor frame, metres")
    look_from: Triple = Field(description="unit vector, floor frame: to where a camera would look into it")
    advice: str = Field(description="one line for the person who records")
    volume_m3: float = Field(description="of the unseen region behind it, cubic metres")
    inside_share: float = Field(description="of that region, expected to be inside the object")
    solid_share: float = Field(description="of that region, what the solid takes for inside")


class QualityFile(Stored):
    """objects/<recording>/quality.json: how good the truth is."""

    FILE = "quality.json"

    format_version: Literal[1] | None = Field(None, description="of this file's format")
    verdict: str | None = Field(None, description="in words")
    warnings: tuple[str, ...] = Field((), description="one line each")
    repeatability_iou: float | None = Field(None, description="IoU of solids made of odd and even frames")
    estimated_iou: float | None = Field(None, description="estimate of the solid's IoU to the unknown truth")
    estimated_iou_low: float | None = Field(None, description=INTERVAL_LOW)
    estimated_iou_high: float | None = Field(None, description=INTERVAL_HIGH)
    estimated_iou_reasons: tuple[str, ...] = Field((), description="what widens the interval, a line each")
    frontiers: tuple[FrontierPart, ...] = Field(
        (), description="openings that nobody looked into, that with the largest volume behind it first"
    )
    surface_sigma_m: float | None = Field(None, description="standard deviation of the surface, metres")
    unknown_share: float | None = Field(
        None, description="of the solid: never seen; what nobody saw and is taken for air is no part of it"
    )
    unknown_air_share: float | None = Field(
        None, description="never seen and taken for air beside the solid, by the solid's volume; may exceed 1"
    )
    doubtful_share: float | None = Field(None, description="of the solid: perhaps a hollow")
    volume_m3: float | None = Field(None, description="of the solid, cubic metres")
    labels: LabelCounts | None = Field(None, description="voxels of each label")
    box: BoxPart | None = Field(None, description="around the object, floor frame")
    box_odd: BoxPart | None = Field(None, description="of the odd frames alone")
    box_even: BoxPart | None = Field(None, description="of the even frames alone")
    selection: str | None = Field(None, description="automatic or box")
    good_frames: int | None = Field(None, description="frames that were fused")
    unseen_side: UnseenSidePart | None = Field(None, description="side that no camera looked at")
    moving: MovingPart | None = Field(None, description="frames in which something moves")
    max_depth_m: float | None = Field(None, description="farther depth made no surface of it, metres")
    beyond_share: float | None = Field(None, description="of the depth that falls around it: farther")
    method: SolidMethod | str | None = Field(None, description="how the solid was made, with figures")
    source: str | None = Field(None, description="synthesised: the mesh")
    faces: int | None = Field(None, description="synthesised: triangles of the mesh")

    @property
    def advice(self) -> tuple[str, ...]:
        """What to record again, a line for each opening that nobody looked into."""
        return tuple(frontier.advice for frontier in self.frontiers)

    def estimated_iou_words(self, decimals: int = 2) -> str | None:
        """`0.74 (0.35 to 0.80)`: the estimated IoU with its interval, if there is one; None without it."""
        return with_interval(self.estimated_iou, self.estimated_iou_low, self.estimated_iou_high, decimals)


def with_interval(value: float | None, low: float | None, high: float | None, decimals: int) -> str | None:
    """`0.74 (0.35 to 0.80)`; without the ends of its interval the value alone; None without a value."""
    if value is None:
        return None
    ends = "" if low is None or high is None else f" ({low:.{decimals}f} to {high:.{decimals}f})"
    return f"{value:.{decimals}f}{ends}"


class SynthesisedQualityFile(Stored):
    """quality.json of an object that was made from a mesh; `QualityFile` reads it, too."""

    FILE = QualityFile.FILE

    verdict: str = Field(description="in words")
    method: str = Field(description="rule by which the mesh was filled")
    source: str = Field(description="the mesh, or the seed it was made from")
    faces: int = Field(description="triangles of the mesh")
    warnings: tuple[str, ...] = Field(description="one line each")


class MadeGroup(Part):
    """What became of the views of a model that were synthesised together."""

    views: tuple[str, ...] = Field(description="names of those that have a pair")
    refused: tuple[str, ...] = Field(description="why each of the others has none")


class MadeModel(Stored):
    """made.json of a model's artefact while a benchmark is synthesised: what it adds to the report."""

    FILE = "made.json"
    ADVICE = "run the command again"

    split: Split = Field(description="the part of the benchmark that it belongs to")
    quality: SynthesisedQualityFile = Field(description="how its mesh was filled")
    groups: dict[str, MadeGroup] = Field(description="name of a group of views -> what became of them")


class CandidateRow(Part):
    """A box that the object may be chosen by."""

    number: int = Field(description="from 1 on, as in the pictures")
    automatic: bool = Field(description="it is what is chosen without a box")
    box: BoxPart = Field(description="around it, floor frame")
    distance_m: float = Field(description="from where the cameras look to its nearest point, metres")
    picture: str = Field(description="file beside this one")


class CandidatesFile(Stored):
    """candidates/candidates.json."""

    FILE = "candidates.json"
    ADVICE = "`kinectbench segment --suggest --force` makes it again"

    format_version: Literal[1] = Field(1, description="of this file's format")
    floor_found: bool = Field(
        description="false: no floor was found, and the boxes stand on the lowest surface"
    )
    plan: str = Field(description="file beside this one: the scene from above")
    candidates: tuple[CandidateRow, ...] = Field(description="the automatic choice first, then by distance")
