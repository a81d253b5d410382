"""The commands `fetch`, which downloads published data, and `gc`, which deletes unused files."""

from pathlib import Path
from typing import Annotated

import typer

from kinectbench.cli.common import Common, refuse_in_release, takes
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import SettingsError
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
