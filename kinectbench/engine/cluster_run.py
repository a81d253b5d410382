"""Run tasks on a cluster: submit them, receive messages, and submit them again if a worker dies."""

import pickle
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from statistics import median
from typing import TYPE_CHECKING, Any, Generic

from kinectbench.core import ClusterError, KinectBenchError
from kinectbench.engine.executor import Listener, Result, SendMessage, Task, WorkerLost
from kinectbench.engine.on_worker import call, package_versions

if TYPE_CHECKING:
    from distributed import Client, Future

KILLED_ALONE = (
    "its worker was killed although no other recording ran, perhaps for lack of memory; start workers with "
    "more memory and run again, or look for the reason with `kinectbench build {id} --jobs 1`"
)
# Seconds: until the result of a finished task must arrive; of one wait for an event.
RESULT_S, LISTEN_S = 20.0, 1.0


@dataclass
class Run(Generic[Task, Result]):
    """The state of one call of `Cluster.outcomes`; tasks are identified by their index.

    Attributes:
        client: client of the scheduler.
        largest_gb: returns the largest resource `memory_gb` of a worker.
        gone: returns the error for a scheduler that has stopped answering.
        function: computes a task's result.
        tasks: all tasks.
        listener: receives the messages.
        memory_gb: expected memory of a task, GB.
        events: messages of tasks and of the scheduler, and futures that have ended.
        running: index of the task of each running future; a task that runs twice has two futures.
        asked_gb: memory requested for each submitted task.
        submitted_s: time of the first submission of each task, by `time.monotonic`.
        seconds: durations of the finished tasks.
        alone: tasks that run while no other task does.
        killed: tasks whose workers were killed, to be tried again alone.
        orphaned: for each task whose worker has gone, when (`time.monotonic`) and why.
    """

    client: "Client"
    largest_gb: Callable[[], float]
    gone: Callable[[], ClusterError]
    function: Callable[[Task, SendMessage], Result]
    tasks: Sequence[Task]
    listener: Listener
    memory_gb: Callable[[Task], float] | None
    events: "SimpleQueue[Any]" = field(default_factory=SimpleQueue)
    running: "dict[Future, int]" = field(default_factory=dict)
    asked_gb: dict[int, float] = field(default_factory=dict)
    submitted_s: dict[int, float] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    alone: set[int] = field(default_factory=set)
    killed: deque[int] = field(default_factory=deque)
    orphaned: dict[int, tuple[float, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.waiting = deque(range(len(self.tasks)))
        self.topic = f"kinectbench-{self.client.id}"
        self.client.subscribe_topic(self.topic, lambda event: self.events.put(event[1]))
        self.client.subscribe_topic("all", lambda event: self.events.put(event[1]))
        self.versions = package_versions()

    def submit(self, number: int, *, alone: bool = False) -> None:
        """Submit the task of this index; `alone`: no other task runs, so it may use twice the memory."""
        task, largest_gb = self.tasks[number], self.largest_gb()
        asked_gb = 0.0
        if self.memory_gb is not None and largest_gb:
            asked_gb = min(self.memory_gb(task) * (2 if alone else 1), largest_gb)
        self.asked_gb[number] = asked_gb
        packed = pickle.dumps((self.function, task))  # a worker unpacks it, as that may kill it
        how = {"pure": False, "resources": {"memory_gb": asked_gb} if asked_gb else None}
        key = f"{self.topic}-{number}-{time.monotonic_ns()}"
        try:
            future = self.client.submit(call, packed, self.topic, self.versions, key=key, **how)
        except Exception as error:  # the scheduler has gone since the last request
            raise self.gone() from error
        self.running[future] = number
        self.submitted_s.setdefault(number, time.monotonic())
        if alone:
            self.alone.add(number)
        future.add_done_callback(self.events.put)

    def ask_for_less(self) -> None:
        """Submit tasks again with less memory if they request more than any remaining worker has."""
        largest_gb = self.largest_gb()
        for future, number in list(self.running.items()):
            if self.asked_gb[number] > largest_gb:
                del self.running[future]
                future.cancel()
                self.submit(number, alone=number in self.alone)

    def submit_slowest(self) -> None:
        """Submit the longest running task to a second worker, if it takes twice the usual time."""
        copies = Counter(self.running.values())
        single = [number for number, count in copies.items() if count == 1 and number not in self.alone]
        slowest = min(single, key=self.submitted_s.__getitem__, default=None)
        usual_s = median(self.seconds) if self.seconds else float("inf")
        if slowest is not None and time.monotonic() - self.submitted_s[slowest] > 2 * usual_s:
            self.submit(slowest)

    def ended(self) -> Iterator[tuple[Task, Result | WorkerLost]]:
        """Wait up to a second for an event; yield the task and its outcome if one has ended."""
        self._tell_orphaned()
        try:
            event = self.events.get(timeout=LISTEN_S)
        except Empty:
            return
        if isinstance(event, tuple | list):
            self.listener.heard(tuple(event))
            return
        if isinstance(event, dict):
            self._note_orphaned(event)
            return
        number = self.running.pop(event, None)
        if number is None:
            return  # another copy of the task was faster
        try:
            outcome = self._outcome(event, number)
        except TimeoutError:  # its worker is slow, or died: Dask then repeats the task
            self.running[event] = number
            event.add_done_callback(self.events.put)
            return
        if outcome is None:
            return
        for copy in [future for future, same in self.running.items() if same == number]:
            del self.running[copy]
            copy.cancel()
        self._tell_orphaned(number)
        self.seconds.append(time.monotonic() - self.submitted_s.pop(number))
        yield self.tasks[number], outcome

    def _note_orphaned(self, event: dict[str, Any]) -> None:
        """If the scheduler reports that a worker was removed, record the tasks that the worker had."""
        if event.get("action") != "remove-worker":
            return
        gone = {*event.get("processing-tasks", ()), *event.get("lost-computed-tasks", ())}
        why = "was stopped" if event.get("expected") else "died, perhaps for lack of memory"
        for future, number in self.running.items():
            if future.key in gone:
                self.orphaned.setdefault(number, (time.monotonic(), why))

    def _tell_orphaned(self, ended: int | None = None) -> None:
        """Warn of workers lost over a second ago; of the lost worker of the task `ended`, warn at once."""
        for number, (since, why) in list(self.orphaned.items()):
            if number == ended or time.monotonic() - since >= LISTEN_S:
                del self.orphaned[number]
                line = f"{{id}}: its worker {why}; the recording is tried again"
                self.listener.warn(line, self.tasks[number])

    def _outcome(self, future: "Future", number: int) -> Result | WorkerLost | None:
        """Return the outcome of a task; None if the task is tried again at the end, or runs elsewhere.

        Raises:
            TimeoutError: the result has not arrived in time; the future will end again.
            KinectBenchError: raised by the task.
            ClusterError: the task raised another error, or the scheduler has gone.
        """
        from distributed.scheduler import KilledWorker, NoValidWorkerError

        try:
            result: Result = future.result(timeout=RESULT_S)
            return result
        except (KilledWorker, NoValidWorkerError):
            self.orphaned.pop(number, None)  # its outcome is reported below
            if number in self.running.values():
                return None
            if number in self.alone:
                return WorkerLost(KILLED_ALONE)
            self.listener.warn(
                "{id}: its workers died one after another, perhaps for lack of memory; the recording is "
                "tried once more at the end, alone",
                self.tasks[number],
            )
            self.killed.append(number)
            return None
        except KinectBenchError:
            raise
        except Exception as error:
            if future.status == "pending" or (
                future.status == "finished" and isinstance(error, TimeoutError)
            ):
                raise TimeoutError from error
            if future.status != "error":
                raise self.gone() from error
            raise ClusterError(
                f"a worker could not carry out its task ({type(error).__name__}: {dask_line(error)}); every "
                f"worker needs kinectbench {self.versions['kinectbench']} and the packages of this machine"
            ) from error

    def close(self) -> None:
        """Cancel the remaining tasks; a task that cannot be cancelled ends unobserved."""
        for future in self.running:
            future.cancel()
        self.running.clear()


def dask_line(error: BaseException) -> str:
    """Return the message of a Dask error, in one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__
