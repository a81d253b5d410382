"""The stage `segment` as a whole: an object is chosen in the scene, observed by its frames and made solid."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinectbench.core.errors import ShapeError
from kinectbench.core.geometry import Grid, OrientedBox, TriangleMesh, transform_points
from kinectbench.core.sensor_limits import DEFAULT_LIMITS, SensorLimits
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Float64, Progress, Underside
from kinectbench.core.voxels.observation import Observation, merge
from kinectbench.settings.models import FloorCuts, FusionSettings, Vector4
from kinectbench.stages.fuse import observe
from kinectbench.stages.fuse.depth_range import grid_range_m
from kinectbench.stages.segment.choose import Segmentation, segment
from kinectbench.stages.segment.evidence import Rules, weigh
from kinectbench.stages.segment.frontiers import Frontier, find_frontiers
from kinectbench.stages.segment.grids import (
    floor_layers,
    object_grid,
    surround_frames,
    surround_grid,
    usual_ray_width_m,
)
from kinectbench.stages.segment.near import enlarged_transform
from kinectbench.stages.segment.object_model import ObjectModel, object_model, usual_pose_error
from kinectbench.stages.segment.quality import surface_sigma_m
from kinectbench.stages.segment.resolution import (
    USUAL_VOXEL_M,
    enlarged_observation,
    object_voxel_size_m,
    restored_frontier,
    restored_shape,
)
from kinectbench.stages.segment.seen_floor import other_floor
from kinectbench.stages.segment.solid import SolidShape, make_solid, solidify
from kinectbench.stages.segment.up import FloorHint, floor_hint
from kinectbench.stages.segment.whole import NO_LAYERS, segment_whole
from kinectbench.stages.segment.witness import witness


def build_object(
    sequence: Sequence,
    trajectory: Trajectory,
    scene: TriangleMesh,
    given_box: OrientedBox | None,
    segmentation: FloorCuts,
    fusion: FusionSettings,
    progress: Progress | None = None,
    floor: Vector4 | None = None,
    underside: Underside = "unseen",
    limits: SensorLimits = DEFAULT_LIMITS,
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
        floor: a person's plane (a, b, c, d) in the world of the trajectory, metres, or None.
        underside: what a person says of the object's underside.
        limits: what a camera can see.

    Raises:
        SegmentationError: no floor, no object, or a box with nothing in it.
        ShapeError: no solid can be made.
    """
    hint = floor_hint(sequence, trajectory, floor)
    chosen = _chosen(sequence, trajectory, scene, given_box, segmentation, hint)
    frames = trajectory.good_frames
    voxel_size_m, scale = _resolution(chosen, sequence, trajectory, fusion)
    with chosen.floor.said_in_errors():
        grid = object_grid(chosen.box, chosen.floor, voxel_size_m, given=given_box is not None)
    max_depth_m = grid_range_m(trajectory.T_world_camera[frames], grid, fusion)
    fusion = fusion.model_copy(update={"max_depth_m": max_depth_m})
    T_floor_grid = enlarged_transform(chosen.floor.T_floor_world @ grid.T_world_grid, scale)
    chosen = _floor_doubted(chosen, sequence, trajectory, hint, max_depth_m)
    middle_world = transform_points(grid.T_world_grid, grid.size_m / 2)
    rules = Rules(
        NO_LAYERS if chosen.hangs else floor_layers(chosen.floor, segmentation, voxel_size_m),
        usual_ray_width_m(sequence.camera, trajectory, middle_world),
        *(limits, underside, not chosen.hangs),
    )
    made = _solids(
        lambda half: observe(sequence, trajectory, frames[half::2], grid, fusion, progress),
        chosen.excluded(grid),
        rules.enlarged(scale),
        *(T_floor_grid, scale),
    ).restored(grid, scale)
    around = surround_grid(grid, chosen.floor)
    surround = observe(sequence, trajectory, surround_frames(frames), around, fusion)
    seen = witness(sequence, trajectory, scene, chosen, grid, max_depth_m)
    pose_error = usual_pose_error(trajectory)
    return object_model(chosen, made.shapes, made.sigma_m, seen, surround, pose_error, made.frontiers, rules)


def _chosen(
    sequence: Sequence,
    trajectory: Trajectory,
    scene: TriangleMesh,
    given_box: OrientedBox | None,
    segmentation: FloorCuts,
    hint: FloorHint,
) -> Segmentation:
    """What of the scene is the object: all of it, where only the object's own depth was fused."""
    if sequence.beside_m is not None:
        return segment_whole(scene, trajectory, given_box, hint)
    return segment(scene, trajectory, given_box, segmentation, hint)


def _floor_doubted(
    chosen: Segmentation, sequence: Sequence, trajectory: Trajectory, hint: FloorHint, max_depth_m: float
) -> Segmentation:
    """With what the frames by themselves have to say against the floor."""
    if chosen.how == "masks":
        return chosen
    lines = other_floor(chosen.floor, sequence, trajectory, hint, max_depth_m)
    return replace(chosen, doubts=(*lines, *chosen.doubts))


class _Made(NamedTuple):
    """Solids from all, from odd and from even frames, and their frontiers, enlarged; the surface's sigma."""

    shapes: tuple[SolidShape, SolidShape, SolidShape]
    frontiers: tuple[Frontier, ...]
    sigma_m: float

    def restored(self, grid: Grid, scale: float) -> "_Made":
        """The same in this world, on its grid."""
        whole, odd, even = (restored_shape(shape, grid, scale) for shape in self.shapes)
        frontiers = tuple(restored_frontier(each, scale) for each in self.frontiers)
        return _Made((whole, odd, even), frontiers, self.sigma_m)


def _solids(
    observed: Callable[[int], Observation],
    excluded: Bools,
    rules: Rules,
    T_floor_grid: Float64,
    scale: float,
) -> _Made:
    """The solids of what the odd and the even frames saw, and of both together.

    Args:
        observed: what the odd (0) or the even frames (1) say.
        excluded: bool, voxels that cannot be the object.
        rules: what a solid is made by, in the larger world.
        T_floor_grid: (4, 4), in the larger world.
        scale: this world is 1 / scale times as large.
    """
    odd, even = observed(0), observed(1)
    try:
        of_odd, of_even = (
            solidify(enlarged_observation(half, scale), excluded, rules) for half in (odd, even)
        )
    except ShapeError as error:
        raise ShapeError(f"odd or even frames alone: {error}") from error
    sigma_m = surface_sigma_m(odd, even)
    together = enlarged_observation(merge(odd, even), scale)
    # Of a large object each of them is a gigabyte.
    del odd, even
    evidence = weigh(together, excluded, rules)
    whole = make_solid(together, evidence, rules)
    frontiers = find_frontiers(whole, evidence, rules.limits, T_floor_grid)
    return _Made((whole, of_odd, of_even), frontiers, sigma_m)


def _resolution(
    chosen: Segmentation, sequence: Sequence, trajectory: Trajectory, fusion: FusionSettings
) -> tuple[float, float]:
    """Edge of the object's voxels, metres, and by what the rules see it enlarged: 1 / scale times.

    What a person says of the voxels is taken, and the rules see the object as it is.
    """
    if fusion.voxel_size_m is not None:
        return fusion.voxel_size_m, 1.0
    middle_world = transform_points(chosen.floor.T_world_floor, np.array(chosen.box.center_m))
    width_m = usual_ray_width_m(sequence.camera, trajectory, middle_world)
    voxel_size_m = object_voxel_size_m(chosen.box, width_m)
    return voxel_size_m, voxel_size_m / USUAL_VOXEL_M
