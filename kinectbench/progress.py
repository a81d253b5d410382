"""How far a command is, on standard error: bars in a terminal, plain lines in a file or a log."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from kinectbench.interrupts import check_interrupt

if TYPE_CHECKING:
    from kinectbench.pipeline import Outcome

# In a log, a bar is a line as often as this; what is done sooner says nothing.
LOG_EVERY_S = 10.0


class PlainLines:
    """Lines such as `[  12 s] chair_01: track`, for where no bar can be drawn."""

    def __init__(self, console: Console) -> None:
        """Begin to count the seconds."""
        self._console = console
        self._started = time.monotonic()
        self._last = self._started

    def say(self, text: str) -> None:
        """A line, with the time since the beginning."""
        self._last = time.monotonic()
        seconds = self._last - self._started
        self._console.print(f"[{seconds:4.0f} s] {text}", markup=False, highlight=False, soft_wrap=True)

    def say_sometimes(self, text: str) -> None:
        """A line, unless there was one a short while ago."""
        if time.monotonic() - self._last >= LOG_EVERY_S:
            self.say(text)


@contextmanager
def bar(console: Console, title: str) -> Iterator[Callable[[int, int], None]]:
    """One bar; yields a function of (done, total)."""
    plain = None if console.is_terminal else PlainLines(console)
    with _bars(console) as bars:
        task = bars.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            check_interrupt()
            bars.update(task, completed=done, total=total)
            if plain:
                plain.say_sometimes(f"{title}: {done} of {total}")

        yield update


class RecordingBars:
    """A bar for each recording that is being worked on, and one over all where there are several.

    It is called with (recording, stage, done, total), and told of outcomes; `kinectbench.parallel.Watcher`.
    """

    def __init__(self, console: Console, bars: Progress, recordings: int | None) -> None:
        """Nothing is shown yet; `recordings` is how many there will be, if that is known."""
        self._console = console
        self._bars = bars
        self._plain = None if console.is_terminal else PlainLines(console)
        self._tasks: dict[str, Any] = {}
        self._stages: dict[str, str] = {}
        self._ended = 0
        self._of = f" of {recordings}" if recordings else ""
        several = recordings is not None and recordings > 1
        self._all = bars.add_task("recordings", total=recordings) if several else None

    def __call__(self, recording: str, stage: str, done: int, total: int) -> None:
        """A recording is so far in a stage."""
        check_interrupt()
        if self._stages.get(recording) != stage:
            self._stages[recording] = stage
            if self._plain and stage:
                self._plain.say(f"{recording}: {stage}")
        if recording not in self._tasks:
            self._tasks[recording] = self._bars.add_task(recording, total=None)
        self._bars.update(
            self._tasks[recording], description=f"{recording}: {stage}", completed=done, total=max(total, 1)
        )

    def ended(self, outcome: "Outcome") -> None:
        """A recording is up to date or has failed: a line in a log, if anything was to be done."""
        self._ended += 1
        if outcome.recording in self._tasks:
            self._bars.remove_task(self._tasks.pop(outcome.recording))
        if self._all is not None:
            self._bars.update(self._all, completed=self._ended)
        if self._plain and (outcome.made or outcome.error):
            what = "failed" if outcome.error else "done"
            count = f", {self._ended}{self._of}" if self._all is not None else ""
            self._plain.say(f"{outcome.recording}: {what}{count}")

    def warn(self, message: str) -> None:
        """Something that concerns all of them."""
        self._console.print(f"warning: {message}", markup=False, highlight=False, soft_wrap=True)


@contextmanager
def recording_bars(console: Console, recordings: int | None = None) -> Iterator[RecordingBars]:
    """Bars of recordings, of which there are so many."""
    with _bars(console) as bars:
        yield RecordingBars(console, bars, recordings)


def _bars(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
