"""Executors of tasks: this process, processes of this machine, or a cluster.

Code that runs many tasks needs only `Executor`; its results do not depend on which executor runs it.

The package loky would not help for `Pool`: its pool also breaks if a process is killed.
"""

import contextlib
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

from kinectbench.engine.interrupts import check_interrupt
from kinectbench.engine.processes import CONTEXT, submit_all, worker_pool

if TYPE_CHECKING:
    from multiprocessing.queues import Queue


Task = TypeVar("Task")
Result = TypeVar("Result")
# A callback by which a task reports progress, as texts and numbers.
SendMessage = Callable[[Any], None]


@dataclass(frozen=True)
class WorkerLost:
    """Returned instead of a result: the task's process hangs, or was killed even when it ran alone.

    If a task hangs, its process returns this value and ends soon after.

    Attributes:
        reason: one line, in which `{id}` stands for the recording.
    """

    reason: str


# The iterator over results that an executor returns.
Outcomes: TypeAlias = Generator[tuple[Task, Result | WorkerLost], None, None]


class Listener(Protocol):
    """Receives the messages of running tasks, always in this process."""

    def heard(self, message: Any) -> None:
        """Receive a task's message."""

    def warn(self, message: str, task: Any = None) -> None:
        """Receive a one-line warning about all tasks or one; `{id}` in it stands for the task's recording."""


class Executor(Protocol):
    """Runs tasks, several at a time."""

    def slots(self) -> int:
        """Return the number of tasks that can run at the same time now."""

    def outcomes(
        self,
        function: Callable[[Task, SendMessage], Result],
        tasks: Sequence[Task],
        listener: Listener,
        memory_gb: Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        """Yield each finished task with its result, in any order.

        If the caller closes the iterator before the end, running tasks are stopped; on other machines they
        may run to their end.

        Args:
            function: a module-level function or a partial of one; it may be called several times for a task.
            tasks: the tasks; must be picklable.
            listener: receives the messages of the tasks.
            memory_gb: largest expected memory of a task, GB, for executors that assign memory.
            slowest_twice: whether idle workers may run the last tasks a second time, and the first result
                counts; only for tasks that do not wait for each other.

        Raises:
            Exception: an error of the function. On a cluster, errors other than KinectBenchError are raised
                as ClusterError.
            ClusterError: the cluster cannot be used any more.
        """


class SerialExecutor:
    """Runs tasks one after another in this process."""

    def slots(self) -> int:
        """Always one."""
        return 1

    def outcomes(
        self,
        function: Callable[[Task, SendMessage], Result],
        tasks: Sequence[Task],
        listener: Listener,
        memory_gb: Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        """See `Executor`; no task can be lost."""
        for task in tasks:
            yield task, function(task, listener.heard)


KILLED_ALONE = (
    "its process was killed although no other ran beside it, perhaps for lack of memory; "
    "free some memory and run again, or look for the reason with `kinectbench build {id} --jobs 1`"
)
# Seconds between two checks for messages of tasks.
LISTEN_S = 0.2


@dataclass(frozen=True)
class Pool:
    """A pool of processes on this machine, which end with this process.

    If a process is killed (by the system, for lack of memory), the unfinished tasks run on half as many
    processes, at last on one. A task that kills even the single process fails, and the other tasks run on
    all processes again.
    """

    processes: int

    def slots(self) -> int:
        """Return the number of processes."""
        return self.processes

    def outcomes(
        self,
        function: Callable[[Task, SendMessage], Result],
        tasks: Sequence[Task],
        listener: Listener,
        memory_gb: Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        """See `Executor`; `slowest_twice` is ignored, because another local process is no faster."""
        left, at_once = list(tasks), self.processes
        while left:
            left, hangs = yield from _until_killed(function, left, at_once, listener)
            check_interrupt()  # a SIGTERM to the process group ends the workers, too
            if left and hangs:
                listener.warn("the process of a recording that hangs was ended; those beside it begin again")
            elif left and at_once == 1:
                # A single process runs the tasks in order, so the first unfinished one killed it.
                culprit, *left = left
                at_once = self.processes
                yield culprit, WorkerLost(KILLED_ALONE)
            elif left:
                at_once = max(at_once // 2, 1)
                listener.warn(
                    "a worker process was killed, perhaps for lack of memory; "
                    f"going on with {at_once} recording{'s' * (at_once > 1)} at a time"
                )


def _until_killed(
    function: Callable[[Task, SendMessage], Result], tasks: Sequence[Task], processes: int, listener: Listener
) -> Generator[tuple[Task, Result | WorkerLost], None, tuple[list[Task], bool]]:
    """Yield outcomes until a process is killed; return the unfinished tasks, and whether a task hangs."""
    messages = CONTEXT.Queue()
    undone, hangs = dict(enumerate(tasks)), False
    try:
        with worker_pool(processes, _keep_queue, (messages,)) as pool:
            # A queue, because waiting for all pending futures would check each of them each time.
            done = SimpleQueue[Future[Result]]()
            numbers = {}
            for number, future in enumerate(submit_all(pool, partial(_call, function), tasks)):
                numbers[future] = number
                future.add_done_callback(done.put)
            for _ in tasks:
                future = _next_done(done, messages, listener)
                result = future.result()
                hangs = isinstance(result, WorkerLost)
                yield undone.pop(numbers[future]), result
                if hangs:
                    raise BrokenProcessPool
    except BrokenProcessPool:
        pass
    return list(undone.values()), hangs


def _next_done(
    done: "SimpleQueue[Future[Result]]", messages: "Queue[object]", listener: Listener
) -> "Future[Result]":
    """Wait for the next finished task; pass on messages of tasks meanwhile."""
    while True:
        ended = None
        with contextlib.suppress(Empty):
            ended = done.get(timeout=LISTEN_S)
        for message in _drained(messages):
            listener.heard(message)
        if ended is not None:
            return ended


# The queue for messages to the parent, in a worker process.
_messages: list["Queue[object]"] = []


def _keep_queue(messages: "Queue[object]") -> None:
    messages.cancel_join_thread()  # an ending worker must not wait for unread messages
    _messages.append(messages)


def _call(function: Callable[[Task, SendMessage], Result], task: Task) -> Result:
    return function(task, _messages[-1].put)


def _drained(messages: "Queue[object]") -> Iterator[object]:
    while True:
        try:
            yield messages.get_nowait()
        except Empty:
            return
