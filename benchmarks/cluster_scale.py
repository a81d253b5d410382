"""The real scheduler with 200 workers that sleep: what ten thousand recordings cost beside their own work.

Times are drawn as those of recordings are spread (log-normal), and slept a hundred times faster; of a hundred
tasks one fails. All workers are threads of this process: its memory is that of scheduler, client and workers.
"""

import random
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from figures import Figure, arguments, at_most, equals, run, told
from memory import peak_mb

from kinectbench.engine.cluster import Cluster
from kinectbench.engine.executor import Lost, Say

# Of recordings that take 40 s and a few minutes, a hundred times faster (own choice).
MEDIAN_S, SPREAD = 0.4, 0.5


@dataclass(frozen=True)
class Sleep:
    """A task: so many seconds, and whether it fails at its end."""

    number: int
    seconds: float
    fails: bool


class Nobody:
    heard_messages = 0

    def heard(self, message: Any) -> None:
        self.heard_messages += 1

    def warn(self, message: str) -> None:
        print(message, file=sys.stderr)


def sleep(task: Sleep, say: Say) -> str:
    say((str(task.number), "sleeping", 0, 1))
    time.sleep(task.seconds)
    return "failed" if task.fails else "done"


def options() -> ArgumentParser:
    parser = arguments(__doc__)
    parser.add_argument("--tasks", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=200)
    return parser


def measure(chosen: Namespace) -> Iterator[Figure]:
    from distributed import Client, LocalCluster

    drawn = random.Random(0)
    tasks = [
        Sleep(number, MEDIAN_S * drawn.lognormvariate(0, SPREAD), drawn.random() < 0.01)
        for number in range(chosen.tasks)
    ]
    where: dict[str, Any] = {"processes": False, "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with (
        LocalCluster(n_workers=chosen.workers, threads_per_worker=1, **where) as here,
        Client(here) as client,
    ):
        cluster, audience = Cluster(client, "here"), Nobody()
        started, cpu_s = time.monotonic(), time.process_time()
        found = dict(cluster.outcomes(sleep, tasks, audience, slowest_twice=True))
        makespan_s = time.monotonic() - started
        cpu_ms = 1000 * (time.process_time() - cpu_s) / len(tasks)
    slept = [task.seconds for task in tasks]
    bound_s = max(sum(slept) / chosen.workers, *slept)
    yield told("tasks", len(tasks))
    yield told("workers", chosen.workers)
    yield equals("tasks with a result", sum(not isinstance(r, Lost) for r in found.values()), len(tasks))
    failed = sum(task.fails for task in tasks)
    yield equals("tasks that failed", sum(result == "failed" for result in found.values()), failed)
    yield told("messages heard", audience.heard_messages)
    yield told("max(sum / workers, longest), s", round(bound_s, 1))
    yield told("makespan, s", round(makespan_s, 1))
    yield at_most("makespan over that", round(makespan_s / bound_s, 3), 1.1)
    yield at_most("CPU of scheduler, client and workers a task, ms", round(cpu_ms, 2), 2.0)
    yield at_most("peak memory of them all, MB", round(peak_mb()), 500)


if __name__ == "__main__":
    chosen = options().parse_args()
    run(chosen, lambda: list(measure(chosen)))
