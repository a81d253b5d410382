"""Ctrl-C that cannot get lost.

An interrupt that comes while a library is being imported may be swallowed there, or come out as an
ImportError; whoever runs for long asks here from time to time.
"""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_asked: list[int] = []


@contextmanager
def interrupts_remembered() -> Iterator[None]:
    """Within the block an interrupt raises KeyboardInterrupt as ever, and is remembered.

    One that comes in a callback that cannot raise, such as the import system's, is remembered without a word.
    """
    previous, told = signal.signal(signal.SIGINT, _remember), sys.unraisablehook
    sys.unraisablehook = _without_interrupts(told)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
        sys.unraisablehook = told


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if there was one, even if somebody has swallowed it."""
    if _asked:
        raise KeyboardInterrupt


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Within the block no interrupt is answered, at its end it is; processes started in it never answer any.

    Ctrl-C reaches all processes of a terminal. Workers must not answer it, each with a traceback of its own:
    they inherit that the signal is blocked, and their parent stops them. The parent needs the handler too,
    for threads of libraries take the signal although it is blocked here.
    """
    asked: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    on_main_thread = threading.current_thread() is threading.main_thread()
    if on_main_thread:
        signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        if on_main_thread:
            signal.signal(signal.SIGINT, handler)
    if asked:
        raise KeyboardInterrupt


def _without_interrupts(told: Callable[[Any], object]) -> Callable[[Any], object]:
    """A hook that hands on what could not be raised, but for interrupts: they are remembered."""
    return lambda unraisable: None if unraisable.exc_type is KeyboardInterrupt else told(unraisable)


def _remember(number: int, frame: object) -> None:
    _asked.append(number)
    raise KeyboardInterrupt
