"""What each stage does: it reads what it stands on, calls one function, and writes the result.

Import late: the functions load numba.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.mesh import read_ply
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory, read_trajectory, write_trajectory
from kinectbench.core.types import Progress
from kinectbench.doctor.during_build import OffsetWatch, refuse_hopeless
from kinectbench.engine.object import build_object
from kinectbench.engine.stages import SUGGEST, Job
from kinectbench.stages.fuse import fuse
from kinectbench.stages.fuse.reconstruction import write_reconstruction
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.pairs import full_shape, write_pairs
from kinectbench.stages.sample_views.views import read_masks, read_views, sample_views, write_views
from kinectbench.stages.segment.candidate_pictures import write_candidates
from kinectbench.stages.segment.candidates import find_candidates
from kinectbench.stages.segment.object_model import read_object, write_object
from kinectbench.stages.track import track
from kinectbench.stages.track.pictures import COMPARISON, write_pictures


def read_tracked(build: Path) -> tuple[Sequence, Trajectory]:
    """The sequence, its depth as the tracker calibrated it, and the trajectory of `build/<recording>/`."""
    sequence = read_sequence(build / "sequence")
    trajectory = read_trajectory(build / "trajectory", sequence.stamps_ns)
    return sequence.calibrated(trajectory.depth_calibration), trajectory


def _scene(build: Path) -> TriangleMesh:
    return read_ply(build / "reconstruction" / "mesh.ply")


def _ingest(job: Job, folder: Path, progress: Progress) -> None:
    recording = open_recording(job.source, job.recording.camera)
    refuse_hopeless(recording)
    needed = job.recording.trajectory != "ignore"
    watched = recording if needed else replace(recording, given_trajectory=None)
    write_sequence(recording, folder, progress, needs_trajectory=needed, watch=OffsetWatch(watched))


def _track(job: Job, folder: Path, progress: Progress) -> None:
    sequence = read_sequence(job.build / "sequence")
    trajectory = track(sequence, job.recording.trajectory, job.settings.tracking, progress)
    write_trajectory(trajectory, folder)
    write_pictures(folder, trajectory)
    # It shows the trajectory that is about to be replaced.
    (job.build / COMPARISON).unlink(missing_ok=True)


def _fuse(job: Job, folder: Path, progress: Progress) -> None:
    reconstruction = fuse(*read_tracked(job.build), job.settings.fusion, progress)
    write_reconstruction(reconstruction, folder)


def _suggest(job: Job, folder: Path, progress: Progress) -> None:
    sequence, trajectory = read_tracked(job.build)
    found = find_candidates(_scene(job.build), trajectory, job.settings.segmentation)
    write_candidates(found, sequence, trajectory, folder)


def _segment(job: Job, folder: Path, progress: Progress) -> None:
    tracked, scene, settings = read_tracked(job.build), _scene(job.build), job.settings
    box = job.recording.box.box() if job.recording.box else None
    model = build_object(*tracked, scene, box, settings.segmentation, settings.fusion, progress)
    write_object(model, folder)


def _sample_views(job: Job, folder: Path, progress: Progress) -> None:
    sequence, trajectory = read_tracked(job.build)
    model = read_object(job.build / "object")
    masks = None if job.masks is None else read_masks(job.masks)
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
