"""What the JSON files of a release hold, as models: their schemas are made from these."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, RootModel

from kinectbench.release.metadata import ReleaseInfo

Vector = list[float]
Matrix = list[list[float]]


class Described(BaseModel):
    """Typed keys; more may be added in later versions."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)


class SplitsFile(RootModel[dict[Literal["train", "validation", "test"], list[str]]]):
    """splits.json: split -> recordings, sorted."""


class ViewRow(Described):
    """One view; of a held-back recording `view`, `K`, `width`, `height` and `pair` only."""

    view: str = Field(pattern="^[0-9]{3,6}$", description="zero-padded index")
    K: Matrix | None = Field(None, description="(3, 3) intrinsics, pixels; pixel centres are integers")
    width: int | None = Field(None, description="of depth and mask, pixels")
    height: int | None = Field(None, description="of depth and mask, pixels")
    pair: bool | None = Field(None, description="the view has a pair, and its images are published")
    frame: int | None = Field(None, description="index of the frame in the recording")
    stamp_ns: int | None = Field(None, description="depth stamp, nanoseconds")
    reason: str | None = Field(None, description="why it was chosen")
    T_world_camera: Matrix | None = Field(
        None, description="(4, 4), camera to world, metres, after alignment"
    )
    moved_m: float | None = Field(None, description="by the alignment, metres")
    turned_rad: float | None = Field(None, description="by the alignment, radians")
    blur: float | None = Field(None, description="of the colour image, see docs/tracking.md")
    pose_residual_m: float | None = Field(None, description="of the tracker, metres")
    pixels: int | None = Field(None, description="of the mask")
    visible_share: float | None = Field(None, description="of the silhouette that has depth")
    border_share: float | None = Field(None, description="of the silhouette, within 1 px of the border")
    truncated_share: float | None = Field(None, description="of the outline, beyond the image")
    dropped_share: float | None = Field(None, description="of the depth in the mask, far from the shape")
    containment: float | None = Field(None, description="share of the view's points in the shape")
    residual_m: float | None = Field(None, description="median distance of the points from the shape, metres")
    steps: list[int] | None = Field(None, description="synthesised: steps of roll, pitch, yaw")
    angles_rad: Vector | None = Field(None, description="synthesised: roll, pitch, yaw, radians")


class ViewsFile(Described):
    """views/<recording>/views.json."""

    format_version: Literal[1]
    views: list[ViewRow] = Field(description="a row for each view")
    refused: list[dict[str, Any]] = Field(description="frames that were no views: `frame`, `reason`")
    color_registered: bool | None = Field(None, description="colour pixels lie on depth pixels")
    warnings: list[str] | None = Field(None, description="one line each")
    order: str | None = Field(None, description="synthesised: order of the angles")
    steps_per_turn: list[int] | int | None = Field(None, description="synthesised: steps in a turn")
    camera: dict[str, float] | None = Field(None, description="synthesised: width, height, fx, fy, cx, cy")


class FloorFile(Described):
    """objects/<recording>/floor.json."""

    format_version: Literal[1]
    plane_world: Vector = Field(description="[a, b, c, d]: a x + b y + c z + d = 0, (a, b, c) up")
    T_floor_world: Matrix = Field(description="(4, 4); frame floor: z up, floor at z = 0")
    noise_m: float = Field(description="of the points on the floor, metres")
    inlier_share: float = Field(description="of the points below the cameras")
    tilt_rad: float | None = Field(None, description="between its normal and up as the cameras were held")
    found: bool | None = Field(None, description="false: no floor was found, and a box was given")


class QualityFile(Described):
    """objects/<recording>/quality.json: how good the truth is."""

    format_version: Literal[1] | None = None
    verdict: str | None = Field(None, description="in words")
    warnings: list[str] | None = Field(None, description="one line each")
    repeatability_iou: float | None = Field(None, description="IoU of solids made of odd and even frames")
    estimated_iou: float | None = Field(None, description="estimate of the solid's IoU to the unknown truth")
    surface_sigma_m: float | None = Field(None, description="standard deviation of the surface, metres")
    unknown_share: float | None = Field(None, description="of the solid: never seen")
    doubtful_share: float | None = Field(None, description="of the solid: perhaps a hollow")
    volume_m3: float | None = Field(None, description="of the solid, cubic metres")
    labels: dict[str, int] | None = Field(None, description="voxels of each label")
    box: dict[str, Any] | None = Field(None, description="floor frame: `center_m`, `size_m`, `yaw_rad`")
    box_odd: dict[str, Any] | None = Field(None, description="of the odd frames alone")
    box_even: dict[str, Any] | None = Field(None, description="of the even frames alone")
    selection: str | None = Field(None, description="automatic or box")
    good_frames: int | None = Field(None, description="frames that were fused")
    unseen_side: dict[str, Any] | None = Field(None, description="`gap_deg`, `towards_deg`, `share`")
    moving: dict[str, Any] | None = Field(None, description="`judged`, `frames`, `largest_share`")
    method: dict[str, Any] | str | None = Field(None, description="how the solid was made, with figures")
    source: str | None = Field(None, description="synthesised: the mesh")
    faces: int | None = Field(None, description="synthesised: triangles of the mesh")


class StageRow(Described):
    """What made one artefact."""

    package_version: str = Field(description="of kinectbench")
    settings: dict[str, Any] = Field(description="those the stage depends on")
    fingerprint: str = Field(description="of settings and inputs")


class LineageView(Described):
    """The frame of a view."""

    view: str = Field(description="zero-padded index")
    frame: int = Field(description="index among the recording's depth images, in their order")
    stamp_ns: int = Field(description="nanoseconds")


class LineageRecording(Described):
    """One recording."""

    source: str = Field(description="who recorded it, or where it is from")
    license: str = Field(description="of the data")
    files: dict[str, str] = Field(description="file of the recording -> SHA-256")
    stages: dict[str, StageRow] = Field(description="by name, in their order")
    views: list[LineageView] | None = Field(None, description="those with a pair; held back: none")


class LineageFile(Described):
    """lineage.json; the versions of packages are in benchmark.json."""

    format_version: Literal[1]
    package_version: str = Field(description="kinectbench that published it")
    packages: str = Field(description="where the versions of packages are")
    recordings: dict[str, LineageRecording]


class RemovedRow(Described):
    """Something that was removed."""

    file: str = Field(description="of the release")
    what: str = Field(description="in words")


class PrivacyFile(Described):
    """privacy.json."""

    format_version: Literal[1]
    color: Literal["left out", "published", "none"] = Field(description="colour images of the views")
    looked_in: list[str]
    looked_for: list[str]
    removed: list[RemovedRow]
    kept: list[str] = Field(description="what is published knowingly")


class ThresholdsFile(Described):
    """thresholds.json."""

    thresholds: dict[str, float] = Field(description="category -> threshold, one of 0.1, 0.15, ... 0.9")
    objects: list[str] | None = Field(None, description="they were found on")
    method: str | None = Field(None, description="they were found for")
    benchmark_sha256: str | None = Field(None, description="of the release they were found on")


# Schema's name -> (files of the release, model).
JSON_FILES: dict[str, tuple[str, type[BaseModel]]] = {
    "benchmark": ("benchmark.json", ReleaseInfo),
    "splits": ("splits.json", SplitsFile),
    "views": ("views/*/views.json", ViewsFile),
    "floor": ("objects/*/floor.json", FloorFile),
    "quality": ("objects/*/quality.json", QualityFile),
    "lineage": ("lineage.json", LineageFile),
    "privacy": ("privacy.json", PrivacyFile),
    "thresholds": ("thresholds.json", ThresholdsFile),
}
