"""Terminal output: progress and messages on standard error, tables on standard output."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from kinectbench.cli.wide_table import WideTable
from kinectbench.core import failure_word, listed, printable

if TYPE_CHECKING:
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
