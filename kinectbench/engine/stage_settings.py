"""What of the settings each stage depends on: one value per stage, and its step is given nothing else.

The value's JSON is the settings in the stage's fingerprint, so that a step cannot read a setting that is not
in it. `stages` makes them of a job.
"""

from typing import Any, ClassVar, TypeVar

from pydantic import Field

from kinectbench.core.types import Underside
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

Section = TypeVar("Section", bound=Settings)


def part_of(wanted: type[Section], section: Settings) -> Section:
    """The part of a section that a stage depends on; what is beyond it cannot be reached through the part."""
    kept = (name for name, field in wanted.model_fields.items() if not field.exclude)
    return wanted.model_validate({name: getattr(section, name) for name in kept})


class StageSettings(Settings):
    """Base of what a stage depends on.

    Attributes:
        ADDED: keys, with dots where nested, that came when artefacts of the stage's version lay on disks
            already. At their defaults they are left out of the fingerprint, which so stays what it was.
    """

    ADDED: ClassVar[tuple[str, ...]] = ()

    def fingerprinted(self) -> dict[str, Any]:
        """The settings in the stage's fingerprint and manifest, as plain JSON values."""
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
    """Of `ingest`."""

    ADDED = ("needs_trajectory", "own_pixels", "camera.sensor")

    camera: CameraSettings | None
    # Without it a given trajectory that is broken, or of another time, ends the stage.
    needs_trajectory: bool = True
    # A given trajectory is that of the object, and says nothing of all else that is in view.
    own_pixels: bool = False


class TrackSettings(StageSettings):
    """Of `track`."""

    ADDED = ("segment_by",)

    trajectory: TrajectoryMode | None
    segment_by: SegmentBy | None = None
    tracking: TrackingSettings


class SceneFusion(FusionSettings):
    """What fuses the scene: the object's voxels are no affair of it."""

    voxel_size_m: None = Field(None, exclude=True)


class ObjectFusion(FusionSettings):
    """What fuses the object: the scene's voxels are no affair of it."""

    scene_voxel_size_m: None = Field(None, exclude=True)


class FuseSettings(StageSettings):
    """Of `fuse`."""

    ADDED = ("segment_by",)

    segment_by: SegmentBy | None = None
    fusion: SceneFusion


class SuggestSettings(StageSettings):
    """Of `suggest`."""

    ADDED = ("segment_by", "floor")

    segment_by: SegmentBy | None = None
    floor: Vector4 | None = None
    segmentation: FloorCuts


class SegmentSettings(StageSettings):
    """Of `segment`."""

    ADDED = (
        *("segment_by", "floor", "underside"),
        *("segmentation.line_width_m", "segmentation.near_m"),
        *("segmentation.camera_size_m", "segmentation.camera_height_m"),
    )

    segment_by: SegmentBy | None = None
    box: BoxSettings | None
    floor: Vector4 | None = None
    underside: Underside = "unseen"
    segmentation: ObjectCuts
    fusion: ObjectFusion


class SampleSettings(StageSettings):
    """Of `sample-views`; the floor's cuts, which `segment` depends on alike, are those of masks, too."""

    ADDED = ("segment_by", "segmentation.seed", "segmentation.floor_cut_m", "segmentation.low_cut_m")

    segment_by: SegmentBy | None = None
    views: ViewSettings
    segmentation: MaskCuts
    pairs: FitLimits


class PairsSettings(StageSettings):
    """Of `pairs`; limits that only views have to keep are among those that `sample-views` depends on."""

    ADDED = ("pairs.max_residual_m", "pairs.min_visible_share")

    pairs: PairSettings
