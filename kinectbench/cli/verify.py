"""The command `verify`."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import build_jobs
from kinectbench.cli.common import CANNOT_BE_USED, Common, takes
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import SettingsError, printable
from kinectbench.core.store.address import shown, url_of


@takes("jobs", "as_json")
def verify_command(
    common: Common,
    release: Annotated[
        Path, typer.Argument(help="the release's folder or URL, or its .zip, .tar or .tar.gz")
    ] = Path("benchmark"),
    rebuild: Annotated[
        Path | None,
        typer.Option(help="make the pairs again from here: a benchmark.yaml, or a folder of recordings"),
    ] = None,
    objects: Annotated[
        int | None,
        typer.Option(min=1, help="with --rebuild: so many objects, drawn by its hash; default: all"),
    ] = None,
    checksums: Annotated[
        bool,
        typer.Option("--checksums", help="the bytes alone: every file is the published one"),
    ] = False,
    work: Annotated[
        Path | None, typer.Option(help="with --rebuild: build here and keep it; default: a temporary folder")
    ] = None,
) -> int:
    """Re-check every byte and every pair of a release; with --rebuild make the pairs again and compare."""
    from kinectbench.engine.scratch import scratch_folder
    from kinectbench.release.check.reservations import reservations
    from kinectbench.release.check.verify import verify as find_problems
    from kinectbench.release.check.verify import verify_checksums

    if checksums and rebuild is not None:
        raise SettingsError(
            "verify: --checksums looks at the bytes alone, --rebuild at all: give one of them"
        )
    if objects is not None and rebuild is None:
        raise SettingsError(f"--objects {objects}: only with --rebuild, which makes pairs again")
    url = url_of(release)
    with ExitStack() as stack:
        folder, problems = release, list[str]()
        if url is not None:
            # The scratch folder holds the lock that marks it as in use.
            folder = stack.enter_context(scratch_folder()) / "release"
            problems = [] if checksums else _brought(url, folder)
        with progress_bar("verify") as progress:
            if url is not None and checksums:
                problems = verify_checksums(url, folder, progress)
            else:
                problems += find_problems(folder, progress, checksums_only=checksums)
        if rebuild is not None and not problems:
            problems = _rebuild(folder, rebuild, work, common.workers, objects)
        clauses = [] if problems else reservations(folder, checksums_only=checksums)
    common.tell_problems(problems, "; ".join([f"{shown(release)}: all well", *clauses]))
    return CANNOT_BE_USED if problems else 0


def _brought(url: str, folder: Path) -> list[str]:
    """Download a release unchanged into `folder`; return a line for each file at the URL that it lacks."""
    from kinectbench.release.check.verify import EXTRA
    from kinectbench.release.fetch import mirror_release

    with progress_bar("fetch") as progress:
        others = mirror_release(url, folder, progress)
    return [EXTRA.format(printable(name, 200)) for name in others]


def _rebuild(
    release: Path, recordings: Path, work: Path | None, processes: int, objects: int | None
) -> list[str]:
    """Do the work of `--rebuild`: build the recordings of a faultless release again; return differences."""
    from kinectbench.engine.scratch import scratch_folder
    from kinectbench.engine.stages import Job
    from kinectbench.release.check.rebuild import differences, find_sources, rebuild_plan
    from kinectbench.release.opening import open_contents
    from kinectbench.stages.ingest.readers import name_suffixes

    sources = find_sources(recordings, name_suffixes())
    with ExitStack() as stack:
        contents = stack.enter_context(open_contents(release))
        plan = rebuild_plan(contents, sources, objects)
        console.lines("note", plan.notes, "yellow")
        root = work or stack.enter_context(scratch_folder())
        chosen = [Job(plan.settings, recording, root) for recording in plan.settings.recordings]
        build_jobs(chosen, "pairs", processes)
        return list(differences(contents, plan, root / "build"))
