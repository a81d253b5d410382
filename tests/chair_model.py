"""One small simulated chair with its object model, made once per process."""

import functools
from dataclasses import dataclass

from analytic_scenes import Furniture, furniture, small_spec

from kinectbench.config import FusionSettings, SegmentationSettings, TrackingSettings
from kinectbench.fusion import fuse
from kinectbench.shape import ObjectModel, build_object
from kinectbench.tracking import Trajectory, track

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
    model = build_object(recorded.sequence, trajectory, scene, None, SegmentationSettings(), FUSION)
    return Chair(recorded, trajectory, model)
