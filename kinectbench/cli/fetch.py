"""The commands `fetch` and `verify` for published data, and `gc`, which deletes unused files of a store."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import build_jobs
from kinectbench.cli.common import CANNOT_BE_USED, Common, refuse_in_release, takes
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import SettingsError, printable
from kinectbench.core.store.address import shown, url_of

# Largest number of files that `gc` lists one by one: a screenful.
SHOWN = 20


@takes("as_json", "jobs", makes_release=True)
def fetch_command(
    common: Common,
    release: Annotated[
        str,
        typer.Argument(
            metavar="NAME|URL|RECIPE",
            help="a release: its URL, folder, or name at KINECTBENCH_RELEASES; or a folder with sources.yaml",
        ),
    ],
    split: Annotated[str | None, typer.Option(help="train, validation or test alone")] = None,
    category: Annotated[
        list[str] | None, typer.Option(help="of this category alone; may be repeated")
    ] = None,
    views: Annotated[int | None, typer.Option(min=1, help="so many views of each recording")] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="of a recipe: so many scans of each category, drawn by its seed")
    ] = None,
    stream: Annotated[
        bool,
        typer.Option(
            "--stream", help="of a recipe: fetch, build and delete scan after scan, in 5 GB of disk"
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="folder; default: the last part of the URL, or the recipe's own")
    ] = None,
) -> int:
    """Download a release, part of one, or a recipe's scans; check each file, resume downloads."""
    from kinectbench.release.recipe import is_recipe

    if is_recipe(release):
        from kinectbench.cli.recipe import fetch_recipe

        if split is not None or views is not None:
            raise SettingsError(
                "--split and --views are of a release; of a recipe there are --category, --limit"
            )
        return fetch_recipe(common, Path(release), out, tuple(category or ()), limit, stream=stream)
    if limit is not None or stream:
        raise SettingsError(
            f"{release}: no recipe (a folder with sources.yaml), and --limit and --stream are of one"
        )
    return _fetch_release(common, release, split, category, views, out)


def _fetch_release(
    common: Common,
    release: str,
    split: str | None,
    category: list[str] | None,
    views: int | None,
    out: Path | None,
) -> int:
    from kinectbench.core.artefacts.targets import SPLITS
    from kinectbench.release.fetch import ReleasePart, fetch_release, release_url

    if split is not None and split not in SPLITS:
        raise SettingsError(f"--split {split}: choose among {', '.join(SPLITS)}")
    url = release_url(release)
    part = ReleasePart(split, tuple(category or ()), views)
    folder = out or Path(url.rpartition("/")[2])
    refuse_in_release(folder, makes_release=True)
    with progress_bar("fetch") as progress:
        fetched = fetch_release(url, folder, None if part == ReleasePart() else part, progress)
    result = {
        "release": str(fetched.folder),
        "benchmark_sha256": fetched.benchmark_sha256,
        "pairs": fetched.pairs,
        "fetched": fetched.fetched,
        "kept": fetched.kept,
    }
    lines = [
        f"{fetched.folder}: {fetched.pairs} pairs, {fetched.fetched} files fetched, {fetched.kept} were here",
        f"benchmark_sha256 {fetched.benchmark_sha256}",
    ]
    common.tell(result, lines)
    return 0


@takes("config", "as_json", at_url=True)
def gc_command(
    common: Common,
    delete: Annotated[bool, typer.Option("--delete", help="remove it; without, it is listed")] = False,
    everything: Annotated[
        bool, typer.Option("--all", help="also what is younger than a day: while nothing is built there")
    ] = False,
) -> None:
    """List files in a store's build/ that no manifest names, left by killed runs; --delete removes them."""
    from kinectbench.core.store.store import Store
    from kinectbench.engine.orphans import find_orphans, remove_orphans

    url = url_of(common.place)
    if url is None:
        raise SettingsError(
            f"--config {common.config}: gc is for stores; in a folder of this machine each run removes what "
            "killed ones left",
            what="bad-url",
        )
    store = Store(url)
    lost = find_orphans(store, young=everything)
    removed = remove_orphans(store, lost) if delete else 0
    size = f"{len(lost)} file{'s' * (len(lost) != 1)}, {sum(each.size for each in lost) / 1e6:.1f} MB"
    names = [f"{each.name} ({each.size} bytes)" for each in lost[:SHOWN]]
    more = [f"and {len(lost) - SHOWN} more"] if len(lost) > SHOWN else []
    outcome = f"removed {removed} files" if delete else "nothing is removed; --delete does"
    lines = [f"{shown(url)}: {size} that no manifest names; {outcome}", *names, *more]
    result = {"found": [each.name for each in lost], "removed": removed}
    common.tell(result, lines if lost else [f"{shown(url)}: nothing that no manifest names"])


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
        bool, typer.Option("--checksums", help="the bytes alone: every file is the published one")
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
        build_jobs(chosen, "pairs", Common(jobs=processes))
        return list(differences(contents, plan, root / "build"))
