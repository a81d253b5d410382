"""Terminal output: progress and messages on standard error, tables on standard output."""

import json
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.segment import Segment
from rich.text import Text

from kinectbench.cli.wide_table import WideTable
from kinectbench.core import failure_word, listed, printable
from kinectbench.engine.interrupts import check_interrupt

if TYPE_CHECKING:
    from kinectbench.engine.pipeline import Outcome
    from kinectbench.engine.summary import BuiltRecording, RecordingSummary

PLAIN_WIDTH = 160
# Limit in characters of a message: a library's message may quote much of a file. Our own have up to 400.
LONGEST = 900
# Largest number of lines of one kind: nobody reads more; untrusted files may cause hundreds of thousands.
MOST_LINES = 1000
# Parts of a message that differ from file to file: a voxel with its value, a decimal, a length. Other numbers
# are sizes or counts.
MEASURED = re.compile(
    r"(?:-?\d[\d.e+-]* )?at \([\d, ]+\)|-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+(?= mm?\b| of \d+ edges\b| edges\b)"
)
# Where no bar can be drawn, a line is printed at this interval; shorter work prints none.
LOG_EVERY_S = 10.0
# The fields of a summary that each stage fills.
COLUMNS: Mapping[str, Mapping[str, str]] = {
    "ingest": {"frames": "frames", "damaged": "damaged"},
    "track": {"left_out": "left out", "lost": "lost"},
    "segment": {"repeatability_iou": "odd/even IoU", "estimated_iou": "est. IoU"},
    "sample-views": {"views": "views"},
    "pairs": {
        "pairs": "pairs",
        "refused": "passed over",
        "containment": "contained",
        "residual_mm": "residual mm",
    },
}
PASSED_OVER = "frames that did not do as a view, and views without a pair"
# Formats of some fields; other figures have three decimals.
FORMATS: Mapping[str, str] = {"containment": ".1%", "residual_mm": ".1f"}
ADVICE = {
    "failed": "Correct them and run the same command again: what is done is kept.",
    "in use": "Run the same command again when the other run has ended, or without --no-wait.",
}
# Keys of text columns; other columns have numbers.
TEXTS = ("recording", "status", "state", "next", "error")


class SafeConsole(Console):
    """A rich console for untrusted text: `one_line` replaces control characters, and markup stays text."""

    def __init__(self, **options: Any) -> None:
        """Make a console without markup and emoji codes: a category may be called `[/x]`."""
        super().__init__(**options, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render as rich does, but replace each line that has control characters by its `one_line`."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                shown = "\n".join(one_line(part) for part in segment.text.split("\n"))
                yield Segment(shown, segment.style)


err = SafeConsole(stderr=True)
# In a file or a log, this width leaves room for whole cells.
out = SafeConsole() if SafeConsole().is_terminal else SafeConsole(width=PLAIN_WIDTH)


def one_line(text: str) -> str:
    """Return a text as one line: line ends become spaces, other control characters `?`.

    Texts longer than `LONGEST` characters lose their middle.
    """
    return printable(re.sub(r"[\t\r\n]+", " ", text), most=LONGEST)


def say(*texts: str) -> None:
    """Print one line for each text on standard output, without wrapping."""
    for text in texts:
        typer.echo(one_line(text))


def say_json(value: object) -> None:
    """Print a value as JSON on standard output, in one line; characters beyond ASCII are escaped."""
    typer.echo(json.dumps(value))


def at_most(messages: Sequence[str]) -> list[str]:
    """Return the first `MOST_LINES` messages, then a line with the number of the rest."""
    more = len(messages) - MOST_LINES
    return [*messages[:MOST_LINES], *([f"and {more} more"] if more > 0 else [])]


def by_mistake(messages: Iterable[str]) -> list[str]:
    """Group messages about the same mistake; return the first message of each group, and its number of files.

    Args:
        messages: `<file>: <what is wrong>`; messages about the same mistake differ only in file, voxel and
            measured values.
    """
    groups: dict[str, list[str]] = {}
    for message in dict.fromkeys(messages):
        file, _, what = message.partition(": ")
        stem = file.removesuffix(PurePosixPath(file).suffix)
        own = re.compile(rf"(?<!\w){re.escape(stem)}(?!\w)")
        groups.setdefault(MEASURED.sub("*", own.sub("*", what)) if what else message, []).append(message)
    return [f"{len(of)} files, first {of[0]}" if len(of) > 1 else of[0] for of in groups.values()]


def lines(kind: str, messages: Sequence[str], style: str) -> None:
    """Print one line per message on standard error, without wrapping, and the number of messages left out.

    Args:
        kind: the text before the colon in each line, such as "warning".
        messages: the messages, of which `at_most` are printed.
        style: rich's style for `kind`.
    """
    for message in at_most(messages):
        # Names and messages hold untrusted text, so no markup is interpreted.
        text = Text.assemble((f"{one_line(kind)}:", style), " ", one_line(message))
        err.print(text, highlight=False, soft_wrap=True)


def recording_lines(recording: str, kind: str, messages: Sequence[str], style: str) -> None:
    """Print messages about a recording as `lines` does; drop the id from messages that start with it."""
    lines(f"{recording}: {kind}", [message.removeprefix(f"{recording}: ") for message in messages], style)


def waiting(what: str, holder: str) -> None:
    """Print that a command (`what`) waits for another run (`holder`)."""
    lines("waiting", [f"{what}: for {holder}; Ctrl-C to stop"], "yellow")


def object_lines(rows: "Sequence[RecordingSummary]", *, frontiers: bool) -> None:
    """Print about each object: estimated IoU with causes, the user's statements, why it is left out, advice.

    Args:
        rows: one summary for each recording.
        frontiers: whether to print advice on what to record again. It is printed only for recordings that
            were up to date; for new results, the warnings have it.
    """
    from kinectbench.core.artefacts.object import REASONS_FOLLOW, with_interval

    for row in rows:
        estimate = with_interval(row.estimated_iou, row.estimated_iou_low, row.estimated_iou_high, 2)
        if estimate and row.estimated_iou_reasons:
            out.print(Text(f"{row.recording}: estimated IoU {estimate}; {REASONS_FOLLOW}:"), soft_wrap=True)
            for reason in row.estimated_iou_reasons:
                out.print(Text(f"  {reason}"), soft_wrap=True)
        left_out = row.left_out_of_release and f"would be left out of a release: {row.left_out_of_release}"
        for line in filter(None, (row.rests_on_word, left_out)):
            out.print(Text(f"{row.recording}: {line}"), soft_wrap=True)
        for frontier in (row.frontiers or ()) if frontiers and not row.made else ():
            out.print(Text(f"{row.recording}: {frontier.advice}"), soft_wrap=True)


def failures(rows: "Sequence[BuiltRecording]") -> None:
    """Print a line on the failed recordings and one on those in use; nothing if only one recording ran."""
    ended = {row.recording: failure_word(row.code) for row in rows if row.error is not None}
    others_done = "; the rest is done" if len(ended) < len(rows) else ""
    for word, advice in ADVICE.items() if len(rows) > 1 else ():
        if names := [name for name, of in ended.items() if of == word]:
            text = f"{len(names)} of {len(rows)} recordings: {listed(names)}{others_done}. {advice}"
            lines(word, [text], "red")


def summary_table(rows: "Sequence[RecordingSummary]", stages: Sequence[str]) -> WideTable:
    """Return the table that ends a build: a row per recording, and the columns that these stages have."""
    columns = {"recording": "recording"}
    for stage in stages:
        columns |= COLUMNS.get(stage, {})
    if not any(row.damaged for row in rows):
        columns.pop("damaged", None)
    columns["status"] = "status"
    medians = (
        f"contained and residual: medians over the pairs; passed over: {PASSED_OVER}"
        if "residual_mm" in columns
        else None
    )
    shown = [row.json_value() | {"estimated_iou": _estimate(row)} for row in rows]
    return text_table(shown, columns, FORMATS, caption=medians)


def _estimate(row: "RecordingSummary") -> str | None:
    from kinectbench.core.artefacts.object import with_interval

    return with_interval(row.estimated_iou, row.estimated_iou_low, row.estimated_iou_high)


def text_table(
    rows: Sequence[Mapping[str, object]],
    columns: Mapping[str, str],
    formats: Mapping[str, str],
    *,
    title: str | None = None,
    caption: str | None = None,
) -> WideTable:
    """Return a table whose cells are never shortened; a table that is too wide is split into pieces.

    Args:
        rows: {key: value} for each row.
        columns: {key: title} of each column.
        formats: {key: number format}; numbers of other keys get three decimals.
        title: title above the table.
        caption: caption below the table.
    """
    made = WideTable(title=title, caption=caption, whole=True)
    for key, name in columns.items():
        made.add_column(name, justify="left" if key in TEXTS else "right")
    for row in rows:
        made.add_row(*(Text(_cell(row.get(key), formats.get(key, ".3f"))) for key in columns))
    return made


def _cell(value: object, spec: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        # Frames are listed by their index.
        shown = ", ".join(map(str, value[:6])) + (" …" if len(value) > 6 else "")
        return f"{len(value)} (frame{'s' * (len(value) > 1)} {shown})" if value else "0"
    return format(value, spec) if isinstance(value, float) else str(value)


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
        shown = f"[{seconds:4.0f} s] {one_line(text)}"
        err.print(shown, markup=False, highlight=False, soft_wrap=True)

    def say_sometimes(self, text: str) -> None:
        """Print a line unless one was printed in the last 10 s."""
        if time.monotonic() - self._last >= LOG_EVERY_S:
            self.say(text)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar during a `with` block; yield a function that updates it with (done, total)."""
    plain = None if err.is_terminal else PlainLines()
    with _bars() as bars:
        task = bars.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            check_interrupt()
            bars.update(task, completed=done, total=total)
            if plain:
                plain.say_sometimes(f"{title}: {done} of {total}")

        yield update


@contextmanager
def frames_counted(title: str) -> Iterator[Callable[[int, float, str], None]]:
    """Show a counter of frames during a `with` block; yield a function that updates it.

    The function takes the number of frames, the seconds passed, and the guide's advice or "".
    """
    plain = None if err.is_terminal else PlainLines()
    with err.status(title) as status:

        def update(frames: int, seconds: float, advice: str) -> None:
            """Show the number of frames, the seconds passed and the guide's advice."""
            check_interrupt()
            text = f"{title}: {frames} frames, {seconds:.0f} s; Ctrl-C ends it"
            text = f"{advice.upper()} ({text})" if advice else text
            status.update(Text(text))
            if plain:
                plain.say_sometimes(text)

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
        self._plain = None if err.is_terminal else PlainLines()
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
        if outcome.error and self._failed > MOST_LINES:
            return  # only counted; the last lines of the run say where reasons are
        if self._plain and (outcome.made or outcome.error):
            what = failure_word(outcome.code) if outcome.error else "done"
            count = f", {self._ended}{self._of}" if self._all is not None else ""
            # With several recordings, the list of all errors may come late.
            why = f": {outcome.error}" if outcome.error and self._all is not None else ""
            self._plain.say(f"{outcome.recording}: {what}{count}{why}")
        elif outcome.error and self._all is not None:
            recording_lines(outcome.recording, failure_word(outcome.code), [outcome.error], "red")

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
        err.print(f"warning: {one_line(message)}", markup=False, highlight=False, soft_wrap=True)


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
        console=err,
        transient=True,
        disable=not err.is_terminal,
    )
