"""Run independent tasks in one process or several; results are always in the order of the tasks."""

from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from kinectbench.core import KinectBenchError
from kinectbench.core.types import Progress, no_progress
from kinectbench.engine.processes import KILLED, submit_all, worker_pool

# Number of tasks for which another process is worthwhile. Its start takes 2 s of CPU, a pair with all
# baselines 2.4 s. Two pairs took 10.4 s of CPU in two processes and 6.0 s in one, in the same time.
TASKS_A_PROCESS = 2

Task = TypeVar("Task")
Result = TypeVar("Result")


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    jobs: int = 1,
    progress: Progress = no_progress,
    keep: Callable[[Task, Result], None] | None = None,
) -> list[Result]:
    """Apply a module-level function to every task; return the results in the order of the tasks.

    Args:
        function: its results must not depend on the order of the tasks.
        tasks: picklable values.
        jobs: maximum number of processes; with 1, or with fewer than `2 * TASKS_A_PROCESS` tasks, all tasks
            run in the calling process.
        progress: called with (tasks done, tasks in all).
        keep: called in the calling process with each task and its result, in the order of the tasks.

    Raises:
        KinectBenchError: a task raised it, or a process was killed, for example because memory was full.
    """
    results: list[Result] = []

    def done(result: Result) -> None:
        if keep:
            keep(tasks[len(results)], result)
        results.append(result)
        progress(len(results), len(tasks))

    jobs = min(jobs, len(tasks) // TASKS_A_PROCESS)
    if jobs <= 1:
        for task in tasks:
            done(function(task))
        return results
    with worker_pool(jobs) as pool:
        try:
            for future in submit_all(pool, function, tasks):
                done(future.result())
        except BrokenProcessPool as error:
            raise KinectBenchError(KILLED, what="process-killed") from error
    return results
