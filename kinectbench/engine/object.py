"""The stage `segment` as a whole: an object is chosen in the scene, observed by its frames and made solid."""

from kinectbench.core.errors import ShapeError
from kinectbench.core.geometry import OrientedBox, TriangleMesh
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Progress
from kinectbench.core.voxels.observation import merge
from kinectbench.settings.models import FusionSettings, SegmentationSettings
from kinectbench.stages.fuse import observe
from kinectbench.stages.fuse.depth_range import grid_range_m
from kinectbench.stages.segment.choose import segment
from kinectbench.stages.segment.evidence import weigh
from kinectbench.stages.segment.frontiers import find_frontiers
from kinectbench.stages.segment.grids import (
    floor_layers,
    object_grid,
    surround_frames,
    surround_grid,
    usual_ray_width_m,
)
from kinectbench.stages.segment.object_model import ObjectModel, object_model, usual_pose_error
from kinectbench.stages.segment.quality import surface_sigma_m
from kinectbench.stages.segment.solid import make_solid, solidify
from kinectbench.stages.segment.witness import witness


def build_object(
    sequence: Sequence,
    trajectory: Trajectory,
    scene: TriangleMesh,
    given_box: OrientedBox | None,
    segmentation: SegmentationSettings,
    fusion: FusionSettings,
    progress: Progress | None = None,
) -> ObjectModel:
    """Find the object in the fused scene and make it solid.

    The odd and the even frames are fused apart and then together, so that the shape's repeatability
    costs no further pass over the frames.

    Args:
        sequence: the recording.
        trajectory: its poses.
        scene: the fused scene's surface, world frame.
        given_box: a person's box (floor frame), or None to choose the object automatically.
        segmentation: floor and object settings.
        fusion: voxel size, and the range of depth that a person gives, if any.
        progress: called with (done, total).

    Raises:
        SegmentationError: no floor, no object, or a box with nothing in it.
        ShapeError: no solid can be made.
    """
    chosen = segment(scene, trajectory, given_box, segmentation)
    frames, voxel_size_m = trajectory.good_frames, fusion.voxel_size_m
    grid = object_grid(chosen.box, chosen.floor, voxel_size_m, given=given_box is not None)
    max_depth_m = grid_range_m(trajectory.T_world_camera[frames], grid, fusion)
    fusion = fusion.model_copy(update={"max_depth_m": max_depth_m})
    odd, even = (observe(sequence, trajectory, frames[k::2], grid, fusion, progress) for k in (0, 1))
    layers = floor_layers(chosen.floor, segmentation, voxel_size_m)
    rules = chosen.excluded(grid), layers, usual_ray_width_m(sequence.camera, trajectory, grid)
    try:
        halves = solidify(odd, *rules), solidify(even, *rules)
    except ShapeError as error:
        raise ShapeError(f"odd or even frames alone: {error}") from error
    sigma_m = surface_sigma_m(odd, even)
    together = merge(odd, even)
    # Of a large object each of them is a gigabyte.
    del odd, even
    evidence = weigh(together, *rules)
    whole = make_solid(together, evidence, layers)
    del together
    T_floor_grid = chosen.floor.T_floor_world @ grid.T_world_grid
    frontiers = find_frontiers(whole, evidence, T_floor_grid)
    del evidence
    around = surround_grid(grid, chosen.floor)
    surround = observe(sequence, trajectory, surround_frames(frames), around, fusion)
    seen = witness(sequence, trajectory, scene, chosen, grid, max_depth_m)
    pose_error = usual_pose_error(trajectory)
    return object_model(chosen, (whole, *halves), sigma_m, seen, surround, pose_error, frontiers)
