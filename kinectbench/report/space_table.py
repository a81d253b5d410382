"""Make the table of scores of predictions in the camera frame, for the terminal and the page."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

from kinectbench.core.artefacts.score_figures import AsPapers, ScoreRow, fields_of
from kinectbench.core.artefacts.score_marks import BASELINE
from kinectbench.core.artefacts.scores import OVERALL, ScoreTable
from kinectbench.scoring.averages import plain_mean

TITLE = "predictions in the camera frame: means over all categories"
# {key of the figure: (heading, format)}.
COLUMNS = {
    "chamfer_l1_m": ("Chamfer L1, m", "{:.4f}"),
    "chamfer_l2_m2": ("Chamfer L2, m²", "{:.2e}"),
    "f_score_5mm": ("F 5 mm", "{:.3f}"),
    "f_score_10mm": ("F 10 mm", "{:.3f}"),
    "f_score_20mm": ("F 20 mm", "{:.3f}"),
    "f_score_1pct": ("F 1 %", "{:.3f}"),
    "f_score_2pct": ("F 2 %", "{:.3f}"),
    "f_score_5pct": ("F 5 %", "{:.3f}"),
    "normal_consistency": ("normals", "{:.3f}"),
    "iou": ("IoU", "{:.3f}"),
}
# Further metrics of a row, as in `COLUMNS`.
FURTHER_COLUMNS = {
    **{name: (str(field.title), "{:.3f}") for name, field in fields_of(AsPapers).items() if field.title},
    "cut": ("cut", "{:.1%}"),
    "silhouette": ("outside mask", "{:.1%}"),
}
EMPTY_NOTE = (
    "empty: not known of every view; open meshes and points have no IoU, points without normals no normals"
)
CEILING = "(ceiling)"
CEILING_NOTE = "(ceiling): what the truth's own uncertainty leaves to a perfect prediction"
NOTHING_NOTE = "(n empty): views of which nothing is predicted; each counts with the diagonal of its cube"
# {heading: what it says}, for the columns that are shown.
FURTHER_NOTES = {
    FURTHER_COLUMNS["cut"][0]: "of the truth, outside the method's volume",
    FURTHER_COLUMNS["silhouette"][0]: "of the predicted surface",
}


@dataclass(frozen=True)
class SpaceTable:
    """Scores of predictions in the camera frame as text, for the terminal and the page.

    Attributes:
        columns: headings of the scores.
        groups: {heading: lines (method's name, one text per column)}; the method with the lowest Chamfer L1
            distance is first. The last line may be the ceiling: the scores that even a perfect prediction
            would get, because the truth is uncertain.
        notes: lines below the table.
    """

    columns: tuple[str, ...]
    groups: dict[str, list[tuple[str, list[str]]]]
    notes: tuple[str, ...]


def space_table(tables: Sequence[ScoreTable], parts: Collection[str] | None = None) -> SpaceTable:
    """Return the table: under each heading, a line for each method scored, lowest Chamfer L1 distance first.

    A heading states protocol, registration, part of the shape and number of hypotheses.

    Args:
        tables: score tables; only those of predictions in the camera frame are used.
        parts: parts of the shape that get lines (whole, visible, occluded); None: all.
    """
    headings = dict.fromkeys(
        name
        for table in tables
        for name in table.overall or {}
        if any(row.in_space and (parts is None or row.part in parts) for row in table.pairs(name)[:1])
    )
    groups: dict[str, list[tuple[str, list[str]]]] = {}
    for heading in headings:
        ordered = [
            t for t in sorted(tables, key=lambda t: _far(t, heading)) if OVERALL in t.averages(heading)
        ]
        lines = groups[heading] = []
        for table in ordered:
            rows = table.pairs(heading)
            closed = f" (closed: {table.settings.close})" * any(row.closed for row in rows)
            cells = [*_cells(table.averages(heading)[OVERALL]), *_further(rows)]
            of = " (baseline)" * is_baseline(table)
            lines.append((f"{table.method}{of}{closed}{_empty(rows)}", cells))
        if any(ceiling := _ceiling(ordered[0].pairs(heading)) if ordered else []):
            lines.append((CEILING, ceiling))
    failed = [f"{t.method}: {len(t.failures)} views failed{_reason(t)}" for t in tables if t.failures]
    left_out = dict.fromkeys(line for t in tables for name in headings if (line := t.left_out_line(name)))
    names = [name for lines in groups.values() for name, _ in lines]
    columns = tuple(name for name, _ in (COLUMNS | FURTHER_COLUMNS).values())
    shown = _without_empty(SpaceTable(columns, groups, ()))
    beside = "; ".join(f"{name}: {what}" for name, what in FURTHER_NOTES.items() if name in shown.columns)
    notes = [
        *([NOTHING_NOTE] if any(name.endswith(" empty)") for name in names) else []),
        EMPTY_NOTE,
        *([beside] if beside else []),
        *([CEILING_NOTE] if CEILING in names else []),
    ]
    return replace(shown, notes=(*failed, *left_out, *notes))


def _reason(table: ScoreTable) -> str:
    """Return ": <reason>" if every view of a method failed, all for one reason; else ""."""
    reasons = {failure.reason for failure in table.failures}
    return f": {reasons.pop()}" if len(reasons) == 1 and not table.rows else ""


def is_baseline(table: ScoreTable) -> bool:
    """Return whether a table has the scores of a baseline, whether added by `score` or scored as a method."""
    return table.baseline or any(mark.kind == BASELINE for mark in table.marks)


def _without_empty(table: SpaceTable) -> SpaceTable:
    """Return the table without the columns in which no line has a value."""
    lines = [cells for of in table.groups.values() for _, cells in of]
    kept = [i for i in range(len(table.columns)) if any(cells[i] for cells in lines)]
    groups = {
        heading: [(name, [cells[i] for i in kept]) for name, cells in of]
        for heading, of in table.groups.items()
    }
    return SpaceTable(tuple(table.columns[i] for i in kept), groups, table.notes)


def _far(table: ScoreTable, heading: str) -> float:
    of = table.averages(heading).get(OVERALL)
    return float("inf") if of is None or of.chamfer_l1_m is None else float(of.chamfer_l1_m)


def _empty(rows: Sequence[ScoreRow]) -> str:
    """Return " (<n> empty)" if n views have an empty prediction, else "".

    Empty predictions dominate a mean distance.
    """
    count = sum(row.counts and row.solid is None for row in rows)
    return f" ({count} empty)" if count else ""


def _cells(averages: object) -> list[str]:
    return [_written(getattr(averages, name), form) for name, (_, form) in COLUMNS.items()]


def _further(rows: Sequence[ScoreRow]) -> list[str]:
    return [
        _written(plain_mean(rows, partial(_stated, name)), form)
        for name, (_, form) in FURTHER_COLUMNS.items()
    ]


def _stated(name: str, row: ScoreRow) -> float | None:
    found: float | None = (
        getattr(row, name, None) if hasattr(row, name) else getattr(row.as_papers, name, None)
    )
    return found


def _allowed(name: str, row: ScoreRow) -> float | None:
    found: float | None = getattr(row.ceiling, name, None)
    return found


def _ceiling(rows: Sequence[ScoreRow]) -> list[str]:
    return [
        _written(plain_mean(rows, partial(_allowed, name)), form)
        for name, (_, form) in (COLUMNS | FURTHER_COLUMNS).items()
    ]


def _written(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)
