"""The table that people see in the terminal: methods by categories."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kinectbench.core.artefacts.score_figures import SHARES
from kinectbench.core.artefacts.scores import OVERALL, ScoreTable
from kinectbench.scoring.compare import Comparison
from kinectbench.scoring.counts import PRIMARY
from kinectbench.scoring.references import CATEGORIES, LABEL, PUBLISHED

if TYPE_CHECKING:
    from rich.table import Table

SHOWN_PROTOCOLS = (PRIMARY, "paper")
# Below the tables that have the line `truth unknown`.
UNKNOWN_NOTE = (
    "truth unknown: of the true shapes' volume, what is a guess; space that nobody saw and that is taken for "
    "air is no part of it"
)


def score_table(tables: Sequence[ScoreTable], published: bool = False) -> "Table":
    """One line per method: IoU and CE (nats a voxel) per category, then overall, under `known` and `paper`.

    Args:
        tables: the methods; beside the name of one that is incomplete stands how many predictions failed.
        published: add the paper's own figures where a category has its name, under a line that says what
            they are.
    """
    from rich.table import Table
    from rich.text import Text

    protocols = [p for p in SHOWN_PROTOCOLS if any(p in table.settings.protocols for table in tables)]
    categories = sorted({category for table in tables for category in table.thresholds})
    columns = [*categories, OVERALL] if len(categories) > 1 else categories
    result = Table(title="IoU (higher is better) / cross-entropy (lower is better)", title_justify="left")
    result.add_column("method")
    for protocol in protocols:
        for column in columns:
            result.add_column(f"{'all' if column == OVERALL else column}\n{protocol}", justify="right")
    for group in ([t for t in tables if not t.baseline], [t for t in tables if t.baseline]):
        for table in group:
            result.add_row(Text(_name(table)), *_cells(table, protocols, columns))
        result.add_section()
    of_truth = [next((t.averages(p) for t in tables if t.averages(p)), {}) for p in protocols]
    shares = [of[c].truth_unknown_share if c in of else None for of in of_truth for c in columns]
    _add_unknown(result, shares)
    left_out = dict.fromkeys(t.left_out_line(p) for t in tables for p in t.settings.protocols)
    said = [UNKNOWN_NOTE if _told(shares) else "", *left_out]
    result.caption, result.caption_justify = "\n".join(filter(None, said)) or None, "left"
    if published and "paper" in protocols and set(columns) & set(CATEGORIES):
        _add_published(result, protocols, columns)
    return result


def _name(table: ScoreTable) -> str:
    """A method's name, with what is to be known before its figures are read."""
    if table.by_category is None or table.overall is None:
        count = len(table.failures)
        return f"{table.method}: {count} prediction{'s' * (count != 1)} failed"
    return f"{table.method} (baseline)" if table.baseline else table.method


def _add_published(table: "Table", protocols: Sequence[str], columns: Sequence[str]) -> None:
    """The paper's own figures, under one line that says that they are no rivals of those above."""
    table.add_section()
    table.add_row(f"the paper's own results: {LABEL}", style="dim")
    for entry in PUBLISHED:
        values = dict(zip(CATEGORIES, zip(entry.iou, entry.ce, strict=True), strict=True))
        cells = [
            _cell(*values[column]) if protocol == "paper" and column in values else ""
            for protocol in protocols
            for column in columns
        ]
        table.add_row(f"  {entry.method}", *cells, style="dim")


def _told(shares: Sequence[float | None]) -> bool:
    """Whether any table says how much of the true shapes is not known."""
    return any(share is not None for share in shares)


def _add_unknown(table: "Table", shares: Sequence[float | None]) -> None:
    """A last line: the share of the true shapes that is not known; none where no table says it."""
    if _told(shares):
        table.add_section()
        cells = ["" if share is None else f"{100 * share:.1f} %" for share in shares]
        table.add_row("truth unknown", *cells, style="dim")


def _cells(table: ScoreTable, protocols: Sequence[str], columns: Sequence[str]) -> list[str]:
    """The cells of one method; they are empty where a part of its predictions failed."""
    cells = []
    for protocol in protocols:
        averages = table.averages(protocol)
        cells += [_cell(averages[c].iou, averages[c].ce) if c in averages else "" for c in columns]
    return cells


def _cell(iou: float | None, ce: float | None) -> str:
    return "" if iou is None or ce is None else f"{iou:.3f} / {ce:.3f}"


def comparison_tables(found: Comparison) -> "list[Table]":
    """Ranks and means of every method, and every pair of methods."""
    from rich.table import Table
    from rich.text import Text

    better = "higher" if found.metric in SHARES else "lower"
    means = Table(
        title=f"rank (tied unless significant) and {found.metric} under {found.protocol}, {better} is better",
        title_justify="left",
    )
    means.add_column("method")
    for scope in found.means:
        means.add_column(scope, justify="right")
    for name in found.methods:
        cells = [f"{found.ranks[scope][name]}  {found.means[scope][name]:.3f}" for scope in found.means]
        means.add_row(Text(name), *cells)
    shares = [found.truth_unknown_share[scope] for scope in found.means]
    _add_unknown(means, shares)
    means.caption, means.caption_justify = UNKNOWN_NOTE if _told(shares) else None, "left"
    pairs = Table(title="differences, object by object", title_justify="left")
    for column in ("methods", "scope", "difference", "p", "p (Holm)", ""):
        pairs.add_column(column, justify="left" if column in ("methods", "scope", "") else "right")
    for row in found.differences:
        cells = [row.scope, f"{row.mean:+.3f}", f"{row.p:.2g}", f"{row.p_holm:.2g}", row.verdict]
        pairs.add_row(Text(f"{row.first} - {row.second}"), *map(Text, cells))
    return [means, pairs]
