"""The command `track`, and the comparison of what it finds with a trajectory in TUM format."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinectbench.commands import (
    DEFAULT_CONFIG,
    Config,
    Force,
    Ids,
    Jobs,
    Json,
    Set,
    build_recordings,
    exit_for,
    open_benchmark,
    run_stage,
)
from kinectbench.errors import KinectBenchError

if TYPE_CHECKING:
    from kinectbench.sequence import GivenTrajectory


def track(
    ids: Ids = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    jobs: Jobs = None,
    force: Force = False,
    compare: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="tell ATE and RPE against a trajectory in TUM format, and plot it"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Bring recordings up to date as far as `track`; with a file, compare what was found with it."""
    if compare is None:
        run_stage("track", ids, config, overrides, jobs, force, as_json)
        return
    from kinectbench import console
    from kinectbench.ingest.trajectory_file import read_trajectory
    from kinectbench.tracking.comparison import comparison_table

    reference, warnings = read_trajectory(compare)
    console.lines("warning", warnings, "yellow")
    settings, root = open_benchmark(config, overrides)
    rows = build_recordings(settings, root, ids, "track", jobs, ("track",) if force else ())
    for row in rows:
        if row["error"] is None:
            _compare(row, root / "build" / row["recording"], reference, compare)
    compared = [row["comparison"] for row in rows if row.get("comparison")]
    if as_json:
        typer.echo(json.dumps([{"comparison": None, **row} for row in rows]))
    elif compared:
        console.out.print(comparison_table(compared, str(compare)))
        for comparison in compared:
            typer.echo(f"picture: {comparison['picture']}")
    exit_for(rows)


def _compare(row: dict[str, Any], build: Path, reference: "GivenTrajectory", name: Path) -> None:
    """Add the comparison to a recording's row, or the error; beside the artefact, which stays as it is."""
    from kinectbench import console
    from kinectbench.stored import read_tracked
    from kinectbench.tracking.comparison import compare_with
    from kinectbench.workspace import replaced_file

    picture = build / "compare.png"
    try:
        figures, png = compare_with(read_tracked(build)[1], reference)
        with replaced_file(picture) as temporary:
            temporary.write_bytes(png)
    except KinectBenchError as error:
        row["error"], row["status"] = f"{name}: {error}", "failed"
        console.lines(f"{row['recording']}: error", [row["error"]], "red")
        return
    row["comparison"] = {"recording": row["recording"], **asdict(figures), "picture": str(picture)}
