"""Running the stages: what is current is skipped, recordings run in parallel, errors are told apart."""

import json
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from queue import Empty
from typing import Any

from kinectbench.errors import KinectBenchError, internal_error
from kinectbench.interrupts import check_interrupt
from kinectbench.processes import CONTEXT, KILLED, submit_all, worker_pool
from kinectbench.stages import STAGES, Job, Stage, stages_upto
from kinectbench.workspace import Artefact, locked, pretty_json

StageProgress = Callable[[str, int, int], None]
RecordingProgress = Callable[[str, str, int, int], None]


@dataclass(frozen=True)
class Outcome:
    """What became of one recording: the stages made and those still current, the error or None."""

    recording: str
    made: tuple[str, ...]
    current: tuple[str, ...]
    error: str | None
    seconds: float


STAGE_NAMES = tuple(stage.name for stage in STAGES)


def build_recording(
    job: Job,
    upto: str = "pairs",
    force: Sequence[str] = (),
    progress: Callable[[str, int, int], None] | None = None,
) -> Outcome:
    """Bring one recording up to date as far as a stage. Its errors are told, not raised.

    Not even an unforeseen one may stop the other recordings (but does with KINECTBENCH_DEBUG set).

    Args:
        job: the recording.
        upto: name of the last stage.
        force: names of stages to make anew even if they are current.
        progress: called with (stage, done, total).
    """
    report = progress or (lambda stage, done, total: None)
    started = time.monotonic()
    made: list[str] = []
    current: list[str] = []
    error = None
    try:
        with locked(job.build):
            artefacts: dict[str, Artefact] = {}
            for stage in stages_upto(upto):
                artefact = _artefact(job, stage, artefacts)
                artefacts[stage.name] = artefact
                if artefact.is_current() and stage.name not in force:
                    current.append(stage.name)
                    continue
                report(stage.name, 0, 1)
                _make(job, stage, artefact, report)
                made.append(stage.name)
    except KinectBenchError as failure:
        error = str(failure)
    except Exception as failure:
        if os.environ.get("KINECTBENCH_DEBUG"):
            raise
        error = internal_error(failure)
    if error is not None:
        check_interrupt()  # an interrupt in the midst of an import may look like an error
    return Outcome(job.recording.id, tuple(made), tuple(current), error, time.monotonic() - started)


def is_current(job: Job, upto: str) -> bool:
    """Whether all stages up to the named one are made and current."""
    artefacts: dict[str, Artefact] = {}
    for stage in stages_upto(upto):
        artefacts[stage.name] = _artefact(job, stage, artefacts)
    return all(artefact.is_current() for artefact in artefacts.values())


def _artefact(job: Job, stage: Stage, artefacts: Mapping[str, Artefact]) -> Artefact:
    inputs = {name: artefacts[name].fingerprint for name in stage.inputs} | dict(stage.sources(job))
    return Artefact(job.build / stage.folder, stage.name, stage.settings(job), inputs)


def _make(job: Job, stage: Stage, artefact: Artefact, report: Callable[[str, int, int], None]) -> None:
    started = time.monotonic()
    with artefact.write() as folder:
        stage.run(job, folder, lambda done, total: report(stage.name, done, total))
        timing = {"seconds": round(time.monotonic() - started, 3)}
        (folder / "timing.json").write_text(pretty_json(timing))


def summary(job: Job, stages: Collection[str]) -> dict[str, Any]:
    """The key figures of a recording, for the table at the end; None where not built.

    Args:
        job: the recording.
        stages: those that are made and current; what lies there of others is of an earlier run.
    """

    def read(stage: str, name: str) -> dict[str, Any]:
        if stage not in stages:
            return {}
        try:
            content: dict[str, Any] = json.loads((job.build / name).read_text())
        except (OSError, ValueError):
            return {}
        return content

    sequence, health = read("ingest", "sequence/camera.json"), read("track", "trajectory/health.json")
    quality, views = read("segment", "object/quality.json"), read("sample-views", "views/views.json")
    pairs = read("pairs", "pairs/pairs.json")
    rows = pairs.get("pairs", [])
    return {
        "recording": job.recording.id,
        "frames": sequence.get("frames"),
        "left_out": [row["frame"] for row in health.get("rejected", [])] if health else None,
        "lost": len(health["lost"]) if health else None,
        **{key: health.get(key) for key in ("source", "grade", "verdict", "recommended")},
        "repeatability_iou": quality.get("repeatability_iou"),
        "estimated_iou": quality.get("estimated_iou"),
        "views": len(views["views"]) if views else None,
        "pairs": len(rows) if pairs else None,
        "refused": len(pairs.get("refused", [])) + len(views.get("refused", [])) if pairs else None,
        "containment": round(sum(r["containment"] for r in rows) / len(rows), 4) if rows else None,
        "residual_mm": round(1000 * sum(r["residual_m"] for r in rows) / len(rows), 2) if rows else None,
        "warnings": [
            warning for part in (sequence, health, quality, views) for warning in part.get("warnings", [])
        ],
    }


def build(
    jobs: Sequence[Job],
    upto: str = "pairs",
    force: Sequence[str] = (),
    workers: int = 1,
    progress: RecordingProgress | None = None,
) -> list[Outcome]:
    """Bring recordings up to date, each for itself; one that fails does not stop the others.

    Args:
        jobs: the recordings.
        upto: name of the last stage.
        force: names of stages to make anew even if they are current.
        workers: processes; the results do not depend on how many.
        progress: called in this process with (recording, stage, done, total).

    Returns:
        One outcome per job, in their order.
    """
    report = progress or (lambda recording, stage, done, total: None)
    if workers <= 1 or len(jobs) <= 1:
        return [build_recording(job, upto, force, _for(job.recording.id, report)) for job in jobs]
    messages = CONTEXT.Queue()
    try:
        with worker_pool(min(workers, len(jobs)), _keep_queue, (messages,)) as pool:
            futures = submit_all(pool, partial(_build_in_worker, upto=upto, force=force), jobs)
            pending: set[Future[Outcome]] = set(futures)
            while pending:
                _, pending = wait(pending, timeout=0.2, return_when=FIRST_COMPLETED)
                for message in _drained(messages):
                    report(*message)
            return [_outcome(job, future) for job, future in zip(jobs, futures, strict=True)]
    except BaseException:
        for job in jobs:
            with locked(job.build):  # sweeps away what the workers left behind
                pass
        raise


def _outcome(job: Job, future: Future[Outcome]) -> Outcome:
    try:
        return future.result()
    except BrokenProcessPool:
        return Outcome(job.recording.id, (), (), KILLED, 0.0)


def _for(recording: str, report: RecordingProgress) -> StageProgress:
    return lambda stage, done, total: report(recording, stage, done, total)


# In a worker process: the way of its progress to the parent.
_messages: list[Any] = []


def _keep_queue(messages: Any) -> None:
    messages.cancel_join_thread()  # a worker must not wait at its end for messages nobody reads
    _messages.append(messages)


def _build_in_worker(job: Job, upto: str, force: Sequence[str]) -> Outcome:
    return build_recording(job, upto, force, lambda *step: _messages[-1].put((job.recording.id, *step)))


def _drained(messages: Any) -> Iterator[tuple[str, str, int, int]]:
    while True:
        try:
            yield messages.get_nowait()
        except Empty:
            return
