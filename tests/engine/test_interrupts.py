"""Ctrl-C that comes where nothing can be raised is remembered, without a traceback."""

import signal
import sys
from concurrent.futures.process import BrokenProcessPool

import pytest

from kinectbench.engine import interrupts
from kinectbench.engine.interrupts import (
    check_interrupt,
    interrupted_status,
    interrupts_held,
    interrupts_remembered,
)


class Dying:
    """Its end interrupts, as a signal may that comes during a callback."""

    def __init__(self, what: type[BaseException]) -> None:
        self.what = what

    def __del__(self) -> None:
        if self.what is KeyboardInterrupt:
            signal.raise_signal(signal.SIGINT)
        raise self.what


def test_an_interrupt_in_a_callback_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda unraisable: told.append(unraisable.exc_type))
    monkeypatch.setattr(interrupts, "_asked", [])
    with interrupts_remembered():
        check_interrupt()
        Dying(KeyboardInterrupt)
        assert told == []
        with pytest.raises(KeyboardInterrupt):
            check_interrupt()
        Dying(ValueError)
        assert told == [ValueError]
    Dying(OSError)
    assert told == [ValueError, OSError]


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_held_interrupt_outlasts_what_fails_by_it(
    monkeypatch: pytest.MonkeyPatch, number: signal.Signals, status: int
) -> None:
    """A signal to the group ends a worker that starts, and its parent finds it gone before it answers."""
    monkeypatch.setattr(interrupts, "_asked", [])
    with interrupts_remembered():
        with pytest.raises(KeyboardInterrupt), interrupts_held():
            signal.raise_signal(number)
            raise BrokenProcessPool
        assert interrupted_status() == status
        with pytest.raises(OSError, match="its own"), interrupts_held():
            raise OSError("its own")
