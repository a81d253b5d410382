"""Handle Ctrl-C and SIGTERM so that no signal is lost.

If an interrupt arrives during the import of a library, the library may swallow it or turn it into an
ImportError. So long-running code calls `check_interrupt` from time to time.
"""

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# Signals that ask for an end: SIGINT by Ctrl-C; SIGTERM by `kill`, `timeout` and batch systems.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)

# While a library computes, Python handles no signal. The process is ended after this many seconds (with the
# time for ending it, two seconds).
ANSWER_S = 1.5
# Interval at which the watching thread checks for unhandled signals; bytes to read at once.
LOOK_EVERY_S, MANY = 0.5, 4096

_asked: list[int] = []
# Signals that Python has handled, including delayed ones, in order.
_seen: list[int] = []


@contextmanager
def interrupts_remembered(unanswered: Callable[[int], None] | None = None) -> Iterator[None]:
    """Make an interrupt or SIGTERM within the block raise KeyboardInterrupt, and remember it.

    If the signal arrives in a callback that cannot raise, such as one of the import system, nothing is
    raised, and `check_interrupt` raises the exception later.

    Args:
        unanswered: called with the signal, on another thread, if Python has not handled it after 1.5 s
            because a library computes; it should end the process. None: the signal waits for the library.
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
    """Within the block, run a thread that calls `unanswered` for signals not handled in time."""
    if unanswered is None:
        yield
        return
    # The system writes each signal's number into this pipe at once, whatever Python does.
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    seen = len(_seen)
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    thread = threading.Thread(target=_watch_signals, args=(reading, unanswered, seen), daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(writing)
        thread.join()
        os.close(reading)


def _watch_signals(reading: int, unanswered: Callable[[int], None], before: int) -> None:
    """Wait for signals in the pipe `reading`; call `unanswered` for a signal not handled within 1.5 s.

    `before` is the number of signals that Python has handled so far.
    """
    while True:
        # Count before reading the pipe, because Python may handle a later signal.
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
        # One call stands for all signals that arrived while Python handled none.
        counted = len(_seen)
        if select.select([reading], [], [], 0)[0] and not os.read(reading, MANY):
            return
        before = counted


def ignore_interrupts() -> None:
    """Ignore interrupts and SIGTERM from now on, while the process ends."""
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def interrupted_status() -> int:
    """Return the exit status of an interrupted process: 143 after SIGTERM, else 130, as in shells."""
    return 128 + (signal.SIGTERM if signal.SIGTERM in _asked else signal.SIGINT)


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if a signal has arrived, even if other code swallowed the exception."""
    if _asked:
        raise KeyboardInterrupt


def interrupt_answered() -> None:
    """Forget a Ctrl-C after the interrupted task has ended, so that the command can continue.

    `check_interrupt` no longer raises for this Ctrl-C. A SIGTERM is kept, because it ends the whole command.
    """
    _asked[:] = [number for number in _asked if number != signal.SIGINT]


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Delay interrupts until the block ends; processes started in it never receive any.

    Ctrl-C sends SIGINT to all processes of a terminal. SIGINT is blocked; processes started in the block
    inherit this, so they print no tracebacks, and their parent stops them. A handler delays SIGINT as well,
    because threads of libraries receive it nevertheless. SIGTERM is delayed by the handler alone, which is
    not inherited, so that the parent can stop its workers by SIGTERM.

    A signal to the whole process group may end workers that are just starting, so that the block fails. The
    interrupt then replaces that error.
    """
    asked: list[int] = []

    def hold(came: int, frame: object) -> None:
        """Remember a signal until the end of the block."""
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
    # `timeout` sends SIGTERM to the command and then to its group: the second must not stop the cleaning up.
    if not (again and number == signal.SIGTERM):
        raise KeyboardInterrupt
