"""Ctrl-C that cannot get lost.

An interrupt that comes while a library is being imported may be swallowed there, or come out as an
ImportError; whoever runs for long asks here from time to time.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

_asked: list[int] = []


@contextmanager
def interrupts_remembered() -> Iterator[None]:
    """Within the block an interrupt raises KeyboardInterrupt as ever, and is remembered."""
    previous = signal.signal(signal.SIGINT, _remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if there was one, even if somebody has swallowed it."""
    if _asked:
        raise KeyboardInterrupt


def _remember(number: int, frame: object) -> None:
    _asked.append(number)
    raise KeyboardInterrupt
