"""The settings of each stage, one model per stage, and the other inputs of a stage.

The model's JSON is part of the stage's fingerprint, so a step cannot read a setting that is not in it.
`stages` makes the models from a job.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

from pydantic import Field, JsonValue

from kinectbench.core.types import Progress, Underside
from kinectbench.settings.base import Settings
from kinectbench.settings.models import (
    BoxSettings,
    CameraSettings,
    FitLimits,
    FloorCuts,
    FusionSettings,
    MaskCuts,
    ObjectCuts,
    PairSettings,
    SegmentBy,
    TrackingSettings,
    TrajectoryMode,
    Vector4,
    ViewSettings,
)
from kinectbench.settings.pick import PickSettings

Section = TypeVar("Section", bound=Settings)
# Name of the source for the recording's files.
RECORDING = "recording"
# Name of the source for the user's masks.
MASKS = "masks"
# Name of the source for a mesh that replaces the fused ground truth.
REFERENCE = "reference"
# {setting that a stage makes of a key of benchmark.yaml: this key}
MADE_OF = {"needs_trajectory": "trajectory", "own_pixels": "segment_by"}
Needed = TypeVar("Needed", bound="StageSettings")


def part_of(wanted: type[Section], section: Settings) -> Section:
    """Copy a section of benchmark.yaml into the model `wanted`, which has only some of the section's keys.

    Fields that the model excludes from JSON keep their defaults.
    """
    kept = (name for name, field in wanted.model_fields.items() if not field.exclude)
    return wanted.model_validate({name: getattr(section, name) for name in kept})


class StageSettings(Settings):
    """Base class of the settings of a stage.

    Attributes:
        ADDED: keys (`section.key` if nested) that were added after the stage's version was set. The
            fingerprint omits them while they have their defaults, so that existing artefacts stay valid.
    """

    ADDED: ClassVar[tuple[str, ...]] = ()

    def fingerprinted(self) -> dict[str, JsonValue]:
        """Return the settings in the stage's fingerprint and manifest, as plain JSON values."""
        values = self.model_dump(mode="json")
        for dotted in self.ADDED:
            *above, key = dotted.split(".")
            section, model = values, type(self)
            for name in above:
                section, model = section[name], type(getattr(self, name))
            if section is not None and section[key] == model.model_fields[key].default:
                del section[key]
        return values


class IngestSettings(StageSettings):
    """Settings of `ingest`, which reads a recording."""

    ADDED = ("needs_trajectory", "own_pixels", "camera.sensor")

    camera: CameraSettings | None
    # If False, a given trajectory that is broken, or of another time, does not end the stage.
    needs_trajectory: bool = True
    # If True, a given trajectory is that of the object, and says nothing about the rest of the scene.
    own_pixels: bool = False


class TrackSettings(StageSettings):
    """Settings of `track`, which finds the camera's poses."""

    ADDED = ("segment_by",)

    trajectory: TrajectoryMode | None
    segment_by: SegmentBy | None = None
    tracking: TrackingSettings


class SceneFusion(FusionSettings):
    """Settings for the fusion of the scene: all but the voxel size of the object."""

    voxel_size_m: None = Field(None, exclude=True)


class ObjectFusion(FusionSettings):
    """Settings for the fusion of the object: all but the voxel size of the scene."""

    scene_voxel_size_m: None = Field(None, exclude=True)


class FuseSettings(StageSettings):
    """Settings of `fuse`, which fuses depth images into the scene."""

    ADDED = ("segment_by",)

    segment_by: SegmentBy | None = None
    fusion: SceneFusion


class SuggestSettings(StageSettings):
    """Settings of `suggest`, which lists boxes that may hold the object."""

    ADDED = ("segment_by", "floor", "pick")

    segment_by: SegmentBy | None = None
    pick: PickSettings | None = None
    floor: Vector4 | None = None
    segmentation: FloorCuts


class SegmentSettings(StageSettings):
    """Settings of `segment`, which makes the object's solid shape."""

    ADDED = (
        *("segment_by", "floor", "underside", "pick"),
        *("segmentation.line_width_m", "segmentation.near_m"),
        *("segmentation.camera_size_m", "segmentation.camera_height_m"),
    )

    segment_by: SegmentBy | None = None
    box: BoxSettings | None
    pick: PickSettings | None = None
    floor: Vector4 | None = None
    underside: Underside = "unseen"
    segmentation: ObjectCuts
    fusion: ObjectFusion


class SampleSettings(StageSettings):
    """Settings of `sample-views`; its masks also use the heights at which `segment` cuts off the floor."""

    ADDED = ("segment_by", "segmentation.seed", "segmentation.floor_cut_m", "segmentation.low_cut_m")

    segment_by: SegmentBy | None = None
    views: ViewSettings
    segmentation: MaskCuts
    pairs: FitLimits


class PairsSettings(StageSettings):
    """Settings of `pairs`: the form of pairs, and how well a view must fit the object."""

    ADDED = ("pairs.max_residual_m", "pairs.min_visible_share")

    pairs: PairSettings


@dataclass(frozen=True)
class Source:
    """An input of a stage from outside `build/`: the recording, the user's masks, or a reference mesh.

    Attributes:
        path: the file or folder.
        sha256: a hash over the names and contents of its files.
    """

    path: Path
    sha256: str


@dataclass(frozen=True)
class Work(Generic[Needed]):
    """The inputs of one stage; a stage may read nothing else.

    Attributes:
        settings: the settings that the stage depends on.
        stages: folders of the stages that it reads, by the name of the stage.
        sources: inputs from outside `build/` whose hashes are in the stage's fingerprint, by name.
        folder: the empty folder to fill.
        progress: called with (done, total).
    """

    settings: Needed
    stages: Mapping[str, Path]
    sources: Mapping[str, Source]
    folder: Path
    progress: Progress

    @property
    def masks(self) -> Path | None:
        """The folder of the user's masks; None if the stage does not depend on any."""
        return self.sources[MASKS].path if MASKS in self.sources else None
