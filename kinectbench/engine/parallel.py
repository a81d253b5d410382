"""Building many recordings, several at a time: none stops the others, even if its process is killed."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from kinectbench.core.errors import StorageError
from kinectbench.core.threads import using_threads
from kinectbench.engine.failures import keep_failure
from kinectbench.engine.interrupts import check_interrupt
from kinectbench.engine.locks import locked
from kinectbench.engine.pipeline import Outcome, build_recording
from kinectbench.engine.processes import CONTEXT, submit_all, worker_pool
from kinectbench.engine.stages import Job

# Threads of one recording: each holds a pair of its own in memory. The peak of `pairs`, measured on 92 frames
# of a phone: 274 MiB with one, 301 with two, 340 with 4, 415 with 8, 504 with 16. Time was measured on two
# cores only.
MOST_THREADS = 8
KILLED_ALONE = (
    "its process was killed although no other ran beside it, perhaps for lack of memory; "
    "free some memory and run again, or look for the reason with `kinectbench build {id} --jobs 1`"
)


class Watcher(Protocol):
    """Whoever wants to know how far the recordings are."""

    def __call__(self, recording: str, stage: str, done: int, total: int) -> None:
        """A recording is so far in a stage."""

    def ended(self, outcome: Outcome) -> None:
        """A recording is up to date, or has failed."""

    def warn(self, message: str) -> None:
        """Something that concerns all of them."""


class _Nobody:
    def __call__(self, recording: str, stage: str, done: int, total: int) -> None: ...
    def ended(self, outcome: Outcome) -> None: ...
    def warn(self, message: str) -> None: ...


# `build_recording` with all but the job and who is told how far it is.
BuildOne = Callable[..., Outcome]


def build(
    jobs: Sequence[Job],
    upto: str = "pairs",
    force: Sequence[str] = (),
    workers: int = 1,
    watcher: Watcher | None = None,
    *,
    wait_for_others: bool = True,
) -> list[Outcome]:
    """Bring recordings up to date, each for itself; one that fails does not stop the others.

    Where a worker process is killed (by the system, for lack of memory), the recordings that were not done
    are built on half as many processes, and in the end one at a time: then it is known which one cannot be.

    Args:
        jobs: the recordings.
        upto: name of the last stage.
        force: names of stages to make anew even if they are current.
        workers: processes, or threads of a recording that is alone, at most eight; the results do not depend
            on how many.
        watcher: told in this process how far each recording is.
        wait_for_others: whether to wait for another run that is at the same recording, or to let it fail.

    Returns:
        One outcome per job, in their order.
    """
    outcomes = _Outcomes(watcher or _Nobody())
    build_one = partial(build_recording, upto=upto, force=tuple(force), wait=wait_for_others)
    if workers <= 1 or len(jobs) <= 1:
        with using_threads(min(workers, MOST_THREADS)):
            for job in jobs:
                outcomes.add(build_one(job, progress=partial(outcomes.tell, job.recording.id)))
        return list(outcomes.by_id.values())
    left, at_once = list(jobs), min(workers, len(jobs))
    try:
        while left:
            left = _in_pool(left, at_once, build_one, outcomes)
            check_interrupt()  # a SIGTERM to the whole group ends the workers, too
            if left and at_once == 1:
                # A single process takes them in their order: the first that is left killed it.
                culprit, *left = left
                outcomes.add(_killed(culprit))
            elif left:
                at_once = max(at_once // 2, 1)
                outcomes.watcher.warn(
                    "a worker process was killed, perhaps for lack of memory; "
                    f"going on with {at_once} recording{'s' * (at_once > 1)} at a time"
                )
    except BaseException:
        _clear_away(jobs)
        raise
    return [outcomes.by_id[job.recording.id] for job in jobs]


@dataclass(frozen=True)
class _Outcomes:
    """What has become of the recordings so far."""

    watcher: Watcher
    by_id: dict[str, Outcome] = field(default_factory=dict)

    def tell(self, recording: str, stage: str, done: int, total: int) -> None:
        if recording not in self.by_id:  # messages may come later than the outcome
            self.watcher(recording, stage, done, total)

    def add(self, outcome: Outcome) -> None:
        self.by_id[outcome.recording] = outcome
        self.watcher.ended(outcome)


def _killed(job: Job) -> Outcome:
    error = KILLED_ALONE.format(id=job.recording.id)
    keep_failure(job.build, None, error)
    return Outcome(job.recording.id, (), (), error, 0.0)


def _in_pool(jobs: Sequence[Job], workers: int, build_one: BuildOne, outcomes: _Outcomes) -> list[Job]:
    """Build them on so many processes; returns those that were not done when a process was killed."""
    messages = CONTEXT.Queue()
    try:
        with worker_pool(workers, _keep_queue, (messages,)) as pool:
            # To wait for all that are pending would look at each of them each time.
            done = SimpleQueue[Future[Outcome]]()
            alone = [job.alone for job in jobs]
            for future in submit_all(pool, partial(_build_in_worker, build_one), alone):
                future.add_done_callback(done.put)
            for _ in jobs:
                future = _next_done(done, messages, outcomes)
                outcomes.add(future.result())
    except BrokenProcessPool:
        pass
    return [job for job in jobs if job.recording.id not in outcomes.by_id]


def _next_done(done: "SimpleQueue[Future[Outcome]]", messages: Any, outcomes: _Outcomes) -> Future[Outcome]:
    """The next recording that is done; until then what the workers say is told."""
    while True:
        ended = None
        with contextlib.suppress(Empty):
            ended = done.get(timeout=0.2)
        for message in _drained(messages):
            outcomes.tell(*message)
        if ended is not None:
            return ended


def _clear_away(jobs: Sequence[Job]) -> None:
    """Remove what the workers left behind; not where another run is at work, or none has begun."""
    for job in jobs:
        if not job.build.is_dir():
            continue
        try:
            with locked(job.build, wait=False):
                pass
        except StorageError:
            continue


# In a worker process: the way of its progress to the parent.
_messages: list[Any] = []


def _keep_queue(messages: Any) -> None:
    messages.cancel_join_thread()  # a worker must not wait at its end for messages nobody reads
    _messages.append(messages)


def _build_in_worker(build_one: BuildOne, job: Job) -> Outcome:
    def report(stage: str, done: int, total: int) -> None:
        _messages[-1].put((job.recording.id, stage, done, total))

    return build_one(job, progress=report)


def _drained(messages: Any) -> Iterator[tuple[str, str, int, int]]:
    while True:
        try:
            yield messages.get_nowait()
        except Empty:
            return
