"""`kinectbench triage`: separate trustworthy recordings from recordings that the user should review."""

from textwrap import shorten

from kinectbench.cli import console
from kinectbench.cli.build import SHOWN_RECORDINGS, build_recordings, built, exit_status
from kinectbench.cli.common import Common, Ids, takes
from kinectbench.cli.progress_bars import progress_bar

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
