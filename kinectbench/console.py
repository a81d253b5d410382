"""What people see in the terminal: progress and messages on standard error, tables on standard output."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from kinectbench import progress

PLAIN_WIDTH = 160
# What each stage can say of a recording, by its key in a summary row.
COLUMNS: Mapping[str, Mapping[str, str]] = {
    "ingest": {"frames": "frames"},
    "track": {"left_out": "left out", "lost": "lost"},
    "segment": {"repeatability_iou": "odd/even IoU", "estimated_iou": "est. IoU"},
    "sample-views": {"views": "views"},
    "pairs": {
        "pairs": "pairs",
        "refused": "refused",
        "containment": "contained",
        "residual_mm": "residual mm",
    },
}
# How the page shows them; other figures have three decimals.
FORMATS: Mapping[str, str] = {"containment": ".1%", "residual_mm": ".1f"}

err = Console(stderr=True)
out = Console()
if not out.is_terminal:
    # Piped into a file or a log: room for whole cells.
    out = Console(width=PLAIN_WIDTH)


def bar(title: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """A progress bar; yields a function of (done, total)."""
    return progress.bar(err, title)


def recording_bars(recordings: int | None = None) -> AbstractContextManager[progress.RecordingBars]:
    """A bar for each of so many recordings; yields a function of (recording, stage, done, total)."""
    return progress.recording_bars(err, recordings)


def lines(kind: str, messages: Sequence[str], style: str) -> None:
    """One line per message on standard error, without wrapping."""
    for message in messages:
        for line in message.splitlines():
            # Names and messages hold what strangers wrote: never markup.
            err.print(Text.assemble((f"{kind}:", style), " ", line), highlight=False, soft_wrap=True)


def recording_lines(recording: str, kind: str, messages: Sequence[str], style: str) -> None:
    """`lines` about a recording. Where its path is its id, messages begin with it: it is said once."""
    lines(f"{recording}: {kind}", [message.removeprefix(f"{recording}: ") for message in messages], style)


def waiting(what: str, holder: str) -> None:
    """One line before a wait for another run."""
    lines("waiting", [f"{what}: for {holder}; Ctrl-C to stop"], "yellow")


def failures(rows: Sequence[Mapping[str, Any]]) -> None:
    """The last line of a run over several recordings of which some failed: which, and how to go on."""
    failed = [row["recording"] for row in rows if row["error"] is not None]
    if failed and len(rows) > 1:
        rest = "; the rest is done" if len(failed) < len(rows) else ""
        text = (
            f"{len(failed)} of {len(rows)} recordings: {', '.join(failed)}, for the reasons above{rest}. "
            "Correct them and run the same command again: what is done is kept."
        )
        lines("failed", [text], "red")


def summary_table(rows: Sequence[Mapping[str, Any]], stages: Sequence[str]) -> Table:
    """The table at the end of a build: one line per recording, with what these stages can fill."""
    columns = {"recording": "recording"}
    for stage in stages:
        columns |= COLUMNS.get(stage, {})
    columns["status"] = "status"
    medians = "contained and residual: medians over the pairs" if "residual_mm" in columns else None
    table = Table(caption=medians, caption_justify="left")
    for key, title in columns.items():
        table.add_column(title, justify="left" if key in ("recording", "status") else "right")
    for row in rows:
        table.add_row(*(_cell(row.get(key), FORMATS.get(key, ".3f")) for key in columns))
    return table


def _cell(value: Any, spec: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        # Frames by their index.
        shown = ", ".join(map(str, value[:6])) + (" …" if len(value) > 6 else "")
        return f"{len(value)} (frame{'s' * (len(value) > 1)} {shown})" if value else "0"
    return format(value, spec) if isinstance(value, float) else str(value)
