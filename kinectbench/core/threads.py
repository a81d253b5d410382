"""Threads for the computations of one recording; results never depend on their number.

Threads suffice, because the long computations release the interpreter's lock: numba kernels, OpenCV and
zstandard. Each item is the result of a pure function, and each part of an array is written by one thread.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")
Result = TypeVar("Result")
Other = TypeVar("Other")

# Parts for each thread: several, so that no thread waits long for another.
PARTS_A_THREAD = 4

# One thread, if nothing else is set; new threads start with this default, too.
_threads: ContextVar[int] = ContextVar("threads", default=1)


@contextmanager
def using_threads(count: int) -> Iterator[None]:
    """Set the number of threads for `ahead` and `in_parts` within the block."""
    token = _threads.set(max(count, 1))
    try:
        yield
    finally:
        _threads.reset(token)


def ahead(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield the function's results in order, while threads compute the next results.

    At most `threads + 1` results wait to be yielded, which bounds memory. An error of the function or of the
    iterator is raised where its result would be yielded. The function's result depends only on the item.
    """
    threads = _threads.get()
    if threads == 1:
        yield from map(function, items)
        return
    remaining = iter(items)
    started: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for _ in range(threads + 1):
                started.extend(_started(pool, function, remaining))
            while started:
                result = started.popleft().result()
                started.extend(_started(pool, function, remaining))
                yield result
        finally:
            pool.shutdown(cancel_futures=True)


def _started(
    pool: ThreadPoolExecutor, function: Callable[[Item], Result], items: Iterator[Item]
) -> Iterator[Future[Result]]:
    """Submit the next item and yield its future; if the iterator raised, yield a future with that error."""
    try:
        item = next(items)
    except StopIteration:
        return
    except Exception as error:
        failed: Future[Result] = Future()
        failed.set_exception(error)
        yield failed
        return
    yield pool.submit(function, item)


def both(first: Callable[[], Result], second: Callable[[], Other]) -> tuple[Result, Other]:
    """Return the results of two functions; with several threads, the second runs beside the first, on one."""
    if _threads.get() == 1:
        return first(), second()
    with ThreadPoolExecutor(1) as pool:
        beside = pool.submit(second)
        return first(), beside.result()


def in_parts(function: Callable[[int, int], None], count: int) -> None:
    """Call `function(start, stop)` for parts of `range(count)`, in parallel.

    Args:
        function: writes only the results of its part.
        count: number of items.
    """
    threads = _threads.get()
    if threads == 1 or count < threads:
        function(0, count)
        return
    bounds = np.linspace(0, count, min(threads * PARTS_A_THREAD, count) + 1).astype(int).tolist()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(function, *zip(*pairwise(bounds), strict=True)))
