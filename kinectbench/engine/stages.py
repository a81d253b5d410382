"""The stages in order, each with its inputs and settings. The module `steps` runs them."""

import functools
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import JsonValue

from kinectbench.core import RESULTS, KinectBenchError, RecordingError
from kinectbench.core.artefacts.manifest import Manifest, Sources
from kinectbench.core.artefacts.views import MasksFile
from kinectbench.engine.artefact import VERSIONS, content_hash, fingerprint, has_sizes, whole_manifest
from kinectbench.engine.slim import kept_source
from kinectbench.engine.stage_settings import (
    MASKS,
    RECORDING,
    REFERENCE,
    FuseSettings,
    IngestSettings,
    ObjectFusion,
    PairsSettings,
    SampleSettings,
    SceneFusion,
    SegmentSettings,
    Source,
    StageSettings,
    SuggestSettings,
    TrackSettings,
    part_of,
)
from kinectbench.settings.models import (
    BenchmarkSettings,
    FitLimits,
    FloorCuts,
    MaskCuts,
    ObjectCuts,
    RecordingSettings,
)
from kinectbench.stages.ingest.sources import check_there, files_below

# Endings of archives of releases beside benchmark.yaml, whose names begin with the benchmark's.
ARCHIVES = (".zip", ".zip.sha256")


@dataclass(frozen=True)
class Job:
    """One recording of a benchmark.

    Attributes:
        settings: settings of the whole benchmark.
        recording: settings of the recording.
        root: the folder of benchmark.yaml, or its URL as a path; relative paths start there.
        source_sha256: the hash over the recording's files if known without reading them.
    """

    settings: BenchmarkSettings
    recording: RecordingSettings
    root: Path
    source_sha256: str | None = None

    @property
    def build(self) -> Path:
        """The recording's folder `build/<recording>/`."""
        return self.root / "build" / self.recording.id

    @property
    def source(self) -> Path:
        """The recording's file or folder."""
        return self.root / self.recording.path

    @property
    def masks(self) -> Path | None:
        """The folder of the user's masks; None if benchmark.yaml names none."""
        return None if self.recording.masks is None else self.root / self.recording.masks

    @property
    def reference(self) -> Path | None:
        """The mesh that serves as ground truth; None: the fused object is the ground truth."""
        return None if self.recording.reference is None else self.root / self.recording.reference

    @property
    def alone(self) -> "Job":
        """A copy without the other recordings, which is small to send to processes."""
        return replace(self, settings=self.settings.model_copy(update={"recordings": [self.recording]}))

    @property
    def unused_masks(self) -> Path | None:
        """`masks/<recording>/` if it exists although benchmark.yaml names no masks; else None."""
        folder = self.root / "masks" / self.recording.id
        return folder if self.recording.masks is None and folder.is_dir() else None


@dataclass(frozen=True)
class Stage:
    """One stage of the pipeline.

    Attributes:
        name: name of the stage and of its command.
        folder: folder of its artefact, below `build/<recording>/`.
        inputs: names of the stages that it reads.
        needs: makes the settings that the stage depends on, from a job; the stage gets no others.
        outside: returns the names of its inputs from outside `build/`, which are keys of SOURCES.
    """

    name: str
    folder: str
    inputs: tuple[str, ...]
    needs: Callable[[Job], StageSettings]
    outside: Callable[[Job], tuple[str, ...]] = lambda job: ()

    @property
    def version(self) -> int:
        """Version of the stage's output; artefacts of another version are made again."""
        return VERSIONS[self.name]

    def settings(self, job: Job) -> Mapping[str, JsonValue]:
        """Return the settings that the stage depends on, as plain JSON values."""
        return self.needs(job).fingerprinted()

    def sources(self, job: Job) -> Mapping[str, Source]:
        """Return the stage's inputs from outside `build/`, by name, as they are on the disk now."""
        return {name: SOURCES[name](job) for name in self.outside(job)}


def _ingest(job: Job) -> StageSettings:
    own = job.recording
    needed = own.trajectory_mode != "ignore"
    of_object = needed and own.segment_by is not None
    return IngestSettings(camera=own.camera, needs_trajectory=needed, own_pixels=of_object)


def _track(job: Job) -> StageSettings:
    own = job.recording
    mode, tracking = own.trajectory_mode, job.settings.tracking
    return TrackSettings(trajectory=mode, segment_by=own.segment_by, tracking=tracking)


def _fuse(job: Job) -> StageSettings:
    fusion = part_of(SceneFusion, job.settings.fusion)
    return FuseSettings(segment_by=job.recording.segment_by, fusion=fusion)


def _suggest(job: Job) -> StageSettings:
    own, cuts = job.recording, part_of(FloorCuts, job.settings.segmentation)
    floor, pick = own.plane_world, own.pick
    return SuggestSettings(segment_by=own.segment_by, floor=floor, pick=pick, segmentation=cuts)


def _segment(job: Job) -> StageSettings:
    own, settings = job.recording, job.settings
    return SegmentSettings(
        segment_by=own.segment_by,
        box=own.box,
        pick=own.pick,
        floor=own.plane_world,
        underside=settings.underside_of(own),
        segmentation=part_of(ObjectCuts, settings.segmentation),
        fusion=part_of(ObjectFusion, settings.fusion),
    )


def _sample_views(job: Job) -> StageSettings:
    settings = job.settings
    return SampleSettings(
        segment_by=job.recording.segment_by,
        views=settings.views,
        segmentation=part_of(MaskCuts, settings.segmentation),
        pairs=part_of(FitLimits, settings.pairs),
    )


def _pairs(job: Job) -> StageSettings:
    return PairsSettings(pairs=job.settings.pairs)


def check_masks(job: Job) -> None:
    """Check that the folder of masks exists, if benchmark.yaml names one.

    Raises:
        RecordingError: the folder is missing, or is no folder.
    """
    if job.masks is None:
        return
    missing = f"no such folder of masks of {job.recording.id}; make it, or correct `masks`"
    check_there(job.masks, missing)
    if not job.masks.is_dir():
        raise RecordingError(f"{job.masks}: {missing}", what="not-found")


def _masks_named(job: Job) -> tuple[str, ...]:
    """Return (MASKS,) if benchmark.yaml names masks by the user, of views or of frames; else ()."""
    return () if job.masks is None else (MASKS,)


def _frame_masks_named(job: Job) -> tuple[str, ...]:
    """Return (MASKS,) if benchmark.yaml names masks of frames by the user; () if none or masks of views."""
    return _masks_named(job) if job.recording.segment_by == "masks" else ()


def _object_inputs(job: Job) -> tuple[str, ...]:
    """Return the names of inputs that define the object: the user's masks of frames, the reference mesh."""
    return (*_frame_masks_named(job), *(() if job.reference is None else (REFERENCE,)))


def _cache(build: Path, name: str) -> Path:
    """Return the file in `build/<recording>/` that keeps names, sizes and hashes of an input's files."""
    return build / (Sources.FILE if name == RECORDING else f"{name}.{Sources.FILE}")


def _masks(job: Job) -> Source:
    assert job.masks is not None
    check_masks(job)
    return Source(job.masks, content_hash(_given_masks(job), job.masks, _cache(job.build, MASKS)))


def _given_masks(job: Job) -> list[Path]:
    """Return the files of the user's masks; [] if benchmark.yaml names no folder of masks."""
    if job.masks is None:
        return []
    files = files_below(job.masks, follow_links=job.recording.follow_links)
    # masks.json only permits or refuses masks (`drawn_masks`); it never changes a result.
    return [file for file in files if file.parent == job.masks and file.name != MasksFile.FILE]


def _reference(job: Job) -> Source:
    assert job.reference is not None
    check_there(
        job.reference, f"no such reference mesh; add it, or correct `reference` of '{job.recording.id}'"
    )
    cache = _cache(job.build, REFERENCE)
    return Source(job.reference, content_hash([job.reference], job.reference.parent, cache))


def _recording(job: Job) -> Source:
    if job.source_sha256 is not None:
        return Source(job.source, job.source_sha256)
    if not os.path.exists(job.source) and (kept := kept_source(job.build)):  # noqa: PTH110 - of any name
        return Source(job.source, kept)
    from kinectbench.stages.ingest.readers import source_files

    check_there(job.source, f"no such recording; correct `path` of '{job.recording.id}'")
    files = source_files(job.source, follow_links=job.recording.follow_links)
    files = _own_files(job, files)
    return Source(job.source, content_hash(files, job.source, _cache(job.build, RECORDING)))


def _absolute(path: Path) -> Path:
    """Make a path absolute and without "..", so that paths can be compared; links are not resolved."""
    return Path(os.path.abspath(path))  # noqa: PTH100 - `absolute` leaves ".."


def _own_files(job: Job, files: list[Path]) -> list[Path]:
    """Return the recording's own files: without the benchmark's results, and without other inputs."""
    folders = {folder: _absolute(folder) for folder in {file.parent for file in files}}
    there = [folders[file.parent] / file.name for file in files]
    others = _results(job, there) | _other_inputs(job, there)
    if not others:
        return files
    return [
        file for file, whole in zip(files, there, strict=True) if others.isdisjoint((whole, *whole.parents))
    ]


def _results(job: Job, files: Sequence[Path]) -> set[Path]:
    """Return the benchmark's own files and folders if its root is in the recording's folder; else none."""
    root = _absolute(job.root)
    if not root.is_relative_to(_absolute(job.source)):
        return set()
    own = {root / name for name in (*RESULTS, "benchmark.yaml", f"masks/{job.recording.id}")}
    begin = f"{job.settings.name}-"
    own |= {file for file in files if file.name.startswith(begin) and file.name.endswith(ARCHIVES)}
    return own


def _other_inputs(job: Job, files: Sequence[Path]) -> set[Path]:
    """Return files in the recording's folder that are other inputs: reference mesh, user's masks, masks.json.

    Masks in a folder that `ingest` also reads are not returned: they stay files of the recording.
    """
    masks = _absolute(job.masks) if job.masks else None
    drawn = [file for file in files if file.parent == masks]
    named = {_absolute(job.reference)}.intersection(files) if job.reference else set()
    named |= {file for file in drawn if file.name == MasksFile.FILE}
    if not drawn:
        return named
    from kinectbench.stages.ingest.known_names import in_any_case
    from kinectbench.stages.ingest.readers import open_recording
    from kinectbench.stages.ingest.recording import MASKS_FOLDER, FileRecording
    from kinectbench.stages.sample_views.masks import mask_name

    try:
        recording = open_recording(job.source, job.recording.camera, follow_links=job.recording.follow_links)
    except KinectBenchError:  # ingest reports it
        return named
    read = recording.folders if isinstance(recording, FileRecording) else set()
    if masks in {_absolute(folder) for folder in (in_any_case(job.source, MASKS_FOLDER), *read)}:
        return named
    return named | {file for file in drawn if mask_name(file.name, plain_of_frame=True)}


# Makes each input from outside `build/`, by its name.
SOURCES: Mapping[str, Callable[[Job], Source]] = {RECORDING: _recording, MASKS: _masks, REFERENCE: _reference}

STAGES: tuple[Stage, ...] = (
    Stage("ingest", "sequence", (), _ingest, lambda job: (RECORDING,)),
    Stage("track", "trajectory", ("ingest",), _track, _frame_masks_named),
    Stage("fuse", "reconstruction", ("ingest", "track"), _fuse, _frame_masks_named),
    Stage("segment", "object", ("ingest", "track", "fuse"), _segment, _object_inputs),
    Stage("sample-views", "views", ("ingest", "track", "segment"), _sample_views, _masks_named),
    Stage("pairs", "pairs", ("ingest", "track", "segment", "sample-views"), _pairs),
)

# A side stage: boxes that a person may choose from. No other stage reads it.
SUGGEST = Stage("suggest", "candidates", ("ingest", "track", "fuse"), _suggest)


def stages_upto(name: str) -> tuple[Stage, ...]:
    """Return the stages up to the named one, in order; for `suggest`, those up to `fuse`, and `suggest`."""
    if name == SUGGEST.name:
        return (*stages_upto("fuse"), SUGGEST)
    names = [stage.name for stage in STAGES]
    return STAGES[: names.index(name) + 1]


def _has_input(job: Job, build: Path, name: str, sha256: str) -> bool:
    """Whether an input from outside `build/` still has a hash (`has_sizes`); True if the input is gone."""
    path = {RECORDING: job.source, MASKS: job.masks, REFERENCE: job.reference}[name]
    if path is None or not os.path.exists(path):  # noqa: PTH110 - of any name
        return True
    cache = _cache(build, name)
    if name == REFERENCE:
        return has_sizes(path.parent, cache, sha256, [path.name], few=True)
    try:
        names = [file.name for file in _given_masks(job)] if name == MASKS else None
    except (OSError, RecordingError):  # a build would refuse it
        return False
    return has_sizes(path, cache, sha256, names, few=name == MASKS)


def _is_of_sources(manifest: Manifest, stage: Stage, job: Job, has_input: Callable[[str, str], bool]) -> bool:
    """Whether an artefact was made from the job's present inputs from outside `build/`.

    `has_input` takes the name and the hash of an input, and returns whether the input still has that hash.
    """
    named = stage.outside(job)
    if manifest.inputs.keys() - set(stage.inputs) != set(named):
        return False
    return all(has_input(name, manifest.inputs[name]) for name in named)


def current_stages(build: Path, job: Job | None = None) -> dict[str, Path]:
    """Return the folders in `build/<recording>/` of the stages that are up to date, by stage.

    Such a folder is complete, and was made by the stage's present version from the present artefacts of its
    input stages. Changes of the recording are noticed only in the names and sizes of some files. Changes of
    masks and the reference mesh are noticed in all their files. An input that is gone is not compared.

    Args:
        build: `build/<recording>/`.
        job: a job whose settings and sources the artefacts must have; None: any.
    """
    folders: dict[str, Path] = {}
    fingerprints: dict[str, str] = {}
    has_input = functools.cache(lambda *stated: job is None or _has_input(job, build, *stated))
    for stage in STAGES:
        folder = build / stage.folder
        manifest = whole_manifest(folder)
        if manifest is None or any(
            manifest.inputs.get(name) != fingerprints.get(name, "") for name in stage.inputs
        ):
            continue
        if job and not _is_of_sources(manifest, stage, job, has_input):
            continue
        settings = stage.settings(job) if job else manifest.settings
        if manifest.fingerprint == fingerprint(stage.name, stage.version, settings, manifest.inputs):
            folders[stage.name], fingerprints[stage.name] = folder, manifest.fingerprint
    return folders
