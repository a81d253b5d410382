"""`kinectbench verify`: a release checked, and made again from its recordings."""

import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.commands import (
    CANNOT_BE_USED,
    DEFAULT_CONFIG,
    Jobs,
    Json,
    build_jobs,
    tell_problems,
    workers,
)
from kinectbench.errors import SettingsError

if TYPE_CHECKING:
    from kinectbench.release.rebuild import Source


def verify(
    release: Annotated[
        Path, typer.Argument(help="the release's folder, or its .zip, .tar or .tar.gz")
    ] = Path("benchmark"),
    rebuild: Annotated[
        Path | None,
        typer.Option(help="make the pairs again from here: a benchmark.yaml, or a folder of recordings"),
    ] = None,
    work: Annotated[
        Path | None, typer.Option(help="with --rebuild: build here and keep it; default: a temporary folder")
    ] = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Re-check every byte and every pair of a release; with --rebuild make the pairs again and compare."""
    from kinectbench import console
    from kinectbench.release.verify import verify as find_problems

    with console.bar("verify") as progress:
        problems = find_problems(release, progress)
    if rebuild is not None and not problems:
        problems = _rebuild(release, find_sources(rebuild), work, workers(jobs))
    tell_problems(problems, as_json, f"{release}: all well", CANNOT_BE_USED)


def _rebuild(release: Path, sources: "dict[str, Source]", work: Path | None, processes: int) -> list[str]:
    """Build the release's recordings anew and say what differs; only a sound release comes here."""
    from kinectbench import console
    from kinectbench.release.contents import open_contents
    from kinectbench.release.rebuild import differences, rebuild_plan
    from kinectbench.stages import Job

    with ExitStack() as stack:
        contents = stack.enter_context(open_contents(release))
        plan = rebuild_plan(contents, sources)
        console.lines("note", plan.notes, "yellow")
        root = work or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="kinectbench-rebuild-")))
        chosen = [Job(plan.settings, recording, root) for recording in plan.settings.recordings]
        build_jobs(chosen, "pairs", processes)
        return list(differences(contents, plan, root / "build"))


def find_sources(path: Path) -> "dict[str, Source]":
    """Where recordings lie: as a benchmark.yaml says, or else by their ids in a folder.

    Args:
        path: a benchmark.yaml, a folder that holds one, or a folder with `<id>/`, `<id>.bag` and so on.

    Raises:
        SettingsError: there is no such folder.
    """
    from kinectbench.benchmark_file import load_benchmark
    from kinectbench.release.rebuild import Source

    config = path / DEFAULT_CONFIG if path.is_dir() else path
    if config.is_file():
        settings = load_benchmark(config, ())
        root = config.parent
        return {
            r.id: Source(root / r.path, None if r.masks is None else root / r.masks)
            for r in settings.recordings
        }
    if not path.is_dir():
        raise SettingsError(f"{path}: no such benchmark.yaml or folder of recordings")
    found = {entry.stem: Source(entry) for entry in sorted(path.iterdir()) if not entry.name.startswith(".")}
    return found | {entry.name: Source(entry) for entry in sorted(path.iterdir()) if entry.is_dir()}
