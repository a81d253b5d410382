"""Ctrl-C and SIGTERM that cannot get lost.

An interrupt that comes while a library is being imported may be swallowed there, or come out as an
ImportError; whoever runs for long asks here from time to time.
"""

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# What asks for an end: people by Ctrl-C, `kill`, `timeout` and batch systems by SIGTERM.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)

# Python answers no signal while a library computes: so many seconds after one the process is ended all the
# same (with the time that ending takes, two seconds).
ANSWER_S = 1.5
# So often the watch looks whether Python has seen a signal that it did not wait for; bytes read at once.
LOOK_EVERY_S, MANY = 0.5, 4096

_asked: list[int] = []
# Those that Python has seen, those that are held, too, in the order in which it did.
_seen: list[int] = []


@contextmanager
def interrupts_remembered(unanswered: Callable[[int], None] | None = None) -> Iterator[None]:
    """Within the block an interrupt or SIGTERM raises KeyboardInterrupt, and is remembered.

    One that comes in a callback that cannot raise, such as the import system's, is remembered silently.

    Args:
        unanswered: called with the signal, on another thread, where Python has not seen it after 1.5 s: a
            library computes. It is to end the process. None: the signal waits for the library.
    """
    with _watch(unanswered):
        previous = [signal.signal(number, _remember) for number in STOP_SIGNALS]
        hook = sys.unraisablehook
        sys.unraisablehook = lambda each: None if each.exc_type is KeyboardInterrupt else hook(each)
        try:
            yield
        finally:
            for number, handler in zip(STOP_SIGNALS, previous, strict=True):
                signal.signal(number, handler)
            sys.unraisablehook = hook


@contextmanager
def _watch(unanswered: Callable[[int], None] | None) -> Iterator[None]:
    """Within the block a thread sees to it that signals are answered."""
    if unanswered is None:
        yield
        return
    # The system writes each signal's number there at once, whatever Python does.
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    seen = len(_seen)
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    thread = threading.Thread(target=_see_to_answers, args=(reading, unanswered, seen), daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(writing)
        thread.join()
        os.close(reading)


def _see_to_answers(reading: int, unanswered: Callable[[int], None], before: int) -> None:
    """Wait for signals, and pass on those that Python does not handle in time."""
    while True:
        # Count before reading the pipe, as Python may answer a later signal.
        counted = len(_seen)
        if not select.select([reading], [], [], LOOK_EVERY_S)[0]:
            before = counted
            continue
        read = os.read(reading, MANY)
        if not read:
            return
        came = [number for number in read if number in STOP_SIGNALS]
        end = time.monotonic() + ANSWER_S
        while came and len(_seen) == before and (left_s := end - time.monotonic()) > 0:
            time.sleep(min(left_s, 0.05))
        if came and len(_seen) == before:
            unanswered(came[0])
        # One answer is for all that came while Python saw none.
        counted = len(_seen)
        if select.select([reading], [], [], 0)[0] and not os.read(reading, MANY):
            return
        before = counted


def ignore_interrupts() -> None:
    """Ignore interrupts and SIGTERM from here on, for the end of the process."""
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def interrupted_status() -> int:
    """The exit status of an interrupted process: 143 after SIGTERM, else 130, as in shells."""
    return 128 + (signal.SIGTERM if signal.SIGTERM in _asked else signal.SIGINT)


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if one occurred, even if other code swallowed it."""
    if _asked:
        raise KeyboardInterrupt


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Delay interrupts to the end of the block; processes started in it never receive any.

    Ctrl-C reaches all processes of a terminal. Workers must not answer it, each with a traceback of its own:
    they inherit that the signal is blocked, and their parent stops them. The parent needs the handler too,
    for threads of libraries take the signal although it is blocked here. SIGTERM ends workers silently,
    and is how their parent stops them: they do not inherit that it is held.

    A signal to the whole group ends workers that start, too, and what the block does fails by that: the
    interrupt is answered all the same, in place of the error.
    """
    asked: list[int] = []

    def hold(came: int, frame: object) -> None:
        """Keep a signal for the end of the block."""
        _seen.append(came)
        asked.append(came)

    handlers = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    on_main_thread = threading.current_thread() is threading.main_thread()
    if on_main_thread:
        for number in STOP_SIGNALS:
            signal.signal(number, hold)
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


def _remember(number: int, frame: object) -> None:
    again = number in _asked
    _seen.append(number)
    _asked.append(number)
    # `timeout` sends SIGTERM to the command and then to its group: the second must not stop the clearing up.
    if not (again and number == signal.SIGTERM):
        raise KeyboardInterrupt
