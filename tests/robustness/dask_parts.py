"""A scheduler and workers of Dask as processes of their own, to be killed."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
from fault_rows import LONGEST_S, NotHereError

from kinectbench.core.errors import KinectBenchError

# A worker that is silent for so long is ended; the default is minutes.
SILENT_S = 20
OF_SCHEDULER = ("--no-dashboard", "--host", "127.0.0.1", "--port", "0")
OF_WORKER = (
    *("--nthreads", "1", "--no-dashboard", "--memory-limit", "2GB"),
    *("--local-directory", tempfile.gettempdir()),
)


@dataclass(frozen=True)
class Worker:
    """How a worker is started.

    Attributes:
        words: options of `dask worker`, beside those of all.
        before: a command that runs it, such as `faketime`.
        preload: Python that it runs when it starts.
    """

    words: tuple[str, ...] = ()
    before: tuple[str, ...] = ()
    preload: str = ""


@dataclass
class Parts:
    """The processes of a cluster.

    Attributes:
        file: of the scheduler.
        scheduler: its process.
        nannies: each watches over one worker.
    """

    file: Path
    scheduler: "subprocess.Popen[bytes]"
    nannies: "list[subprocess.Popen[bytes]]"

    def worker_of(self, recording: Path) -> psutil.Process:
        """The worker that builds a recording now, or one that builds nothing; `recording` is its folder."""
        lock = recording / ".lock"
        words = lock.read_text(encoding="utf-8").split() if lock.is_file() else []
        pids = [nanny.pid for nanny in self.nannies]
        named = int(words[1]) if words[:1] == ["process"] else 0
        return worker_below(named if named in pids else pids[0])


def worker_below(nanny: int) -> psutil.Process:
    """The worker of a nanny: the child that has most memory, once there is one."""
    end = time.monotonic() + LONGEST_S
    while time.monotonic() < end:
        children = psutil.Process(nanny).children()
        workers = [each for each in children if "resource_tracker" not in " ".join(each.cmdline())]
        if workers:
            return max(workers, key=lambda each: int(each.memory_info().rss))
        time.sleep(0.05)
    raise KinectBenchError(f"nanny {nanny} has no worker")


@contextmanager
def dask(
    folder: Path,
    workers: Sequence[Worker] = (Worker(), Worker()),
    variables: Mapping[str, str] | None = None,
    of_scheduler: Sequence[str] = OF_SCHEDULER,
) -> Iterator[Parts]:
    """A cluster for as long as the block runs."""
    file = folder / "s.json"
    file.unlink(missing_ok=True)
    more = {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": f"{SILENT_S} s", **(variables or {})}
    with ExitStack() as stack:
        scheduler = stack.enter_context(running("scheduler", *of_scheduler, file=file, variables=more))
        nannies = []
        for number, worker in enumerate(workers):
            words = [*OF_WORKER, *worker.words]
            if worker.preload:
                script = folder / f"preload{number}.py"
                script.write_text(worker.preload)
                words += ["--preload", str(script)]
            part = running("worker", *words, file=file, variables=more, before=worker.before)
            nannies.append(stack.enter_context(part))
        yield Parts(file, scheduler, nannies)


@contextmanager
def running(
    part: str, *words: str, file: Path, variables: Mapping[str, str], before: Sequence[str] = ()
) -> Iterator["subprocess.Popen[bytes]"]:
    """A part of the cluster as a process of its own; it is ended, however it is."""
    command = [*before, sys.executable, "-m", f"distributed.cli.dask_{part}", "--scheduler-file", str(file)]
    try:
        process = subprocess.Popen(
            [*command, *words],
            env={**os.environ, **variables},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except FileNotFoundError as error:
        raise NotHereError(f"no {before[0]}") from error
    with process:
        try:
            end = time.monotonic() + LONGEST_S
            while not file.is_file() and process.poll() is None and time.monotonic() < end:
                time.sleep(0.05)
            yield process
        finally:
            below = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
            for each in below:  # a worker that was stopped, or whose nanny was killed
                if each.is_running():
                    each.kill()


def killed_in(root: Path, stage_folder: str, parts: Parts, process: "subprocess.Popen[str]") -> str:
    """SIGKILL the worker that is in the midst of a stage; the recording that it was at, "" if there is none.

    It is held first, to see that it is still there.
    """
    while (recording := writing(root, stage_folder, process)) is not None:
        worker = parts.worker_of(recording)
        worker.send_signal(signal.SIGSTOP)
        if list(recording.glob(f".{stage_folder}.*.part")):
            worker.kill()
            return recording.name
        worker.send_signal(signal.SIGCONT)
    return ""


def writing(root: Path, stage_folder: str, process: "subprocess.Popen[str]") -> Path | None:
    """Wait until a stage is being written; the recording's folder, None if the process ended before."""
    end = time.monotonic() + LONGEST_S
    while process.poll() is None and time.monotonic() < end:
        for part in root.glob(f"build/*/.{stage_folder}.*.part"):
            return part.parent
        time.sleep(0.001)
    return None


def kill_all_of(process: "subprocess.Popen[str]", number: int) -> None:
    """A signal to a command and what it started here."""
    os.killpg(process.pid, number)
