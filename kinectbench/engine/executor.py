"""Executors of tasks: this process, processes of this machine, or a cluster.

Whoever has many tasks is written once, against `Executor`; the result does not depend on which one it is.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")
# A task's progress callback, called with texts and numbers.
SendMessage = Callable[[Any], None]


@dataclass(frozen=True)
class WorkerLost:
    """In place of a result: the task's process was killed although it ran alone at last, or hangs.

    A task whose process hangs returns it itself; the process ends soon after.

    Attributes:
        reason: one line; `{id}` stands for the recording.
    """

    reason: str


# What an executor yields.
Outcomes: TypeAlias = Generator[tuple[Task, Result | WorkerLost], None, None]


class Listener(Protocol):
    """Receives the messages of running tasks, always in this process."""

    def heard(self, message: Any) -> None:
        """Receive a task's message."""

    def warn(self, message: str, task: Any = None) -> None:
        """Receive a warning about all tasks, or one, in one line; `{id}` in it stands for its recording."""


class Executor(Protocol):
    """Carries out tasks, several at a time."""

    def slots(self) -> int:
        """The number of tasks that can run at once now."""

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

        Whoever stops before the end closes the iterator: then what still runs is stopped, or left to end by
        itself on other machines.

        Args:
            function: module-level, or a partial of one; may be called several times for a task.
            tasks: picklable.
            listener: receives the messages of the tasks.
            memory_gb: expected memory of a task at most, in GB, where somebody hands memory out.
            slowest_twice: whether the last tasks may be given to idle workers once more, and the first result
                counts: only for tasks that do not wait for each other.

        Raises:
            Exception: that of the function.
            ClusterError: the cluster cannot be used any more.
        """


class SerialExecutor:
    """Runs one task after another, in this process."""

    def slots(self) -> int:
        """One."""
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
        """See `Executor`; nothing can be lost."""
        for task in tasks:
            yield task, function(task, listener.heard)
