"""The threads that one recording may use; results never depend on their number.

Threads, as what takes long lets them run side by side: kernels without the interpreter's lock, and the codecs
of OpenCV and zstandard. Every item is made by a pure function, and every part of an array by one thread.
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

# Parts for each thread, so that none waits long for another.
PARTS_A_THREAD = 4

# A thread that is started here uses one itself.
_threads: ContextVar[int] = ContextVar("threads", default=1)


@contextmanager
def using_threads(count: int) -> Iterator[None]:
    """Set the number of threads of `ahead` and `in_parts` within the block."""
    token = _threads.set(max(count, 1))
    try:
        yield
    finally:
        _threads.reset(token)


def ahead(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """The function's results in order; threads compute the next ones ahead.

    One result more than there are threads waits at a time, so that memory is bounded. An error, of the
    function or of the items, is raised where its result would come.

    Args:
        function: depends on nothing but the item.
        items: one after another.
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
    """The next item's result, or the error that the iterator raised."""
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


def in_parts(function: Callable[[int, int], None], count: int) -> None:
    """Call `function(start, stop)` for parts of `range(count)`, side by side.

    Args:
        function: writes what belongs to its part, and nothing else.
        count: of what there is to do.
    """
    threads = _threads.get()
    if threads == 1 or count < threads:
        function(0, count)
        return
    bounds = np.linspace(0, count, min(threads * PARTS_A_THREAD, count) + 1).astype(int).tolist()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(function, *zip(*pairwise(bounds), strict=True)))
