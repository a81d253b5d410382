"""Ctrl-C that comes where nothing can be raised is remembered, without a traceback."""

import os
import runpy
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from kinectbench.cli.common import on_interrupt
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


# A mutex that is locked twice: a library that computes for ever, and gives Python's lock back meanwhile.
COMPUTES = """
import ctypes, threading, sys
from pathlib import Path
from kinectbench.cli.main import _end_unanswered
from kinectbench.core.storage import replaced_file, replaced_folder
from kinectbench.engine import interrupts

interrupts.ANSWER_S = 0.2
folder = Path(sys.argv[1])
with interrupts.interrupts_remembered(_end_unanswered), replaced_folder(folder), \
        replaced_file(folder.with_name("scores.json")) as half:
    half.write_text("half")
    mutex = ctypes.create_string_buffer(64)
    lock = ctypes.CDLL(None).pthread_mutex_lock
    # By another thread, once this one is where no signal is seen.
    threading.Timer(0.5, lambda: print("computes", flush=True)).start()
    lock(mutex)
    lock(mutex)
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_library_that_computes_does_not_keep_the_process(
    tmp_path: Path, number: signal.Signals, status: int
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", COMPUTES, str(tmp_path / "object")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "computes\n"
    assert len([*tmp_path.iterdir()]) == 2
    asked = time.monotonic()
    process.send_signal(number)
    assert process.communicate(timeout=10)[1] == f"error: {on_interrupt.words}\n"
    assert process.returncode == status
    assert time.monotonic() - asked < 2
    assert [*tmp_path.iterdir()] == []


def test_a_signal_before_is_no_answer_to_one_after(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that was held, or that somebody swallowed, was seen; the next one is not by that."""
    monkeypatch.setattr(interrupts, "_asked", [])
    monkeypatch.setattr(interrupts, "_seen", [])
    monkeypatch.setattr(interrupts, "ANSWER_S", 0.4)
    monkeypatch.setattr(interrupts, "LOOK_EVERY_S", 0.01)
    ended = list[int]()
    reading, writing = os.pipe()
    watch = threading.Thread(target=interrupts._watch_signals, args=(reading, ended.append, 0))
    watch.start()
    for _ in range(2):  # Python sees it: the system writes its number, and the handler is called
        os.write(writing, bytes([signal.SIGINT]))
        interrupts._seen.append(signal.SIGINT)
        time.sleep(0.8)
        assert ended == []
    os.write(writing, bytes([signal.SIGINT]))  # a library computes: the handler is not called
    time.sleep(0.8)
    assert ended == [signal.SIGINT]
    os.write(writing, bytes([signal.SIGTERM, signal.SIGTERM]))  # two that one call answers
    interrupts._seen.append(signal.SIGTERM)
    time.sleep(0.8)
    assert ended == [signal.SIGINT]
    os.close(writing)
    watch.join(timeout=5)
    assert not watch.is_alive()
    os.close(reading)


def test_an_answered_interrupt_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interrupts, "_asked", [])
    monkeypatch.setattr(interrupts, "_seen", [])
    monkeypatch.setattr(interrupts, "ANSWER_S", 0.01)
    ended: list[int] = []
    with interrupts_remembered(ended.append):
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        time.sleep(0.1)
    assert ended == []


class Interrupts:
    """Stands for Ctrl-C while the command line's modules are imported."""

    def find_spec(self, name: str, *_: object) -> None:
        if name == "kinectbench.cli.main":
            raise KeyboardInterrupt


def test_a_stop_during_the_imports_has_the_usual_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "kinectbench.cli.main", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupts(), *sys.meta_path])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_module("kinectbench", run_name="__main__")
    assert stopped.value.code == 130
    assert capsys.readouterr().err == "error: stopped; run the same command again to go on from here\n"


def test_the_hook_of_an_application_stays() -> None:
    code = "import sys; sys.excepthook = own = print; import kinectbench.cli; print(sys.excepthook is own)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "True\n"
