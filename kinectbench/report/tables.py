"""Score tables as they are shown: methods down, categories across, the best of a column marked."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from kinectbench.errors import StorageError
from kinectbench.report.stored import as_lines, text_of
from kinectbench.scoring.published import CATEGORIES, LABEL, PUBLISHED

PROTOCOL_NOTES = {
    "known": "the primary protocol: voxels where the truth is trusted; mean over objects",
    "paper": "the paper's protocol: all voxels; plain mean over pairs",
    "occluded": "known voxels that the input view does not see; mean over objects",
}
OVERALL = "overall"
DECIMALS = 3


class CategoryScore(BaseModel):
    """What scores.json holds of one protocol and category; a figure that was not made is None."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    iou: float | None = None
    ce: float | None = None
    precision: float | None = None
    recall: float | None = None
    f1: float | None = None
    pairs: int | None = None
    objects: int | None = None
    coverage_voxels: float | None = None
    coverage_shape: float | None = None
    base_rate_ce: float | None = None
    base_rate_source: str | None = None


class ScoreTable(BaseModel):
    """What the page shows of one scores.json; the tables are None if the set of predictions is incomplete."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    method: str
    benchmark_sha256: str | None = None
    package_version: str | None = None
    thresholds: dict[str, float | None] | None = None
    threshold_source: Any = None
    by_category: dict[str, dict[str, CategoryScore | None] | None] | None = None
    overall: dict[str, CategoryScore | None] | None = None
    failures: Any = None
    warnings: Any = None

    def scores(self, protocol: str) -> dict[str, CategoryScore]:
        """The scores of a protocol by category, and under `overall` over all categories."""
        by_category = (self.by_category or {}).get(protocol) or {}
        overall = (self.overall or {}).get(protocol)
        found = {category: score for category, score in by_category.items() if score}
        return {**found, OVERALL: overall} if overall else found


@dataclass(frozen=True)
class Cell:
    """One figure: its text, the number to sort by ("" if there is none), and what stands small beside it."""

    text: str
    sort: str
    best: bool
    aside: str


@dataclass(frozen=True)
class Table:
    """One table: a row for each method, an IoU and a CE cell for each category.

    Attributes:
        title: heading.
        note: one line below it.
        categories: the columns under each of IoU and CE.
        rows: (method, IoU cells, CE cells).
    """

    title: str
    note: str
    categories: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...], tuple[Cell, ...]], ...]


@dataclass(frozen=True)
class Detail:
    """One line of the table of details: method, protocol, category and the other figures as text."""

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
    complete: bool


def parse_scores(scores: Sequence[Mapping[str, Any]]) -> tuple[ScoreTable, ...]:
    """Check the score tables.

    Raises:
        StorageError: one is not what scores.json should hold.
    """
    tables = []
    for number, score in enumerate(scores, start=1):
        try:
            tables.append(ScoreTable.model_validate(score))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise StorageError(
                f"score table {number}: '{where}' {first['msg'].lower()}; score the predictions again"
            ) from error
    return tuple(tables)


def protocols(tables: Sequence[ScoreTable]) -> list[str]:
    """The protocols that the tables hold, the primary one first."""
    found = {p for table in tables for p in [*(table.by_category or {}), *(table.overall or {})]}
    first = [p for p in PROTOCOL_NOTES if p in found]
    return first + sorted(found - set(first))


def score_table(tables: Sequence[ScoreTable], protocol: str) -> Table:
    """The table of one protocol."""
    scores = {table.method: table.scores(protocol) for table in tables}
    categories = {c for by_category in scores.values() for c in by_category}
    columns = tuple(sorted(categories - {OVERALL})) + ((OVERALL,) if OVERALL in categories else ())
    empty = CategoryScore()
    cells: dict[str, dict[str, CategoryScore]] = {
        method: {c: by_category.get(c, empty) for c in columns} for method, by_category in scores.items()
    }
    note = PROTOCOL_NOTES.get(protocol, "")
    return _table(f"Protocol “{protocol}”", note, columns, cells)


def published_table() -> Table:
    """The paper's own figures for real recordings."""
    cells = {
        row.method: {
            category: CategoryScore(iou=iou, ce=ce)
            for category, iou, ce in zip(CATEGORIES, row.iou, row.ce, strict=True)
        }
        for row in PUBLISHED
    }
    return _table("The paper's real-world results", LABEL, CATEGORIES, cells)


def _table(
    title: str, note: str, columns: tuple[str, ...], cells: Mapping[str, Mapping[str, CategoryScore]]
) -> Table:
    rows = tuple(
        (
            method,
            tuple(_cell(row[c].iou, _best(max, [r[c].iou for r in cells.values()]), None) for c in columns),
            tuple(
                _cell(row[c].ce, _best(min, [r[c].ce for r in cells.values()]), row[c].base_rate_ce)
                for c in columns
            ),
        )
        for method, row in cells.items()
    )
    return Table(title, note, columns, rows)


def _best(choose: Callable[[list[float]], float], values: list[float | None]) -> float | None:
    """The best of a column as it is shown: figures that look the same are the same."""
    found = [round(value, DECIMALS) for value in values if value is not None]
    return choose(found) if found else None


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:.{DECIMALS}f}"


def _cell(value: float | None, best: float | None, beside: float | None) -> Cell:
    if value is None:
        return Cell("–", "", False, "")
    aside = "" if beside is None else _shown(beside)
    return Cell(_shown(value), repr(value), round(value, DECIMALS) == best, aside)


def details(tables: Sequence[ScoreTable]) -> tuple[Detail, ...]:
    """Every other figure, a line for each method, protocol and category."""
    lines = []
    for protocol in protocols(tables):
        for table in tables:
            for category, s in table.scores(protocol).items():
                shares = (s.coverage_voxels, s.coverage_shape)
                figures = (
                    *(_shown(value) for value in (s.iou, s.precision, s.recall, s.f1, s.ce)),
                    *("–" if share is None else f"{100 * share:.1f} %" for share in shares),
                    " ".join(filter(None, (_shown(s.base_rate_ce), s.base_rate_source))),
                    *(text_of(count) for count in (s.pairs, s.objects)),
                )
                lines.append(Detail(table.method, protocol, category, figures))
    return tuple(lines)


def methods(tables: Sequence[ScoreTable]) -> tuple[Method, ...]:
    """How each method was scored: thresholds, failures, warnings."""
    return tuple(
        Method(
            name=table.method,
            thresholds=", ".join(f"{c} {text_of(p)}" for c, p in sorted((table.thresholds or {}).items())),
            source=text_of(table.threshold_source),
            failures=as_lines(table.failures),
            warnings=as_lines(table.warnings),
            complete=table.by_category is not None,
        )
        for table in tables
    )
