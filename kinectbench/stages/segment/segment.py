"""The stage `segment`: find the object in the fused scene, fuse it finely, and make it a closed solid."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kinectbench.core import ShapeError
from kinectbench.core.geometry import Grid, TriangleMesh
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead, both
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Progress, no_progress
from kinectbench.core.voxels.observation import Observation, merge, ray_width_m
from kinectbench.settings.models import FusionSettings, ObjectCuts
from kinectbench.stages.fuse import observe
from kinectbench.stages.fuse.depth_range import grid_range_m, some_frames
from kinectbench.stages.segment.find.floor import explained, other_floor
from kinectbench.stages.segment.find.given import NOTHING_GIVEN, GivenObject, check_picked
from kinectbench.stages.segment.find.hints import floor_hint
from kinectbench.stages.segment.find.moving import segment_masked_scene
from kinectbench.stages.segment.find.object import Segmentation, find_floor_and_object
from kinectbench.stages.segment.find.scale import enlarged_transform
from kinectbench.stages.segment.judge.coverage_report import coverage_report
from kinectbench.stages.segment.judge.estimate import FloorCut, pose_error_of, taken_by_floor_cut
from kinectbench.stages.segment.judge.frontiers import Frontier, find_frontiers, is_obstructed
from kinectbench.stages.segment.judge.quality import measure_quality, solid_box, surface_sigma_m
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.solid.evidence import Rules, classify_voxels
from kinectbench.stages.segment.solid.grids import (
    blurred_height_m,
    choose_resolution,
    enlarged_observation,
    floor_layers,
    median_distance_m,
    middle_world,
    object_grid,
    surround_grid,
    surround_labels,
)
from kinectbench.stages.segment.solid.solid import SolidBody, Solids, SolidShape, make_solid, solidify

# Solids are made from the odd, from the even, and from all frames.
SOLIDS = 3


@dataclass(frozen=True)
class _Found:
    """The object that was found, the grid around it, and the rules by which it is made solid there.

    Attributes:
        chosen: its floor, box and cells.
        grid: the fine grid around it.
        neighbours: bool in the grid's shape, voxels near the surface of other things.
        beyond_box: bool in the grid's shape, voxels outside the given box; None if no box is given.
        max_depth_m: depth up to this is fused into the grid, metres.
        scale: the solid is made in a world that is 1 / scale times as large (`choose_resolution`).
        rules: in the world as it is.
    """

    chosen: Segmentation
    grid: Grid
    neighbours: Bools
    beyond_box: Bools | None
    max_depth_m: float
    scale: float
    rules: Rules


def segment(
    sequence: Sequence,
    trajectory: Trajectory,
    scene: TriangleMesh,
    segmentation: ObjectCuts,
    fusion: FusionSettings,
    given: GivenObject = NOTHING_GIVEN,
    progress: Progress = no_progress,
) -> ObjectModel:
    """Find the object in the fused scene, make it a solid, and judge the solid.

    The odd and the even frames are fused separately and then merged, so that measuring the repeatability of
    the shape needs no further pass over the frames.

    Args:
        sequence: the recording.
        trajectory: its poses.
        scene: the fused scene's surface, world frame, metres.
        segmentation: bounds of the floor and of air.
        fusion: voxel size and range of depth, if the user gives them.
        given: what the user states about the object.
        progress: called with (done, total) of each half of the frames, then of the solids.

    Raises:
        SegmentationError: no floor, no object, a box that is empty or of another floor frame, a plane above
            the cameras, a picked point beside the object, or an object too large for its voxels.
        ShapeError: no solid can be made.
    """
    found = _find(sequence, trajectory, scene, segmentation, fusion, given)
    chosen, grid, good = found.chosen, found.grid, trajectory.good_frames
    # Fuse both halves of the frames into the grid around the object; make a solid of each, and of all.
    within = fusion.model_copy(update={"max_depth_m": found.max_depth_m})
    odd, even = (
        observe(sequence, trajectory, half, grid, within, progress) for half in (good[0::2], good[1::2])
    )
    bodies: list[SolidBody] = []
    for body in ahead(partial(_solid_of_half, found=found), (odd, even)):
        bodies.append(body)
        progress(len(bodies), SOLIDS)
    sigma_m = surface_sigma_m(odd, even)
    together = enlarged_observation(merge(odd, even), found.scale)
    del odd, even  # of a large object each is a gigabyte
    seen, range_is_set = (sequence, trajectory, scene, chosen, grid), fusion.max_depth_m is not None
    judge = partial(coverage_report, *seen, found.max_depth_m, found.rules.limits, range_is_set=range_is_set)
    (whole, frontiers, floor_cut), report = both(partial(_solid_of_all, together, found), judge)
    progress(SOLIDS, SOLIDS)
    del together
    solids = Solids(whole, bodies[0], bodies[1], sigma_m, len(good))
    # Label the space around it, coarsely.
    around = surround_grid(grid, chosen.floor)
    surround = observe(sequence, trajectory, some_frames(good), around, within)
    labels_around = surround_labels(surround, chosen.support)
    box, pose_error = solid_box(whole, chosen.floor), pose_error_of(trajectory)
    quality = measure_quality(chosen, box, solids, report, pose_error, frontiers, found.rules, floor_cut)
    return ObjectModel(chosen.floor, box, whole, around, labels_around, sigma_m, quality)


def _find(
    sequence: Sequence,
    trajectory: Trajectory,
    scene: TriangleMesh,
    segmentation: ObjectCuts,
    fusion: FusionSettings,
    given: GivenObject,
) -> _Found:
    """Find the floor and the object on it; choose the grid around it, the range of depth, and the rules."""
    picked, camera = given.picked, sequence.camera
    hint = floor_hint(sequence, trajectory, given.plane_world, picked and picked.point_world)
    if sequence.beside_m is None:
        chosen = find_floor_and_object(scene, trajectory, given.box, segmentation, hint)
    else:  # only the object's own depth was fused
        chosen = segment_masked_scene(scene, trajectory, given.box, hint)
    if picked is not None and chosen.how == "automatic":
        check_picked(picked, chosen.beside_m(picked.point_world), chosen.cell_m)
    voxel_m, scale = choose_resolution(chosen.box, chosen.floor, camera, trajectory, fusion)
    with explained(lambda: chosen.floor.against):
        grid = object_grid(chosen.box, chosen.floor, voxel_m, given=given.box is not None)
    max_depth_m = grid_range_m(trajectory.T_world_camera[trajectory.good_frames], grid, fusion)
    if chosen.how != "masks":  # warn where single frames show another floor than the fused scene
        lines = other_floor(chosen.floor, sequence, trajectory, hint, max_depth_m)
        chosen = replace(chosen, warnings=(*lines, *chosen.warnings))
    layers = floor_layers(chosen.support, segmentation, voxel_m)
    distance_m, stands = median_distance_m(trajectory, middle_world(grid)), chosen.support is not None
    width_m = ray_width_m(camera, trajectory.median_pose_sigma_m, distance_m)
    blurred_m = blurred_height_m(camera, trajectory, grid)
    rules = Rules(layers, width_m, blurred_m, segmentation.limits(), given.underside, stands=stands)
    return _Found(chosen, grid, chosen.neighbours(grid), chosen.beyond_box(grid), max_depth_m, scale, rules)


def _solid_of_half(half: Observation, found: _Found) -> SolidBody:
    """Return the solid from the odd or the even frames alone, for comparison."""
    seen, larger = enlarged_observation(half, found.scale), found.rules.enlarged(found.scale)
    try:
        shape = solidify(seen, found.neighbours, larger, found.beyond_box)
    except ShapeError as error:
        raise ShapeError(f"odd or even frames alone: {error}", what=error.what) from error
    return shape.restored(found.grid, found.scale)


def _solid_of_all(together: Observation, found: _Found) -> tuple[SolidShape, tuple[Frontier, ...], FloorCut]:
    """Make the solid from all frames; find the openings that no frame saw into, and what the floor cut took.

    The solid is made in an enlarged world (see `_Found.scale`) and scaled back.
    """
    scale, floor, rules = found.scale, found.chosen.floor, found.rules
    larger = rules.enlarged(scale)
    evidence = classify_voxels(together, found.neighbours, larger, found.beyond_box)
    whole = make_solid(together, evidence, larger)
    T_floor_grid = enlarged_transform(floor.T_floor_world @ found.grid.T_world_grid, scale)
    frontiers = []
    for opening in find_frontiers(whole, evidence, larger.limits, T_floor_grid):
        each = opening.restored(scale)
        center_m, look_from = np.array(each.center_m), np.array(each.look_from)
        obstructed = is_obstructed(found.chosen, center_m, look_from, rules.limits)
        frontiers.append(replace(each, obstructed=obstructed))
    others = found.neighbours if found.beyond_box is None else found.neighbours | found.beyond_box
    voxel_m = found.grid.voxel_size_m
    cut = taken_by_floor_cut(evidence, whole.solid, others, rules.layers, voxel_m, floor)
    return whole.restored(found.grid, scale), tuple(frontiers), cut
