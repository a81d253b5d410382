"""Processes of this machine as an executor: a killed one costs nothing but time.

A pool of loky breaks, too, when a process is killed, and what it did not do begins again here all the same.
"""

import contextlib
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from kinectbench.engine.executor import Listener, Outcomes, Result, SendMessage, Task, WorkerLost
from kinectbench.engine.interrupts import check_interrupt
from kinectbench.engine.processes import CONTEXT, submit_all, worker_pool

if TYPE_CHECKING:
    from multiprocessing.queues import Queue

KILLED_ALONE = (
    "its process was killed although no other ran beside it, perhaps for lack of memory; "
    "free some memory and run again, or look for the reason with `kinectbench build {id} --jobs 1`"
)
# Seconds between two polls of the tasks' messages.
LISTEN_S = 0.2


@dataclass(frozen=True)
class Pool:
    """A pool of processes on this machine, which end with this one.

    Where one is killed (by the system, for lack of memory), the tasks that were not done are carried out on
    half as many, and in the end one at a time: then it is known which one cannot be, and the others are
    carried out by all processes again.
    """

    processes: int

    def slots(self) -> int:
        """The number of processes."""
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
        """See `Executor`; no task runs twice, as another local process is no faster."""
        left, at_once = list(tasks), self.processes
        while left:
            left, hangs = yield from _until_killed(function, left, at_once, listener)
            check_interrupt()  # a SIGTERM to the whole group ends the workers, too
            if left and hangs:
                listener.warn("the process of a recording that hangs was ended; those beside it begin again")
            elif left and at_once == 1:
                # A single process takes them in their order: the first that is left killed it.
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
    """Run tasks until a process is killed; returns the remaining ones, and whether one hangs."""
    messages = CONTEXT.Queue()
    undone, hangs = dict(enumerate(tasks)), False
    try:
        with worker_pool(processes, _keep_queue, (messages,)) as pool:
            # To wait for all that are pending would look at each of them each time.
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
    """The next finished task; messages of the tasks are reported until then."""
    while True:
        ended = None
        with contextlib.suppress(Empty):
            ended = done.get(timeout=LISTEN_S)
        for message in _drained(messages):
            listener.heard(message)
        if ended is not None:
            return ended


# In a worker process: the way of what its task says to the parent.
_messages: list["Queue[object]"] = []


def _keep_queue(messages: "Queue[object]") -> None:
    messages.cancel_join_thread()  # a worker must not wait at its end for messages nobody reads
    _messages.append(messages)


def _call(function: Callable[[Task, SendMessage], Result], task: Task) -> Result:
    return function(task, _messages[-1].put)


def _drained(messages: "Queue[object]") -> Iterator[object]:
    while True:
        try:
            yield messages.get_nowait()
        except Empty:
            return
