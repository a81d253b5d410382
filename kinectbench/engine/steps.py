"""What each stage does: it reads what it stands on, calls one function, and writes the result.

Import late: the functions load numba.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.mesh import read_own_ply
from kinectbench.core.own_pixels import by_own_pixels
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory, read_trajectory, write_trajectory
from kinectbench.core.types import Progress
from kinectbench.core.upright import upright
from kinectbench.doctor.during_build import OffsetWatch, refuse_hopeless
from kinectbench.engine.frame_masks import frame_masks, plane_given
from kinectbench.engine.object import build_object
from kinectbench.engine.stages import SUGGEST, Job
from kinectbench.engine.track_scene import track_scene
from kinectbench.stages.fuse import fuse
from kinectbench.stages.fuse.reconstruction import write_reconstruction
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.pairs import full_shape, write_pairs
from kinectbench.stages.sample_views.views import read_masks, read_views, sample_views, write_views
from kinectbench.stages.segment.candidate_pictures import write_candidates
from kinectbench.stages.segment.candidates import find_candidates
from kinectbench.stages.segment.object_model import read_object, write_object
from kinectbench.stages.segment.up import floor_hint
from kinectbench.stages.track.own_pixels import track_own_pixels
from kinectbench.stages.track.pictures import COMPARISON, write_pictures

NOTHING_TO_CHOOSE = (
    "with `segment_by` there is nothing to choose from: all that is fused is the object; correct the masks, "
    "or leave `segment_by` out"
)


def read_tracked(build: Path) -> tuple[Sequence, Trajectory]:
    """The sequence as the tracker saw it, and the trajectory of `build/<recording>/`.

    Its depth is calibrated, and a rolling shutter that was found is undone.
    """
    sequence = read_sequence(build / "sequence")
    trajectory = read_trajectory(build / "trajectory", sequence.stamps_ns)
    calibrated = sequence.calibrated(trajectory.depth_calibration)
    return upright(calibrated, trajectory.shutter), trajectory


def read_own(job: Job) -> tuple[Sequence, Trajectory]:
    """As `read_tracked`; of what is segmented by masks, with the object's own depth only."""
    sequence, trajectory = read_tracked(job.build)
    masks = frame_masks(job, sequence)
    return (sequence if masks is None else by_own_pixels(sequence, masks)), trajectory


def _scene(build: Path) -> TriangleMesh:
    return read_own_ply(build / "reconstruction" / "mesh.ply")


def _ingest(job: Job, folder: Path, progress: Progress) -> None:
    recording = open_recording(job.source, job.recording.camera, follow_links=job.recording.follow_links)
    refuse_hopeless(recording)
    needed = job.recording.trajectory_mode != "ignore"
    watched = recording if needed else replace(recording, given_trajectory=None)
    write_sequence(recording, folder, progress, needs_trajectory=needed, watch=OffsetWatch(watched))


def _track(job: Job, folder: Path, progress: Progress) -> None:
    sequence = read_sequence(job.build / "sequence")
    masks, how = frame_masks(job, sequence), (job.recording.trajectory_mode, job.settings.tracking)
    if masks is None:
        trajectory = track_scene(sequence, *how, progress)
    else:
        trajectory = track_own_pixels(sequence, masks, *how, progress)
    write_trajectory(trajectory, folder)
    write_pictures(folder, trajectory)
    # It shows the trajectory that is about to be replaced.
    (job.build / COMPARISON).unlink(missing_ok=True)


def _fuse(job: Job, folder: Path, progress: Progress) -> None:
    reconstruction = fuse(*read_own(job), job.settings.fusion, progress)
    write_reconstruction(reconstruction, folder)


def _suggest(job: Job, folder: Path, progress: Progress) -> None:
    if job.recording.segment_by is not None:
        raise SegmentationError(NOTHING_TO_CHOOSE)
    sequence, trajectory = read_tracked(job.build)
    found = find_candidates(
        _scene(job.build),
        trajectory,
        job.settings.segmentation,
        floor_hint(sequence, trajectory, job.recording.plane_world),
    )
    write_candidates(found, sequence, trajectory, folder)


def _segment(job: Job, folder: Path, progress: Progress) -> None:
    tracked, scene, settings = read_own(job), _scene(job.build), job.settings
    box = job.recording.box.box() if job.recording.box else None
    wanted = settings.segmentation, settings.fusion
    model = build_object(*tracked, scene, box, *wanted, progress, plane_given(job, *tracked))
    write_object(model, folder)


def _sample_views(job: Job, folder: Path, progress: Progress) -> None:
    sequence, trajectory = read_tracked(job.build)
    model = read_object(job.build / "object")
    of_frames = frame_masks(job, sequence)
    of_views = None if job.recording.segment_by == "masks" else job.masks
    masks = None if of_views is None else read_masks(of_views)
    sequence = replace(sequence, masks=of_frames) if of_frames else sequence
    wanted = job.settings.views, job.settings.segmentation, job.settings.pairs
    views = sample_views(sequence, trajectory, model, *wanted, masks, progress)
    write_views(views, sequence, folder)


def _pairs(job: Job, folder: Path, progress: Progress) -> None:
    sequence, _ = read_tracked(job.build)
    shape = full_shape(read_object(job.build / "object"))
    write_pairs(read_views(job.build / "views"), sequence, shape, job.settings.pairs, folder, progress)


# By the stage's name: (job, folder to fill, progress).
STEPS: Mapping[str, Callable[[Job, Path, Progress], None]] = {
    "ingest": _ingest,
    "track": _track,
    "fuse": _fuse,
    "segment": _segment,
    "sample-views": _sample_views,
    "pairs": _pairs,
    SUGGEST.name: _suggest,
}
