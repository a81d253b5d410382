"""The commands `report`, which writes a page of a build or release, and `triage`, which sorts recordings."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import SHOWN_RECORDINGS, build_recordings, built, exit_status, release_here
from kinectbench.cli.common import Baselines, Common, Ids, takes
from kinectbench.cli.progress_bars import progress_bar, recording_bars
from kinectbench.core import SettingsError

if TYPE_CHECKING:
    from kinectbench.release.release import Release


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def report_command(
    common: Common,
    ids: Ids = None,
    scores: Annotated[
        list[Path] | None,
        typer.Option(help="scores.json, or a folder of them; repeat to merge; default: scores/"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="the file to write: a page (default: index.html in the folder of scores), or with "
            "--paper-table Markdown (default: printed)"
        ),
    ] = None,
    baselines: Baselines = True,
    paper_table: Annotated[
        bool, typer.Option("--paper-table", help="print the paper's table of the scores instead, Markdown")
    ] = False,
) -> int:
    """Write the benchmark's page, scores/index.html: recordings, pairs, scores. It opens from disk.

    With ids, the page has those recordings and all scores.
    """
    if paper_table:
        return _paper_table(common, ids, scores or [common.beside("scores")], out, baselines)
    from kinectbench.release.release import open_release
    from kinectbench.scoring.compare import find_scores
    from kinectbench.scoring.read_table import read_table

    if common.benchmark is not None and ids:
        raise SettingsError(f"report {' '.join(ids)}: with --benchmark the page is of the whole release")
    if common.benchmark is None:  # before the benchmark is built
        for path in find_scores(scores or ()):
            read_table(path)
    release = None if common.benchmark is None else open_release(release_here(common.benchmark))
    rows = [] if release else build_recordings(common, ids, "pairs", brief=True)
    page = write_page(common, release, scores or common.beside("scores"), out, baselines, ids)
    common.tell_written(page.resolve())
    return exit_status(rows)


def _paper_table(
    common: Common, ids: Sequence[str] | None, scores: Sequence[Path], out: Path | None, baselines: bool
) -> int:
    """Print score files as a table in the paper's form, or write it to `out`; nothing is built."""
    from kinectbench.core import replaced_file
    from kinectbench.release.release import open_release
    from kinectbench.report.paper_table import paper_markdown, paper_tables
    from kinectbench.report.run import files_named, kept_baselines

    if ids:
        raise SettingsError("report --paper-table: is of score files, not of recordings; name --scores")
    release = None if common.benchmark is None else open_release(release_here(common.benchmark))
    files = files_named(scores, release.benchmark_sha256 if release else None)
    files += kept_baselines(files) if baselines else []
    tables = paper_tables([file.table for file in files])
    text = paper_markdown(tables)
    if out is None:
        common.tell([asdict(table) for table in tables], text.splitlines())
        return 0
    with replaced_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    common.tell_written(out.resolve())
    return 0


def write_page(
    common: Common,
    release: "Release | None",
    scores: Path | list[Path],
    out: Path | None = None,
    baselines: bool = True,
    ids: Sequence[str] | None = None,
) -> Path:
    """Write a page with the scores and the release; if `release` is None, with the local benchmark's build.

    Args:
        common: the shared options.
        release: the release; None if there is none.
        scores: scores.json files, or folders that hold them.
        out: the page's path; None: index.html in the folder of scores.
        baselines: whether baselines are shown.
        ids: the recordings to show of the build; None: all.
    """
    from kinectbench.report.run import page_of_benchmark, page_of_release

    if release is not None:
        page, warnings = page_of_release(release, scores, out, baselines)
    else:
        shown = [r for r in common.settings.recordings if not ids or r.id in ids]
        with recording_bars() as progress:
            page, warnings = page_of_benchmark(
                common.settings.model_copy(update={"recordings": shown}),
                common.root,
                scores,
                lambda name, done, total: progress("report", name, done, total),
                out,
                baselines,
            )
    console.lines("warning", warnings, "yellow")
    return page


# Limit in letters of a reason in the table, so that it fits beside the decision; the page has the full text.
REASON = 60
COLUMNS = {"recording": "recording", "decision": "decision", "reason": "first reason"}


@takes("config", "overrides", "jobs", "as_json")
def triage_command(common: Common, ids: Ids = None) -> int:
    """Build what is not up to date; sort recordings into accept, look, reject; write a page to triage/.

    If recordings are named, their decisions are printed, and nothing is written to triage/.
    """
    from kinectbench.core import replaced_file
    from kinectbench.release.triage.triage import triage as sorted_out
    from kinectbench.report.triage import write_triage_page

    settings, root = common.settings, common.root
    rows = build_recordings(common, ids, "pairs", brief=True)
    if ids:
        chosen = tuple(each for each in settings.recordings if each.id in ids)
        settings = settings.model_copy(update={"recordings": chosen})
    result = sorted_out(settings, root / "build", built(rows))
    page = root / "triage" / "index.html"
    if not ids:
        page.parent.mkdir(exist_ok=True)
        with replaced_file(page.parent / result.FILE) as temporary:
            temporary.write_text(result.text(), encoding="utf-8")
        with progress_bar("triage") as progress:
            write_triage_page(settings.name, result, root / "build", page, progress)
    console.lines("warning", [pair.line for pair in result.same_object], "yellow")
    shown = [
        {"recording": row.recording, "decision": row.decision, "reason": _first(row.reasons, row.review)}
        for row in result.rows
    ]
    if not common.as_json:
        console.out.print(console.text_table(shown[:SHOWN_RECORDINGS], COLUMNS, {}))
    counts = ", ".join(f"{decision} {count}" for decision, count in result.counts.items())
    common.tell(result.json_value(), [counts, *([] if ids else [f"wrote {page.resolve()}"])])
    return exit_status(rows)


def _first(reasons: tuple[str, ...], review: str | None) -> str:
    """Return the user's review, or else the first reason, shortened, and the number of further reasons."""
    lines = [*([f"review: {review}"] if review else []), *reasons]
    more = f" (and {len(lines) - 1} more)" if len(lines) > 1 else ""
    return f"{shorten(lines[0], REASON, placeholder=' …')}{more}" if lines else ""
