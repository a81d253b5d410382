"""Run the stages of one recording: skip current artefacts, and report errors instead of raising them."""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from pydantic import Field, field_serializer

from kinectbench.core import (
    KinectBenchError,
    SegmentationError,
    SettingsError,
    ShapeError,
    TrackingError,
    error_code,
    internal_error,
)
from kinectbench.core.artefacts.manifest import Timing
from kinectbench.core.artefacts.object import (
    INTERVAL_HIGH,
    INTERVAL_LOW,
    BoxPart,
    CandidatesFile,
    FrontierPart,
)
from kinectbench.core.artefacts.stored import StoredPart, optional
from kinectbench.core.types import NamedProgress, no_progress
from kinectbench.engine.artefact import Artefact, whole_manifest
from kinectbench.engine.failures import failed_before, forget_failure, keep_failure
from kinectbench.engine.interrupts import check_interrupt
from kinectbench.engine.locks import locked
from kinectbench.engine.processes import give_back_memory
from kinectbench.engine.slim import refuse_slim
from kinectbench.engine.stage_settings import MASKS, Source, Work
from kinectbench.engine.stages import STAGES, SUGGEST, Job, Stage, check_masks, stages_upto
from kinectbench.engine.time_limit import Hung, time_limit


class RecordingSummary(StoredPart):
    """The result of one recording; a figure is null unless its stage is up to date."""

    recording: str = Field(description="id of the recording")
    frames: int | None = Field(description="number of frames")
    damaged: int | None = optional("number of further frames that could not be read")
    left_out: tuple[int, ...] | None = Field(description="frames whose depth disagrees with their given pose")
    lost: int | None = Field(description="number of other frames without a pose")
    source: str | None = Field(description="source of the poses: trust, refine or tracked")
    grade: str | None = Field(description="quality of the poses for ground truth, in a word")
    verdict: str | None = Field(description="quality of the poses for ground truth, in a sentence")
    recommended: str | None = Field(description="recommended value of the setting `trajectory`")
    repeatability_iou: float | None = Field(description="IoU of the solids made of odd and of even frames")
    estimated_iou: float | None = Field(description="estimate of the solid's IoU to the unknown truth")
    estimated_iou_low: float | None = Field(description=INTERVAL_LOW)
    estimated_iou_high: float | None = Field(description=INTERVAL_HIGH)
    estimated_iou_reasons: tuple[str, ...] | None = Field(description="what widens that interval")
    rests_on_word: str | None = optional(
        "a warning if much of the solid rests on the user's `underside: closed`"
    )
    frontiers: tuple[FrontierPart, ...] | None = Field(description="openings that nobody looked into")
    views: int | None = Field(description="number of views")
    pairs: int | None = Field(description="number of pairs")
    refused: int | None = Field(description="number of frames refused as views, and of views without a pair")
    containment: float | None = Field(description="share of the partial in the shape, median over the pairs")
    residual_m: float | None = Field(
        alias="residual_mm", description="distance of the points from the shape, median over the pairs, mm"
    )
    warnings: tuple[str, ...] = Field(description="warnings of all stages, one line each")
    first: str | None = optional("the warning to deal with first")
    left_out_of_release: str | None = optional("why `publish` would leave the recording out")
    status: str = Field(description="failed, in use, up to date, or the seconds it took")
    error: str | None = Field(description="why the recording failed")
    code: str | None = Field(description="code of this error")
    made: tuple[str, ...] = Field(description="stages that this run made")
    current: tuple[str, ...] = Field(description="stages that were up to date")

    @field_serializer("residual_m")
    def _millimetres(self, residual_m: float | None) -> float | None:
        # Hardly rounded here, because the value is rounded when it is shown.
        return None if residual_m is None else round(1000 * residual_m, 6)


NO_MEMORY = "not enough memory; run again with --jobs 1, or with larger voxels (fusion.voxel_size_m)"


@dataclass(frozen=True)
class Outcome:
    """The outcome of building one recording.

    Attributes:
        recording: id of the recording.
        made: names of the stages that were made.
        current: names of the stages that were up to date.
        error: why the recording failed, one line; None if it did not.
        seconds: how long the run took, with waiting for other runs.
        repeated: the error is that of an earlier run; nothing was tried because no input has changed.
        row: the summary of a recording in a store; None: it can be read from the local folder.
        warnings: warnings of the run, one line each; stages keep their own warnings in their artefacts.
        code: code of the error, as in docs/errors.md.
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
    progress: NamedProgress | None = None,
    *,
    wait: bool = True,
    limit_s: float | None = None,
    hung: Hung | None = None,
) -> Outcome:
    """Bring one recording up to date, up to the stage `upto`; report errors in the outcome.

    A failed stage is tried again if one of its inputs has changed, or if it is forced. Unforeseen errors are
    reported too, so that they do not stop other recordings (raised if KINECTBENCH_DEBUG is set).

    Args:
        job: the recording.
        upto: name of the last stage.
        force: names of stages to make again even if they are current.
        progress: called with (stage, done, total); while waiting, `stage` is "waiting for <the other run>".
        wait: whether to wait for another run that builds this recording; otherwise the outcome is an error.
        limit_s: time limit, seconds, without the waiting; None: no limit.
        hung: called with the reason, on another thread, if the build still hangs long after the limit.
    """
    report = progress or no_progress
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
        check_interrupt()  # an interrupt during an import may look like an error
    seconds, done = time.monotonic() - started, (tuple(made), tuple(current))
    return Outcome(job.recording.id, *done, error, seconds, repeated, warnings=warnings, code=code)


def _look_at_masks(job: Job, stages: Sequence[Stage]) -> tuple[str, ...]:
    """Check the user's masks before slow work, and record in masks.json which image each was drawn on.

    Return warnings about masks whose image is assumed, and about files that are not used.
    """
    samples = next((stage for stage in stages if stage.name == "sample-views"), None)
    with _failure_kept(job, samples or stages[-1], {}):
        if samples:
            check_masks(job)
        if job.masks is None and job.unused_masks is None:
            return ()
        from kinectbench.engine.drawn_masks import look_at_masks

        return look_at_masks(job, used=samples is not None)


def _check_mask_numbers(job: Job, stages: Sequence[Stage]) -> None:
    """Refuse masks of frames that do not exist, before slow work. `ingest` must have counted the frames."""
    from kinectbench.engine.drawn_masks import check_mask_numbers

    with _failure_kept(job, stages[-1], {}):
        check_mask_numbers(job)


@contextmanager
def _failure_kept(job: Job, stage: Stage, artefacts: Mapping[str, Artefact]) -> Iterator[None]:
    """If a stage fails in the block, store the reason; not for `suggest`, whose failures no page shows."""
    try:
        yield
    except Exception as failure:
        check_interrupt()
        if stage.name in STAGE_NAMES:
            keep_failure(job.build, stage.name, error_line(failure), failure, artefacts.get(stage.name))
        raise


def error_line(failure: Exception) -> str:
    """Return an error as one line to print; with KINECTBENCH_DEBUG set, raise an unforeseen error instead."""
    if isinstance(failure, KinectBenchError):
        return str(failure)
    if isinstance(failure, MemoryError):
        return NO_MEMORY
    if os.environ.get("KINECTBENCH_DEBUG"):
        raise failure
    return internal_error(failure)


def is_current(job: Job, upto: str) -> bool:
    """Whether the artefacts of all stages up to the named one are up to date."""
    return all(artefact.is_current() for artefact in artefacts_upto(job, upto).values())


def artefacts_upto(job: Job, upto: str) -> dict[str, Artefact]:
    """Return the artefacts of the stages up to the named one, in order, as the job now defines them."""
    artefacts: dict[str, Artefact] = {}
    for stage in stages_upto(upto):
        artefacts[stage.name] = _artefact(job, stage, stage.sources(job), artefacts)
    return artefacts


def changed_settings(job: Job, upto: str) -> dict[str, tuple[object, object]]:
    """Return settings that differ from those of artefacts on disk up to a stage: {dotted key: (then, now)}.

    Artefacts of another version of their stage are not compared.
    """
    changed: dict[str, tuple[object, object]] = {}
    for stage in stages_upto(upto):
        manifest = whole_manifest(job.build / stage.folder)
        if manifest is not None and manifest.stage_version == stage.version:
            changed |= differing_settings(manifest.settings, stage.settings(job))
    return changed


def differing_settings(
    then: Mapping[str, object], now: Mapping[str, object], above: str = ""
) -> dict[str, tuple[object, object]]:
    """Return settings that differ: {`above` + dotted key: (then, now)}; a missing value is "default"."""
    found: dict[str, tuple[object, object]] = {}
    for key in {**then, **now}:
        old, new = then.get(key, "default"), now.get(key, "default")
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            found |= differing_settings(old, new, f"{above}{key}.")
        elif old != new:
            found[f"{above}{key}"] = (old, new)
    return found


def listed_box(job: Job, number: int) -> BoxPart:
    """Return the box with this number in the recording's current list of candidates, made by `suggest`.

    Raises:
        SettingsError: there is no current list, or the list has no such number.
        RecordingError, StorageError: the recording or the list cannot be read.
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
    job: Job, stage: Stage, sources: Mapping[str, Source], artefact: Artefact, report: NamedProgress
) -> None:
    """Run a stage and write its artefact. The stage gets only inputs that are in its fingerprint."""
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
    """Refuse masks of frames whose images have changed; return the check of masks of views, to call later.

    The returned check takes the folder of the new views; it is None if there are no masks. Checks only refuse
    masks, and never change a stage's result. So masks.json is in no fingerprint, and after a refusal the
    stage is tried again.
    """
    from kinectbench.engine.drawn_masks import DrawnMasks
    from kinectbench.stages.ingest.sequence_folder import read_sequence

    drawn, sequence = DrawnMasks.of(job), read_sequence(job.build / FOLDERS["ingest"])
    if drawn is None:
        return None
    return partial(drawn.check_frames(sequence).check_views, sequence)


def _explained(job: Job, failure: KinectBenchError) -> str:
    """Return the message of a failure with its likely cause, which comes first if the poses prove it."""
    from kinectbench.doctor.during_build import likely_cause
    from kinectbench.stages.ingest.readers import open_recording

    try:
        recording = open_recording(job.source, job.recording.camera, follow_links=job.recording.follow_links)
        if job.recording.trajectory_mode == "ignore" or job.recording.segment_by:
            recording = replace(recording, given_trajectory=None, trajectory_error="")
        cause, proven = likely_cause(recording)
    except KinectBenchError:
        return str(failure)  # the recording has since been removed or damaged
    if cause and not proven:
        return f"{failure}. Perhaps why: {cause}"
    return f"{cause}. What failed: {failure}" if cause else str(failure)
