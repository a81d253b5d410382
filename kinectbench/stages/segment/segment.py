"""The stage `segment`: find the object in the fused scene, fuse it finely, and make it a closed solid."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kinectbench.core import ShapeError
from kinectbench.core.geometry import Camera, Grid, TriangleMesh
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Bools, Progress, Underside, no_progress
from kinectbench.core.voxels.observation import Observation, merge
from kinectbench.settings.models import FusionSettings, ObjectCuts
from kinectbench.stages.fuse import observe
from kinectbench.stages.fuse.depth_range import grid_range_m, some_frames
from kinectbench.stages.segment.find.floor import Floor, explained, other_floor
from kinectbench.stages.segment.find.given import NOTHING_GIVEN, GivenObject, check_picked
from kinectbench.stages.segment.find.hints import enlarged_transform, floor_hint
from kinectbench.stages.segment.find.moving import segment_masked_scene
from kinectbench.stages.segment.find.object import Segmentation, find_floor_and_object
from kinectbench.stages.segment.judge.coverage_report import coverage_report
from kinectbench.stages.segment.judge.estimate import FloorCut, pose_error_of, taken_by_floor_cut
from kinectbench.stages.segment.judge.frontiers import Frontier, find_frontiers, is_obstructed
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
from kinectbench.stages.segment.solid.solid import SolidBody, Solids, SolidShape, make_solid, solidify

# Solids are made from the odd, from the even, and from all frames.
SOLIDS = 3


@dataclass(frozen=True)
class _Found:
    """The object that was found, and the grid around it.

    Attributes:
        chosen: its floor, box and cells.
        grid: the fine grid around it.
        scale: the solid is made in a world that is 1 / scale times as large (`ObjectResolution`).
        neighbours: bool in the grid's shape, voxels near the surface of other things.
        beyond_box: bool in the grid's shape, voxels outside the given box; None if no box is given.
        max_depth_m: depth up to this is fused into the grid, metres.
    """

    chosen: Segmentation
    grid: Grid
    scale: float
    neighbours: Bools
    beyond_box: Bools | None
    max_depth_m: float


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
    rules = _rules(found, sequence.camera, trajectory, segmentation, given.underside)
    # Fuse the frames into the grid around the object, and label its voxels.
    range_is_set = fusion.max_depth_m is not None
    fusion, good = fusion.model_copy(update={"max_depth_m": found.max_depth_m}), trajectory.good_frames
    odd, even = (
        observe(sequence, trajectory, half, found.grid, fusion, progress) for half in (good[0::2], good[1::2])
    )
    bodies: list[SolidBody] = []
    for body in ahead(partial(_solid_of_half, found=found, rules=rules), (odd, even)):
        bodies.append(body)
        progress(len(bodies), SOLIDS)
    sigma_m = surface_sigma_m(odd, even)
    together = enlarged_observation(merge(odd, even), found.scale)
    del odd, even  # of a large object each is a gigabyte
    whole, frontiers, floor_cut = _solid_of_all(together, found, rules)
    progress(SOLIDS, SOLIDS)
    del together
    solids = Solids(whole, bodies[0], bodies[1], sigma_m, len(good))
    # Label the space around it, coarsely.
    chosen, around = found.chosen, surround_grid(found.grid, found.chosen.floor)
    surround = observe(sequence, trajectory, some_frames(good), around, fusion)
    labels_around = surround_labels(surround, _support(chosen))
    # Judge the solid.
    seen = (sequence, trajectory, scene, chosen, found.grid, found.max_depth_m, rules.limits)
    report = coverage_report(*seen, range_is_set=range_is_set)
    box, pose_error = solid_box(whole, chosen.floor), pose_error_of(trajectory)
    quality = measure_quality(chosen, box, solids, report, pose_error, frontiers, rules, floor_cut)
    return ObjectModel(chosen.floor, box, whole, around, labels_around, sigma_m, quality)


def _find(
    sequence: Sequence,
    trajectory: Trajectory,
    scene: TriangleMesh,
    segmentation: ObjectCuts,
    fusion: FusionSettings,
    given: GivenObject,
) -> _Found:
    """Find the floor and the object on it; choose the grid around it, and the range of depth."""
    picked = given.picked
    hint = floor_hint(sequence, trajectory, given.plane_world, picked and picked.point_world)
    if sequence.beside_m is None:
        chosen = find_floor_and_object(scene, trajectory, given.box, segmentation, hint)
    else:  # only the object's own depth was fused
        chosen = segment_masked_scene(scene, trajectory, given.box, hint)
    if picked is not None and chosen.how == "automatic":
        check_picked(picked, chosen.beside_m(picked.point_world), chosen.cell_m)
    resolution = choose_resolution(chosen.box, chosen.floor, sequence.camera, trajectory, fusion)
    with explained(lambda: chosen.floor.against):
        grid = object_grid(chosen.box, chosen.floor, resolution.voxel_size_m, given=given.box is not None)
    max_depth_m = grid_range_m(trajectory.T_world_camera[trajectory.good_frames], grid, fusion)
    if chosen.how != "masks":  # warn where single frames show another floor than the fused scene
        lines = other_floor(chosen.floor, sequence, trajectory, hint, max_depth_m)
        chosen = replace(chosen, warnings=(*lines, *chosen.warnings))
    neighbours, beyond_box = chosen.neighbours(grid), chosen.beyond_box(grid)
    return _Found(chosen, grid, resolution.scale, neighbours, beyond_box, max_depth_m)


def _support(chosen: Segmentation) -> Floor | None:
    """Return the plane that the object stands on; None if it hangs, or is held."""
    return None if chosen.hangs else chosen.floor


def _rules(
    found: _Found, camera: Camera, trajectory: Trajectory, segmentation: ObjectCuts, underside: Underside
) -> Rules:
    """Return the rules by which the voxels of the found object's grid are labelled."""
    support = _support(found.chosen)
    layers = floor_layers(support, segmentation, found.grid.voxel_size_m)
    ray_width_m = grid_ray_width_m(camera, trajectory, found.grid)
    return Rules(layers, ray_width_m, segmentation.limits(), underside, stands=support is not None)


def _solid_of_half(half: Observation, found: _Found, rules: Rules) -> SolidBody:
    """Return the solid from the odd or the even frames alone, for comparison."""
    seen, larger = enlarged_observation(half, found.scale), rules.enlarged(found.scale)
    try:
        shape = solidify(seen, found.neighbours, larger, found.beyond_box)
    except ShapeError as error:
        raise ShapeError(f"odd or even frames alone: {error}", what=error.what) from error
    return shape.restored(found.grid, found.scale)


def _solid_of_all(
    together: Observation, found: _Found, rules: Rules
) -> tuple[SolidShape, tuple[Frontier, ...], FloorCut]:
    """Make the solid from all frames; find the openings that no frame saw into, and what the floor cut took.

    The solid is made in an enlarged world (see `_Found.scale`) and scaled back.
    """
    scale, floor, larger = found.scale, found.chosen.floor, rules.enlarged(found.scale)
    evidence = classify_voxels(together, found.neighbours, larger, found.beyond_box)
    whole = make_solid(together, evidence, larger)
    T_floor_grid = enlarged_transform(floor.T_floor_world @ found.grid.T_world_grid, scale)
    frontiers = []
    for each in find_frontiers(whole, evidence, larger.limits, T_floor_grid):
        opening = each.restored(scale)
        center_m, look_from = np.array(opening.center_m), np.array(opening.look_from)
        obstructed = is_obstructed(found.chosen, center_m, look_from, rules.limits)
        frontiers.append(replace(opening, obstructed=obstructed))
    others = found.neighbours if found.beyond_box is None else found.neighbours | found.beyond_box
    voxel_m = found.grid.voxel_size_m
    cut = taken_by_floor_cut(evidence, whole.solid, others, rules.layers, voxel_m, floor)
    return whole.restored(found.grid, scale), tuple(frontiers), cut
