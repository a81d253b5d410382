"""What dies while a cluster builds: afterwards, is the benchmark the same to the byte?

A scheduler and two workers are started for each fault; one of them, or `build` itself, is killed or stopped
at a random moment, and `build` is said again where it ended. Every round ends with `publish`.
"""

import os
import random
import signal
import subprocess
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from figures import Figure, arguments, equals, run, told
from small_runs import copied, leftovers, make_small, published, start

from kinectbench.core.errors import KinectBenchError

LONGEST_S = 600.0
# A worker that is silent for so long is ended; the default is minutes.
SILENT_S = 20


@dataclass
class Parts:
    """The processes of a cluster, and of `build` on it.

    Attributes:
        file: of the scheduler.
        scheduler: its process.
        nannies: each watches over one worker.
        client: `build`.
    """

    file: Path
    scheduler: "subprocess.Popen[bytes]"
    nannies: "list[subprocess.Popen[bytes]]"
    client: "subprocess.Popen[str]"

    def worker(self) -> int:
        """The process of a worker that is at work, below its nanny."""
        nanny = self.nannies[0].pid
        children = Path(f"/proc/{nanny}/task/{nanny}/children").read_text(encoding="utf-8").split()
        busiest = max(
            children, key=lambda pid: Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1]
        )
        return int(busiest)


FAULTS: dict[str, Callable[[Parts], None]] = {
    "nothing": lambda parts: None,
    "SIGKILL of a worker": lambda parts: os.kill(parts.worker(), signal.SIGKILL),
    "SIGSTOP of a worker": lambda parts: os.kill(parts.worker(), signal.SIGSTOP),
    "SIGKILL of a worker's nanny": lambda parts: parts.nannies[0].kill(),
    "SIGKILL of the scheduler": lambda parts: parts.scheduler.kill(),
    "SIGKILL of build": lambda parts: os.killpg(parts.client.pid, signal.SIGKILL),
    "SIGINT of build": lambda parts: os.killpg(parts.client.pid, signal.SIGINT),
}


def options() -> ArgumentParser:
    parser = arguments(__doc__)
    parser.add_argument("--rounds", type=int, default=1, help="of each fault; default: 1")
    parser.add_argument("--only", nargs="*", choices=list(FAULTS), default=list(FAULTS), help="default: all")
    parser.add_argument("--seed", type=int, default=0, help="draws the moments")
    return parser


def measure(chosen: Namespace) -> Iterator[Figure]:
    moments = random.Random(chosen.seed)
    with TemporaryDirectory(prefix="kinectbench-cluster-") as folder:
        whole = make_small(Path(folder) / "whole", ("chair",))
        wanted = published(whole)
        yield told("benchmark_sha256, undisturbed", wanted)
        for name in chosen.only:
            for number in range(chosen.rounds):
                started = time.monotonic()
                root = copied(whole, Path(folder) / "b")
                said = disturbed(root, Path(folder), FAULTS[name], moments.uniform(0, 20))
                same = published(root) == wanted
                seconds = time.monotonic() - started
                problems = [*(["other bytes"] if not same else []), *map(str, leftovers(root)), *said]
                print(f"{name}, {number + 1}: {problems or 'well'}, {seconds:.0f} s", file=sys.stderr)
                yield equals(
                    f"{name}, {number + 1}: what went wrong", "; ".join(problems) or "nothing", "nothing"
                )


def disturbed(root: Path, folder: Path, fault: Callable[[Parts], None], after_s: float) -> list[str]:
    """Build on a cluster, let a fault happen, and build again if it ended; what was told wrongly."""
    with ExitStack() as stack:
        file = folder / "s.json"
        file.unlink(missing_ok=True)
        scheduler = stack.enter_context(
            running("scheduler", "--no-dashboard", "--host", "127.0.0.1", file=file)
        )
        nannies = [stack.enter_context(running("worker", *OF_WORKER, file=file)) for _ in range(2)]
        client = start(root, "build", "--cluster", str(file))
        stack.callback(client.kill)
        end = time.monotonic() + LONGEST_S
        while client.poll() is None and not list((root / "build").glob("*/.*.part")):
            if time.monotonic() > end:
                raise KinectBenchError(f"build wrote nothing in {LONGEST_S:.0f} s")
            time.sleep(0.05)
        time.sleep(after_s)
        fault(Parts(file, scheduler, nannies, client))
        _, err = client.communicate(timeout=LONGEST_S)
    return told_wrongly(client.returncode, err)


OF_WORKER = ("--nthreads", "1", "--no-dashboard", "--memory-limit", "2GB")


@contextmanager
def running(part: str, *words: str, file: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """A part of the cluster as a process of its own; it is ended, however it is."""
    command = [sys.executable, "-m", f"distributed.cli.dask_{part}", "--scheduler-file", str(file), *words]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    env = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": f"{SILENT_S} s"}
    with subprocess.Popen(command, env=env, **quiet) as process:
        try:
            end = time.monotonic() + LONGEST_S
            while not file.is_file() and process.poll() is None and time.monotonic() < end:
                time.sleep(0.05)
            yield process
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


def told_wrongly(status: int, err: str) -> Sequence[str]:
    """What is wrong with how `build` ended: well, killed, interrupted, or with one line about the cluster."""
    problems = ["a traceback"] if "Traceback" in err or "internal error" in err else []
    lines = [line for line in err.splitlines() if "error: " in line]
    if status not in (0, 1, 130, -signal.SIGKILL) or (status == 1 and len(lines) != 1):
        problems.append(f"status {status}: {lines}")
    return problems


if __name__ == "__main__":
    chosen = options().parse_args()
    run(chosen, lambda: list(measure(chosen)))
