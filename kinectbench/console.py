"""What people see in the terminal: progress bars on standard error, tables on standard output."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from kinectbench.interrupts import check_interrupt

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

err = Console(stderr=True)
out = Console()
if not out.is_terminal:
    # Piped into a file or a log: room for whole cells.
    out = Console(width=PLAIN_WIDTH)


@contextmanager
def bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar; yields a function of (done, total)."""
    with _bars() as bars:
        task = bars.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            check_interrupt()
            bars.update(task, completed=done, total=total)

        yield update


@contextmanager
def recording_bars() -> Iterator[Callable[[str, str, int, int], None]]:
    """One progress bar a recording; yields a function of (recording, stage, done, total)."""
    with _bars() as bars:
        tasks: dict[str, Any] = {}

        def update(recording: str, stage: str, done: int, total: int) -> None:
            check_interrupt()
            if recording not in tasks:
                tasks[recording] = bars.add_task(recording, total=None)
            bars.update(
                tasks[recording], description=f"{recording}: {stage}", completed=done, total=max(total, 1)
            )

        yield update


def lines(kind: str, messages: Sequence[str], style: str) -> None:
    """One line per message on standard error, without wrapping."""
    for message in messages:
        for line in message.splitlines():
            # Names and messages hold what strangers wrote: never markup.
            err.print(Text.assemble((f"{kind}:", style), " ", line), highlight=False, soft_wrap=True)


def recording_lines(recording: str, kind: str, messages: Sequence[str], style: str) -> None:
    """`lines` about a recording. Where its path is its id, messages begin with it: it is said once."""
    lines(f"{recording}: {kind}", [message.removeprefix(f"{recording}: ") for message in messages], style)


def summary_table(rows: Sequence[Mapping[str, Any]], stages: Sequence[str]) -> Table:
    """The table at the end of a build: one line per recording, with what these stages can fill."""
    columns = {"recording": "recording"}
    for stage in stages:
        columns |= COLUMNS.get(stage, {})
    columns["status"] = "status"
    table = Table()
    for key, title in columns.items():
        table.add_column(title, justify="left" if key in ("recording", "status") else "right")
    for row in rows:
        table.add_row(*(_cell(row.get(key)) for key in columns))
    return table


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        shown = ", ".join(map(str, value[:6])) + (" …" if len(value) > 6 else "")
        return f"{len(value)}: {shown}" if value else "0"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


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
