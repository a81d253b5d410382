"""Make score tables for display: methods are rows, categories columns, and the best of a column is marked."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from kinectbench.core.artefacts.object import with_interval
from kinectbench.core.artefacts.score_figures import (
    IN_SPACE,
    SHARES,
    ScoreRow,
    SurfaceMetrics,
    VoxelMetrics,
    fields_of,
)
from kinectbench.core.artefacts.score_marks import BASELINE
from kinectbench.core.artefacts.scores import OVERALL, CategoryAverages, Extremes, OverallAverages, ScoreTable
from kinectbench.report.figures import per_cent, text_of
from kinectbench.scoring.averages import extremes
from kinectbench.scoring.baselines.registry import BASE_RATE
from kinectbench.scoring.caveats import marks_of
from kinectbench.scoring.published import LABEL, REAL, PublishedTable

PROTOCOL_NOTES = {
    "known": "the primary protocol: voxels where the truth is trusted; mean over objects",
    "paper": "the paper's protocol: all voxels; plain mean over pairs",
    "occluded": "known voxels that the input view does not see; mean over objects",
    "measured": "known voxels that a camera measured, without what was inferred; mean over objects",
    "known-unsaid": "known voxels but those that are so by a person's word alone; mean over objects",
    "shell": "the shape's surface alone, the extreme of the paper's real truth; plain mean over pairs",
    "camera": "surfaces in the camera frame, as predicted, in metres; mean over objects",
}
# The two metrics of a protocol's table: key, heading, decimals. Protocols of voxels and of space show
# different metrics.
OF_VOXELS = (("iou", "IoU", 3), ("ce", "CE, nats a voxel", 3))
OF_SURFACES = (("f_score_10mm", "F-score 10 mm", 3), ("chamfer_l1_m", "Chamfer L1, m", 4))
CEILING = "ceiling"
DECIMALS, LENGTH_DECIMALS, METRE_DECIMALS = 3, 2, 4
Averages = CategoryAverages | OverallAverages
NONE = CategoryAverages()


@dataclass(frozen=True)
class Cell:
    """A value in a table.

    Attributes:
        text: the value as shown.
        sort: the exact value, to sort the column by; "" if not known.
        best: whether it is the column's best.
        interval: its confidence interval as text, or "".
    """

    text: str
    sort: str
    best: bool
    interval: str


@dataclass(frozen=True)
class MethodRow:
    """The row of one method in a table.

    Attributes:
        method: the method's name.
        group: letters; methods that share a letter cannot be distinguished. "" if not compared.
        iou: the table's first metric in each category: IoU, or F-score under protocols of surfaces.
        ce: the table's second metric in each category: cross-entropy, or Chamfer distance of surfaces.
        marks: caveats of the scores, a few words each.
        standing: "reported", or "verified" (recomputed) with date and version; "" for published results.
    """

    method: str
    group: str
    iou: tuple[Cell, ...]
    ce: tuple[Cell, ...]
    marks: tuple[str, ...] = ()
    standing: str = ""


@dataclass(frozen=True)
class Table:
    """One table: a row for each method, with two metrics for each category.

    Attributes:
        title: the heading.
        protocol: the protocol under which the methods were scored.
        note: one line below the table.
        categories: the columns under each of the two metrics.
        rows: the methods, best first.
        base_rate: for each category, the cross-entropy of predicting the share of occupied voxels everywhere;
            empty if not known, or if the baseline `base-rate` has a row.
        unknown: for each category, the share of the true shapes that is unknown; empty if not stated.
        left_out: a sentence with the number of pairs left out because no voxel of the shape is known, or "".
        grouped: whether rows have letters in `group`.
        shared: marks that every row has; they are shown above the table instead of in the rows.
        of_baselines: further marks that every baseline has, also shown above the table.
        figures: headings of the two metrics.
    """

    title: str
    protocol: str
    note: str
    categories: tuple[str, ...]
    rows: tuple[MethodRow, ...]
    base_rate: tuple[str, ...]
    grouped: bool
    unknown: tuple[str, ...] = ()
    left_out: str = ""
    shared: tuple[str, ...] = ()
    of_baselines: tuple[str, ...] = ()
    figures: tuple[str, str] = (OF_VOXELS[0][1], OF_VOXELS[1][1])


def _figures(protocol: str) -> tuple[tuple[str, str, int], tuple[str, str, int]]:
    return OF_SURFACES if protocol.startswith(IN_SPACE) else OF_VOXELS


def protocols(tables: Sequence[ScoreTable]) -> list[str]:
    """Return the protocols under which the tables have averages, first in the order of `PROTOCOL_NOTES`."""
    names = dict.fromkeys(p for t in tables for p in [*(t.by_category or {}), *(t.overall or {})])
    first = [p for p in PROTOCOL_NOTES if p in names]
    return first + [p for p in names if p not in first]


def best_first(tables: Sequence[ScoreTable], protocol: str) -> list[ScoreTable]:
    """Sort score tables by overall IoU (F-score under protocols of surfaces), the highest first.

    Tables without this value come last.
    """
    name = _figures(protocol)[0][0]

    def key(table: ScoreTable) -> float:
        value = table.averages(protocol).get(OVERALL, NONE)[name]
        return 1.0 if value is None else -value

    return sorted(tables, key=key)


def protocol_table(
    tables: Sequence[ScoreTable], protocol: str, groups: Mapping[str, str] | None = None
) -> Table:
    """Return the table of one protocol; `groups` is {method: letters of its groups}, if known."""
    ordered = best_first(tables, protocol)
    scores = {table.method: table.averages(protocol) for table in ordered}
    categories = {c for by_category in scores.values() for c in by_category}
    columns = ((OVERALL,) if OVERALL in categories else ()) + tuple(sorted(categories - {OVERALL}))
    cells: dict[str, dict[str, Averages]] = {
        method: {c: by_category.get(c, NONE) for c in columns} for method, by_category in scores.items()
    }
    note = PROTOCOL_NOTES.get(protocol, "")
    table = _table(f"Protocol “{protocol}”", protocol, note, columns, cells)
    of = {table.method: table for table in ordered}
    marks = {method: [mark.words for mark in marks_of(table)] for method, table in of.items()}
    shared = _shared([*marks.values()])
    baselines = [words for words in marks.values() if BASELINE in words]
    of_baselines = tuple(words for words in _shared(baselines) if words not in (*shared, BASELINE))
    above = {
        method: (*shared, *(of_baselines if BASELINE in words else ())) for method, words in marks.items()
    }
    rows = tuple(
        replace(
            row,
            group=(groups or {}).get(row.method, ""),
            marks=tuple(words for words in marks[row.method] if words not in above[row.method]),
            standing=of[row.method].standing,
        )
        for row in table.rows
    )
    shares = [
        next((s for row in cells.values() if (s := row[c].truth_unknown_share) is not None), None)
        for c in columns
    ]
    return replace(
        table,
        rows=rows,
        grouped=bool(groups),
        base_rate=() if BASE_RATE in of else table.base_rate,
        unknown=tuple(map(per_cent, shares)) if any(share is not None for share in shares) else (),
        left_out=next(filter(None, (one.left_out_line(protocol) for one in ordered)), ""),
        shared=shared,
        of_baselines=of_baselines,
    )


def _shared(marks: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the marks (caveats) that all rows have; none if there is one row, which shows its own marks."""
    first = marks[0] if len(marks) > 1 else ()
    return tuple(words for words in first if all(words in of for of in marks))


def published_table(published: PublishedTable = REAL) -> Table:
    """Return a table that the paper itself published, in the form of our tables."""
    cells = {
        row.method: {
            category: CategoryAverages(iou=iou, ce=ce)
            for category, iou, ce in zip(published.categories, row.iou, row.ce, strict=True)
        }
        for row in published.rows
    }
    return _table(f"The paper's results: {published.title}", "paper", LABEL, published.categories, cells)


def _table(
    title: str,
    protocol: str,
    note: str,
    columns: tuple[str, ...],
    cells: Mapping[str, Mapping[str, Averages]],
) -> Table:
    figures = _figures(protocol)
    best = [
        {c: _best(choose, [row[c][key] for row in cells.values()], decimals) for c in columns}
        for choose, (key, _, decimals) in zip((max, min), figures, strict=True)
    ]
    rows = []
    for method, row in cells.items():
        first, second = (
            tuple(_cell(row[c][key], of[c], row[c].intervals.get(key), decimals) for c in columns)
            for of, (key, _, decimals) in zip(best, figures, strict=True)
        )
        rows.append(MethodRow(method, "", first, second))
    rates = [
        [row[c].base_rate_ce for row in cells.values() if row[c].base_rate_ce is not None] for c in columns
    ]
    base_rate = tuple(shown_figure(of[0] if of else None) for of in rates) if any(rates) else ()
    headings = (figures[0][1], figures[1][1])
    return Table(title, protocol, note, columns, tuple(rows), base_rate, grouped=False, figures=headings)


def _best(choose: Callable[[list[float]], float], values: list[float | None], decimals: int) -> float | None:
    """Return the best rounded value of a column; all values that look equal to it count as best."""
    rounded = [round(value, decimals) for value in values if value is not None]
    return choose(rounded) if rounded else None


def shown_figure(value: float | None, decimals: int = DECIMALS) -> str:
    """Return a value as text with this number of decimals, or "–" for None."""
    return "–" if value is None else f"{value:z.{decimals}f}"


def _cell(value: float | None, best: float | None, interval: Sequence[float] | None, decimals: int) -> Cell:
    if value is None:
        return Cell("–", "", False, "")
    between = "" if interval is None else "–".join(shown_figure(end, decimals) for end in interval)
    return Cell(shown_figure(value, decimals), repr(value), round(value, decimals) == best, between)


def _base_rate(averages: Averages) -> str:
    """Return one text: the cross-entropy of predicting the base rate, and the split it was computed on."""
    source = averages.base_rate_source if isinstance(averages, CategoryAverages) else None
    return " ".join(filter(None, (shown_figure(averages.base_rate_ce), source)))


def _truth_iou(averages: Averages) -> str | None:
    """Return the truth's estimated IoU and its interval as text, means over objects; None if unknown."""
    low, high = averages.truth_estimated_iou_low, averages.truth_estimated_iou_high
    return with_interval(averages.truth_estimated_iou, low, high, DECIMALS)


def _surface(name: str) -> Callable[[Averages], str]:
    decimals = DECIMALS if name in SHARES else METRE_DECIMALS if name.endswith("_m") else LENGTH_DECIMALS
    return lambda averages: shown_figure(getattr(averages, name), decimals)


# Columns of the table of details: those surface metrics that have a heading, among others.
DETAILS: Mapping[str, Callable[[Averages], str]] = {
    "IoU": lambda of: shown_figure(of.iou),
    CEILING: lambda of: shown_figure(of.ceiling_iou),
    "precision": lambda of: shown_figure(of.precision),
    "recall": lambda of: shown_figure(of.recall),
    "F1": lambda of: shown_figure(of.f1),
    "CE": lambda of: shown_figure(of.ce),
    "base-rate CE": _base_rate,
    **{field.title: _surface(name) for name, field in fields_of(SurfaceMetrics).items() if field.title},
    "voxels counted": lambda of: per_cent(of.coverage_voxels),
    "shape counted": lambda of: per_cent(of.coverage_shape),
    "truth's IoU, estimated": lambda of: _truth_iou(of) or "–",
    "repeatability": lambda of: shown_figure(of.truth_repeatability_iou),
    "truth unknown": lambda of: per_cent(of.truth_unknown_share),
    "pairs": lambda of: text_of(of.pairs),
    "objects": lambda of: text_of(of.objects),
}

# Columns of shares: a first click on the heading sorts the highest on top.
MORE_IS_BETTER = frozenset(
    str(field.title)
    for kind in (VoxelMetrics, SurfaceMetrics)
    for name, field in fields_of(kind).items()
    if name in SHARES and field.title
)

# Baselines whose side limits nothing: a constant gives the same grid at every side.
CONSTANT = ("empty", BASE_RATE)

# (method, protocol, category), and a text for each of `DETAILS`.
Detail = tuple[tuple[str, str, str], tuple[str, ...]]


def details(tables: Sequence[ScoreTable]) -> tuple[Detail, ...]:
    """Return a line for each protocol, method and category, with the metrics in `DETAILS` as texts."""
    return tuple(
        (
            (table.method, protocol, category),
            tuple(
                "–" if name == CEILING and table.method in CONSTANT else text(of)
                for name, text in DETAILS.items()
            ),
        )
        for protocol in protocols(tables)
        for table in tables
        for category, of in table.averages(protocol).items()
    )


# An object, its category, its number of pairs, the unknown share of its truth, and its pairs left out.
ObjectTruth = tuple[str, str, int, str, int]


def truth_of_objects(tables: Sequence[ScoreTable], protocol: str) -> tuple[ObjectTruth, ...]:
    """Return a row on the truth of each object, largest unknown share first.

    A row is (object, category, number of pairs, unknown share as text, number of pairs that do not count in
    scores). All tables must have the same truth.
    """
    most: dict[str, tuple[ScoreTable, list[ScoreRow]]] = {}
    for table in tables:
        for name, rows in _by_object(table.pairs(protocol)).items():
            # Take the table with most of the object's pairs: in another, predictions may have failed.
            if name not in most or len(rows) > len(most[name][1]):
                most[name] = table, rows
    result = []
    for name, (table, rows) in most.items():
        if name in table.truth_unknown_share:
            count = sum(not row.counts for row in rows)
            result.append((table.truth_unknown_share[name], name, rows[0].category, len(rows), count))
    falling = sorted(result, key=lambda row: (-row[0], row[1]))
    return tuple(
        (name, category, pairs, per_cent(share), left) for share, name, category, pairs, left in falling
    )


def _by_object(rows: Sequence[ScoreRow]) -> dict[str, list[ScoreRow]]:
    groups: dict[str, list[ScoreRow]] = {}
    for row in rows:
        groups.setdefault(row.object, []).append(row)
    return groups


def best_and_worst(tables: Sequence[ScoreTable], protocol: str) -> dict[str, Extremes]:
    """Return {method: its best and worst pairs under one protocol}; added baselines are left out."""
    by_method = {table.method: extremes(table.rows).get(protocol) for table in tables if not table.baseline}
    return {method: of for method, of in by_method.items() if of and of.best}
