"""Running the stages: what is current is skipped, recordings run in parallel, errors are told apart."""

import json
import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from queue import Empty
from typing import Any

from kinectbench.errors import KinectBenchError
from kinectbench.stages import STAGES, Job, Stage
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
    force: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> Outcome:
    """Bring one recording up to date as far as a stage. Its errors are told, not raised.

    Args:
        job: the recording.
        upto: name of the last stage.
        force: make that last stage anew even if it is current.
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
            for stage in STAGES[: STAGE_NAMES.index(upto) + 1]:
                artefact = _artefact(job, stage, artefacts)
                artefacts[stage.name] = artefact
                if artefact.is_current() and not (force and stage.name == upto):
                    current.append(stage.name)
                    continue
                report(stage.name, 0, 1)
                _make(job, stage, artefact, report)
                made.append(stage.name)
    except KinectBenchError as failure:
        error = str(failure)
    return Outcome(job.recording.id, tuple(made), tuple(current), error, time.monotonic() - started)


def _artefact(job: Job, stage: Stage, artefacts: Mapping[str, Artefact]) -> Artefact:
    inputs = {name: artefacts[name].fingerprint for name in stage.inputs} | dict(stage.sources(job))
    return Artefact(job.build / stage.folder, stage.name, stage.settings(job), inputs)


def _make(job: Job, stage: Stage, artefact: Artefact, report: Callable[[str, int, int], None]) -> None:
    started = time.monotonic()
    with artefact.write() as folder:
        stage.run(job, folder, lambda done, total: report(stage.name, done, total))
        timing = {"seconds": round(time.monotonic() - started, 3)}
        (folder / "timing.json").write_text(pretty_json(timing))


def summary(job: Job) -> dict[str, Any]:
    """The key figures of what is built of a recording, for the table at the end; None where not built."""

    def read(name: str) -> dict[str, Any]:
        try:
            content: dict[str, Any] = json.loads((job.build / name).read_text())
        except (OSError, ValueError):
            return {}
        return content

    health, quality = read("trajectory/health.json"), read("object/quality.json")
    sequence, views, pairs = read("sequence/camera.json"), read("views/views.json"), read("pairs/pairs.json")
    rows = pairs.get("pairs", [])
    return {
        "recording": job.recording.id,
        "frames": sequence.get("frames"),
        "left_out": [row["frame"] for row in health.get("rejected", [])] if health else None,
        "lost": len(health["lost"]) if health else None,
        "repeatability_iou": quality.get("repeatability_iou"),
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
    force: bool = False,
    workers: int = 1,
    progress: RecordingProgress | None = None,
) -> list[Outcome]:
    """Bring recordings up to date, each for itself; one that fails does not stop the others.

    Args:
        jobs: the recordings.
        upto: name of the last stage.
        force: make that stage anew even if it is current.
        workers: processes (started by `spawn`: `fork` hangs after numba or Open3D); the results do not
            depend on how many.
        progress: called in this process with (recording, stage, done, total).

    Returns:
        One outcome per job, in their order.
    """
    report = progress or (lambda recording, stage, done, total: None)
    if workers <= 1 or len(jobs) <= 1:
        return [build_recording(job, upto, force, _for(job.recording.id, report)) for job in jobs]
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, _pool(min(workers, len(jobs)), context) as pool:
        messages = manager.Queue()
        futures = [pool.submit(_build_in_worker, job, upto, force, messages) for job in jobs]
        pending: set[Future[Outcome]] = set(futures)
        while pending:
            _, pending = wait(pending, timeout=0.2, return_when=FIRST_COMPLETED)
            for message in _drained(messages):
                report(*message)
        return [future.result() for future in futures]


@contextmanager
def _pool(workers: int, context: Any) -> Iterator[ProcessPoolExecutor]:
    """A pool that an interrupt stops at once instead of finishing what is queued."""
    pool = ProcessPoolExecutor(workers, mp_context=context)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _for(recording: str, report: RecordingProgress) -> StageProgress:
    return lambda stage, done, total: report(recording, stage, done, total)


def _build_in_worker(job: Job, upto: str, force: bool, messages: Any) -> Outcome:
    """Runs in a worker process; progress travels through a queue."""
    return build_recording(job, upto, force, lambda *step: messages.put((job.recording.id, *step)))


def _drained(messages: Any) -> Iterator[tuple[str, str, int, int]]:
    while True:
        try:
            yield messages.get_nowait()
        except Empty:
            return
