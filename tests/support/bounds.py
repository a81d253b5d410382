"""What something may cost: a block that takes more of the processor, or more memory, fails.

Limits are of the processor's time, not of the clock's: other programs that run meanwhile do not count.
"""

import resource
import signal
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def children_within(times: float) -> Iterator[None]:
    """Fail where the processes that the block starts, and waits for, take more of the processor than so many
    times what a process takes that imports three libraries, on the same machine and beside the same load."""
    before = _of_children()
    subprocess.run([sys.executable, "-c", "import numpy, pydantic, typer"], check=True)
    middle = _of_children()
    yield
    taken, reference = _of_children() - middle, middle - before
    assert taken < times * reference, f"{taken:.2f} s of the processor, {taken / reference:.1f} times as much"


def _of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@contextmanager
def within(seconds: int, megabytes: int | None = None) -> Iterator[None]:
    """Fail where the block takes more seconds of the processor, or allocates more, through Python or numpy.

    What waits for ever ends after ten times as long. tracemalloc makes some loops three times slower: choose
    the bounds with that in mind, or None for the memory.
    """

    def too_long(*_: object) -> None:
        raise AssertionError(f"not done after {seconds} s")

    signals = {signal.SIGALRM: signal.ITIMER_REAL, signal.SIGPROF: signal.ITIMER_PROF}
    before = {number: signal.signal(number, too_long) for number in signals}
    signal.setitimer(signal.ITIMER_REAL, 10 * seconds)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    if megabytes is not None:
        tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        for number, timer in signals.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])
    assert megabytes is None or peak < megabytes << 20, f"{peak >> 20} MB at once"
