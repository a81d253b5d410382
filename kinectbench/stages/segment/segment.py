"""The stage `segment`: find the object in the fused scene, fuse it finely, and make it a closed solid."""

from dataclasses import dataclass, replace

import numpy as np

from kinectbench.core.errors import ShapeError
from kinectbench.core.geometry import Grid, OrientedBox, TriangleMesh
from kinectbench.core.sensor_limits import DEFAULT_LIMITS, SensorLimits
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Progress, Underside
from kinectbench.core.voxels.observation import Observation, merge
from kinectbench.settings.models import FloorCuts, FusionSettings, Vector4
from kinectbench.stages.fuse import observe
from kinectbench.stages.fuse.depth_range import grid_range_m, some_frames
from kinectbench.stages.segment.find.distance_scale import enlarged_transform
from kinectbench.stages.segment.find.gravity import FloorHint, floor_hint
from kinectbench.stages.segment.find.masked_scene import segment_masked_scene
from kinectbench.stages.segment.find.object import Segmentation, find_floor_and_object
from kinectbench.stages.segment.find.picked import PickedPoint, check_picked
from kinectbench.stages.segment.find.seen_floor import other_floor
from kinectbench.stages.segment.judge.coverage_report import coverage_report
from kinectbench.stages.segment.judge.estimate import pose_error_of
from kinectbench.stages.segment.judge.frontiers import Frontier, find_frontiers
from kinectbench.stages.segment.judge.obstacles import is_obstructed
from kinectbench.stages.segment.judge.quality import measure_quality, solid_box, surface_sigma_m
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.solid.evidence import Rules, classify_voxels
from kinectbench.stages.segment.solid.grids import (
    choose_resolution,
    enlarged_observation,
    floor_layers,
    grid_ray_width_m,
    object_grid,
    surround_grid,
    surround_labels,
)
from kinectbench.stages.segment.solid.solid import Solids, make_solid, solidify


def segment(
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
    picked: PickedPoint | None = None,
) -> ObjectModel:
    """Find the object in the fused scene, make it a solid, and judge the solid.

    Args:
        sequence: the recording.
        trajectory: its poses.
        scene: the fused scene's surface, world frame.
        given_box: a person's box (floor frame), or None to choose the object automatically.
        segmentation: floor and object settings.
        fusion: voxel size and range of depth, where a person gives them.
        progress: called with (done, total).
        floor: a person's plane (a, b, c, d) in the world of the trajectory, metres, or None.
        underside: a person's statement on the underside.
        limits: of the sensor.
        picked: a point on the object that a person picked; None: the cameras look at it.

    Raises:
        SegmentationError: no floor, no object, a box with nothing in it, or a point beside the object.
        ShapeError: no solid can be made.
    """
    # Find the object, and choose the grid around it.
    hint = floor_hint(sequence, trajectory, floor, picked and picked.point_world)
    if sequence.beside_m is None:
        chosen = find_floor_and_object(scene, trajectory, given_box, segmentation, hint)
    else:  # only the object's own depth was fused
        chosen = segment_masked_scene(scene, trajectory, given_box, hint)
    if picked is not None and chosen.how == "automatic":
        check_picked(picked, chosen)
    resolution = choose_resolution(chosen.box, chosen.floor, sequence.camera, trajectory, fusion)
    with chosen.floor.explained_in_errors():
        grid = object_grid(chosen.box, chosen.floor, resolution.voxel_size_m, given=given_box is not None)
    max_depth_m = grid_range_m(trajectory.T_world_camera[trajectory.good_frames], grid, fusion)
    fusion = fusion.model_copy(update={"max_depth_m": max_depth_m})
    chosen = _with_warnings_of_frames(chosen, sequence, trajectory, hint, max_depth_m)
    # Fuse the frames into that grid, and label the solid.
    support = None if chosen.hangs else chosen.floor
    layers = floor_layers(support, segmentation, grid.voxel_size_m)
    ray_width_m = grid_ray_width_m(sequence.camera, trajectory, grid)
    rules = Rules(layers, ray_width_m, limits, underside, stands=support is not None)
    frames = _Frames(sequence, trajectory, fusion, progress)
    solids, frontiers = _make_solids(frames, grid, chosen, rules, resolution.scale)
    surround = frames.fused_around(grid, chosen)
    # Judge the solid.
    report = coverage_report(sequence, trajectory, scene, chosen, grid, max_depth_m, limits)
    box, pose_error = solid_box(solids.whole, chosen.floor), pose_error_of(trajectory)
    quality = measure_quality(chosen, box, solids, report, pose_error, frontiers, rules)
    around = surround.grid, surround_labels(surround, support)
    return ObjectModel(chosen.floor, box, solids.whole, *around, solids.surface_sigma_m, quality)


def _with_warnings_of_frames(
    chosen: Segmentation, sequence: Sequence, trajectory: Trajectory, hint: FloorHint, max_depth_m: float
) -> Segmentation:
    """Add a warning if single frames show another floor than the fused scene."""
    if chosen.how == "masks":
        return chosen
    lines = other_floor(chosen.floor, sequence, trajectory, hint, max_depth_m)
    return replace(chosen, warnings=(*lines, *chosen.warnings))


@dataclass(frozen=True)
class _Frames:
    """The good frames, and how they are fused."""

    sequence: Sequence
    trajectory: Trajectory
    fusion: FusionSettings
    progress: Progress | None

    def fused_half(self, first: int, grid: Grid) -> Observation:
        """Fuse every second frame, from the first (0) or the second one (1) on."""
        frames = self.trajectory.good_frames[first::2]
        return observe(self.sequence, self.trajectory, frames, grid, self.fusion, self.progress)

    def fused_around(self, grid: Grid, chosen: Segmentation) -> Observation:
        """Fuse some frames into the coarse grid around the object's."""
        frames = some_frames(self.trajectory.good_frames)
        around = surround_grid(grid, chosen.floor)
        return observe(self.sequence, self.trajectory, frames, around, self.fusion)


def _make_solids(
    frames: _Frames, grid: Grid, chosen: Segmentation, rules: Rules, scale: float
) -> tuple[Solids, tuple[Frontier, ...]]:
    """Make solids of all, of the odd and of the even frames; find the openings that no frame saw into.

    The odd and the even frames are fused apart and then merged: the repeatability of the shape costs no
    further pass over the frames. The rules see the object in a world that is 1 / scale times as large.
    """
    neighbours, beyond_box, larger = chosen.neighbours(grid), chosen.beyond_box(grid), rules.enlarged(scale)
    odd, even = frames.fused_half(0, grid), frames.fused_half(1, grid)
    try:
        of_odd, of_even = (
            solidify(enlarged_observation(half, scale), neighbours, larger, beyond_box)
            for half in (odd, even)
        )
    except ShapeError as error:
        raise ShapeError(f"odd or even frames alone: {error}", what=error.what) from error
    sigma_m = surface_sigma_m(odd, even)
    together = enlarged_observation(merge(odd, even), scale)
    del odd, even  # of a large object each is a gigabyte
    evidence = classify_voxels(together, neighbours, larger, beyond_box)
    whole = make_solid(together, evidence, larger)
    T_floor_grid = enlarged_transform(chosen.floor.T_floor_world @ grid.T_world_grid, scale)
    frontiers = find_frontiers(whole, evidence, larger.limits, T_floor_grid)
    whole, of_odd, of_even = (shape.restored(grid, scale) for shape in (whole, of_odd, of_even))
    restored = (frontier.restored(scale) for frontier in frontiers)
    return Solids(whole, of_odd, of_even, sigma_m), tuple(
        replace(
            each,
            obstructed=is_obstructed(chosen, np.array(each.center_m), np.array(each.look_from), rules.limits),
        )
        for each in restored
    )
