"""Ctrl-C and SIGTERM that cannot get lost.

An interrupt that comes while a library is being imported may be swallowed there, or come out as an
ImportError; whoever runs for long asks here from time to time.
"""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# What asks for an end: people by Ctrl-C, `kill`, `timeout` and batch systems by SIGTERM.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)

_asked: list[int] = []


@contextmanager
def interrupts_remembered() -> Iterator[None]:
    """Within the block an interrupt or SIGTERM raises KeyboardInterrupt, and is remembered.

    One that comes in a callback that cannot raise, such as the import system's, is remembered without a word.
    """
    previous = [signal.signal(number, _remember) for number in STOP_SIGNALS]
    told = sys.unraisablehook
    sys.unraisablehook = _without_interrupts(told)
    try:
        yield
    finally:
        for number, handler in zip(STOP_SIGNALS, previous, strict=True):
            signal.signal(number, handler)
        sys.unraisablehook = told


def ignore_interrupts() -> None:
    """For the end of the process: from here on no interrupt or SIGTERM is answered."""
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def interrupted_status() -> int:
    """The exit status of a process that was interrupted: 143 if by SIGTERM, else 130, as shells count."""
    return 128 + (signal.SIGTERM if signal.SIGTERM in _asked else signal.SIGINT)


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if there was one, even if somebody has swallowed it."""
    if _asked:
        raise KeyboardInterrupt


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Within the block no interrupt is answered, at its end it is; processes started in it never answer any.

    Ctrl-C reaches all processes of a terminal. Workers must not answer it, each with a traceback of its own:
    they inherit that the signal is blocked, and their parent stops them. The parent needs the handler too,
    for threads of libraries take the signal although it is blocked here. SIGTERM ends workers without a word,
    and is how their parent stops them: they do not inherit that it is held.

    A signal to the whole group ends workers that start, too, and what the block does fails by that: the
    interrupt is answered all the same, in place of the error.
    """
    asked: list[int] = []
    handlers = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    on_main_thread = threading.current_thread() is threading.main_thread()
    if on_main_thread:
        for number in STOP_SIGNALS:
            signal.signal(number, lambda came, _: asked.append(came))
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        if on_main_thread:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        if asked:
            signal.raise_signal(asked[0])


def _without_interrupts(told: Callable[[Any], object]) -> Callable[[Any], object]:
    """A hook that hands on what could not be raised, but for interrupts: they are remembered."""
    return lambda unraisable: None if unraisable.exc_type is KeyboardInterrupt else told(unraisable)


def _remember(number: int, frame: object) -> None:
    again = number in _asked
    _asked.append(number)
    # `timeout` sends SIGTERM to the command and then to its group: the second must not stop the clearing up.
    if not (again and number == signal.SIGTERM):
        raise KeyboardInterrupt
