"""Executors of tasks: this process, processes of this machine, or a cluster.

Code that runs many tasks needs only `Executor`; its results do not depend on which executor runs it.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, TypeVar

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
