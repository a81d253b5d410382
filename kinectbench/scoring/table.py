"""The result of scoring one method, as a value and as files."""

import csv
import io
from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass, field, fields
from pathlib import Path
from typing import Any

from kinectbench.scoring.surface import SURFACE_METRICS
from kinectbench.workspace import pretty_json, replaced_file

METRICS = ("iou", "ce", "precision", "recall", "f1")
SURFACES = SURFACE_METRICS
SHARES = frozenset({*METRICS, *SURFACES} - {"ce", "chamfer_mm"})  # in [0, 1], the higher the better


@dataclass(frozen=True)
class ScoreRow:
    """One pair under one protocol. Cross-entropies are in nats a voxel, the rest are shares in [0, 1].

    Attributes:
        recording: id of the recording.
        object: the thing recorded.
        view: zero-padded index.
        category: such as "chair".
        protocol: "paper", "known" or "occluded".
        threshold: a voxel is predicted occupied if y > threshold.
        iou: intersection over union.
        ce: mean cross-entropy.
        precision: at the threshold.
        recall: at the threshold.
        f1: at the threshold.
        base_rate_ce: the cross-entropy of the category's base-rate constant.
        coverage_voxels: share of the 256**3 voxels that the protocol counts.
        coverage_shape: share of the shape's voxels that it counts.
        cells: side of the prediction as it was submitted; 0 if it is missing and scored as empty.
        ceiling_iou: what the truth itself reaches when it is reduced to that side (see `ceiling.py`).
        chamfer_mm, f_score_1pct, f_score_2pct, f_score_10mm, f_score_20mm, surface_dice,
            normal_consistency: see `surface.py`; None if they were not asked for.
    """

    recording: str
    object: str
    view: str
    category: str
    protocol: str
    threshold: float
    iou: float
    ce: float
    precision: float
    recall: float
    f1: float
    base_rate_ce: float
    coverage_voxels: float
    coverage_shape: float
    cells: int = 256
    ceiling_iou: float = 1.0
    chamfer_mm: float | None = None
    f_score_1pct: float | None = None
    f_score_2pct: float | None = None
    f_score_10mm: float | None = None
    f_score_20mm: float | None = None
    surface_dice: float | None = None
    normal_consistency: float | None = None


@dataclass(frozen=True)
class ScoreTable:
    """Everything known of one method's scores; its fields are the keys of scores.json.

    Attributes:
        method: its name.
        benchmark_sha256: the release it was scored against.
        package_version: of kinectbench.
        settings: every choice that the numbers depend on.
        complete: every test pair was scored; if not, there are no averages.
        thresholds: by category.
        threshold_source: "validation", "file:<sha256>" or "fixed".
        base_rate: {category: {value, source}}.
        rows: one per test pair and protocol.
        by_category: {protocol: {category: averages}}, or None if not complete.
        overall: {protocol: macro mean over the categories}, or None if not complete.
        truth_quality: {recording: what the release says of its truth}.
        failures: [{recording, view, reason}].
        warnings: one line each.
        notes: what to know of the numbers, one line each.
        extremes: {protocol: the best and the worst pairs by IoU}.
        iou_by_threshold: {protocol: {category: mean IoU at thresholds k / 20, k = 2 to 18}}, or None if not
            complete.
        hashes: {pair: SHA-256 of its truth, and "blake3:<hex>" of the prediction's file}.
        baseline: whether kinectbench made the predictions itself, to stand beside a method's.
    """

    method: str
    benchmark_sha256: str
    package_version: str
    settings: Mapping[str, Any]
    complete: bool
    thresholds: Mapping[str, float]
    threshold_source: str
    base_rate: Mapping[str, Mapping[str, Any]]
    rows: tuple[ScoreRow, ...]
    by_category: Mapping[str, Mapping[str, Mapping[str, Any]]] | None
    overall: Mapping[str, Mapping[str, Any]] | None
    truth_quality: Mapping[str, Any]
    failures: tuple[Mapping[str, str], ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    extremes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    iou_by_threshold: Mapping[str, Mapping[str, list[float]]] | None = None
    hashes: Mapping[str, Mapping[str, str | None]] = field(default_factory=dict)
    baseline: bool = False


def scores_json(table: ScoreTable) -> str:
    """scores.json as text: strict JSON, the same for the same table."""
    return pretty_json(asdict(table))


def scores_csv(table: ScoreTable) -> str:
    """scores.csv as text: one line per pair and protocol."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["method", *(column.name for column in fields(ScoreRow))])
    writer.writerows([table.method, *astuple(row)] for row in table.rows)
    return buffer.getvalue()


def write_scores(table: ScoreTable, folder: Path) -> None:
    """Write scores.json and scores.csv into a folder, each whole or not at all.

    Raises:
        StorageError: the disk is full or read-only.
    """
    for name, text in (("scores.csv", scores_csv(table)), ("scores.json", scores_json(table))):
        with replaced_file(folder / name) as temporary:
            temporary.write_text(text)
