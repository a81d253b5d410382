"""Run independent tasks in one process or several; results come in the order of the tasks either way."""

from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from kinectbench.core.errors import KinectBenchError
from kinectbench.core.types import Progress
from kinectbench.engine.processes import KILLED, submit_all, worker_pool

Task = TypeVar("Task")
Result = TypeVar("Result")


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    jobs: int = 1,
    progress: Progress | None = None,
    keep: Callable[[Task, Result], None] | None = None,
) -> list[Result]:
    """Apply a module-level function to every task.

    Args:
        function: must not depend on the order of the tasks.
        tasks: picklable values.
        jobs: number of processes; 1 runs in this one.
        progress: called with (tasks done, tasks in all).
        keep: called in this process with each task and its result, in the order of the tasks.

    Raises:
        KinectBenchError: what a task raises, or a process was killed, as by lack of memory.
    """
    results: list[Result] = []

    def done(result: Result) -> None:
        if keep:
            keep(tasks[len(results)], result)
        results.append(result)
        if progress:
            progress(len(results), len(tasks))

    if jobs <= 1 or len(tasks) <= 1:
        for task in tasks:
            done(function(task))
        return results
    with worker_pool(min(jobs, len(tasks))) as pool:
        try:
            for future in submit_all(pool, function, tasks):
                done(future.result())
        except BrokenProcessPool as error:
            raise KinectBenchError(KILLED) from error
    return results
