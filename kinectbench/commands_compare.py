"""`kinectbench compare`: methods against each other, on the same objects."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from kinectbench.commands import Json


def compare(
    scores: Annotated[list[Path], typer.Argument(help="scores.json files, or folders that hold them")],
    metric: Annotated[str, typer.Option(help="such as iou, ce, f1, chamfer_mm, surface_dice")] = "iou",
    protocol: Annotated[str, typer.Option(help="paper, known, occluded")] = "known",
    as_json: Json = False,
) -> None:
    """Say which methods are better: paired tests over objects, ranks, or that the test set is too small."""
    from kinectbench import console
    from kinectbench.scoring.compare import compare as compare_tables
    from kinectbench.scoring.read import find_scores, read_scores
    from kinectbench.scoring.terminal import comparison_tables

    tables = [read_scores(path) for path in find_scores(scores)]
    found = compare_tables(tables, metric, protocol)
    if as_json:
        typer.echo(json.dumps(asdict(found)))
        return
    for table in comparison_tables(found):
        console.out.print(table)
    console.lines("note", found.notes, "yellow")
