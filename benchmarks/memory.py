"""The memory that a script has needed."""

import multiprocessing
import resource
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

POLL_S = 0.2


def peak_mb() -> float:
    """Peak resident memory of this process.

    Linux counts its parent's memory in `ru_maxrss`, so that it is asked for this process's own.
    """
    own = _status_mb("self")
    if own is not None:
        return own
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


@contextmanager
def watched_workers() -> Iterator[dict[int, float]]:
    """The peak resident memory of every process that this one starts meanwhile, in MB by its id; on Linux."""
    peaks: dict[int, float] = {}
    stop = threading.Event()

    def watch() -> None:
        while not stop.wait(POLL_S):
            for process in multiprocessing.active_children():
                peak = _status_mb(str(process.pid))
                if process.pid is not None and peak is not None:
                    peaks[process.pid] = peak

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield peaks
    finally:
        stop.set()
        thread.join()


def _status_mb(process: str) -> float | None:
    """What Linux knows of a process; None elsewhere, or if it has ended."""
    try:
        text = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    except OSError:
        return None
    lines = dict(line.split(":", 1) for line in text.splitlines())
    return int(lines["VmHWM"].split()[0]) / 1e3 if "VmHWM" in lines else None
