"""A limit to the time that a recording may take: it fails by itself, and the others go on."""

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from kinectbench.core.errors import KinectBenchError

# A worker process that gives no sign of life for as long again and this much more hangs (own choice).
HANG_S = 600.0
Report = Callable[[str, int, int], None]


class TimeLimitError(KinectBenchError):
    """A recording takes longer than it may; the next run tries it again, perhaps with more time."""


@contextmanager
def time_limit(limit_s: float | None, report: Report) -> Iterator[Report]:
    """Yield `report` as it is to be called in the block: it raises once the block takes too long.

    A stage reports for every frame or pair, so that it stops between two of them. A worker process that
    hangs in the midst of one is ended.

    Args:
        limit_s: how long the block may take, seconds; None: as long as it does.
        report: called with (stage, done, total).

    Raises:
        TimeLimitError: it took too long.
    """
    if limit_s is None:
        yield report
        return
    end = time.monotonic() + limit_s

    def checked(stage: str, done: int, total: int) -> None:
        """`report`, unless it takes too long: then `TimeLimitError`."""
        if time.monotonic() > end:
            raise TimeLimitError(
                f"{stage}: took longer than --time-limit {limit_s:g} (seconds); give it more time, or leave "
                "the recording out"
            )
        report(stage, done, total)

    hangs = threading.Timer(2 * limit_s + HANG_S, os._exit, (1,))
    hangs.daemon = True
    if multiprocessing.parent_process() is not None:
        hangs.start()
    try:
        yield checked
    finally:
        hangs.cancel()
