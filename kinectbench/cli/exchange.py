"""The commands `export` and `import`: releases in other layouts."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from kinectbench.cli.build import exit_status, find_release
from kinectbench.cli.common import Common, takes

# Each is a room `release/exchange/<layout>.py` with a function `export_<layout>`.
Layout = Literal["recgan", "bop", "webdataset", "parquet"]


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def export(
    common: Common,
    out: Annotated[Path, typer.Argument(help="a new folder, or an earlier export")],
    layout: Annotated[
        Layout, typer.Option(help="the paper's authors', BOP's, WebDataset's, or the targets as Parquet")
    ] = "recgan",
) -> int:
    """Write a release in another layout: of the paper's authors (`recgan`), BOP, WebDataset; Parquet."""
    from importlib import import_module

    from kinectbench.cli import console

    write = getattr(import_module(f"kinectbench.release.exchange.{layout}"), f"export_{layout}")
    release, rows = find_release(common)
    with console.bar("export") as progress:
        pairs = write(release, out, progress)
    common.tell({"folder": str(out), "pairs": pairs}, [f"exported {pairs} pairs: {out}"])
    return exit_status(rows)


@takes("as_json")
def import_(
    common: Common,
    folder: Annotated[Path, typer.Argument(help="holds P1_<synset>_<category>/")],
    out: Annotated[Path, typer.Argument(help="the release: a new folder")],
    views: Annotated[
        int | None,
        typer.Option(
            help="the test set: 125 (the paper's SV, viewing angles of training) or 216 (CV, others)"
        ),
    ] = None,
) -> None:
    """Make a release of files in the layout of the paper's authors."""
    from kinectbench.cli import console
    from kinectbench.release.exchange.recgan import import_recgan

    with console.bar("import") as progress:
        pairs = import_recgan(folder, out, progress, views)
    common.tell({"folder": str(out), "pairs": pairs}, [f"imported {pairs} pairs: {out}"])
