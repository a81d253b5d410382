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


def score_table(tables: Sequence[ScoreTable], published: bool = False) -> "Table":
    """One line per method: IoU and CE (nats a voxel) per category, then overall, under `known` and `paper`.

    Args:
        tables: the methods; one that is incomplete shows how many predictions failed instead of numbers.
        published: add the paper's own figures where a category has its name, labelled as not comparable.
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
            name = f"{table.method} (baseline)" if table.baseline else table.method
            result.add_row(Text(name), *_cells(table, protocols, columns))
        result.add_section()
    of_truth = [next((t.averages(p) for t in tables if t.averages(p)), {}) for p in protocols]
    shares = [of[c].truth_unknown_share if c in of else None for of in of_truth for c in columns]
    _add_unknown(result, shares)
    left_out = dict.fromkeys(t.left_out_line(p) for t in tables for p in t.settings.protocols)
    result.caption, result.caption_justify = "\n".join(filter(None, left_out)) or None, "left"
    if published:
        result.add_section()
        for entry in PUBLISHED:
            values = dict(zip(CATEGORIES, zip(entry.iou, entry.ce, strict=True), strict=True))
            cells = [
                _cell(*values[column]) if protocol == "paper" and column in values else ""
                for protocol in protocols
                for column in columns
            ]
            result.add_row(f"{entry.method} ({LABEL})", *cells, style="dim")
    return result


def _add_unknown(table: "Table", shares: Sequence[float | None]) -> None:
    """A last line: the share of the true shapes that is not known; none where no table says it."""
    if any(share is not None for share in shares):
        table.add_section()
        cells = ["" if share is None else f"{100 * share:.1f} %" for share in shares]
        table.add_row("truth unknown", *cells, style="dim")


def _cells(table: ScoreTable, protocols: Sequence[str], columns: Sequence[str]) -> list[str]:
    """The cells of one method."""
    if table.by_category is None or table.overall is None:
        cells = [f"{len(table.failures)} failed"] + [""] * (len(protocols) * len(columns) - 1)
        return cells[: len(protocols) * len(columns)]
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
    _add_unknown(means, [found.truth_unknown_share[scope] for scope in found.means])
    pairs = Table(title="differences, object by object", title_justify="left")
    for column in ("methods", "scope", "difference", "p", "p (Holm)", ""):
        pairs.add_column(column, justify="left" if column in ("methods", "scope", "") else "right")
    for row in found.differences:
        cells = [row.scope, f"{row.mean:+.3f}", f"{row.p:.2g}", f"{row.p_holm:.2g}", row.verdict]
        pairs.add_row(Text(f"{row.first} - {row.second}"), *map(Text, cells))
    return [means, pairs]
