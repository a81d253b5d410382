"""What the page reads of a scores.json: documented keys only, each of which an older file may lack."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from kinectbench.errors import StorageError
from kinectbench.scoring.counts import THRESHOLDS

OVERALL = "overall"


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class CategoryScore(_Part):
    """What scores.json holds of one protocol and category; a figure that was not made is None."""

    iou: float | None = None
    ce: float | None = None
    precision: float | None = None
    recall: float | None = None
    f1: float | None = None
    chamfer_mm: float | None = None
    f_score_1pct: float | None = None
    surface_dice: float | None = None
    normal_consistency: float | None = None
    pairs: int | None = None
    objects: int | None = None
    coverage_voxels: float | None = None
    coverage_shape: float | None = None
    ceiling_iou: float | None = None
    base_rate_ce: float | None = None
    base_rate_source: str | None = None
    truth_estimated_iou: float | None = None
    truth_repeatability_iou: float | None = None
    intervals: dict[str, tuple[float, float] | None] | None = None

    def interval(self, metric: str) -> tuple[float, float] | None:
        """The 95 % interval of a metric over objects."""
        return (self.intervals or {}).get(metric)


class PairScore(_Part):
    """One row: a pair under one protocol."""

    recording: str
    view: str
    category: str
    protocol: str
    object: str = ""
    iou: float | None = None
    threshold: float | None = None
    coverage_shape: float | None = None

    @property
    def pair(self) -> str:
        """`<recording>/<view>`."""
        return f"{self.recording}/{self.view}"


Curve = list[float]


class ScoreTable(_Part):
    """What the page shows of one scores.json; without averages if the set of predictions is incomplete."""

    method: str
    benchmark_sha256: str | None = None
    package_version: str | None = None
    thresholds: dict[str, float | None] | None = None
    threshold_source: Any = None
    by_category: dict[str, dict[str, CategoryScore | None] | None] | None = None
    overall: dict[str, CategoryScore | None] | None = None
    rows: list[PairScore] | None = None
    iou_by_threshold: dict[str, dict[str, Curve]] | None = None
    failures: Any = None
    warnings: Any = None
    notes: Any = None
    baseline: bool | None = None

    def scores(self, protocol: str) -> dict[str, CategoryScore]:
        """The scores of a protocol by category, and under `overall` over all categories."""
        by_category = (self.by_category or {}).get(protocol) or {}
        overall = (self.overall or {}).get(protocol)
        found = {category: score for category, score in by_category.items() if score}
        return {**found, OVERALL: overall} if overall else found

    def curves(self, protocol: str) -> dict[str, Curve]:
        """IoU at each threshold by category; a curve of another length than the thresholds is left out."""
        curves = (self.iou_by_threshold or {}).get(protocol, {})
        return {category: curve for category, curve in curves.items() if len(curve) == len(THRESHOLDS)}

    def pairs(self, protocol: str) -> list[PairScore]:
        """The rows of a protocol."""
        return [row for row in self.rows or [] if row.protocol == protocol]


def parse_scores(scores: Sequence[Mapping[str, Any]]) -> tuple[ScoreTable, ...]:
    """Check the score tables; methods of one name are told apart as `net`, `net #2`.

    Raises:
        StorageError: one is not what scores.json should hold.
    """
    tables: list[ScoreTable] = []
    names: dict[str, int] = {}
    for number, score in enumerate(scores, start=1):
        try:
            table = ScoreTable.model_validate(score)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise StorageError(
                f"score table {number}: '{where}' {first['msg'].lower()}; score the predictions again"
            ) from error
        names[table.method] = names.get(table.method, 0) + 1
        again = f" #{names[table.method]}" if names[table.method] > 1 else ""
        tables.append(table.model_copy(update={"method": table.method + again}))
    return tuple(tables)
