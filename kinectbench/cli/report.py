"""`kinectbench report`: the page, of a benchmark's build or of a release alone."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli.build import build_recordings, exit_status, release_here
from kinectbench.cli.common import Baselines, Common, Ids, takes

if TYPE_CHECKING:
    from kinectbench.release.release import Release


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def report(
    common: Common,
    ids: Ids = None,
    scores: Annotated[
        list[Path] | None,
        typer.Option(help="scores.json, or a folder of them; repeat to merge; default: scores/"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="default: index.html in the folder of scores")] = None,
    baselines: Baselines = True,
) -> int:
    """Write the benchmark's page, scores/index.html: recordings, pairs, scores. It opens from disk."""
    from kinectbench.release.release import open_release
    from kinectbench.scoring.compare import find_scores
    from kinectbench.scoring.read_table import read_table

    if common.benchmark is None:  # before the benchmark is built
        for path in find_scores(scores or ()):
            read_table(path)
    release = None if common.benchmark is None else open_release(release_here(common.benchmark))
    rows = [] if release else build_recordings(common, ids, "pairs", told=True)
    page = write_page(common, release, scores or common.beside("scores"), out, baselines)
    common.tell_written(page.resolve())
    return exit_status(rows)


def write_page(
    common: Common,
    release: "Release | None",
    scores: Path | list[Path],
    out: Path | None = None,
    baselines: bool = True,
) -> Path:
    """The page of scores: of a release alone, or else of the benchmark here with what is built of it."""
    from kinectbench.cli import console
    from kinectbench.report.run import page_of_benchmark, page_of_release

    if release is not None:
        page, warnings = page_of_release(release, scores, out, baselines)
    else:
        with console.recording_bars() as progress:
            page, warnings = page_of_benchmark(
                common.settings,
                common.root,
                scores,
                lambda name, done, total: progress("report", name, done, total),
                out,
                baselines,
            )
    console.lines("warning", warnings, "yellow")
    return page
