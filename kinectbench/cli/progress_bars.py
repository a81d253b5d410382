"""Show how far a command is: progress bars on a terminal, lines in a log."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from kinectbench.cli import console
from kinectbench.core import failure_word
from kinectbench.engine.interrupts import check_interrupt

if TYPE_CHECKING:
    from kinectbench.engine.pipeline import Outcome

# Where no bar can be drawn, a line is printed at this interval; shorter work prints none.
LOG_EVERY_S = 10.0


class PlainLines:
    """Progress as lines such as `[  12 s] chair_01: track`, for logs, which cannot have progress bars."""

    def __init__(self) -> None:
        """Start the clock of the printed times."""
        self._started = time.monotonic()
        self._last = self._started

    def say(self, text: str) -> None:
        """Print a line with the time since the start."""
        self._last = time.monotonic()
        seconds = self._last - self._started
        shown = f"[{seconds:4.0f} s] {console.one_line(text)}"
        console.err.print(shown, markup=False, highlight=False, soft_wrap=True)

    def say_sometimes(self, text: str) -> None:
        """Print a line unless one was printed in the last 10 s."""
        if time.monotonic() - self._last >= LOG_EVERY_S:
            self.say(text)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar during a `with` block; yield a function that updates it with (done, total)."""
    plain = None if console.err.is_terminal else PlainLines()
    with _bars() as bars:
        task = bars.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            check_interrupt()
            bars.update(task, completed=done, total=total)
            if plain:
                plain.say_sometimes(f"{title}: {done} of {total}")

        yield update


@contextmanager
def _status(title: str) -> Iterator[Callable[[str], None]]:
    """Show a line during a `with` block, at first `title`; yield a function that replaces it."""
    plain = None if console.err.is_terminal else PlainLines()
    with console.err.status(title) as status:

        def update(text: str) -> None:
            check_interrupt()
            status.update(Text(text))
            if plain:
                plain.say_sometimes(text)

        yield update


@contextmanager
def step_shown(title: str) -> Iterator[Callable[[str], None]]:
    """Show the present step of a command during a `with` block; yield a function that takes its name."""
    with _status(title) as show:
        yield lambda step: show(f"{title}: {step}")


@contextmanager
def frames_counted(title: str) -> Iterator[Callable[[int, float, str], None]]:
    """Show a counter of frames during a `with` block; yield a function that updates it.

    The function takes the number of frames, the seconds passed, and the guide's advice or "".
    """
    with _status(title) as show:

        def update(frames: int, seconds: float, advice: str) -> None:
            """Show the number of frames, the seconds passed and the guide's advice."""
            text = f"{title}: {frames} frames, {seconds:.0f} s; Ctrl-C ends it"
            show(f"{advice.upper()} ({text})" if advice else text)

        yield update


class RecordingBars:
    """Progress bars of a build: one for each recording in work, and one for all if there are several.

    An instance is a `kinectbench.engine.parallel.ProgressWatcher`: it is called with (recording, stage, done,
    total), and also reports outcomes and warnings.
    """

    def __init__(
        self, bars: Progress, recordings: int | None, workers: Callable[[], int] | None = None
    ) -> None:
        """Start with the bar for all recordings if there are several, else without any bar.

        Args:
            bars: rich's progress display.
            recordings: number of recordings; None: not known.
            workers: function that returns the present number of parallel builds.
        """
        self._bars = bars
        self._recordings, self._workers = recordings, workers
        self._started = time.monotonic()
        self._failed = 0
        self._plain = None if console.err.is_terminal else PlainLines()
        self._tasks: dict[str, TaskID] = {}
        self._stages: dict[str, str] = {}
        self._ended = 0
        self._of = f" of {recordings}" if recordings else ""
        several = recordings is not None and recordings > 1
        self._all = bars.add_task("recordings", total=recordings) if several else None

    def __call__(self, recording: str, stage: str, done: int, total: int) -> None:
        """Show the progress of a recording: `done` of `total` steps of a stage."""
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
        """Remove the bar of a finished or failed recording; report its error, or in a log that it ended."""
        self._ended += 1
        self._failed += outcome.error is not None
        if outcome.recording in self._tasks:
            self._bars.remove_task(self._tasks.pop(outcome.recording))
        if self._plain and self._all is not None:
            self._plain.say_sometimes(f"recordings: {self._ended}{self._of} ended, {self._rest()}")
        if self._all is not None:
            self._bars.update(self._all, description=f"recordings ({self._rest()})", completed=self._ended)
        if outcome.error and self._failed > console.MOST_LINES:
            return  # only counted; the last lines of the run say where reasons are
        if self._plain and (outcome.made or outcome.error):
            what = failure_word(outcome.code) if outcome.error else "done"
            count = f", {self._ended}{self._of}" if self._all is not None else ""
            # With several recordings, the list of all errors may come late.
            why = f": {outcome.error}" if outcome.error and self._all is not None else ""
            self._plain.say(f"{outcome.recording}: {what}{count}{why}")
        elif outcome.error and self._all is not None:
            console.recording_lines(outcome.recording, failure_word(outcome.code), [outcome.error], "red")

    def _rest(self) -> str:
        """Return the state of the run as text, such as `3 failed, 97 left, 8 workers, 12 min to go`."""
        left = (self._recordings or 0) - self._ended
        parts = [f"{self._failed} failed", f"{left} left"]
        if self._workers is not None:
            workers = self._workers()
            parts.append(f"{workers} worker{'s' * (workers != 1)}")
        to_go_s = (time.monotonic() - self._started) / max(self._ended, 1) * left
        return ", ".join([*parts, f"{duration(to_go_s)} to go"])

    def warn(self, message: str) -> None:
        """Print a warning that concerns all recordings."""
        console.err.print(
            f"warning: {console.one_line(message)}", markup=False, highlight=False, soft_wrap=True
        )


@contextmanager
def recording_bars(
    recordings: int | None = None, workers: Callable[[], int] | None = None
) -> Iterator[RecordingBars]:
    """Show `RecordingBars` during a `with` block and yield them."""
    with _bars() as bars:
        yield RecordingBars(bars, recordings, workers)


def duration(seconds: float) -> str:
    """Return a duration as text, such as `40 s`, `12 min` or `3.5 h`."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _bars() -> Progress:
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console.err,
        transient=True,
        disable=not console.err.is_terminal,
    )
