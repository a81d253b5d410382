"""One function per stage: it reads the inputs, calls the code of the stage, and writes the result.

Import this module late, because it loads numba.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core import SegmentationError, TrackingError
from kinectbench.core.geometry import TriangleMesh, read_own_ply
from kinectbench.core.own_pixels import by_own_pixels
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.trajectory.trajectory import Trajectory, read_trajectory, write_trajectory
from kinectbench.core.types import Float64, Progress
from kinectbench.core.upright import upright
from kinectbench.doctor.during_build import OffsetWatch, refuse_hopeless
from kinectbench.doctor.still import turntable_warning
from kinectbench.engine.frame_masks import frame_masks, plane_given
from kinectbench.engine.stage_settings import (
    REFERENCE,
    FuseSettings,
    IngestSettings,
    PairsSettings,
    SampleSettings,
    SegmentSettings,
    SuggestSettings,
    TrackSettings,
    Work,
)
from kinectbench.engine.stages import SUGGEST
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.fuse import fuse
from kinectbench.stages.fuse.reconstruction import write_reconstruction
from kinectbench.stages.ingest.partial_sequence import partial_sequence
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.pairs import full_shape, write_pairs
from kinectbench.stages.reference.truth import reference_as_truth
from kinectbench.stages.sample_views.views import read_masks, read_views, sample_views, write_views
from kinectbench.stages.segment.find.candidates import find_candidates, write_candidates
from kinectbench.stages.segment.find.given import GivenObject, PickedPoint, picked_point, reanchored
from kinectbench.stages.segment.find.hints import floor_hint
from kinectbench.stages.segment.object_model import read_object, write_object
from kinectbench.stages.segment.segment import segment
from kinectbench.stages.track import track
from kinectbench.stages.track.own_pixels import track_own_pixels
from kinectbench.stages.track.pictures import COMPARISON, write_pictures

NOTHING_TO_CHOOSE = (
    "with `segment_by` there is nothing to choose from: all that is fused is the object; correct the masks, "
    "or leave `segment_by` out"
)


# Stage -> a file of `build/<recording>/` that describes its earlier result, and is removed with it.
OVERTAKEN: Mapping[str, str] = {"track": COMPARISON}
# If given positions vary by less, metres, the camera counts as standing on a tripod.
STRAY_M = 0.02
ONE_VIEW = "the camera did not move, and all frames show one view of the object: walk around it"


def read_tracked(build: Path) -> tuple[Sequence, Trajectory]:
    """Read the sequence, as corrected by tracking, and the trajectory from `build/<recording>/`.

    Depth is calibrated, and a detected rolling shutter is undone.
    """
    return _tracked({"ingest": build / "sequence", "track": build / "trajectory"})


def _tracked(stages: Mapping[str, Path]) -> tuple[Sequence, Trajectory]:
    sequence = read_sequence(stages["ingest"])
    trajectory = read_trajectory(stages["track"], sequence.stamps_ns)
    calibrated = sequence.calibrated(trajectory.depth_calibration)
    return upright(calibrated, trajectory.shutter), trajectory


def _read_masked(work: Work[FuseSettings] | Work[SegmentSettings]) -> tuple[Sequence, Trajectory]:
    """Read the sequence and the trajectory; if masks define the object, keep only the depth inside them."""
    sequence, trajectory = _tracked(work.stages)
    masks = frame_masks(sequence, work.settings.segment_by, work.masks)
    return (sequence if masks is None else by_own_pixels(sequence, masks)), trajectory


def _scene(stages: Mapping[str, Path]) -> TriangleMesh:
    return read_own_ply(stages["fuse"] / "mesh.ply")


def _ingest(work: Work[IngestSettings]) -> None:
    # Links that must not be followed were refused when the recording's files were hashed.
    recording = open_recording(work.sources["recording"].path, work.settings.camera, follow_links=True)
    refuse_hopeless(recording)
    needed = work.settings.needs_trajectory
    watches = needed and not work.settings.own_pixels
    watched = recording if watches else replace(recording, given_trajectory=None)
    camera = work.settings.camera
    stated = camera is not None and None not in (camera.fx, camera.fy, camera.cx, camera.cy)
    watch = OffsetWatch(watched, intrinsics_stated=stated)
    partial, where = partial_sequence(), (work.folder, work.progress)
    write_sequence(recording, *where, needs_trajectory=needed, watch=watch, partial=partial)


def _track(work: Work[TrackSettings]) -> None:
    sequence, settings = read_sequence(work.stages["ingest"]), work.settings
    masks = frame_masks(sequence, settings.segment_by, work.masks)
    how = settings.trajectory, settings.tracking
    if masks is None:
        trajectory = _track_scene(sequence, *how, work.progress)
    else:
        trajectory = track_own_pixels(sequence, masks, *how, work.progress)
    write_trajectory(trajectory, work.folder)
    write_pictures(work.folder, trajectory)


def _fuse(work: Work[FuseSettings]) -> None:
    reconstruction = fuse(*_read_masked(work), work.settings.fusion, work.progress)
    write_reconstruction(reconstruction, work.folder)


def _suggest(work: Work[SuggestSettings]) -> None:
    settings = work.settings
    if settings.segment_by is not None:
        raise SegmentationError(NOTHING_TO_CHOOSE, what="no-candidates")
    sequence, trajectory = _tracked(work.stages)
    picked = _picked(sequence, trajectory, settings)
    hint = floor_hint(sequence, trajectory, settings.floor, picked and picked.point_world)
    candidates = find_candidates(_scene(work.stages), trajectory, settings.segmentation, hint)
    write_candidates(candidates, sequence, trajectory, work.folder)


def _picked(
    sequence: Sequence, trajectory: Trajectory, settings: SuggestSettings | SegmentSettings
) -> PickedPoint | None:
    """Return the picked point on the object; None if none is given, or if `segment_by` defines the object."""
    if settings.pick is None or settings.segment_by is not None:
        return None
    return picked_point(sequence, trajectory, settings.pick.frame, settings.pick.pixel)


def _segment(work: Work[SegmentSettings]) -> None:
    settings, (sequence, trajectory) = work.settings, _read_masked(work)
    given = GivenObject(
        box=reanchored(settings.box.box(), sequence) if settings.box else None,
        plane_world=plane_given(sequence, trajectory, settings.segment_by, settings.floor),
        underside=settings.underside,
        picked=_picked(sequence, trajectory, settings),
    )
    scene, cuts, fusion = _scene(work.stages), settings.segmentation, settings.fusion
    model = segment(sequence, trajectory, scene, cuts, fusion, given, work.progress)
    if REFERENCE in work.sources:
        model = reference_as_truth(model, work.sources[REFERENCE].path)
    write_object(model, work.folder)


def _sample_views(work: Work[SampleSettings]) -> None:
    settings, (sequence, trajectory) = work.settings, _tracked(work.stages)
    model = read_object(work.stages["segment"])
    of_frames = frame_masks(sequence, settings.segment_by, work.masks)
    of_views = None if settings.segment_by == "masks" else work.masks
    masks = None if of_views is None else read_masks(of_views)
    sequence = replace(sequence, masks=of_frames) if of_frames else sequence
    wanted = settings.views, settings.segmentation, settings.pairs
    views = sample_views(sequence, trajectory, model, *wanted, masks, work.progress)
    write_views(views, sequence, work.folder)


def _pairs(work: Work[PairsSettings]) -> None:
    sequence, _ = _tracked(work.stages)
    shape = full_shape(read_object(work.stages["segment"]))
    views = read_views(work.stages["sample-views"])
    write_pairs(views, sequence, shape, work.settings.pairs, work.folder, work.progress)


# Stage -> its step, which takes the settings of that stage.
STEPS: Mapping[str, Callable[[Work[Any]], None]] = {
    "ingest": _ingest,
    "track": _track,
    "fuse": _fuse,
    "segment": _segment,
    "sample-views": _sample_views,
    "pairs": _pairs,
    SUGGEST.name: _suggest,
}


def _track_scene(
    sequence: Sequence,
    mode: TrajectoryMode | None,
    settings: TrackingSettings,
    progress: Progress | None = None,
) -> Trajectory:
    """Track a scene; warn in health.json if the camera stands still, unless given poses show motion."""
    given = None if mode == "ignore" else sequence.given_trajectory
    line = "" if given is not None and _moves(given.T_world_camera) else turntable_warning(sequence)
    try:
        trajectory = track(sequence, mode, settings, progress)
    except TrackingError as error:
        raise TrackingError(f"{error}; {line}" if line else str(error), what=error.what) from error
    if not line and not _moves(trajectory.T_world_camera):
        line = ONE_VIEW
    if not line or trajectory.health is None:
        return trajectory
    warnings = (line, *trajectory.health.warnings)
    return replace(trajectory, health=trajectory.health.model_copy(update={"warnings": warnings}))


def _moves(T_world_camera: Float64) -> bool:
    """Whether the positions of poses (n, 4, 4), NaN where lost, vary by more than on a tripod: 2 cm."""
    at = T_world_camera[has_pose(T_world_camera), :3, 3]
    return bool(len(at) and np.ptp(at, axis=0).max() > STRAY_M)
