"""The real scheduler with 200 workers that sleep: what ten thousand recordings cost beside their own work.

Times are drawn as those of recordings are spread (log-normal), and slept twenty times faster; of a hundred
tasks one fails. The workers are threads of one process, which costs more than their sleep: it is not counted.
What the scheduler and the client cost, each in a process of its own, is.
"""

import random
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil
from dask_parts import dask
from distributed import Client
from figures import Figure, arguments, at_most, equals, run, told
from memory import peak_mb
from sleeping import Sleep, run_workers, sleep

from kinectbench.engine.cluster import Cluster
from kinectbench.engine.executor import Lost
from kinectbench.engine.processes import CONTEXT

# Of recordings that take 40 s and a few minutes, twenty times faster (own choice).
MEDIAN_S, SPREAD = 2.0, 0.5

IDLE_S = 10.0


class Nobody:
    heard_messages = 0

    def heard(self, message: Any) -> None:
        self.heard_messages += 1

    def warn(self, message: str, task: object = None) -> None:
        print(message, file=sys.stderr)


def options() -> ArgumentParser:
    parser = arguments(__doc__)
    parser.add_argument("--tasks", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=200)
    return parser


def measure(chosen: Namespace) -> Iterator[Figure]:
    drawn = random.Random(0)
    tasks = [
        Sleep(number, MEDIAN_S * drawn.lognormvariate(0, SPREAD), drawn.random() < 0.01)
        for number in range(chosen.tasks)
    ]
    with (
        TemporaryDirectory() as folder,
        dask(Path(folder), workers=()) as parts,
        Client(scheduler_file=str(parts.file)) as client,
    ):
        where = (client.scheduler.address, chosen.workers)
        workers = CONTEXT.Process(target=run_workers, args=where, daemon=True)
        workers.start()
        client.wait_for_workers(chosen.workers)
        yield from timed(client, tasks, psutil.Process(parts.scheduler.pid), chosen.workers)
        workers.terminate()


def used_s(process: psutil.Process) -> float:
    """Processor seconds that a process has used."""
    return float(sum(process.cpu_times()[:2]))


def timed(client: Client, tasks: list[Sleep], scheduler: psutil.Process, workers: int) -> Iterator[Figure]:
    """Carry the tasks out, and hold what that took against their own time."""
    idle_s = used_s(scheduler)
    time.sleep(IDLE_S)
    idle = (used_s(scheduler) - idle_s) / IDLE_S
    cluster, audience = Cluster(client, "here"), Nobody()
    started, here_s, there_s = time.monotonic(), time.process_time(), used_s(scheduler)
    found = dict(cluster.outcomes(sleep, tasks, audience, slowest_twice=True))
    makespan_s = time.monotonic() - started
    client_ms = 1000 * (time.process_time() - here_s) / len(tasks)
    scheduler_ms = 1000 * (used_s(scheduler) - there_s - idle * makespan_s) / len(tasks)
    slept = [task.seconds for task in tasks]
    bound_s = max(sum(slept) / workers, *slept)
    memory_mb = peak_mb() + scheduler.memory_info().rss / 1e6
    yield told("tasks", len(tasks))
    yield told("workers", workers)
    yield equals("tasks with a result", sum(not isinstance(r, Lost) for r in found.values()), len(tasks))
    failed = sum(task.fails for task in tasks)
    yield equals("tasks that failed", sum(result == "failed" for result in found.values()), failed)
    yield told("messages heard", audience.heard_messages)
    yield told("max(sum / workers, longest), s", round(bound_s, 1))
    yield told("makespan, s", round(makespan_s, 1))
    yield at_most("makespan over that", round(makespan_s / bound_s, 3), 1.1)
    yield told("CPU of the scheduler with nothing to do, ms a second", round(1000 * idle, 1))
    yield told("CPU of the scheduler a task, beyond that, ms", round(scheduler_ms, 2))
    yield told("CPU of the client a task, ms", round(client_ms, 2))
    yield at_most("CPU of both a task, ms", round(scheduler_ms + client_ms, 2), 2.0)
    yield at_most("memory of both, MB", round(memory_mb), 500)


if __name__ == "__main__":
    chosen = options().parse_args()
    run(chosen, lambda: list(measure(chosen)))
