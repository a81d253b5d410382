"""The command `publish`: what is built as a release, in parts and archives where asked for."""

import json
from functools import partial
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
    Wait,
    build_recordings,
    built,
    exit_for,
    open_benchmark,
)

if TYPE_CHECKING:
    from kinectbench.release.publish import PublishSummary


def publish(
    ids: Ids = None,
    hold_back: Annotated[
        list[str] | None,
        typer.Option(help="a split: benchmark/ has its inputs only, benchmark-private/ scores"),
    ] = None,
    thresholds: Annotated[
        Path | None, typer.Option(help="a threshold file (of score --save-thresholds) to publish with it")
    ] = None,
    archives: Annotated[bool, typer.Option("--archives", help="pack each part as a zip file too")] = False,
    archives_to: Annotated[
        Path | None, typer.Option(help="folder of the zip files; default: beside the release")
    ] = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    jobs: Jobs = None,
    force: Force = False,
    wait: Wait = True,
    as_json: Json = False,
) -> None:
    """Write the release to benchmark/, from everything that can be built."""
    from kinectbench import console
    from kinectbench.release.archive import refuse_unstated, write_archive
    from kinectbench.release.current import publish_if_stale
    from kinectbench.release.options import publish_options

    settings, root = open_benchmark(config, overrides)
    options = publish_options(settings, hold_back or (), thresholds)
    packed = archives or archives_to is not None
    if packed:
        refuse_unstated(settings, ids)
    rows = build_recordings(settings, root, ids, "pairs", jobs, wait=wait)
    if not built(rows):
        exit_for(rows)
    tell = partial(console.waiting, "publish")
    summary = publish_if_stale(settings, root, built(rows), force, options, wait=wait, waiting=tell)
    parts = [part for part in (summary.folder, summary.private) if part is not None]
    written = [write_archive(part, archives_to or root) for part in parts] if packed else []
    _tell(summary, written, as_json)
    exit_for(rows)


def _tell(summary: "PublishSummary", archives: list[Path], as_json: bool) -> None:
    """What was published, removed, packed, and asked for."""
    from kinectbench import console

    console.lines("warning", summary.warnings, "yellow")
    if summary.unanswered:
        keys = ", ".join(summary.unanswered)
        line = f"not stated in datasheet.md: {keys}; answer under `publish: datasheet:` in benchmark.yaml"
        console.lines("note", [line], "cyan")
    if as_json:
        result: dict[str, Any] = {
            "release": str(summary.folder),
            "recordings": list(summary.recordings),
            "pairs": summary.pairs,
            "benchmark_sha256": summary.benchmark_sha256,
            "private": None if summary.private is None else str(summary.private),
            "private_benchmark_sha256": summary.private_sha256,
            "removed": list(summary.removed),
            "unanswered": list(summary.unanswered),
            "archives": [str(path) for path in archives],
        }
        typer.echo(json.dumps(result))
        return
    count = f"{len(summary.recordings)} recording{'s' * (len(summary.recordings) != 1)}"
    typer.echo(f"published {summary.pairs} pairs of {count}: {summary.folder}")
    typer.echo(f"benchmark_sha256 {summary.benchmark_sha256}")
    if summary.private is not None:
        typer.echo(f"private part, which scores: {summary.private}")
        typer.echo(f"private_benchmark_sha256 {summary.private_sha256}")
    for line in (
        *summary.removed,
        *(f"wrote {path}, {path.stat().st_size / 1e6:.1f} MB, and its .sha256" for path in archives),
    ):
        typer.echo(line)
