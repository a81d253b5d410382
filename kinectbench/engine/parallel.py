"""Building many recordings, several at a time: none stops the others, even if its process is killed."""

from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from kinectbench.core.errors import KILLED
from kinectbench.core.threads import using_threads
from kinectbench.engine.executor import Executor, SendMessage, SerialExecutor, WorkerLost
from kinectbench.engine.memory import expected_gb
from kinectbench.engine.pipeline import Outcome
from kinectbench.engine.place import (
    build_at_its_place,
    clear_away,
    for_elsewhere,
    keep_killed,
    waits_for_others,
)
from kinectbench.engine.pool import Pool
from kinectbench.engine.scratch import clear_scratch
from kinectbench.engine.stages import Job
from kinectbench.engine.time_limit import watched

# Threads of one recording: each holds a pair of its own in memory. The peak of `pairs`, measured on 92 frames
# of a phone: 274 MiB with one, 301 with two, 340 with 4, 415 with 8, 504 with 16. Time was measured on two
# cores only.
MOST_THREADS = 8


class ProgressWatcher(Protocol):
    """Receives the progress of recordings."""

    def __call__(self, recording: str, stage: str, done: int, total: int) -> None:
        """Report the progress of a recording in a stage."""

    def ended(self, outcome: Outcome) -> None:
        """A recording is up to date, or has failed."""

    def warn(self, message: str) -> None:
        """Receive a warning that concerns all recordings."""


class _Nobody:
    def __call__(self, recording: str, stage: str, done: int, total: int) -> None: ...
    def ended(self, outcome: Outcome) -> None: ...
    def warn(self, message: str) -> None: ...


# `build_at_its_place` with all arguments but the job and the progress callback.
BuildOne = Callable[..., Outcome]


def build(
    jobs: Sequence[Job],
    upto: str = "pairs",
    force: Sequence[str] = (),
    workers: int = 1,
    watcher: ProgressWatcher | None = None,
    *,
    wait_for_others: bool = True,
    limit_s: float | None = None,
    executor: Executor | None = None,
) -> list[Outcome]:
    """Bring recordings up to date independently; a failure does not stop the others.

    A recording whose process is killed, in the end with nothing beside it, or hangs, fails, and its
    `failed.json` says so.

    Args:
        jobs: the recordings.
        upto: name of the last stage.
        force: names of stages to make again even if they are current.
        workers: processes, or threads of a recording that is alone, at most eight; the results do not depend
            on how many.
        watcher: called in this process with the progress of each recording.
        wait_for_others: whether to wait for another run that is at the same recording, or to let it fail.
        limit_s: how long a recording may take, seconds; None: as long as it does.
        executor: where they are built, in place of `workers` processes here.

    Returns:
        One outcome per job, in their order.

    Raises:
        ClusterError: the executor cannot be used any more; what is done is kept.
    """
    outcomes = _Outcomes(watcher or _Nobody())
    build_one = partial(
        build_at_its_place, upto=upto, force=tuple(force), wait=wait_for_others, limit_s=limit_s
    )
    alone = executor is None and (workers <= 1 or len(jobs) <= 1)
    tasks = [job.alone if executor is None else for_elsewhere(job.alone) for job in jobs]
    where = executor or (SerialExecutor() if alone else Pool(min(workers, len(jobs))))
    results = where.outcomes(
        partial(_build if alone or limit_s is None else _build_watched, build_one),
        tasks,
        outcomes,
        expected_gb,
        slowest_twice=not any(map(waits_for_others, jobs)),
    )
    try:
        with using_threads(min(workers, MOST_THREADS)) if alone else nullcontext(), closing(results):
            for job, outcome in results:
                outcomes.add(_killed(job, outcome) if isinstance(outcome, WorkerLost) else outcome)
    except BaseException:
        for job in jobs if not alone else ():
            clear_away(job)
        if not alone:
            clear_scratch()
        raise
    return [outcomes.by_id[job.recording.id] for job in jobs]


def _build_watched(build_one: BuildOne, job: Job, say: SendMessage) -> Outcome | WorkerLost:
    """Build a recording in a worker process, which ends if the recording hangs."""
    return watched(lambda hung: _build(partial(build_one, hung=hung), job, say))


def _build(build_one: BuildOne, job: Job, say: SendMessage) -> Outcome:
    """Build a recording on whichever worker runs the task."""

    def report(stage: str, done: int, total: int) -> None:
        say((job.recording.id, stage, done, total))

    return build_one(job, progress=report)


@dataclass(frozen=True)
class _Outcomes:
    """The outcomes of recordings so far."""

    watcher: ProgressWatcher
    by_id: dict[str, Outcome] = field(default_factory=dict)

    def heard(self, message: tuple[str, str, int, int]) -> None:
        recording, stage, done, total = message
        if recording not in self.by_id:  # messages may come later than the outcome
            self.watcher(recording, stage, done, total)

    def warn(self, message: str, task: Job | None = None) -> None:
        self.watcher.warn(message if task is None else message.format(id=task.recording.id))

    def add(self, outcome: Outcome) -> None:
        self.by_id[outcome.recording] = outcome
        self.watcher.ended(outcome)


def _killed(job: Job, lost: WorkerLost) -> Outcome:
    error = lost.reason.format(id=job.recording.id)
    keep_killed(job, error)
    return Outcome(job.recording.id, (), (), error, 0.0, code=KILLED)
