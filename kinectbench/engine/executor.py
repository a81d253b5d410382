"""Where tasks are carried out: in this process, on processes of this machine, or on a cluster.

Whoever has many tasks is written once, against `Executor`; the result does not depend on which one it is.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")
# How a task says how far it is; what it says is a tuple of texts and numbers.
Say = Callable[[Any], None]


@dataclass(frozen=True)
class Lost:
    """In place of a result: the task's process was killed, in the end with nothing beside it, or must be.

    A task whose process hangs returns it itself; the process ends soon after.

    Attributes:
        reason: one line; `{id}` stands for the recording.
    """

    reason: str


# What an executor yields.
Outcomes: TypeAlias = Generator[tuple[Task, Result | Lost], None, None]


class Audience(Protocol):
    """Who hears what is to be told while tasks are carried out, always in this process."""

    def heard(self, message: Any) -> None:
        """What a task said of itself."""

    def warn(self, message: str, task: Any = None) -> None:
        """Something that concerns all tasks, or one, in one line; `{id}` in it stands for its recording."""


class Executor(Protocol):
    """Carries out tasks, several at a time."""

    def slots(self) -> int:
        """How many tasks can be carried out at a time now."""

    def outcomes(
        self,
        function: Callable[[Task, Say], Result],
        tasks: Sequence[Task],
        audience: Audience,
        memory_gb: Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        """Yield each task with its result as soon as it is there, in any order.

        Whoever stops before the end closes the iterator: then what still runs is stopped, or left to end by
        itself on other machines.

        Args:
            function: module-level, or a partial of one; may be called several times for a task.
            tasks: picklable.
            audience: told here what the tasks say.
            memory_gb: what a task is expected to need at most, in GB, where somebody hands memory out.
            slowest_twice: whether the last tasks may be given to idle workers once more, and the first result
                counts: only for tasks that do not wait for each other.

        Raises:
            Exception: what the function raises.
            ClusterError: the cluster cannot be used any more.
        """


class Here:
    """One task after another, in this process."""

    def slots(self) -> int:
        """One."""
        return 1

    def outcomes(
        self,
        function: Callable[[Task, Say], Result],
        tasks: Sequence[Task],
        audience: Audience,
        memory_gb: Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        """See `Executor`; nothing can be lost."""
        for task in tasks:
            yield task, function(task, audience.heard)
