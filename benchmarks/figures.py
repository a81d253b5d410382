"""What every script here prints: a table of figures, some of them held against a bar, and a JSON file."""

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from kinectbench.core.errors import KinectBenchError

PIPED_WIDTH = 160


@dataclass(frozen=True)
class Figure:
    """One measured value.

    Attributes:
        name: what was measured, with its unit.
        value: a number, a text or a list, as JSON keeps it.
        bar: the required value, in words; None if the figure is only stated.
        met: whether the value meets the bar; None without a bar.
    """

    name: str
    value: Any
    bar: str | None = None
    met: bool | None = None


def stated(name: str, value: Any) -> Figure:
    """A figure that is only stated, without a bar."""
    return Figure(name, value)


def at_least(name: str, value: float, bar: float) -> Figure:
    """A figure that has to reach a bar."""
    return Figure(name, value, f">= {bar:g}", bool(value >= bar))


def at_most(name: str, value: float, bar: float) -> Figure:
    """A figure that must not exceed a bar."""
    return Figure(name, value, f"<= {bar:g}", bool(value <= bar))


def equals(name: str, value: Any, bar: Any) -> Figure:
    """A figure that has to be one value."""
    return Figure(name, value, f"= {bar}", bool(value == bar))


def missed(figures: Sequence[Figure]) -> list[str]:
    """The bars that are not met, one line each."""
    return [f"{f.name}: {_text(f.value)}, not {f.bar}" for f in figures if f.met is False]


def arguments(description: str | None) -> argparse.ArgumentParser:
    """A parser of the options that every script has."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    return parser


def run(
    options: argparse.Namespace,
    measure: Callable[[], Sequence[Figure]],
    details: Mapping[str, Any] | None = None,
) -> None:
    """Measure, print the table and write the JSON; exit 1 if a bar is missed or the data cannot be used.

    Args:
        options: of `arguments`.
        measure: makes the figures.
        details: what the JSON has besides them, complete when they are measured.
    """
    started = time.monotonic()
    try:
        figures = [*measure()]
    except KinectBenchError as error:
        sys.exit(f"error: {error}")
    figures.append(stated("this script, s", round(time.monotonic() - started, 1)))
    table = Table("figure", "measured", Column("bar", no_wrap=True), Column(no_wrap=True))
    for figure in figures:
        verdict = {None: "", True: "[green]pass[/]", False: "[red]fail[/]"}[figure.met]
        table.add_row(figure.name, _text(figure.value), figure.bar or "", verdict)
    console = Console()
    if not console.is_terminal:
        console.width = PIPED_WIDTH
    console.print(table)
    if options.json:
        content = {"met": not missed(figures), "figures": [asdict(figure) for figure in figures]}
        content |= details or {}
        options.json.write_text(json.dumps(content, indent=1) + "\n")
    if missed(figures):
        sys.exit(1)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return "\n".join(map(_text, value)) or "none"
    return str(value)
