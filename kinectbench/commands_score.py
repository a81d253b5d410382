"""`kinectbench score`: predictions against a release, with the baselines beside them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.commands import (
    DEFAULT_CONFIG,
    SOME_FAILED,
    Baselines,
    BenchmarkDir,
    Config,
    Jobs,
    Json,
    Predictions,
    Set,
    exit_for,
    find_release,
    release_page,
    workers,
    write_page,
)

if TYPE_CHECKING:
    from kinectbench.release.release import Release
    from kinectbench.scoring.table import ScoreTable

SHOWN_FAILURES = 20


def score(
    predictions: Predictions,
    benchmark: BenchmarkDir = None,
    method: Annotated[str | None, typer.Option(help="name of the method; default: its folder's")] = None,
    protocol: Annotated[list[str] | None, typer.Option(help="paper, known, occluded; default: all")] = None,
    thresholds: Annotated[Path | None, typer.Option(help="a threshold file")] = None,
    save_thresholds: Annotated[
        Path | None, typer.Option(help="freeze the thresholds found on validation in this file")
    ] = None,
    missing: Annotated[str, typer.Option(help="error, or empty: score an empty grid")] = "error",
    upsampling: Annotated[
        str, typer.Option(help="of grids that are not 256 a side: half-pixel, or corner-aligned")
    ] = "half-pixel",
    surface: Annotated[bool, typer.Option(help="Chamfer distance, F-score, surface Dice, normals")] = True,
    baselines: Baselines = True,
    gallery: Annotated[bool, typer.Option(help="keep some predictions for the page, small")] = True,
    out: Annotated[Path | None, typer.Option(help="default: scores/ beside the benchmark")] = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Score predictions; thresholds come from the validation split or a file."""
    from kinectbench import console
    from kinectbench.report.run import write_galleries
    from kinectbench.scoring.run import score_methods
    from kinectbench.scoring.terminal import score_table

    release, rows = find_release(benchmark, config, overrides, jobs)
    folder = out or (Path("scores") if benchmark else config.parent / "scores")
    with console.bar("score") as progress:
        tables = score_methods(
            release,
            predictions,
            folder,
            method=method,
            protocols=protocol,
            thresholds_file=thresholds,
            save_thresholds=save_thresholds,
            missing=missing,
            upsampling=upsampling,
            surface=surface,
            jobs=workers(jobs),
            progress=progress,
        )
    if gallery:
        with console.bar("gallery") as progress:
            write_galleries(release, predictions, tables, folder, upsampling, progress)
    _tell_problems(tables)
    beside = _beside(release, folder, tables, upsampling, jobs) if baselines else []
    if benchmark:
        page = release_page(release, folder, baselines=baselines)
    else:
        page = write_page(config, overrides, folder, baselines=baselines)
    if as_json:
        typer.echo(json.dumps([{"method": t.method, "overall": t.overall} for t in tables]))
    else:
        console.out.print(score_table([*tables, *beside], published=True))
        typer.echo(f"page: {page.resolve()}")
    if not all(table.complete for table in tables):
        raise typer.Exit(SOME_FAILED)
    exit_for(rows)


def _beside(
    release: "Release", folder: Path, tables: "Sequence[ScoreTable]", upsampling: str, jobs: int | None
) -> "list[ScoreTable]":
    """The baselines that are not among the methods already."""
    from kinectbench import console
    from kinectbench.baselines.beside import baselines_beside

    protocols, names = tables[0].settings["protocols"], [table.method for table in tables]
    with console.bar("baselines") as progress:
        return baselines_beside(
            release,
            folder,
            protocols=protocols,
            upsampling=upsampling,
            without=names,
            jobs=workers(jobs),
            progress=progress,
        )


def _tell_problems(tables: "Sequence[ScoreTable]") -> None:
    """Warnings and failures of each method, one line each."""
    from kinectbench import console

    for table in tables:
        console.lines(f"{table.method}: warning", table.warnings, "yellow")
        reasons = [failure["reason"] for failure in table.failures]
        if len(reasons) > SHOWN_FAILURES:
            more = f"and {len(reasons) - SHOWN_FAILURES} more; scores.json and `kinectbench check` list all"
            reasons = [*reasons[:SHOWN_FAILURES], more]
        console.lines(f"{table.method}: error", reasons, "red")
