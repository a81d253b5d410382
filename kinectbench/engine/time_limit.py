"""A time limit for each recording: a recording that exceeds it fails, and the others continue."""

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from typing import Any, TypeVar

from kinectbench.core import KinectBenchError
from kinectbench.core.types import NamedProgress
from kinectbench.engine.executor import WorkerLost

# A recording hangs if it gives no sign of life for the limit again plus this time.
HANG_S = 600.0
# Seconds for a worker to hand over its result before a hanging process is ended.
HAND_OVER_S = 10.0
Hung = Callable[[str], None]
Result = TypeVar("Result")


class TimeLimitError(KinectBenchError):
    """A recording exceeds its time limit; the next run tries it again."""

    what = "time-limit"


@contextmanager
def time_limit(
    limit_s: float | None, report: NamedProgress, hung: Hung | None = None
) -> Iterator[NamedProgress]:
    """Yield a wrapper of `report` that raises `TimeLimitError` once the block has run too long.

    A stage reports after every frame or pair, and is stopped there. A stage that hangs between two reports
    cannot be stopped; then `hung` is called.

    Args:
        limit_s: time limit of the block, seconds; None: no limit.
        report: called with (stage, done, total).
        hung: called once, on another thread, with the reason in one line; None: no call.

    Raises:
        TimeLimitError: the block took too long.
    """
    if limit_s is None or limit_s > threading.TIMEOUT_MAX / 4:  # no timer waits longer
        yield report
        return
    end, latest = time.monotonic() + limit_s, "its start"

    def checked(stage: str, done: int, total: int) -> None:
        """Pass the report on, or raise `TimeLimitError` after the limit."""
        nonlocal latest
        latest = stage
        if time.monotonic() > end:
            raise TimeLimitError(
                f"{stage}: took longer than --time-limit {limit_s:g} (seconds); give it more time, or leave "
                "the recording out"
            )
        report(stage, done, total)

    def tell() -> None:
        """Call `hung` with a line that names the stage of the latest report."""
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
    """Run a function on its own thread; abandon the thread if the function hangs.

    A worker process with an abandoned thread ends soon; the thread's unfinished work is lost.

    Args:
        function: called with a callback that reports a hang (`time_limit` uses it).

    Returns:
        The function's result, or `WorkerLost` with the reason.

    Raises:
        Exception: raised by the function.
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
