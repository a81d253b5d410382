"""views.json and pairs.json: the views of a recording with their statistics, and the pairs made of them."""

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints

from kinectbench.core.artefacts.stored import (
    Count,
    Matrix3,
    Matrix4,
    NotNegative,
    Share,
    Stored,
    StoredPart,
    must,
    optional,
)
from kinectbench.core.untrusted import MOST_SIDE_PX

UNKNOWN_SHARE = "unknown share of the true shape's volume in the pair's cube"

ViewName = Annotated[str, StringConstraints(pattern="^[0-9]{3,6}$")]
# SHA-256 of an image.
Digest = Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]
# Stated for a mask that was drawn on a frame as recorded, not on a view's pictures.
RECORDED: Literal["recorded"] = "recorded"
Steps = tuple[int, int, int]
Angles = tuple[float, float, float]


Side = Annotated[int, must(f"be 1 to {MOST_SIDE_PX} pixels", lambda pixels: 1 <= pixels <= MOST_SIDE_PX)]
Focal = Annotated[float, must("be a positive focal length", lambda pixels: pixels > 0)]
Intrinsics = Annotated[Matrix3, must("have positive focal lengths", lambda K: K[0, 0] > 0 and K[1, 1] > 0)]


class ViewRow(StoredPart):
    """One view; of a held-back recording `view`, `K`, `width`, `height` and `pair` only."""

    view: ViewName = Field(description="zero-padded index")
    steps: Steps | None = optional("synthesised: steps of roll, pitch, yaw")
    angles_rad: Angles | None = optional("synthesised: roll, pitch, yaw, radians")
    frame: Count | None = optional("index of the frame in the recording")
    stamp_ns: int | None = optional("depth stamp, nanoseconds")
    reason: str | None = optional("why it was chosen")
    T_world_camera: Matrix4 | None = optional("(4, 4), camera to world, metres, after alignment")
    moved_m: NotNegative | None = optional("translation by the alignment, metres")
    turned_rad: float | None = optional("rotation by the alignment, radians")
    blur: NotNegative | None = optional("the colour image's blur, see docs/tracking.md")
    pose_residual_m: NotNegative | None = optional("tracker's residual, metres")
    pixels: Count | None = optional("pixels in the mask")
    visible_share: Share | None = optional("share of the silhouette that has depth")
    border_share: Share | None = optional("share of the silhouette within 1 px of the border")
    dropped_share: Share | None = optional("share of depth in the silhouette that the mask leaves out")
    containment: Share | None = optional("share of the view's cells inside the shape, dilated once")
    residual_m: NotNegative | None = optional("median difference between measured and rendered depth, metres")
    truncated_share: Share | None = optional("share of the silhouette outside the image")
    K: Intrinsics | None = optional("(3, 3) intrinsics, pixels; pixel centres are integers")
    width: Side | None = optional("width of depth and mask, pixels")
    height: Side | None = optional("height of depth and mask, pixels")
    pair: bool | None = optional("whether the view has a pair and published images")
    unknown_share: Share | None = optional(UNKNOWN_SHARE)


class Refused(StoredPart):
    """A frame that was not used as a view, or a view without a pair."""

    view: ViewName | None = optional("zero-padded index; frames that were no views have none")
    steps: Steps | None = optional("synthesised: steps of roll, pitch, yaw")
    angles_rad: Angles | None = optional("synthesised: roll, pitch, yaw, radians")
    frame: Count | None = optional("index of the frame in the recording")
    reason: str = Field(description="why it was refused")


class SynthesisedCamera(StoredPart):
    """The pinhole camera that synthesised views were rendered with; pixel centres are integers."""

    width: Side = Field(description="width of the image, pixels")
    height: Side = Field(description="height of the image, pixels")
    fx: Focal = Field(description="focal length in x, pixels")
    fy: Focal = Field(description="focal length in y, pixels")
    cx: float = Field(description="principal point in x, pixels")
    cy: float = Field(description="principal point in y, pixels")


class ViewsFile(Stored):
    """The views of a recording: views/<recording>/views.json."""

    FILE = "views.json"

    format_version: Literal[1] = Field(1, description="version of this file's format")
    color_registered: bool | None = optional("whether colour pixels lie on depth pixels")
    order: str | None = optional("synthesised: order of the angles")
    steps_per_turn: Steps | int | None = optional("synthesised: steps in a turn")
    camera: SynthesisedCamera | None = optional("synthesised: its camera")
    views: tuple[ViewRow, ...] = Field(description="a row for each view")
    refused: tuple[Refused, ...] = Field(description="frames not used as views")
    warnings: tuple[str, ...] = Field((), description="warnings, one line each")


class PairRow(StoredPart):
    """Statistics of one pair of a partial view and the full shape."""

    view: ViewName = Field(description="zero-padded index")
    frame: Count | None = optional("index of the frame in the recording")
    containment: Share | None = optional("share of the view's cells inside the shape, dilated once")
    residual_m: NotNegative | None = optional("median difference between measured and rendered depth, metres")
    dropped_share: Share | None = optional("share of depth in the silhouette that the mask leaves out")
    visible_share: Share | None = optional("share of the silhouette that has depth")
    moved_m: NotNegative | None = optional("translation by the alignment, metres")
    turned_rad: float | None = optional("rotation by the alignment, radians")
    cut_share: Share | None = optional("share of the shape's volume outside the pair's cube")
    unknown_share: Share | None = optional(UNKNOWN_SHARE)


class PairsFile(Stored):
    """pairs/pairs.json: the pairs of a recording, and the views without a pair."""

    FILE = "pairs.json"

    format_version: Literal[1] = Field(1, description="version of this file's format")
    pairs: tuple[PairRow, ...] = Field(description="a row for each pair")
    refused: tuple[Refused, ...] = Field(description="views of which no pair was made")


class DrawnOn(StoredPart):
    """The image that the user drew a mask on."""

    image: Digest = Field(description="SHA-256 of the frame's depth as it was recorded")
    picture: Digest | Literal["recorded"] | None = optional(
        "SHA-256 of the view's pictures as the person saw them; recorded: none of a view, but of "
        "the frame as it was recorded; None: not known"
    )


class MasksFile(Stored):
    """masks.json beside the user's masks: which image each was drawn on, by the masks' file names."""

    FILE = "masks.json"
    ADVICE = "correct it, or remove it and look at every mask again"
    # Where no picture is known, and in files of older versions, the image alone.
    __pydantic_extra__: dict[str, Digest | DrawnOn]

    @classmethod
    def of(cls, drawn_on: Mapping[str, DrawnOn]) -> Self:
        """Return the file with these entries, by file name."""
        return cls.model_validate({file: on if on.picture else on.image for file, on in drawn_on.items()})

    @property
    def drawn_on(self) -> dict[str, DrawnOn]:
        """The image that each mask was drawn on, by file name."""
        entries = self.__pydantic_extra__.items()
        return {file: DrawnOn(image=on) if isinstance(on, str) else on for file, on in entries}
