"""Score tables as they are shown: methods down, categories across, the best of a column marked."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from kinectbench.report.score_model import OVERALL, CategoryScore, ScoreTable
from kinectbench.report.stored import as_lines, text_of
from kinectbench.scoring.published import CATEGORIES, LABEL, PUBLISHED

PROTOCOL_NOTES = {
    "known": "the primary protocol: voxels where the truth is trusted; mean over objects",
    "paper": "the paper's protocol: all voxels; plain mean over pairs",
    "occluded": "known voxels that the input view does not see; mean over objects",
}
DECIMALS = 3
Interval = tuple[float, float] | None


@dataclass(frozen=True)
class Cell:
    """One figure: its text, the number to sort by ("" if there is none), and its interval as text or ""."""

    text: str
    sort: str
    best: bool
    interval: str


@dataclass(frozen=True)
class Row:
    """One method of a table.

    Attributes:
        method: its name.
        rank: 1 + the number of methods that are better by a test, as text; "=" after it if it is shared.
        iou: a cell for each category.
        ce: likewise.
        baseline: whether it was added to stand beside the methods.
    """

    method: str
    rank: str
    iou: tuple[Cell, ...]
    ce: tuple[Cell, ...]
    baseline: bool = False


@dataclass(frozen=True)
class Table:
    """One table: a row for each method, an IoU and a CE cell for each category.

    Attributes:
        title: heading.
        note: one line below it.
        categories: the columns under each of IoU and CE.
        rows: best first.
        base_rate: cross-entropy of a constant, the base rate, under each category; empty if not known.
        ranked: whether rows have ranks.
    """

    title: str
    note: str
    categories: tuple[str, ...]
    rows: tuple[Row, ...]
    base_rate: tuple[str, ...]
    ranked: bool


DETAIL_NAMES = (
    "IoU",
    "ceiling",
    "precision",
    "recall",
    "F1",
    "CE",
    "base-rate CE",
    "Chamfer, mm",
    "F-score 1 %",
    "surface Dice",
    "normals",
    "voxels counted",
    "shape counted",
    "truth's IoU, estimated",
    "repeatability",
    "pairs",
    "objects",
)


@dataclass(frozen=True)
class Detail:
    """One line of the table of details: method, protocol, category, and a text for each of `DETAIL_NAMES`."""

    method: str
    protocol: str
    category: str
    figures: tuple[str, ...]


@dataclass(frozen=True)
class Method:
    """How one method was scored."""

    name: str
    thresholds: str
    source: str
    failures: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    complete: bool


def protocols(tables: Sequence[ScoreTable]) -> list[str]:
    """The protocols that the tables hold, the primary one first."""
    found = {p for table in tables for p in [*(table.by_category or {}), *(table.overall or {})]}
    first = [p for p in PROTOCOL_NOTES if p in found]
    return first + sorted(found - set(first))


def best_first(tables: Sequence[ScoreTable], protocol: str) -> list[ScoreTable]:
    """The tables by their overall IoU, falling; those without one last, in the order given."""

    def key(table: ScoreTable) -> float:
        iou = table.scores(protocol).get(OVERALL, CategoryScore()).iou
        return 1.0 if iou is None else -iou

    return sorted(tables, key=key)


def score_table(tables: Sequence[ScoreTable], protocol: str, ranks: Mapping[str, int] | None = None) -> Table:
    """The table of one protocol; `ranks` by method, where they are known."""
    ordered = best_first(tables, protocol)
    scores = {table.method: table.scores(protocol) for table in ordered}
    categories = {c for by_category in scores.values() for c in by_category}
    columns = ((OVERALL,) if OVERALL in categories else ()) + tuple(sorted(categories - {OVERALL}))
    cells: dict[str, dict[str, CategoryScore]] = {
        method: {c: by_category.get(c, CategoryScore()) for c in columns}
        for method, by_category in scores.items()
    }
    note = PROTOCOL_NOTES.get(protocol, "")
    baselines = frozenset(table.method for table in ordered if table.baseline)
    return _table(f"Protocol “{protocol}”", note, columns, cells, ranks or {}, baselines)


def published_table() -> Table:
    """The paper's own figures for real recordings."""
    cells = {
        row.method: {
            category: CategoryScore(iou=iou, ce=ce)
            for category, iou, ce in zip(CATEGORIES, row.iou, row.ce, strict=True)
        }
        for row in PUBLISHED
    }
    return _table("The paper's real-world results", LABEL, CATEGORIES, cells, {})


def _table(
    title: str,
    note: str,
    columns: tuple[str, ...],
    cells: Mapping[str, Mapping[str, CategoryScore]],
    ranks: Mapping[str, int],
    baselines: Collection[str] = (),
) -> Table:
    best_iou = {c: _best(max, [row[c].iou for row in cells.values()]) for c in columns}
    best_ce = {c: _best(min, [row[c].ce for row in cells.values()]) for c in columns}
    rows = tuple(
        Row(
            method,
            rank_text(ranks, method),
            tuple(_cell(row[c].iou, best_iou[c], row[c].interval("iou")) for c in columns),
            tuple(_cell(row[c].ce, best_ce[c], row[c].interval("ce")) for c in columns),
            method in baselines,
        )
        for method, row in cells.items()
    )
    rates = [
        [row[c].base_rate_ce for row in cells.values() if row[c].base_rate_ce is not None] for c in columns
    ]
    base_rate = tuple(shown(of[0] if of else None) for of in rates) if any(rates) else ()
    return Table(title, note, columns, rows, base_rate, bool(ranks))


def rank_text(ranks: Mapping[str, int], method: str) -> str:
    """`2`, or `2=` where other methods have the same rank; "" where there is none."""
    if method not in ranks:
        return ""
    shared = list(ranks.values()).count(ranks[method]) > 1
    return f"{ranks[method]}{'=' if shared else ''}"


def _best(choose: Callable[[list[float]], float], values: list[float | None]) -> float | None:
    """The best of a column as it is shown: figures that look the same are the same."""
    found = [round(value, DECIMALS) for value in values if value is not None]
    return choose(found) if found else None


def shown(value: float | None) -> str:
    """A share or a cross-entropy as text."""
    return "–" if value is None else f"{value:.{DECIMALS}f}"


def _cell(value: float | None, best: float | None, interval: Interval) -> Cell:
    if value is None:
        return Cell("–", "", False, "")
    between = "" if interval is None else f"{shown(interval[0])}–{shown(interval[1])}"
    return Cell(shown(value), repr(value), round(value, DECIMALS) == best, between)


def details(tables: Sequence[ScoreTable]) -> tuple[Detail, ...]:
    """Every other figure, a line for each method, protocol and category."""
    return tuple(
        Detail(table.method, protocol, category, _figures(score))
        for protocol in protocols(tables)
        for table in tables
        for category, score in table.scores(protocol).items()
    )


def _figures(s: CategoryScore) -> tuple[str, ...]:
    """The texts of one line, in the order of `DETAIL_NAMES`."""
    return (
        *(shown(value) for value in (s.iou, s.ceiling_iou, s.precision, s.recall, s.f1, s.ce)),
        " ".join(filter(None, (shown(s.base_rate_ce), s.base_rate_source))),
        "–" if s.chamfer_mm is None else f"{s.chamfer_mm:.2f}",
        *(shown(value) for value in (s.f_score_1pct, s.surface_dice, s.normal_consistency)),
        *("–" if x is None else f"{100 * x:.1f} %" for x in (s.coverage_voxels, s.coverage_shape)),
        *(shown(value) for value in (s.truth_estimated_iou, s.truth_repeatability_iou)),
        *(text_of(count) for count in (s.pairs, s.objects)),
    )


def methods(tables: Sequence[ScoreTable]) -> tuple[Method, ...]:
    """How each method was scored: thresholds, failures, warnings."""
    return tuple(
        Method(
            name=table.method,
            thresholds=", ".join(f"{c} {text_of(p)}" for c, p in sorted((table.thresholds or {}).items())),
            source=text_of(table.threshold_source),
            failures=as_lines(table.failures),
            warnings=as_lines(table.warnings),
            notes=as_lines(table.notes),
            complete=table.by_category is not None,
        )
        for table in tables
    )
