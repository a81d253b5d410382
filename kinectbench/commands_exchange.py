"""The commands that exchange releases with other layouts."""

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from kinectbench.commands import (
    DEFAULT_CONFIG,
    BenchmarkDir,
    Config,
    Jobs,
    Json,
    Set,
    exit_for,
    find_release,
)

# Each is a room `release/<layout>_export.py` with a function `export_<layout>`.
Layout = Literal["recgan", "bop", "webdataset"]


def export(
    out: Annotated[Path, typer.Argument(help="a new folder")],
    layout: Annotated[Layout, typer.Option(help="the paper's authors', BOP's, or WebDataset's")] = "recgan",
    benchmark: BenchmarkDir = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Write a release in another layout: `recgan`, the paper authors' files and axes; `bop`; `webdataset`."""
    from importlib import import_module

    from kinectbench import console

    write = getattr(import_module(f"kinectbench.release.{layout}_export"), f"export_{layout}")
    release, rows = find_release(benchmark, config, overrides, jobs)
    with console.bar("export") as progress:
        pairs = write(release, out, progress)
    _tell("exported", pairs, out, as_json)
    exit_for(rows)


def import_(
    folder: Annotated[Path, typer.Argument(help="holds P1_<synset>_<category>/")],
    out: Annotated[Path, typer.Argument(help="the release: a new folder")],
    as_json: Json = False,
) -> None:
    """Make a release of files in the layout of the paper's authors."""
    from kinectbench import console
    from kinectbench.release.recgan_import import import_recgan

    with console.bar("import") as progress:
        pairs = import_recgan(folder, out, progress)
    _tell("imported", pairs, out, as_json)


def _tell(done: str, pairs: int, out: Path, as_json: bool) -> None:
    """How many pairs went where."""
    if as_json:
        typer.echo(json.dumps({"folder": str(out), "pairs": pairs}))
    else:
        typer.echo(f"{done} {pairs} pairs: {out}")
