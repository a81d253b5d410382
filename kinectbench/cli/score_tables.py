"""Make terminal tables of scores: methods by categories, and differences between methods."""

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from kinectbench.core.artefacts.score_figures import SHARES
from kinectbench.core.artefacts.score_marks import BASELINE, REPORTED
from kinectbench.core.artefacts.scores import OVERALL, ScoreTable
from kinectbench.report.space_table import TITLE as SPACE_TITLE
from kinectbench.report.space_table import is_baseline, space_table
from kinectbench.scoring.compare import GROUPS_NOTE, Comparison
from kinectbench.scoring.protocols import EVERY_VOXEL, PRIMARY
from kinectbench.scoring.published import LABEL, PARAMETERS_LINE, REAL, PublishedTable, published_beside

if TYPE_CHECKING:
    from kinectbench.cli.wide_table import WideTable

SHOWN_PROTOCOLS = (PRIMARY, *EVERY_VOXEL)
TITLE = "IoU (higher is better) / cross-entropy, nats a voxel (lower is better), under the protocol named"
# Note below tables that have the line `truth unknown`.
PARTS_NOTE = "of whole shapes; the page and scores.csv have their visible and their occluded parts, too"
UNKNOWN_NOTE = (
    "truth unknown: share of the true shapes' volume that nobody saw, a guess; unseen space taken for air is "
    "not counted"
)


def score_table(tables: Sequence[ScoreTable], published: bool = False) -> "WideTable":
    """Return a table with a row per method: IoU and cross-entropy (nats per voxel) by category and overall.

    There are columns for each of `SHOWN_PROTOCOLS` that was scored. The caption has the caveats of methods,
    and which scores were verified.

    Args:
        tables: the methods' scores; the row of an incomplete method states how many predictions failed.
        published: whether to add the results printed in the paper for categories of the same name, below a
            line.
    """
    from rich.text import Text

    from kinectbench.cli.wide_table import WideTable

    protocols = [p for p in SHOWN_PROTOCOLS if any(p in table.settings.protocols for table in tables)]
    categories = sorted({category for table in tables for category in table.thresholds})
    columns = [*categories, OVERALL] if len(categories) > 1 else categories
    result = WideTable(title=TITLE)
    result.add_column("method")
    for protocol in protocols:
        for column in columns:
            result.add_column(f"{'all' if column == OVERALL else column}\n{protocol}", justify="right")
    for group in ([t for t in tables if not is_baseline(t)], [t for t in tables if is_baseline(t)]):
        for table in group:
            result.add_row(Text(_name(table)), *_cells(table, protocols, columns))
        result.add_section()
    of_truth = [next((t.averages(p) for t in tables if t.averages(p)), {}) for p in protocols]
    shares = [of[c].truth_unknown_share if c in of else None for of in of_truth for c in columns]
    _add_unknown(result, shares)
    left_out = dict.fromkeys(t.left_out_line(p) for t in tables for p in t.settings.protocols)
    notes = [*_marks(tables), UNKNOWN_NOTE if _any_known(shares) else "", *left_out]
    result.caption = "\n".join(filter(None, notes)) or None
    recordings = {row.recording for table in tables for row in table.rows}
    beside = published_beside(recordings, categories) if published else ()
    # The truth of the paper's real recordings lies between a solid and its surface.
    under = [p if p == "paper" or (p == "shell" and beside == (REAL,)) else "" for p in protocols]
    if any(under) and any(set(columns) & set(of.categories) for of in beside):
        _add_published(result, under, columns, beside)
    return result


def space_lines(tables: Sequence[ScoreTable]) -> "WideTable":
    """Return a table of the scores of predictions in the camera frame, for whole shapes.

    There is a row for each method and each variant of a protocol, such as a kind of alignment.
    """
    from rich.text import Text

    from kinectbench.cli.wide_table import WideTable

    found = space_table(tables, parts=("whole",))
    result = WideTable(title=SPACE_TITLE, keep=2)
    result.add_column("protocol")
    result.add_column("method")
    for name in found.columns:
        result.add_column(name, justify="right")
    for heading, lines in found.groups.items():
        for name, cells in lines:
            result.add_row(heading, Text(name), *cells)
        result.add_section()
    result.caption = "\n".join((*found.notes, PARTS_NOTE))
    return result


def _name(table: ScoreTable) -> str:
    """Return the text for a method in its row: its name, "(baseline)" or the number of failed predictions.

    A `*` at the end refers to caveats in the caption.
    """
    star = "*" if _own_marks(table) else ""
    if table.by_category is None or table.overall is None:
        count = len(table.failures)
        return f"{table.method}: {count} prediction{'s' * (count != 1)} failed{star}"
    return f"{table.method}{' (baseline)' if is_baseline(table) else ''}{star}"


def _own_marks(table: ScoreTable) -> list[str]:
    """Return a method's caveats in words, except "baseline", which its name in the table includes already."""
    return [mark.words for mark in table.marks if mark.kind != BASELINE]


def _marks(tables: Sequence[ScoreTable]) -> list[str]:
    """Return lines for the caption: the caveats that each `*` refers to, and which scores were verified."""
    meant: dict[str, list[str]] = {}
    for table in tables:
        if words := "; ".join(_own_marks(table)):
            meant.setdefault(words, []).append(table.method)
    stands: dict[str, list[str]] = {}
    for table in tables:
        stands.setdefault(_as_stated(table.standing), []).append(table.method)
    return [
        *(f"* {', '.join(names)}: {words}" for words, names in meant.items()),
        *(f"{standing}: {', '.join(names)}" for standing, names in stands.items()),
    ]


def _as_stated(standing: str) -> str:
    """Return "reported" unchanged; append "(as its scores.json says)" to others, such as "verified"."""
    return standing if standing == REPORTED else f"{standing} (as its scores.json says)"


def _add_published(
    table: "WideTable", protocols: Sequence[str], columns: Sequence[str], published: Sequence[PublishedTable]
) -> None:
    """Add rows with the results printed in the paper, and a note that other rows are not comparable.

    Cells of a group of columns with the protocol "" stay empty.
    """
    table.add_section()
    signs = "†‡§¶"
    for sign, of in zip(signs, published, strict=False):
        line = f"{sign} the paper's own results, {of.title}"
        table.caption = f"{table.caption or ''}\n{line}".strip()
    table.caption = f"{table.caption}: {LABEL}\n{PARAMETERS_LINE}"
    for sign, names, entry in (
        (sign, of.categories, row) for sign, of in zip(signs, published, strict=False) for row in of.rows
    ):
        values = dict(zip(names, zip(entry.iou, entry.ce, strict=True), strict=True))
        cells = [
            _cell(*values[column]) if protocol and column in values else ""
            for protocol in protocols
            for column in columns
        ]
        table.add_row(f"{entry.method} {sign}", *cells, style="dim")


def _any_known(shares: Sequence[float | None]) -> bool:
    """Return whether any of the shares is not None."""
    return any(share is not None for share in shares)


def _add_unknown(table: "WideTable", shares: Sequence[float | None]) -> None:
    """Add a last row with the unknown share of the true shapes in each column, unless none is known."""
    if _any_known(shares):
        table.add_section()
        cells = ["" if share is None else f"{100 * share:.1f} %" for share in shares]
        table.add_row("truth unknown", *cells, style="dim")


def _cells(table: ScoreTable, protocols: Sequence[str], columns: Sequence[str]) -> list[str]:
    """Return the texts of one method's row; they are empty if some of its predictions failed."""
    cells = []
    for protocol in protocols:
        averages = table.averages(protocol)
        cells += [_cell(averages[c].iou, averages[c].ce) if c in averages else "" for c in columns]
    return cells


def _cell(iou: float | None, ce: float | None) -> str:
    return "" if iou is None or ce is None else f"{iou:.3f} / {ce:.3f}"


def comparison_tables(result: Comparison, baselines: Collection[str] = ()) -> "list[WideTable]":
    """Return two tables: the mean of each method with group letters, and the differences between all methods.

    Methods that share a letter do not differ significantly. The methods `baselines` are called so.
    """
    from rich.text import Text

    from kinectbench.cli.wide_table import WideTable

    better = "higher" if result.metric in SHARES else "lower"
    means = WideTable(title=f"group and {result.metric} under {result.protocol}, {better} is better")
    means.add_column("method")
    for scope in result.means:
        means.add_column(scope, justify="right")
    for name in result.methods:
        cells = [f"{result.groups[scope][name]}  {result.means[scope][name]:.3f}" for scope in result.means]
        means.add_row(Text(f"{name} (baseline)" if name in baselines else name), *cells)
    shares = [result.truth_unknown_share[scope] for scope in result.means]
    _add_unknown(means, shares)
    stands = [f"{name}: {_as_stated(standing)}" for name, standing in result.standings.items()]
    means.caption = "\n".join([GROUPS_NOTE, *stands, *([UNKNOWN_NOTE] if _any_known(shares) else [])])
    pairs = WideTable(title="differences, object by object", keep=2)
    for column in ("methods", "scope", "difference", "95 %", "p", "p (Holm)", ""):
        pairs.add_column(column, justify="left" if column in ("methods", "scope", "") else "right")
    for row in result.differences:
        between = "" if row.interval is None else "{:+.3f} to {:+.3f}".format(*row.interval)
        cells = [row.scope, f"{row.mean:+.3f}", between, f"{row.p:.2g}", f"{row.p_holm:.2g}", row.verdict]
        pairs.add_row(Text(f"{row.first} - {row.second}"), *map(Text, cells))
    return [means, pairs]
