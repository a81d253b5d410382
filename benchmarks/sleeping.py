"""Tasks that sleep, and many workers for them in one process: the parts of a cluster that is only timed."""

import asyncio
import time
from dataclasses import dataclass

import dask
from distributed import Worker

from kinectbench.engine.executor import Say
from kinectbench.engine.on_worker import package_versions

# Every worker looks after its own process, a hundred times a second: two hundred in one process need not.
OF_MANY_IN_ONE = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}


@dataclass(frozen=True)
class Sleep:
    """A task: so many seconds, and whether it fails at its end."""

    number: int
    seconds: float
    fails: bool


def sleep(task: Sleep, say: Say) -> str:
    say((str(task.number), "sleeping", 0, 1))
    time.sleep(task.seconds)
    return "failed" if task.fails else "done"


def run_workers(address: str, number: int) -> None:
    """Run so many workers of one thread each in this process, until it is ended."""

    async def until_ended() -> None:
        workers = [
            Worker(
                address, nthreads=1, memory_limit=0, dashboard=False, dashboard_address=":0", silence_logs=50
            )
            for _ in range(number)
        ]
        await asyncio.gather(*workers)
        await asyncio.gather(*(worker.finished() for worker in workers))

    package_versions()  # which each process asks for once, and two hundred threads would at the same time
    with dask.config.set(OF_MANY_IN_ONE):
        asyncio.run(until_ended())
