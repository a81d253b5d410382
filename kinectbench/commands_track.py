"""The command `track`, and the comparison of what it finds with a trajectory in TUM format."""

import json
from collections.abc import Iterator, Mapping, Sequence
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
    show_rows,
)
from kinectbench.errors import KinectBenchError

if TYPE_CHECKING:
    from kinectbench.sequence import GivenTrajectory

# Poses this close to the reference are the same ones, but for rounding.
SAME_MM = 1e-3


def track(
    ids: Ids = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    jobs: Jobs = None,
    force: Force = False,
    compare: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="tell ATE and RPE against a trajectory in TUM format, and plot it; "
            "one file for every recording named, so name the one that it is of",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Bring recordings up to date as far as `track`; with a file, compare what was found with it."""
    # A file that cannot be read is told before anything is built.
    reference = None if compare is None else _reference(compare)
    settings, root = open_benchmark(config, overrides)
    rows = build_recordings(settings, root, ids, "track", jobs, ("track",) if force else ())
    if compare is not None and reference is not None:
        for row in rows:
            row["comparison"] = None
            if row["error"] is None:
                _compare(row, root / "build" / row["recording"], reference, compare)
    if as_json:
        typer.echo(json.dumps(rows))
    else:
        show_rows(rows, "track")
        for line in _verdicts(rows):
            typer.echo(line)
        _show_comparisons(rows, compare)
    exit_for(rows)


def _reference(path: Path) -> "GivenTrajectory":
    from kinectbench import console
    from kinectbench.ingest.trajectory_file import read_trajectory

    reference, warnings = read_trajectory(path)
    console.lines("warning", warnings, "yellow")
    return reference


def _compare(row: dict[str, Any], build: Path, reference: "GivenTrajectory", name: Path) -> None:
    """Add the comparison to a recording's row, or the error; beside the artefact, which stays as it is."""
    from kinectbench import console
    from kinectbench.stored import read_tracked
    from kinectbench.tracking.comparison import compare_with
    from kinectbench.tracking.pictures import COMPARISON
    from kinectbench.workspace import replaced_file

    picture = build / COMPARISON
    try:
        sequence, trajectory = read_tracked(build)
        figures, png = compare_with(trajectory, reference)
        with replaced_file(picture) as temporary:
            temporary.write_bytes(png)
    except KinectBenchError as error:
        row["error"], row["status"] = f"{name}: {error}", "failed"
        console.recording_lines(row["recording"], "error", [row["error"]], "red")
        return
    same = figures.ate_max_mm < SAME_MM or _equal(sequence.given_trajectory, reference)
    row["comparison"] = {
        "recording": row["recording"],
        **asdict(figures),
        "with_itself": trajectory.source == "trust" and same,
        "picture": str(picture),
    }


def _equal(given: "GivenTrajectory | None", reference: "GivenTrajectory") -> bool:
    """Whether they hold the same poses; with stamps between those of the frames errors are not quite 0."""
    import numpy as np

    return (
        given is not None
        and np.array_equal(given.stamps_ns, reference.stamps_ns)
        and np.allclose(given.T_world_camera, reference.T_world_camera, rtol=0, atol=SAME_MM / 1000)
    )


def _verdicts(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """A line per recording whose trajectory is up to date: its verdict, and what would be better."""
    for row in rows:
        # A failed run may have left an older trajectory, of other settings.
        if row["verdict"] is None or "track" not in (*row["made"], *row["current"]):
            continue
        done = "ignore" if row["source"] == "tracked" else row["source"]
        better = row["recommended"] not in (None, done)
        advice = f"; recommended is `trajectory: {row['recommended']}`" if better else ""
        yield f"{row['recording']}: {row['verdict']}{advice}"


def _show_comparisons(rows: Sequence[Mapping[str, Any]], reference: Path | None) -> None:
    compared = [row for row in rows if row.get("comparison")]
    if not compared:
        return
    from kinectbench import console
    from kinectbench.tracking.comparison import comparison_table

    console.out.print(comparison_table([row["comparison"] for row in compared], str(reference)))
    for row in compared:
        if row["comparison"]["with_itself"]:
            typer.echo(
                f"{row['recording']}: these are the given poses themselves, which are trusted: "
                "the comparison says nothing of how right they are"
            )
        typer.echo(f"picture: {row['comparison']['picture']}")
