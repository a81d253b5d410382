"""Typed settings of a benchmark, with all defaults; unknown keys are refused at every depth."""

import math
from typing import Annotated, Literal

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from kinectbench.core import MOST_SIDE_PX, Category, Name, Named, first_clash
from kinectbench.core.geometry import BoxAnchor, OrientedBox, Pose
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import CLOSED_MEANS, OPEN_MEANS, DepthCode, Framing, PartialRule, Split, Underside
from kinectbench.settings.base import Line, Settings
from kinectbench.settings.pick import PickSettings
from kinectbench.settings.publishing import PublishSettings, ReviewSettings
from kinectbench.settings.trajectory_reading import TrajectoryReading

TrajectoryMode = Literal["trust", "refine", "ignore"]
SegmentBy = Literal["masks", "turntable"]
Vector3 = Annotated[tuple[float, float, float], Field(strict=False)]
Vector4 = Annotated[tuple[float, float, float, float], Field(strict=False)]
BOX_KEYS = ("center_m", "size_m", "yaw_rad")
Vector7 = Annotated[Pose, Field(strict=False)]
# Limits as for rows of a trajectory: the farthest camera, and the smallest length of a quaternion.
FARTHEST_M, LEAST_TURN = 1e6, 1e-6
# Seconds, twice from 1970 to today: a clock may count from its start. Added to a stamp it fits 64 bits in ns.
MOST_DELAY_S = 4e9
# Depth up to this range is always fused, unless a person sets less: rules for solids were chosen with it.
LEAST_RANGE_M = 3.0
UNDERSIDE = (
    f"closed: {CLOSED_MEANS}; open: {OPEN_MEANS}, as between a chair's aprons; unseen: nobody looked. Turn "
    "it over: if it is closed, the hand meets one face"
)


class CameraSettings(Settings):
    """Intrinsics that the recording lacks; values given here override its own."""

    width: int | None = Field(None, ge=16, le=MOST_SIDE_PX, description="depth image width, pixels")
    height: int | None = Field(None, ge=16, le=MOST_SIDE_PX, description="depth image height, pixels")
    fx: float | None = Field(None, gt=0, description="focal length in x, pixels")
    fy: float | None = Field(None, gt=0, description="focal length in y, pixels")
    cx: float | None = Field(None, description="principal point in x, pixels")
    cy: float | None = Field(None, description="principal point in y, pixels")
    depth_scale: float | None = Field(None, gt=0, description="native depth units per metre")
    depth_code: DepthCode | None = Field(
        None, description="how depth in files is encoded; default: by its values"
    )
    depth_topic: str | None = Field(None, description="topic of depth images in a bag")
    color_topic: str | None = Field(None, description="topic of colour images in a bag")
    pose_topic: str | None = Field(None, description="topic of poses in a bag, or tf")
    color_delay_s: float = Field(
        0.0, ge=-MOST_DELAY_S, le=MOST_DELAY_S, description="how late colour's stamps are, seconds"
    )
    trajectory_delay_s: float = Field(
        0.0, ge=-MOST_DELAY_S, le=MOST_DELAY_S, description="how late given poses' stamps are, seconds"
    )
    trajectory_reading: TrajectoryReading | None = Field(None, description="how given poses are stored")
    min_confidence: int = Field(2, ge=0, le=2, description="least confidence of an iPhone's depth")
    mask_object: int | None = Field(None, description="object of a BOP scene whose masks are read")
    sensor: str | None = Field(None, pattern="^NP[1-5]$", description="camera of YCB that is read")
    swap_red_blue: bool = Field(False, description="whether colour is stored with red and blue exchanged")


class BoxSettings(Settings):
    """An upright box around the object, in the floor frame (z up, floor at z = 0)."""

    center_m: Vector3 = Field(description="centre, metres")
    size_m: Vector3 = Field(description="edge lengths, metres")
    yaw_rad: float = Field(0.0, description="turn about the vertical, radians")
    anchor_frame: int | None = Field(
        None, ge=0, description="with --pick: frame whose pose fixes the floor frame of the box"
    )
    anchor_pose: Vector7 | None = Field(None, description="its camera in the floor frame: x y z, qx qy qz qw")
    anchor_depth_sha256: str | None = Field(
        None, pattern="^[0-9a-f]{16}$", description="first 16 digits of the SHA-256 of that frame's depth"
    )

    @field_validator("center_m", "size_m")
    @classmethod
    def _in_range(cls, given_m: tuple[float, float, float], info: ValidationInfo) -> Vector3:
        if max(map(abs, given_m)) > FARTHEST_M:
            raise ValueError(f"no more than {FARTHEST_M:.0f} m each: give it in metres")
        if info.field_name == "size_m" and min(given_m) <= 0:
            raise ValueError("every edge must be longer than 0")
        return given_m

    @field_validator("yaw_rad")
    @classmethod
    def _within_a_turn(cls, yaw_rad: float) -> float:
        if abs(yaw_rad) > 2 * math.pi:
            raise ValueError(
                f"more than a whole turn: in radians {yaw_rad:g} degrees are {math.radians(yaw_rad):.3f}"
            )
        return yaw_rad

    @model_validator(mode="after")
    def _whole_anchor(self) -> "BoxSettings":
        frame, pose = self.anchor_frame, self.anchor_pose
        if (frame is None) is not (pose is None):
            raise ValueError("anchor_frame and anchor_pose go together; give both, or remove both")
        if self.anchor_depth_sha256 is not None and frame is None:
            raise ValueError("anchor_depth_sha256 is of an anchor_frame; give both, or remove both")
        if pose is not None and (max(map(abs, pose)) > FARTHEST_M or math.hypot(*pose[3:]) < LEAST_TURN):
            raise ValueError("anchor_pose is no pose; pick the box again, or remove the anchor")
        return self

    @model_serializer(mode="wrap")
    def _without_no_anchor(self, to_dict: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Leave out the keys of a missing anchor, so that fingerprints stay as before boxes had anchors."""
        values: dict[str, object] = to_dict(self)
        if self.anchor_depth_sha256 is None:
            values.pop("anchor_depth_sha256", None)
        if self.anchor_frame is not None:
            return values
        return {key: values[key] for key in BOX_KEYS if key in values}

    def box(self) -> OrientedBox:
        """Return the settings as an `OrientedBox`."""
        frame, pose = self.anchor_frame, self.anchor_pose
        anchor = None if frame is None or pose is None else BoxAnchor(frame, pose, self.anchor_depth_sha256)
        return OrientedBox(self.center_m, self.size_m, self.yaw_rad, anchor)


class FloorSettings(Settings):
    """The plane that the object stands on, as given by a person."""

    plane_world: Vector4 = Field(
        description="a x + b y + c z + d = 0, the normal (a, b, c) up and of length 1; metres, world frame"
    )

    @field_validator("plane_world")
    @classmethod
    def _a_plane(cls, plane_world: tuple[float, float, float, float]) -> Vector4:
        # Rounded normals are normalised where the plane is used; other lengths are a mistake.
        if not 0.5 <= math.hypot(*plane_world[:3]) <= 2:
            raise ValueError("the first three numbers are the plane's normal, of length 1")
        if abs(plane_world[3]) > FARTHEST_M:
            raise ValueError(f"the last number, d, is no more than {FARTHEST_M:.0f}: give it in metres")
        return plane_world


class RecordingSettings(Settings):
    """One recording of the benchmark."""

    id: Name = Field(description="name of the recording, unique in the file")
    path: str = Field(description="folder or bag, relative to benchmark.yaml")
    follow_links: bool = Field(False, description="whether links inside it are followed, wherever they lead")
    category: Category = Field(description="kind of object, such as chair or table")
    object: Name | None = Field(None, description="name of the thing, if it is recorded more than once")
    split: Split = Field("test", description="train, validation or test")
    trajectory: TrajectoryMode | None = Field(None, description="use of given poses; default: trust, if any")
    underside: Underside | None = Field(None, description=f"{UNDERSIDE}; default: its category's")
    camera: CameraSettings | None = Field(None, description="intrinsics that the recording does not say")
    box: BoxSettings | None = Field(None, description="box around the object, only where objects touch")
    pick: PickSettings | None = Field(None, description="pixel on the object, if cameras look elsewhere")
    floor: FloorSettings | None = Field(None, description="plane it stands on, only where that is not found")
    segment_by: SegmentBy | None = Field(
        None, description="for an object that moves before the camera: masks, or turntable if it turns"
    )
    masks: str | None = Field(
        None,
        description="folder of PNG masks of frames, relative to benchmark.yaml; with `segment_by: masks` of "
        "all frames",
    )
    reference: str | None = Field(
        None, description="mesh of a scanner or CAD that is its truth, relative to benchmark.yaml"
    )
    review: ReviewSettings | None = Field(None, description="a person's decision whether it is published")
    license: Line | None = Field(None, description="licence of its data; default: the benchmark's")
    source: Line | None = Field(
        None, description="who recorded it, or where it is from; default: the benchmark's"
    )

    @property
    def plane_world(self) -> Vector4 | None:
        """The plane that the object stands on, if given by hand: [a, b, c, d], metres, world frame."""
        return None if self.floor is None else self.floor.plane_world

    @property
    def trajectory_mode(self) -> TrajectoryMode | None:
        """How to use a given trajectory; default: None, or "ignore" if the object moves, not the camera."""
        return "ignore" if self.trajectory is None and self.segment_by else self.trajectory

    @property
    def object_name(self) -> str:
        """The name of the recorded object: `object`, or else the recording's id."""
        return self.object or self.id


class CategorySettings(Settings):
    """Defaults for all recordings of a category."""

    underside: Underside = Field("unseen", description=UNDERSIDE)


class TrackingSettings(Settings):
    """Camera trajectory: checks against the depth."""

    check_stride_px: int = Field(8, ge=1, le=64, description="step between compared pixels of a frame")
    check_neighbours: int = Field(6, ge=1, le=50, description="frames that a given pose is compared with")
    max_disagreement_m: float = Field(0.025, gt=0, le=1, description="error beyond which a pose is left out")
    max_stamp_gap_s: float = Field(0.1, gt=0, le=10, description="longest time gap in given poses, seconds")


class FusionSettings(Settings):
    """TSDF fusion."""

    voxel_size_m: float | None = Field(
        None,
        ge=0.001,
        le=0.05,
        description="edge of a voxel of the object; default: 5 mm, less for small things seen from near",
    )
    scene_voxel_size_m: float | None = Field(
        None, ge=0.002, le=0.1, description="edge of a voxel of the scene; default: by the recording"
    )
    truncation_voxels: float = Field(4.0, ge=2, le=20, description="truncation of the TSDF, voxels")
    min_depth_m: float = Field(0.3, ge=0, le=10, description="least depth that is fused, metres")
    max_depth_m: float | None = Field(
        None, gt=0.1, le=20, description="largest depth fused, metres; default: by the recording, 3 to 8 m"
    )

    @model_validator(mode="after")
    def _some_depth(self) -> "FusionSettings":
        if self.max_depth_m is None and self.min_depth_m >= LEAST_RANGE_M:
            raise ValueError(
                f"min_depth_m is {self.min_depth_m:g}, and of some recordings no depth beyond "
                f"{LEAST_RANGE_M:g} m would be fused: give max_depth_m, too"
            )
        if self.max_depth_m is not None and self.min_depth_m >= self.max_depth_m:
            raise ValueError(
                f"min_depth_m is {self.min_depth_m:g} and max_depth_m {self.max_depth_m:g}, so that no depth "
                "would be fused: min_depth_m must be less"
            )
        return self


class FloorCuts(Settings):
    """Heights that separate the floor from objects on it."""

    seed: int = Field(0, ge=0, description="seed of RANSAC")
    floor_cut_m: float = Field(0.02, ge=0.005, le=0.1, description="height up to which things are floor")
    low_cut_m: float = Field(
        0.01, ge=0.002, le=0.1, description="the same height for what touches the object (a mat? raise it)"
    )


class MaskCuts(FloorCuts):
    """Limits that decide which pixels of a view belong to the object's mask."""

    mask_tolerance_m: float = Field(0.03, gt=0, le=0.2, description="least depth difference a mask allows")


class ObjectCuts(FloorCuts):
    """Limits of the floor and of free space: space that some camera could see. All other space is the object.

    They hold for a whole benchmark, because they decide which voxels are solid where nothing was measured.
    """

    # A line narrower than two voxels of 5 mm is lost in rounding, and one of 10 cm closes a shelf. Cameras
    # measure from 5 cm to 2 m on, have the size of a fingertip to a helmet, and may lie on the floor.
    line_width_m: float = Field(
        SensorLimits.line_width_m,
        ge=0.01,
        le=0.1,
        description="width of a line of sight: narrower gaps are solid (0.02 where objects are under 0.4 m)",
    )
    near_m: float = Field(
        SensorLimits.near_m, ge=0.05, le=2, description="least distance from a camera to what it sees"
    )
    camera_size_m: float = Field(
        SensorLimits.camera_size_m, ge=0.02, le=0.5, description="diameter of a camera: least gap it passes"
    )
    camera_height_m: float = Field(
        SensorLimits.camera_height_m, ge=0, le=0.5, description="least height of a camera above the floor"
    )

    def limits(self) -> SensorLimits:
        """Return the limits of free space as `SensorLimits`."""
        return SensorLimits(self.line_width_m, self.near_m, self.camera_size_m, self.camera_height_m)


class SegmentationSettings(MaskCuts, ObjectCuts):
    """Floor plane and object selection."""


class ViewSettings(Settings):
    """Sampling of the views."""

    count: int = Field(50, ge=1, le=1000, description="number of views per recording")
    seed: int = Field(0, ge=0, description="seed of the draw")
    strategy: Literal["random", "coverage"] = Field(
        "random", description="random: uniform over the good frames (paper); coverage: every side equally"
    )
    min_pixels: int = Field(500, ge=16, description="least pixels on the object for a view")
    recorded_masks: bool = Field(True, description="whether to use a recording's own masks, such as BOP's")


class PairForm(Settings):
    """How a pair is framed in its cube, and how its partial view is reduced to coarser cells."""

    framing: Framing = Field("object", description="object: cube around full shape; view: around seen part")
    partial_rule: PartialRule = Field("any", description="how 4x4x4 cells of partial_256 become one")


class FitLimits(Settings):
    """Limits for how well a view must fit the object; worse ones give no pair."""

    min_containment: float = Field(0.85, ge=0, le=1, description="least share of a view's cells in the shape")
    max_residual_m: float = Field(0.015, gt=0, le=1, description="largest median difference in depth, metres")
    min_visible_share: float = Field(0.25, ge=0, le=1, description="least share of the outline with depth")


class PairSettings(FitLimits, PairForm):  # fields of the last base come first
    """Pairs of partial view and full shape."""


def _clash(index: int, earlier: int, problem: str) -> PydanticCustomError:
    """Make a validation error about recording `index`, whose names conflict with recording `earlier`."""
    context = {"problem": problem, "at": ("recordings", index), "earlier": earlier}
    return PydanticCustomError("value_error", "{problem}", context)


class BenchmarkSettings(Settings):
    """The content of benchmark.yaml."""

    name: Name = Field(description="name of the benchmark")
    license: Line = Field("unspecified", description="licence of the data, such as CC-BY-4.0")
    source: Line = Field("unspecified", description="who recorded the data, or where it is from")
    recordings: list[RecordingSettings] = Field(min_length=1, description="recordings that it is built from")
    categories: dict[Category, CategorySettings] = Field(
        {}, description="defaults for the recordings of a category, by its name"
    )
    # After loading, the recordings of the included files are in `recordings`.
    include: list[str] | None = Field(
        None, min_length=1, exclude=True, description="files with more recordings: YAML, CSV or Parquet"
    )
    tracking: TrackingSettings = TrackingSettings()
    fusion: FusionSettings = FusionSettings()
    segmentation: SegmentationSettings = SegmentationSettings()
    views: ViewSettings = ViewSettings()
    pairs: PairSettings = PairSettings()
    publish: PublishSettings = PublishSettings()

    @model_validator(mode="after")
    def _unique(self) -> "BenchmarkSettings":
        first_of_id: dict[str, int] = {}
        first_of_object: dict[str, int] = {}
        for index, recording in enumerate(self.recordings):
            earlier = first_of_id.setdefault(recording.id, index)
            if earlier != index:
                problem = f"two recordings have the id '{recording.id}': give each its own"
                raise _clash(index, earlier, problem)
            earlier = first_of_object.setdefault(recording.object_name, index)
            first = self.recordings[earlier]
            if first.split != recording.split:
                problem = (
                    f"object '{recording.object_name}' is in two splits: '{first.split}' ({first.id}) and "
                    f"'{recording.split}' ({recording.id}); an object belongs to one"
                )
                raise _clash(index, earlier, problem)
        clash = first_clash(Named(each.id, each.object_name, each.category) for each in self.recordings)
        if clash is not None:
            raise _clash(clash.row, clash.earlier, clash.problem)
        return self

    @model_validator(mode="after")
    def _used_categories(self) -> "BenchmarkSettings":
        used = {recording.category for recording in self.recordings}
        for category in self.categories:
            if category not in used:
                context = {"problem": "no recording has this category", "at": ("categories", category)}
                raise PydanticCustomError("value_error", "{problem}", context | {"valid": sorted(used)})
        return self

    def by_id(self) -> dict[str, RecordingSettings]:
        """Return {id: recording}; the dict is built at each call, so keep it for repeated use."""
        return {recording.id: recording for recording in self.recordings}

    def underside_of(self, recording: RecordingSettings) -> Underside:
        """Return the underside that the user stated for a recording, or else for its category."""
        of_category = self.categories.get(recording.category, CategorySettings())
        return recording.underside or of_category.underside

    def license_of(self, recording: RecordingSettings) -> str:
        """Return the licence of a recording: its own, else the benchmark's, else "unspecified"."""
        return recording.license or self.license

    def source_of(self, recording: RecordingSettings) -> str:
        """Return the source of a recording: its own, else the benchmark's, else "unspecified"."""
        return recording.source or self.source
