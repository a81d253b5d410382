"""The stages in their order: what each stands on, which settings it depends on, and what it writes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kinectbench.config import BenchmarkSettings, RecordingSettings
from kinectbench.errors import RecordingError
from kinectbench.sources import content_hash

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Job:
    """One recording of a benchmark.

    Attributes:
        settings: the whole benchmark.
        recording: the recording.
        root: the folder of benchmark.yaml; relative paths start there.
    """

    settings: BenchmarkSettings
    recording: RecordingSettings
    root: Path

    @property
    def build(self) -> Path:
        """`build/<recording>/`."""
        return self.root / "build" / self.recording.id

    @property
    def source(self) -> Path:
        """The recording itself."""
        return self.root / self.recording.path

    @property
    def masks(self) -> Path | None:
        """The folder of a person's masks, if there is one."""
        return None if self.recording.masks is None else self.root / self.recording.masks

    @property
    def unused_masks(self) -> Path | None:
        """`masks/<recording>/`, if it is there and benchmark.yaml names no masks of the recording."""
        folder = self.root / "masks" / self.recording.id
        return folder if self.recording.masks is None and folder.is_dir() else None


@dataclass(frozen=True)
class Stage:
    """One arrow of the way through.

    Attributes:
        name: of the command.
        folder: of the artefact, below `build/<recording>/`.
        inputs: names of the stages it stands on.
        settings: what of the settings it depends on, as plain JSON values.
        run: (job, folder to fill, progress); reads its inputs from `job.build`.
        sources: hashes of files outside `build/` that it depends on.
    """

    name: str
    folder: str
    inputs: tuple[str, ...]
    settings: Callable[[Job], Mapping[str, Any]]
    run: Callable[[Job, Path, Progress], None]
    sources: Callable[[Job], Mapping[str, str]] = lambda job: {}


def _ingest(job: Job, folder: Path, progress: Progress) -> None:
    from kinectbench.doctor.hopeless import refuse_hopeless
    from kinectbench.doctor.offsets import OffsetWatch
    from kinectbench.ingest.registry import open_recording
    from kinectbench.ingest.sequence_folder import write_sequence

    recording = open_recording(job.source, job.recording.camera)
    refuse_hopeless(recording)
    needed = job.recording.trajectory != "ignore"
    watched = recording if needed else replace(recording, given_trajectory=None)
    write_sequence(recording, folder, progress, needs_trajectory=needed, watch=OffsetWatch(watched))


def _track(job: Job, folder: Path, progress: Progress) -> None:
    from kinectbench.ingest.sequence_folder import read_sequence
    from kinectbench.tracking import track
    from kinectbench.tracking.pictures import COMPARISON, write_pictures
    from kinectbench.tracking.trajectory_folder import write_trajectory

    sequence = read_sequence(job.build / "sequence")
    trajectory = track(sequence, job.recording.trajectory, job.settings.tracking, progress)
    write_trajectory(trajectory, folder)
    write_pictures(folder, trajectory)
    # It shows the trajectory that is about to be replaced.
    (job.build / COMPARISON).unlink(missing_ok=True)


def _fuse(job: Job, folder: Path, progress: Progress) -> None:
    from kinectbench.fusion import fuse
    from kinectbench.fusion.reconstruction_folder import write_reconstruction
    from kinectbench.stored import read_tracked

    sequence, trajectory = read_tracked(job.build)
    write_reconstruction(fuse(sequence, trajectory, job.settings.fusion, progress), folder)


def _suggest(job: Job, folder: Path, progress: Progress) -> None:
    from kinectbench.mesh_file import read_ply
    from kinectbench.segmentation.candidates import find_candidates
    from kinectbench.segmentation.candidates_folder import write_candidates
    from kinectbench.stored import read_tracked

    sequence, trajectory = read_tracked(job.build)
    scene = read_ply(job.build / "reconstruction" / "mesh.ply")
    found = find_candidates(scene, trajectory, job.settings.segmentation)
    write_candidates(found, sequence, trajectory, folder)


def _segment(job: Job, folder: Path, progress: Progress) -> None:
    from kinectbench.mesh_file import read_ply
    from kinectbench.shape import build_object
    from kinectbench.shape.object_folder import write_object
    from kinectbench.stored import read_tracked

    sequence, trajectory = read_tracked(job.build)
    scene = read_ply(job.build / "reconstruction" / "mesh.ply")
    box = job.recording.box.box() if job.recording.box else None
    settings = job.settings
    model = build_object(sequence, trajectory, scene, box, settings.segmentation, settings.fusion, progress)
    write_object(model, folder)


def _sample_views(job: Job, folder: Path, progress: Progress) -> None:
    from kinectbench.shape.object_folder import read_object
    from kinectbench.stored import read_tracked
    from kinectbench.views import sample_views
    from kinectbench.views_folder import write_views

    sequence, trajectory = read_tracked(job.build)
    model = read_object(job.build / "object")
    settings = job.settings
    views = sample_views(
        sequence,
        trajectory,
        model,
        settings.views,
        settings.segmentation,
        settings.pairs,
        job.masks,
        progress,
    )
    write_views(views, sequence, folder)


def _pairs(job: Job, folder: Path, progress: Progress) -> None:
    from kinectbench.pairs import full_shape, make_pair, pair_row
    from kinectbench.shape.object_folder import read_object
    from kinectbench.stored import read_tracked
    from kinectbench.views_folder import read_views, write_pairs_table
    from kinectbench.voxels.pair_file import pair_bytes

    sequence, _ = read_tracked(job.build)
    shape = full_shape(read_object(job.build / "object"))
    views = read_views(job.build / "views")
    made, refused = [], []
    for done, view in enumerate(views, start=1):
        result = make_pair(view, sequence, shape, job.settings.pairs)
        if result.pair is None:
            refused.append({"view": view.name, "frame": view.frame, "reason": result.reason})
        else:
            (folder / f"{view.name}.npz").write_bytes(pair_bytes(result.pair))
            made.append(pair_row(view, result))
        progress(done, len(views))
    write_pairs_table(made, refused, folder)


def _section(job: Job, name: str, *keys: str, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """A section of the settings as JSON values: the named keys, or all but some."""
    section = getattr(job.settings, name).model_dump(mode="json")
    return {key: value for key, value in section.items() if (not keys or key in keys) and key not in without}


def _ingest_settings(job: Job) -> Mapping[str, Any]:
    camera = job.recording.camera
    return {"camera": None if camera is None else camera.model_dump(mode="json")}


def _segment_settings(job: Job) -> Mapping[str, Any]:
    box = job.recording.box
    return {
        "box": None if box is None else box.model_dump(mode="json"),
        "segmentation": _section(job, "segmentation", without=("mask_tolerance_m",)),
        "fusion": _section(job, "fusion", without=("scene_voxel_size_m",)),
    }


def _view_settings(job: Job) -> Mapping[str, Any]:
    return {
        "views": _section(job, "views"),
        "segmentation": _section(job, "segmentation", "mask_tolerance_m"),
        "pairs": _section(job, "pairs", "min_containment", "max_residual_m", "min_visible_share"),
    }


def check_masks(job: Job) -> None:
    """Refuse a folder of masks that is not there.

    Raises:
        RecordingError: it is named in benchmark.yaml, but missing.
    """
    if job.masks is not None and not job.masks.is_dir():
        raise RecordingError(
            f"{job.recording.id}: no such folder of masks: {job.masks}; make it, or correct `masks`"
        )


def _mask_sources(job: Job) -> Mapping[str, str]:
    check_masks(job)
    if job.masks is None:
        return {}
    return {"masks": content_hash(sorted(job.masks.glob("*.png")), job.masks, None)}


def _recording_sources(job: Job) -> Mapping[str, str]:
    from kinectbench.ingest.registry import source_files

    if not job.source.exists():
        raise RecordingError(f"{job.source}: no such recording; correct `path` of '{job.recording.id}'")
    return {"recording": content_hash(source_files(job.source), job.source, job.build / "sources.json")}


STAGES: tuple[Stage, ...] = (
    Stage("ingest", "sequence", (), _ingest_settings, _ingest, _recording_sources),
    Stage(
        "track",
        "trajectory",
        ("ingest",),
        lambda job: {"trajectory": job.recording.trajectory, "tracking": _section(job, "tracking")},
        _track,
    ),
    Stage(
        "fuse",
        "reconstruction",
        ("ingest", "track"),
        lambda job: {"fusion": _section(job, "fusion", without=("voxel_size_m",))},
        _fuse,
    ),
    Stage("segment", "object", ("ingest", "track", "fuse"), _segment_settings, _segment),
    Stage(
        "sample-views", "views", ("ingest", "track", "segment"), _view_settings, _sample_views, _mask_sources
    ),
    Stage(
        "pairs",
        "pairs",
        ("ingest", "track", "segment", "sample-views"),
        lambda job: {"pairs": _section(job, "pairs", "framing", "partial_rule", "min_containment")},
        _pairs,
    ),
)

# Beside the way: boxes to choose from, for a person to look at. No other stage stands on it.
SUGGEST = Stage(
    "suggest",
    "candidates",
    ("ingest", "track", "fuse"),
    lambda job: {"segmentation": _section(job, "segmentation", "seed", "floor_cut_m", "low_cut_m")},
    _suggest,
)


def stages_upto(name: str) -> tuple[Stage, ...]:
    """The stages up to the named one, in their order; `suggest` follows `fuse`."""
    if name == SUGGEST.name:
        return (*stages_upto("fuse"), SUGGEST)
    names = [stage.name for stage in STAGES]
    return STAGES[: names.index(name) + 1]
