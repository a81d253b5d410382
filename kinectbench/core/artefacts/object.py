"""Files in a recording's `object/` (floor.json, quality.json, volume.npz, surround.npz) and candidates.json.

mesh.ply beside them is binary PLY (`core.geometry.mesh`): the closed surface in the world frame, metres.
"""

from typing import Literal, Self

from pydantic import Field

from kinectbench.core.artefacts.solid_method import SolidMethod
from kinectbench.core.artefacts.stored import (
    Count,
    DegreesInFile,
    Matrix4,
    NotNegative,
    ScaledPart,
    Share,
    Stored,
    StoredPart,
    Vector4,
    optional,
)
from kinectbench.core.geometry import BoxAnchor, OrientedBox, Pose
from kinectbench.core.types import Split, Underside

Triple = tuple[float, float, float]
# The ends of the estimate's interval, wherever they are shown; docs/ground-truth.md has the rule, and
# in how many simulated objects the IoU lay between them.
INTERVAL_LOW = (
    "lower end of its interval: larger surface error, every guess behind openings wrong; not guaranteed"
)
INTERVAL_HIGH = (
    "upper end of its interval: smaller surface error, every guess behind openings right; not guaranteed"
)
# Words of warnings that belong to `doubts`, for older files, which lack that key.
MEASUREMENT_WARNINGS = (
    "`kinectbench segment --suggest` lists boxes to choose from",
    "what carries it gave no depth",
    "large pieces that do not touch",
)
# Begins the warning that the floor cut may have taken parts of the object.
FLOOR_CUT = "floor_cut: "
# The underside is asked about, and what a person says of it is shown, if it decides this share of the solid
# (chosen by hand).
LEAST_UNDERSIDE_SHARE = 0.05
# If more of the depth on an object contradicts its surface, the surface is wrong. Of simulated and real
# objects of Kinects and phones that are right, at most 0.04 % does; where parts are lost or wrong, 0.11 to
# 4 %; with wrong intrinsics, 0.6 to 1.2 %; with poses that are a centimetre off, 0.6 and 1.4 %; of objects
# moved half-way, 0.16 to 16 % (docs/evidence/ground-truth.md, The estimate).
MAX_OFF_SHARE = 0.001
# Before the lines of `estimated_iou_reasons`, where an estimate is shown with its interval in brackets.
REASONS_FOLLOW = "the interval in brackets is so wide because of"


class BoxPart(StoredPart):
    """An upright box in the floor frame, as benchmark.yaml writes it."""

    center_m: Triple = Field(description="centre, floor frame, metres")
    size_m: tuple[NotNegative, NotNegative, NotNegative] = Field(description="edge lengths, metres")
    yaw_rad: float = Field(description="turn about z, radians, counter-clockwise seen from above")

    @classmethod
    def of(cls, box: OrientedBox, decimals_m: int, decimals_rad: int) -> Self:
        """Convert a box; lengths are rounded to `decimals_m` decimals, the yaw to `decimals_rad`."""
        x, y, z = (round(value, decimals_m) for value in box.center_m)
        length, width, height = (round(value, decimals_m) for value in box.size_m)
        return cls(
            center_m=(x, y, z), size_m=(length, width, height), yaw_rad=round(box.yaw_rad, decimals_rad)
        )

    def box(self) -> OrientedBox:
        """Return the part as an `OrientedBox`."""
        return OrientedBox(self.center_m, self.size_m, self.yaw_rad)


class FloorCandidate(StoredPart):
    """A plane that may have been the floor, and the reason against it."""

    plane_world: Vector4 = Field(description="[a, b, c, d], as for the floor, before refinement")
    inlier_share: Share = Field(description="share of the scene's surface on the plane")
    cameras_above_share: Share = Field(description="share of cameras looking down on it")
    below_share: Share = Field(description="share of the scene's surface below it")
    under_share: NotNegative = Field(
        description="points right below the plane's own area, divided by the points on the plane; may exceed "
        "1"
    )
    tilt_rad: float = Field(
        description="angle between its normal and up, by gravity or how cameras were held, radians"
    )
    evidence: float = Field(description="weight of evidence for it: rule in docs/ground-truth.md")
    refused: str | None = Field(description="why it is not the floor; null: it is")


class AnchoredBoxPart(BoxPart):
    """A candidate box, and the camera pose of one frame that fixes the floor frame of its coordinates."""

    anchor_frame: int = Field(description="frame whose pose fixes the floor frame")
    anchor_pose: Pose = Field(
        description="its camera's pose in the floor frame: x, y, z, quaternion x, y, z, w"
    )
    anchor_depth_sha256: str | None = optional("first 16 digits of its depth's SHA-256")

    @classmethod
    def of_anchored(cls, box: OrientedBox, anchor: BoxAnchor) -> Self:
        """Convert a box and its anchor, rounded to mm, mrad and five decimals of a quaternion."""
        x, y, z, *q = anchor.camera_floor
        qx, qy, qz, qw = (round(value, 5) for value in q)
        return cls(
            **dict(BoxPart.of(box, 3, 3)),
            anchor_frame=anchor.frame,
            anchor_pose=(round(x, 3), round(y, 3), round(z, 3), qx, qy, qz, qw),
            anchor_depth_sha256=anchor.depth_sha256,
        )


class FloorFile(Stored):
    """The plane that the object stands on: objects/<recording>/floor.json."""

    FILE = "floor.json"

    format_version: Literal[1] = Field(1, description="version of this file's format")
    plane_world: Vector4 = Field(description="[a, b, c, d]: a x + b y + c z + d = 0, (a, b, c) up; metres")
    T_floor_world: Matrix4 = Field(description="(4, 4), metres; frame floor: z up, floor at z = 0")
    noise_m: NotNegative = Field(description="standard deviation of points on the floor, metres")
    inlier_share: Share = Field(description="share of the scene's surface on the plane")
    tilt_rad: float | None = optional(
        "angle between its normal and up, by gravity or how cameras were held, radians"
    )
    found: bool | None = optional(
        "false: no plane was measured; z = 0 is level, at the lowest surface or below the object"
    )
    scale: float | None = optional("factor on floor_cut_m and low_cut_m, where cameras were nearer than 1 m")
    candidates: tuple[FloorCandidate, ...] = Field(
        (), description="planes among which the floor was chosen; empty if a person gave it"
    )


class LabelCounts(StoredPart):
    """Voxels of each label (`Label`)."""

    free: Count = Field(description="voxels seen through")
    other: Count = Field(description="voxels seen, but not the object's")
    surface: Count = Field(description="voxels measured on the object, or just behind")
    interior: Count = Field(description="voxels that no camera could see")
    unknown: Count = Field(description="unseen voxels that some camera could see")


class UnseenSidePart(ScaledPart):
    """The widest range of directions from which no camera looked at the object."""

    gap_rad: DegreesInFile = Field(description="width of the range, degrees, 0 to 360")
    towards_rad: DegreesInFile = Field(
        description="direction of its middle from the object, degrees from the floor's x axis, "
        "counter-clockwise"
    )
    share: Share = Field(description="share of horizontal directions in which an upright side was never seen")


class MovingPart(StoredPart):
    """Frames in which something moves: it lies in front of the scene, and other frames do not see it."""

    judged: Count = Field(description="number of frames examined")
    frames: tuple[int, ...] = Field(description="indices of frames in which something moves")
    largest_share: Share = Field(description="largest share of a frame's pixels in front of the scene")


class FrontierPart(StoredPart):
    """An opening into unseen space: it borders on free space without a surface between."""

    direction: Literal["up", "side", "down"] = Field(description="outward direction from the unseen region")
    area_m2: NotNegative = Field(
        description="area of its faces in that direction, square metres; more than the box `size_m` where "
        "faces lie behind others"
    )
    size_m: tuple[float, float] = Field(
        description="box around its faces: longer and shorter side from above; for `side` width and height; "
        "metres"
    )
    center_m: Triple = Field(description="middle of its faces, floor frame, metres")
    look_from: Triple = Field(
        description="unit vector towards where a camera would look into it, floor frame"
    )
    advice: str = Field(description="one line of advice for recording it")
    volume_m3: NotNegative = Field(description="volume of the unseen region behind it, cubic metres")
    inside_share: Share = Field(description="share of that volume expected inside the object")
    solid_share: Share = Field(description="share of that volume that the solid fills")
    underside: bool | None = optional("whether the region can be seen only from below")


class ReferenceTruth(StoredPart):
    """The mesh of a scanner or a CAD model that is the truth of a recording."""

    kind: Literal["reference mesh"] = Field(description="what the truth is")
    reference: str = Field(description="the mesh's file")
    sha256: str = Field(description="SHA-256 of its bytes")
    residual_m: NotNegative = Field(description="mean distance to the measured surface, both ways, metres")
    scale: float = Field(description="factor by which the mesh would fit best; not applied")


class QualityFile(Stored):
    """objects/<recording>/quality.json: how good the truth is."""

    FILE = "quality.json"

    format_version: Literal[1] | None = optional("version of this file's format")
    verdict: str | None = optional("summary in words")
    warnings: tuple[str, ...] = Field((), description="warnings, one line each")
    doubts: tuple[str, ...] | None = optional(
        "warnings that the object may not be one whole thing, or may not stand on the floor found"
    )
    repeatability_iou: Share | None = optional("IoU between the solids of odd and of even frames")
    estimated_iou: Share | None = optional("estimate of the solid's IoU to the unknown truth")
    estimated_iou_low: Share | None = optional(INTERVAL_LOW)
    estimated_iou_high: Share | None = optional(INTERVAL_HIGH)
    estimated_iou_reasons: tuple[str, ...] = Field((), description="what widens the interval, a line each")
    estimated_known_iou: Share | None = optional(
        "estimate of the IoU to the unknown truth over known voxels alone"
    )
    estimated_known_iou_low: Share | None = optional("lower end of its interval; not guaranteed")
    estimated_known_iou_high: Share | None = optional("upper end of its interval; not guaranteed")
    frontiers: tuple[FrontierPart, ...] = Field(
        (), description="openings that nobody looked into, largest volume behind first"
    )
    surface_sigma_m: NotNegative | None = optional("standard deviation of the surface, metres")
    unknown_share: Share | None = optional("unknown share of the solid")
    unknown_air_share: NotNegative | None = optional(
        "unseen volume taken for air, divided by the solid's volume; may exceed 1"
    )
    doubtful_share: Share | None = optional(
        "share of the solid that may be hollow; in files up to version 27 of the stage"
    )
    underside: Underside | None = optional(
        "`underside` in benchmark.yaml: a person's statement, not measured"
    )
    underside_share: Share | None = optional(
        "unseen share of the solid that cameras could see only from below"
    )
    volume_m3: NotNegative | None = optional("volume of the solid, cubic metres")
    labels: LabelCounts | None = optional("voxels of each label")
    box: BoxPart | None = optional("box around the object, floor frame")
    box_odd: BoxPart | None = optional("box from odd frames alone")
    box_even: BoxPart | None = optional("box from even frames alone")
    selection: str | None = optional("how the object was selected: automatic, box or masks")
    good_frames: Count | None = optional("number of frames fused")
    unseen_side: UnseenSidePart | None = optional("side that no camera looked at")
    moving: MovingPart | None = optional("frames in which something moves")
    max_depth_m: NotNegative | None = optional("largest depth fused into the object, metres")
    beyond_share: Share | None = optional("share of depth around the object beyond `max_depth_m`")
    off_share: Share | None = optional(
        "share of the depth on the object that lies 20 mm and more off its surface; null: none "
        "of it lies clear of the floor"
    )
    inverse_depth_steps: NotNegative | None = optional(
        "steps of inverse depth, 1/m: 346 of a Kinect v1; else estimates allow for a bias"
    )
    method: SolidMethod | str | None = optional("how the solid was made, with figures")
    source: str | None = optional("synthesised: source mesh")
    faces: Count | None = optional("synthesised: triangles of the mesh")
    truth: ReferenceTruth | None = optional(
        "a mesh that is the truth, in place of what was fused; missing: fused"
    )

    @property
    def trusted_iou(self) -> tuple[float | None, float | None, str]:
        """The estimated IoU with the unknown truth, the lower end of its interval, and where it applies.

        It is the IoU over known voxels, as in scores, and the text is " on known voxels". Files without that
        estimate give the IoU over all voxels of the solid, with the text "".
        """
        if self.estimated_known_iou is None:
            return self.estimated_iou, self.estimated_iou_low, ""
        return self.estimated_known_iou, self.estimated_known_iou_low, " on known voxels"

    @property
    def measurement_warnings(self) -> tuple[str, ...]:
        """Warnings that the object found may be wrong: `doubts`; in older files, some of `warnings`."""
        if self.doubts is not None:
            return self.doubts
        return tuple(line for line in self.warnings if any(words in line for words in MEASUREMENT_WARNINGS))

    @property
    def advice(self) -> tuple[str, ...]:
        """Advice on what to record again, one line for each opening that no camera looked into."""
        return tuple(frontier.advice for frontier in self.frontiers)

    @property
    def rests_on_word(self) -> str | None:
        """A warning if much of the solid depends on the user's statement `underside: closed`; otherwise None.

        If the statement is false, all voxels that depend on it may be air, and the IoU falls by at most their
        share.
        """
        share, low = self.underside_share or 0.0, self.estimated_iou_low
        if self.underside != "closed" or share <= LEAST_UNDERSIDE_SHARE:
            return None
        line = f"{share:.0%} of the solid rests on `underside: closed` alone, which no frame confirms"
        if low is None:
            return line
        return f"{line}; if it is false, the IoU may be as low as {max(0.0, low - share):.2f}"

    def estimated_iou_words(self, decimals: int = 2) -> str | None:
        """The estimated IoU with its interval, such as `0.74 (0.35 to 0.80)`; None if there is none."""
        return with_interval(self.estimated_iou, self.estimated_iou_low, self.estimated_iou_high, decimals)


def with_interval(
    value: float | None, low: float | None, high: float | None, decimals: int | None = None
) -> str | None:
    """Format a value and its interval, such as `0.74 (0.35 to 0.80)`; without an interval the value alone.

    By default, there are two decimals with an interval, and three without. If the value is None, so is the
    result.
    """
    if value is None:
        return None
    if decimals is None:
        decimals = 3 if low is None else 2
    ends = "" if low is None or high is None else f" ({low:.{decimals}f} to {high:.{decimals}f})"
    return f"{value:.{decimals}f}{ends}"


class SynthesisedQualityFile(Stored):
    """quality.json of an object synthesised from a mesh; `QualityFile` reads this file, too."""

    FILE = QualityFile.FILE

    verdict: str = Field(description="summary in words")
    method: str = Field(description="rule by which the mesh was filled")
    source: str = Field(description="the mesh, or the seed it was made from")
    faces: Count = Field(description="triangles of the mesh")
    warnings: tuple[str, ...] = Field(description="warnings, one line each")


class MadeGroup(StoredPart):
    """Views of a model that were synthesised together: views with a pair, and views without, with reasons."""

    views: tuple[str, ...] = Field(description="names of those that have a pair")
    refused: tuple[str, ...] = Field(description="why each of the others has none")


class MadeModel(Stored):
    """made.json, written for each model during synthesis: the model's data for the final report."""

    FILE = "made.json"
    ADVICE = "run the command again"

    split: Split = Field(description="the part of the benchmark that it belongs to")
    quality: SynthesisedQualityFile = Field(description="how its mesh was filled")
    groups: dict[str, MadeGroup] = Field(description="name of a group of views -> what became of them")


class CandidateRow(StoredPart):
    """A candidate box for the object."""

    number: int = Field(description="number in the pictures, from 1")
    automatic: bool = Field(description="whether chosen automatically")
    box: AnchoredBoxPart = Field(description="box around it, floor frame")
    distance_m: float = Field(description="distance from where cameras look, metres")
    picture: str = Field(description="file of its picture")


class CandidatesFile(Stored):
    """candidates/candidates.json: the boxes among which the user may choose the object."""

    FILE = "candidates.json"
    ADVICE = "`kinectbench segment --suggest --force` makes it again"

    format_version: Literal[1] = Field(1, description="version of this file's format")
    floor_found: bool = Field(description="false: the boxes stand on the lowest surface")
    T_floor_world: Matrix4 | None = optional("(4, 4), metres: from the world to the boxes' frame")
    plan: str = Field(description="file of the scene from above")
    candidates: tuple[CandidateRow, ...] = Field(
        description="boxes, automatic choice first, then by distance"
    )
