"""What the commands share: options, the way from a benchmark.yaml to what is built, exit statuses."""

import json
import os
from collections.abc import Sequence
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinectbench.errors import SettingsError

if TYPE_CHECKING:
    from kinectbench.config import BenchmarkSettings
    from kinectbench.release.release import Release
    from kinectbench.stages import Job

CANNOT_BE_USED = 1
SOME_FAILED = 3
DEFAULT_CONFIG = Path("benchmark.yaml")

Ids = Annotated[list[str] | None, typer.Argument(metavar="[RECORDING]...", help="ids; default: all")]
Config = Annotated[Path, typer.Option("--config", "-c", help="the benchmark's settings")]
Set = Annotated[
    list[str] | None, typer.Option("--set", metavar="SECTION.KEY=VALUE", help="override a setting")
]
Jobs = Annotated[int | None, typer.Option("--jobs", "-j", min=1, help="processes; default: one per core")]
Force = Annotated[
    bool, typer.Option("--force", help="make it anew even if it is current; build: every stage")
]
Wait = Annotated[
    bool,
    typer.Option("--wait/--no-wait", help="wait for another run here, or stop and say whose it is"),
]
Json = Annotated[bool, typer.Option("--json", help="print JSON for machines")]
BenchmarkDir = Annotated[
    Path | None, typer.Option("--benchmark", help="a release; default: made from --config")
]
Baselines = Annotated[bool, typer.Option(help="show the baselines beside the methods")]
Predictions = Annotated[Path, typer.Argument(help="one method's folder, or a folder of methods")]


def run_stage(
    name: str,
    ids: list[str] | None,
    config: Path,
    overrides: list[str] | None,
    jobs: int | None,
    force: bool,
    as_json: bool,
    wait: bool = True,
) -> None:
    """Bring recordings up to date as far as a stage (`build`: all), and show what became of them."""
    from kinectbench.pipeline import STAGE_NAMES

    settings, root = open_benchmark(config, overrides)
    upto, stages = ("pairs", STAGE_NAMES) if name == "build" else (name, (name,))
    rows = build_recordings(settings, root, ids, upto, jobs, stages if force else (), wait=wait)
    if as_json:
        typer.echo(json.dumps(rows))
    else:
        show_rows(rows, upto)
    exit_for(rows)


def show_rows(rows: list[dict[str, Any]], upto: str) -> None:
    """The table of what `build_recordings` returned for this last stage."""
    from kinectbench import console
    from kinectbench.pipeline import STAGE_NAMES

    console.out.print(console.summary_table(rows, STAGE_NAMES[: STAGE_NAMES.index(upto) + 1]))


def open_benchmark(config: Path, overrides: list[str] | None) -> "tuple[BenchmarkSettings, Path]":
    """The settings, and the folder that relative paths start from."""
    from kinectbench.benchmark_file import load_benchmark

    return load_benchmark(config, overrides or ()), config.parent


def build_recordings(
    settings: "BenchmarkSettings",
    root: Path,
    ids: list[str] | None,
    upto: str,
    jobs: int | None,
    force: Sequence[str] = (),
    *,
    wait: bool = True,
) -> list[dict[str, Any]]:
    """Build, tell warnings and errors, and return a summary row per recording, with its `error` or None."""
    return build_jobs(chosen_jobs(settings, root, ids), upto, workers(jobs), force, wait=wait)


def build_jobs(
    chosen: "Sequence[Job]", upto: str, processes: int, force: Sequence[str] = (), *, wait: bool = True
) -> list[dict[str, Any]]:
    """`build_recordings` of jobs that are known already, on so many processes."""
    from kinectbench import console
    from kinectbench.parallel import build
    from kinectbench.pipeline import summary

    with console.recording_bars(len(chosen)) as watcher:
        outcomes = build(chosen, upto, force, processes, watcher, wait_for_others=wait)
    rows = []
    for job, outcome in zip(chosen, outcomes, strict=True):
        row = summary(job, (*outcome.made, *outcome.current))
        done = f"{outcome.seconds:.1f} s" if outcome.made else "up to date"
        row["status"] = "failed" if outcome.error else done
        row["error"] = outcome.error
        row["made"], row["current"] = list(outcome.made), list(outcome.current)
        rows.append(row)
        # Told although all is up to date: whoever has just drawn a mask expects it to be used.
        unused = _unused_masks(job) if upto in ("sample-views", "pairs") else []
        row["warnings"] += unused
        told = row["warnings"] if outcome.made else unused
        console.recording_lines(job.recording.id, "warning", told, "yellow")
        console.recording_lines(job.recording.id, "error", [outcome.error] if outcome.error else [], "red")
    return rows


def _unused_masks(job: "Job") -> list[str]:
    """A warning if masks lie where benchmark.yaml does not name them."""
    if job.unused_masks is None:
        return []
    name = job.recording.id
    return [f"{job.unused_masks}: not used; add `masks: masks/{name}` to {name} in benchmark.yaml to use it"]


def built(rows: list[dict[str, Any]]) -> list[str]:
    """Ids of the recordings that went well."""
    return [row["recording"] for row in rows if row["error"] is None]


def exit_for(rows: list[dict[str, Any]]) -> None:
    """End with 1 if no recording could be used, with 3 if some could not; of several, say once more which."""
    from kinectbench import console

    failed = len(rows) - len(built(rows))
    if failed:
        console.failures(rows)
        raise typer.Exit(CANNOT_BE_USED if failed == len(rows) else SOME_FAILED)


def find_release(
    benchmark: Path | None, config: Path, overrides: list[str] | None, jobs: int | None
) -> "tuple[Release, list[dict[str, Any]]]":
    """The release named, or the one of the benchmark here, built and published first if need be.

    Returns:
        The release, and what `build_recordings` returned for it.
    """
    from kinectbench import console
    from kinectbench.release.current import publish_if_stale
    from kinectbench.release.release import open_release

    if benchmark is not None:
        return open_release(benchmark), []
    settings, root = open_benchmark(config, overrides)
    rows = build_recordings(settings, root, None, "pairs", jobs)
    if not built(rows):
        exit_for(rows)
    published = publish_if_stale(settings, root, built(rows), waiting=partial(console.waiting, "publish"))
    return open_release(published.scoring), rows


def write_page(
    config: Path,
    overrides: list[str] | None,
    scores: Path | list[Path],
    out: Path | None = None,
    baselines: bool = True,
) -> Path:
    """The page of the benchmark here."""
    from kinectbench import console
    from kinectbench.report.run import page_of_benchmark

    settings, root = open_benchmark(config, overrides)
    with console.recording_bars() as progress:
        page, warnings = page_of_benchmark(
            settings,
            root,
            scores,
            lambda name, done, total: progress("report", name, done, total),
            out,
            baselines,
        )
    console.lines("warning", warnings, "yellow")
    return page


def release_page(
    release: "Release", scores: Path | list[Path], out: Path | None = None, baselines: bool = True
) -> Path:
    """The page of the scores of a release alone."""
    from kinectbench import console
    from kinectbench.report.run import page_of_release

    page, warnings = page_of_release(release, scores, out, baselines)
    console.lines("warning", warnings, "yellow")
    return page


def tell_problems(problems: list[str], as_json: bool, well: str, status: int) -> None:
    """One line per problem and an exit status, or one line that all is well."""
    from kinectbench import console

    if as_json:
        typer.echo(json.dumps(problems))
    elif not problems:
        typer.echo(well)
    console.lines("error", problems, "red")
    if problems:
        raise typer.Exit(status)


def tell_written(paths: list[Path], as_json: bool) -> None:
    """One line per file or folder that was written."""
    if as_json:
        typer.echo(json.dumps([str(path) for path in paths]))
    else:
        for path in paths:
            typer.echo(f"wrote {path}")


def tell_table(rows: dict[str, str], as_json: bool) -> None:
    """One line per name with what it stands for."""
    if as_json:
        typer.echo(json.dumps(rows))
    else:
        width = max(map(len, rows))
        for name, text in rows.items():
            typer.echo(f"{name:<{width}}  {text}")


def workers(jobs: int | None) -> int:
    """The number of processes: as asked for, or one per core."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return jobs or cores or 1


def chosen_jobs(settings: "BenchmarkSettings", root: Path, ids: list[str] | None) -> "list[Job]":
    """The recordings asked for; an unknown id is refused with the nearest one."""
    from kinectbench.stages import Job

    known = [recording.id for recording in settings.recordings]
    for name in ids or []:
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(known)}"
            raise SettingsError(f"no recording '{name}' in benchmark.yaml; {hint}")
    return [Job(settings, r, root) for r in settings.recordings if not ids or r.id in ids]
