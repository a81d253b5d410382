"""Running the stages of one recording: current artefacts are skipped, errors are reported, not raised."""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from kinectbench.core.artefacts.manifest import Timing
from kinectbench.core.artefacts.object import BoxPart, CandidatesFile
from kinectbench.core.errors import (
    KinectBenchError,
    SegmentationError,
    SettingsError,
    ShapeError,
    TrackingError,
    error_code,
    internal_error,
)
from kinectbench.engine.artefact import Artefact, whole_manifest
from kinectbench.engine.failures import failed_before, forget_failure, keep_failure
from kinectbench.engine.interrupts import check_interrupt
from kinectbench.engine.locks import locked
from kinectbench.engine.processes import give_back_memory
from kinectbench.engine.recording_summary import RecordingSummary
from kinectbench.engine.slim import refuse_slim
from kinectbench.engine.stage_settings import MASKS, Source, Work
from kinectbench.engine.stages import STAGES, SUGGEST, Job, Stage, check_masks, stages_upto
from kinectbench.engine.time_limit import Hung, time_limit

NO_MEMORY = "not enough memory; run again with --jobs 1, or with larger voxels (fusion.voxel_size_m)"


@dataclass(frozen=True)
class Outcome:
    """The outcome of one recording: stages made and stages still current, the error or None.

    `repeated`: the error is that of an earlier run, as nothing has changed; nothing was tried.
    `row`: its figures, of a recording in a store; None: they are read in its folder.
    `code`: of the error.
    `warnings`: of the run itself, one line each; those of stages are in their artefacts.
    """

    recording: str
    made: tuple[str, ...]
    current: tuple[str, ...]
    error: str | None
    seconds: float
    repeated: bool = False
    row: RecordingSummary | None = None
    warnings: tuple[str, ...] = ()
    code: str | None = None


STAGE_NAMES = tuple(stage.name for stage in STAGES)
FOLDERS = {stage.name: stage.folder for stage in STAGES}


def build_recording(
    job: Job,
    upto: str = "pairs",
    force: Sequence[str] = (),
    progress: Callable[[str, int, int], None] | None = None,
    *,
    wait: bool = True,
    limit_s: float | None = None,
    hung: Hung | None = None,
) -> Outcome:
    """Bring one recording up to date as far as a stage. Errors are reported, not raised.

    A stage that failed is tried again once something that it depends on has changed, or if it is forced.
    Not even an unforeseen error may stop the other recordings (but does with KINECTBENCH_DEBUG set).

    Args:
        job: the recording.
        upto: name of the last stage.
        force: names of stages to make again even if they are current.
        progress: called with (stage, done, total); a run that waits for another says so as its stage.
        wait: whether to wait for another run that is at this recording; else that is the error.
        limit_s: how long it may take, seconds, without that wait; None: as long as it does.
        hung: called with the reason, on another thread, if it neither ends nor continues long after that.
    """
    report = progress or (lambda stage, done, total: None)
    started = time.monotonic()
    made, current, warnings = list[str](), list[str](), tuple[str, ...]()
    error: str | None = None
    code, repeated = error, False
    try:
        with (
            locked(job.build, wait=wait, waiting=lambda holder: report(f"waiting for {holder}", 0, 1)),
            time_limit(limit_s, report, hung) as report,
        ):
            artefacts: dict[str, Artefact] = {}
            stages = stages_upto(upto)
            warnings = _look_at_masks(job, stages)
            for stage in stages:
                if job.masks is not None and tuple(artefacts) == ("ingest",):
                    _check_mask_numbers(job, stages)
                with _failure_kept(job, stage, artefacts):
                    sources = stage.sources(job)
                    artefact = artefacts[stage.name] = _artefact(job, stage, sources, artefacts)
                    if artefact.is_current() and stage.name not in force:
                        current.append(stage.name)
                        continue
                    if stage.name not in force and (failed := failed_before(job.build, artefact)):
                        error, code, repeated = failed.error, failed.code, True
                        break
                    report(stage.name, 0, 1)
                    _make(job, stage, sources, artefact, report)
                    made.append(stage.name)
            if not repeated:
                forget_failure(job.build, (*made, *current))
    except Exception as failure:
        error, code = error_line(failure), error_code(failure)
    if error is not None:
        check_interrupt()  # an interrupt in the midst of an import may look like an error
    seconds, done = time.monotonic() - started, (tuple(made), tuple(current))
    return Outcome(job.recording.id, *done, error, seconds, repeated, warnings=warnings, code=code)


def _look_at_masks(job: Job, stages: Sequence[Stage]) -> tuple[str, ...]:
    """Refuse unusable masks of a person before slow work; returns warnings about others."""
    samples = next((stage for stage in stages if stage.name == "sample-views"), None)
    with _failure_kept(job, samples or stages[-1], {}):
        if samples:
            check_masks(job)
        if job.masks is None and job.unused_masks is None:
            return ()
        from kinectbench.engine.drawn_masks import look_at_masks

        return look_at_masks(job, used=samples is not None)


def _check_mask_numbers(job: Job, stages: Sequence[Stage]) -> None:
    """Refuse masks of missing frames before slow work; `ingest` has counted the frames."""
    from kinectbench.engine.drawn_masks import check_mask_numbers

    with _failure_kept(job, stages[-1], {}):
        check_mask_numbers(job)


@contextmanager
def _failure_kept(job: Job, stage: Stage, artefacts: Mapping[str, Artefact]) -> Iterator[None]:
    """Store why a stage failed, for the page; a failure of `suggest` is not shown there."""
    try:
        yield
    except Exception as failure:
        check_interrupt()
        if stage.name in STAGE_NAMES:
            keep_failure(job.build, stage.name, error_line(failure), failure, artefacts.get(stage.name))
        raise


def error_line(failure: Exception) -> str:
    """An error as one line to print; an unforeseen one is raised again if KINECTBENCH_DEBUG is set."""
    if isinstance(failure, KinectBenchError):
        return str(failure)
    if isinstance(failure, MemoryError):
        return NO_MEMORY
    if os.environ.get("KINECTBENCH_DEBUG"):
        raise failure
    return internal_error(failure)


def is_current(job: Job, upto: str) -> bool:
    """Whether all stages up to the named one are made and current."""
    return all(artefact.is_current() for artefact in artefacts_upto(job, upto).values())


def artefacts_upto(job: Job, upto: str) -> dict[str, Artefact]:
    """The artefacts of each stage up to the named one, by stage in order."""
    artefacts: dict[str, Artefact] = {}
    for stage in stages_upto(upto):
        artefacts[stage.name] = _artefact(job, stage, stage.sources(job), artefacts)
    return artefacts


def changed_settings(job: Job, upto: str) -> dict[str, tuple[object, object]]:
    """Settings of the artefacts on disk that have changed: {key: (then, now)}.

    Args:
        job: the recording, with the settings of now.
        upto: name of the last stage.
    """
    changed: dict[str, tuple[object, object]] = {}
    for stage in stages_upto(upto):
        manifest = whole_manifest(job.build / stage.folder)
        if manifest is not None and manifest.stage_version == stage.version:
            then, now = _by_key(manifest.settings), _by_key(stage.settings(job))
            changed |= {
                key: (then[key], value) for key, value in now.items() if then.get(key, value) != value
            }
    return changed


def _by_key(settings: Mapping[str, object], above: str = "") -> dict[str, object]:
    """Nested settings by their keys as `--set` names them, such as fusion.voxel_size_m."""
    flat: dict[str, object] = {}
    for key, value in settings.items():
        flat |= _by_key(value, f"{above}{key}.") if isinstance(value, Mapping) else {f"{above}{key}": value}
    return flat


def listed_box(job: Job, number: int) -> BoxPart:
    """The box of that number, as `suggest` listed it for the recording as it is now.

    Raises:
        SettingsError: there is no current list, or no such number in it.
    """
    name = job.recording.id
    if not is_current(job, SUGGEST.name):
        raise SettingsError(
            f"segment --pick: {name} has no list of boxes, or an old one; "
            f"run `kinectbench segment {name} --suggest` and look at the pictures first"
        )
    listed = CandidatesFile.read(job.build / SUGGEST.folder).candidates
    boxes = {each.number: each.box for each in listed}
    if number not in boxes:
        raise SettingsError(f"segment --pick: {name} has boxes 1 to {len(boxes)}, none of number {number}")
    return boxes[number]


def _artefact(
    job: Job, stage: Stage, sources: Mapping[str, Source], artefacts: Mapping[str, Artefact]
) -> Artefact:
    inputs = {name: artefacts[name].fingerprint for name in stage.inputs}
    inputs |= {name: source.sha256 for name, source in sources.items()}
    return Artefact(job.build / stage.folder, stage.name, stage.version, stage.settings(job), inputs)


def _make(
    job: Job,
    stage: Stage,
    sources: Mapping[str, Source],
    artefact: Artefact,
    report: Callable[[str, int, int], None],
) -> None:
    """Make an artefact; its step gets only the values in its fingerprint, not the job."""
    from kinectbench.engine.steps import OVERTAKEN, STEPS

    started = time.monotonic()
    check_views = _checked_masks(job) if MASKS in sources else None
    folders = {name: job.build / folder for name, folder in FOLDERS.items() if name in stage.inputs}
    for of_stage in folders.values():
        refuse_slim(job.recording.id, of_stage)
    with artefact.write() as folder:
        progress = partial(report, stage.name)
        try:
            STEPS[stage.name](Work(stage.needs(job), folders, sources, folder, progress))
        except (TrackingError, SegmentationError, ShapeError) as failure:
            raise type(failure)(_explained(job, failure), what=failure.what) from failure
        if check_views is not None and stage.name == "sample-views":
            check_views(folder)
        Timing(seconds=round(time.monotonic() - started, 3)).write(folder)
        if stage.name in OVERTAKEN:
            (job.build / OVERTAKEN[stage.name]).unlink(missing_ok=True)
    give_back_memory()


def _checked_masks(job: Job) -> Callable[[Path], object] | None:
    """Refuse masks of frames whose images have changed; returns the check of masks of views.

    It can only refuse, and changes nothing that a step makes: so masks.json is in no fingerprint, and the
    refusal is not one that is kept.
    """
    from kinectbench.engine.drawn_masks import DrawnMasks
    from kinectbench.stages.ingest.sequence_folder import read_sequence

    drawn, sequence = DrawnMasks.of(job), read_sequence(job.build / FOLDERS["ingest"])
    if drawn is None:
        return None
    return partial(drawn.check_frames(sequence).check_views, sequence)


def _explained(job: Job, failure: KinectBenchError) -> str:
    """The line of a failure, after its likely cause if the recording shows one."""
    from kinectbench.doctor.during_build import likely_cause
    from kinectbench.stages.ingest.readers import open_recording

    try:
        recording = open_recording(job.source, job.recording.camera, follow_links=job.recording.follow_links)
        if job.recording.trajectory_mode == "ignore" or job.recording.segment_by:
            recording = replace(recording, given_trajectory=None, trajectory_error="")
        cause = likely_cause(recording)
    except KinectBenchError:
        cause = ""  # the recording itself is gone or damaged since it was read
    return f"{cause}. What failed: {failure}" if cause else str(failure)
