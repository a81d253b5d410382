"""The stages in their order: what each stands on, and which settings it depends on. `steps` runs them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kinectbench.core.errors import RecordingError
from kinectbench.engine.artefact import VERSIONS, content_hash, fingerprint, whole_manifest
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings


@dataclass(frozen=True)
class Job:
    """One recording of a benchmark.

    Attributes:
        settings: the whole benchmark.
        recording: the recording.
        root: the folder of benchmark.yaml, or its URL as a path; relative paths start there.
        source_sha256: one hash over the recording's files, if it is known without them.
    """

    settings: BenchmarkSettings
    recording: RecordingSettings
    root: Path
    source_sha256: str | None = None

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
    def alone(self) -> "Job":
        """The same without the other recordings: thousands would be sent to a process with each of them."""
        return replace(self, settings=self.settings.model_copy(update={"recordings": [self.recording]}))

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
        sources: hashes of files outside `build/` that it depends on.
    """

    name: str
    folder: str
    inputs: tuple[str, ...]
    settings: Callable[[Job], Mapping[str, Any]]
    sources: Callable[[Job], Mapping[str, str]] = lambda job: {}

    @property
    def version(self) -> int:
        """Of what it writes; artefacts of another version are made again."""
        return VERSIONS[self.name]


def _section(job: Job, name: str, *keys: str, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """A section of the settings as JSON values: the named keys, or all but some."""
    section = getattr(job.settings, name).model_dump(mode="json")
    return {key: value for key, value in section.items() if (not keys or key in keys) and key not in without}


def _ingest_settings(job: Job) -> Mapping[str, Any]:
    camera = job.recording.camera
    return {"camera": None if camera is None else camera.model_dump(mode="json")}


def _track_settings(job: Job) -> Mapping[str, Any]:
    """What comes after it depends on `segment_by` through it."""
    by = {} if job.recording.segment_by is None else {"segment_by": job.recording.segment_by}
    return {"trajectory": job.recording.trajectory, **by, "tracking": _section(job, "tracking")}


def _segment_settings(job: Job) -> Mapping[str, Any]:
    box = job.recording.box
    return {
        "box": None if box is None else box.model_dump(mode="json"),
        **_floor_settings(job),
        "segmentation": _section(job, "segmentation", without=("mask_tolerance_m",)),
        "fusion": _section(job, "fusion", without=("scene_voxel_size_m",)),
    }


def _floor_settings(job: Job) -> Mapping[str, Any]:
    """Nothing where no plane is given, so that what was made before the setting came stays current."""
    plane_world = job.recording.plane_world
    return {} if plane_world is None else {"floor": list(plane_world)}


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
    from kinectbench.stages.ingest.sources import check_there

    if job.masks is None:
        return
    missing = f"no such folder of masks of {job.recording.id}; make it, or correct `masks`"
    check_there(job.masks, missing)
    if not job.masks.is_dir():
        raise RecordingError(f"{job.masks}: {missing}")


def _mask_sources(job: Job) -> Mapping[str, str]:
    check_masks(job)
    if job.masks is None:
        return {}
    from kinectbench.stages.ingest.sources import files_below

    files = files_below(job.masks, follow_links=job.recording.follow_links)
    pictures = [file for file in files if file.parent == job.masks and file.suffix.lower() == ".png"]
    return {"masks": content_hash(pictures, job.masks)}


def _frame_mask_sources(job: Job) -> Mapping[str, str]:
    """A person's masks of frames; nothing where those of views are meant."""
    return _mask_sources(job) if job.recording.segment_by == "masks" else {}


def _recording_sources(job: Job) -> Mapping[str, str]:
    if job.source_sha256 is not None:
        return {"recording": job.source_sha256}
    from kinectbench.stages.ingest.readers import source_files
    from kinectbench.stages.ingest.sources import check_there

    check_there(job.source, f"no such recording; correct `path` of '{job.recording.id}'")
    files = source_files(job.source, follow_links=job.recording.follow_links)
    return {"recording": content_hash(files, job.source, job.build)}


STAGES: tuple[Stage, ...] = (
    Stage("ingest", "sequence", (), _ingest_settings, _recording_sources),
    Stage(
        "track",
        "trajectory",
        ("ingest",),
        _track_settings,
        _frame_mask_sources,
    ),
    Stage(
        "fuse",
        "reconstruction",
        ("ingest", "track"),
        lambda job: {"fusion": _section(job, "fusion", without=("voxel_size_m",))},
    ),
    Stage("segment", "object", ("ingest", "track", "fuse"), _segment_settings),
    Stage("sample-views", "views", ("ingest", "track", "segment"), _view_settings, _mask_sources),
    Stage(
        "pairs",
        "pairs",
        ("ingest", "track", "segment", "sample-views"),
        lambda job: {"pairs": _section(job, "pairs", "framing", "partial_rule", "min_containment")},
    ),
)

# Beside the way: boxes to choose from, for a person to look at. No other stage stands on it.
SUGGEST = Stage(
    "suggest",
    "candidates",
    ("ingest", "track", "fuse"),
    lambda job: {
        "segmentation": _section(job, "segmentation", "seed", "floor_cut_m", "low_cut_m"),
        **_floor_settings(job),
    },
)


def stages_upto(name: str) -> tuple[Stage, ...]:
    """The stages up to the named one, in their order; `suggest` follows `fuse`."""
    if name == SUGGEST.name:
        return (*stages_upto("fuse"), SUGGEST)
    names = [stage.name for stage in STAGES]
    return STAGES[: names.index(name) + 1]


def current_stages(build: Path, job: Job | None = None) -> dict[str, Path]:
    """The folders of `build/<recording>/` by their stages, of those that are current there.

    Such a folder is whole, and the stage's present version made it from what lies there now of the stages
    that it stands on. Whether the recording itself changed since is not looked at.

    Args:
        build: where the stages' folders lie.
        job: with whose settings they must be made; None: with any.
    """
    folders: dict[str, Path] = {}
    fingerprints: dict[str, str] = {}
    for stage in STAGES:
        folder = build / stage.folder
        manifest = whole_manifest(folder)
        if manifest is None or any(
            manifest.inputs.get(name) != fingerprints.get(name, "") for name in stage.inputs
        ):
            continue
        settings = stage.settings(job) if job else manifest.settings
        if manifest.fingerprint == fingerprint(stage.name, stage.version, settings, manifest.inputs):
            folders[stage.name], fingerprints[stage.name] = folder, manifest.fingerprint
    return folders
