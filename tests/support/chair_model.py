"""One small simulated chair with its object model, made once per process."""

import functools
from dataclasses import dataclass

from analytic_scenes import Furniture, furniture, small_spec

from kinectbench.settings.models import FusionSettings, SegmentationSettings, TrackingSettings
from kinectbench.stages.fuse import fuse
from kinectbench.stages.segment.find.given import GivenObject
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.segment import segment
from kinectbench.stages.track import Trajectory, track

FUSION = FusionSettings(voxel_size_m=0.008, scene_voxel_size_m=0.016, max_depth_m=2.4)


@dataclass(frozen=True)
class Chair:
    """A recording, its truth, its trajectory and its object."""

    recorded: Furniture
    trajectory: Trajectory
    model: ObjectModel


@functools.cache
def chair() -> Chair:
    recorded = furniture(small_spec("chair:seed=9", 24, world="random"))
    trajectory = track(recorded.sequence, "trust", TrackingSettings())
    scene = fuse(recorded.sequence, trajectory, FUSION).mesh
    model = segment(
        recorded.sequence,
        trajectory,
        scene,
        SegmentationSettings(),
        FUSION,
        GivenObject(underside="closed"),
    )
    return Chair(recorded, trajectory, model)
