"""A time limit per recording: one that exceeds it fails, and others continue."""

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from typing import Any, TypeVar

from kinectbench.core.errors import KinectBenchError
from kinectbench.engine.executor import WorkerLost

# A recording that gives no sign of life for as long again and this much more hangs.
HANG_S = 600.0
# A worker has handed over its result after so many seconds; then a process that hangs ends.
HAND_OVER_S = 10.0
Report = Callable[[str, int, int], None]
Hung = Callable[[str], None]
Result = TypeVar("Result")


class TimeLimitError(KinectBenchError):
    """A recording exceeds its time limit; the next run tries it again, perhaps with more time."""

    what = "time-limit"


@contextmanager
def time_limit(limit_s: float | None, report: Report, hung: Hung | None = None) -> Iterator[Report]:
    """Yield a `report` that raises once the block exceeds its time.

    A stage reports for every frame or pair, so that it stops between two of them. One that hangs in the midst
    of one cannot be stopped: `hung` is called.

    Args:
        limit_s: how long the block may take, seconds; None: as long as it does.
        report: called with (stage, done, total).
        hung: called once with the reason, one line, on another thread; None: no report.

    Raises:
        TimeLimitError: it took too long.
    """
    if limit_s is None:
        yield report
        return
    end, latest = time.monotonic() + limit_s, "its start"

    def checked(stage: str, done: int, total: int) -> None:
        """`report`, which raises `TimeLimitError` after the limit."""
        nonlocal latest
        latest = stage
        if time.monotonic() > end:
            raise TimeLimitError(
                f"{stage}: took longer than --time-limit {limit_s:g} (seconds); give it more time, or leave "
                "the recording out"
            )
        report(stage, done, total)

    def tell() -> None:
        """Report that the block hangs, and its stage."""
        if hung is not None:
            hung(
                f"{latest}: hangs: did not end or go on for {2 * limit_s + HANG_S:g} s, with --time-limit "
                f"{limit_s:g} (seconds); its process is ended. Leave the recording out, or give it more time "
                "if it is only slow"
            )

    hangs = threading.Timer(2 * limit_s + HANG_S, tell)
    hangs.daemon = True
    hangs.start()
    try:
        yield checked
    finally:
        hangs.cancel()


def watched(function: Callable[[Hung], Result]) -> Result | WorkerLost:
    """Run a function on its own thread, and abandon it if it hangs.

    A worker process that holds such a thread ends soon: whatever it has begun meanwhile is lost.

    Args:
        function: gets a callback for when it hangs (`time_limit` uses it).

    Returns:
        What it returns, or `WorkerLost` with the reason.

    Raises:
        Exception: that of the function.
    """
    worked, hangs = Future[Result](), Future[str]()

    def work() -> None:
        try:
            worked.set_result(function(hangs.set_result))
        except BaseException as error:
            worked.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    either: tuple[Future[Any], ...] = (worked, hangs)
    wait(either, return_when=FIRST_COMPLETED)
    if worked.done():
        return worked.result()
    if multiprocessing.parent_process() is not None:
        ends = threading.Timer(HAND_OVER_S, os._exit, (1,))
        ends.daemon = True
        ends.start()
    return WorkerLost(hangs.result())
