"""The figures of an evaluation for people: millimetres, degrees, per cent; for terminal and page."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.core.trajectory.compare import ErrorStatistics
from kinectbench.lab.evaluate.evaluation import Evaluation, TrajectoryFigures
from kinectbench.lab.evaluate.pairs import MaskFigures, PairFigures, Summary
from kinectbench.lab.evaluate.solid import SolidFigures, SolidOverlap
from kinectbench.lab.evaluate.surface import Distances, SurfaceComparison, SurfaceFigures

if TYPE_CHECKING:
    from rich.table import Table

NOT_BUILT = "not built"
NONE = "–"
MAX_LISTED = 8


@dataclass(frozen=True)
class Row:
    """One line: what, its value as text, its unit (may be empty)."""

    figure: str
    value: str
    unit: str = ""


@dataclass(frozen=True)
class Section:
    """The figures of one stage; no rows if it was not built."""

    title: str
    rows: tuple[Row, ...]


def sections(evaluation: Evaluation) -> tuple[Section, ...]:
    """All figures, stage by stage, in the order in which they are built."""
    e = evaluation
    return (
        Section("Worlds", tuple(_alignment(e))),
        Section("Trajectory", tuple(_trajectory(e.trajectory)) if e.trajectory else ()),
        Section("Floor", tuple(_floor(e))),
        Section("Surface", tuple(_surface(e.surface)) if e.surface else ()),
        Section("Solid", tuple(_solid(e.solid)) if e.solid else ()),
        Section("Masks", tuple(_masks(e.masks)) if e.masks else ()),
        Section("Pairs", tuple(_pairs(e.pairs)) if e.pairs else ()),
    )


def evaluation_table(evaluation: Evaluation) -> "Table":
    """The table that people see in the terminal: figure, value, unit."""
    from rich.table import Table

    table = Table("figure", title=f"{evaluation.subject}: built against the truth", title_justify="left")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for section in sections(evaluation):
        table.add_row(f"[bold]{section.title}[/]", "" if section.rows else NOT_BUILT, "")
        for row in section.rows:
            table.add_row(f"  {row.figure}", row.value, row.unit)
        table.add_section()
    return table


def _alignment(evaluation: Evaluation) -> Iterator[Row]:
    alignment = evaluation.alignment
    yield Row("aligned by the trajectories", "yes" if alignment.aligned else "no")
    yield Row("shift of the origin", _mm(alignment.moved_m), "mm")
    yield Row("turn", _degrees(alignment.turned_rad), "°")


def _trajectory(figures: TrajectoryFigures) -> Iterator[Row]:
    yield Row("frames tracked", f"{figures.tracked} of {figures.frames}")
    yield Row("share tracked", _percent(figures.tracked_share), "%")
    yield Row("frames lost", _frames(figures.lost))
    yield Row("frames rejected", _frames(figures.rejected))
    if figures.foreign_tracked:
        yield Row("frames of another scene with a pose", _frames(figures.foreign_tracked))
    error = figures.error
    if error is None:
        yield Row("ATE, RPE", "fewer than 3 poses match")
        return
    yield Row("poses compared", str(error.matched))
    yield from _errors("ATE", error.ate_m)
    yield Row("RPE per frame, rmse", _mm(error.rpe_frame_m.rmse), "mm")
    yield Row("RPE per frame, rmse", _degrees(error.rpe_frame_rad.rmse), "°")
    for drift, text, unit in ((error.rpe_metre_m, _mm, "mm/m"), (error.rpe_metre_rad, _degrees, "°/m")):
        yield Row("drift per metre of path, rmse", text(drift.rmse) if drift else NONE, unit)


def _errors(name: str, errors: ErrorStatistics) -> Iterator[Row]:
    for statistic in ("rmse", "mean", "median", "max"):
        yield Row(f"{name}, {statistic}", _mm(getattr(errors, statistic)), "mm")


def _floor(evaluation: Evaluation) -> Iterator[Row]:
    if evaluation.floor:
        yield Row("angle to the true floor", _degrees(evaluation.floor.angle_rad), "°")
        yield Row("height above it at the object", _mm(evaluation.floor.height_m), "mm")


def _surface(figures: SurfaceFigures) -> Iterator[Row]:
    yield Row("true surface that the camera saw", _percent(figures.visible_share), "%")
    yield Row("mean signed error (> 0: too far out)", _mm(figures.mean_signed_m), "mm")
    yield from _comparison("all", figures.whole)
    yield from _comparison("seen", figures.visible)


def _comparison(part: str, comparison: SurfaceComparison) -> Iterator[Row]:
    sides = (("accuracy", comparison.accuracy), ("completeness", comparison.completeness))
    for name, distances in sides:
        for statistic, text in (("mean_m", "mean"), ("rms_m", "rms"), ("quantile_90_m", "90 %")):
            yield Row(f"{name}, {part}: {text}", _distance(distances, statistic), "mm")
    for score in comparison.scores:
        for name in ("precision", "recall", "f"):
            label = "F" if name == "f" else name
            text = _percent(getattr(score, name))
            yield Row(f"{label} at {score.threshold_m * 1000:g} mm, {part}", text, "%")


def _distance(distances: Distances | None, statistic: str) -> str:
    return NONE if distances is None else _mm(getattr(distances, statistic))


def _solid(figures: SolidFigures) -> Iterator[Row]:
    for overlap in (figures.fine, figures.coarse):
        yield from _overlap(overlap)
    yield Row("true volume", f"{figures.true_volume_m3 * 1000:.2f}", "l")
    yield Row("built volume", f"{figures.built_volume_m3 * 1000:.2f}", "l")
    yield Row("built solid outside the cube", _percent(figures.built_outside_share), "%")


def _overlap(overlap: SolidOverlap) -> Iterator[Row]:
    grid = f"{overlap.cells}³"
    yield Row(f"IoU, {grid}", f"{overlap.iou:.4f}")
    yield Row(f"IoU, {grid}, known cells", _share(overlap.known_iou))
    yield Row(f"true solid labelled unknown, {grid}", _percent(overlap.true_unknown_share), "%")
    yield Row(f"empty space labelled unknown, {grid}", _percent(overlap.empty_unknown_share), "%")


def _masks(figures: MaskFigures) -> Iterator[Row]:
    yield Row("views compared", str(len(figures.rows)))
    if figures.without_truth:
        yield Row("views without truth", ", ".join(figures.without_truth))
    yield Row("IoU on valid depth, mean", _share(figures.mean_valid_iou))
    worst = f" (view {figures.worst_view})" if figures.worst_view else ""
    yield Row(f"IoU on valid depth, worst{worst}", _share(figures.worst_valid_iou))
    yield Row("IoU on all pixels, mean", _share(figures.mean_iou))
    yield Row("IoU on all pixels, worst", _share(figures.worst_iou))


def _pairs(figures: PairFigures) -> Iterator[Row]:
    yield Row("pairs compared", str(len(figures.rows)))
    if figures.without_truth:
        yield Row("pairs without truth", ", ".join(figures.without_truth))
    yield from _summary("IoU of full, 256³", figures.iou)
    yield from _summary("IoU of full, 256³, known cells", figures.known_iou)
    yield from _summary("true solid not known", figures.true_unknown_share)
    yield from _summary("containment of the partial", figures.containment)


def _summary(name: str, summary: Summary | None) -> Iterator[Row]:
    if summary is None:
        yield Row(name, NONE)
        return
    yield Row(f"{name}, mean", _share(summary.mean))
    yield Row(f"{name}, worst (view {summary.worst_view})", _share(summary.worst))


def _mm(value_m: float) -> str:
    return f"{value_m * 1000 + 0.0:.2f}".replace("-0.00", "0.00")


def _degrees(value_rad: float) -> str:
    return f"{np.degrees(value_rad):.3f}"


def _percent(value: float) -> str:
    return f"{100 * value:.1f}"


def _share(value: float | None) -> str:
    return NONE if value is None else f"{value:.4f}"


def _frames(frames: tuple[int, ...]) -> str:
    listed = ", ".join(map(str, frames[:MAX_LISTED])) + (" …" if len(frames) > MAX_LISTED else "")
    return f"{len(frames)}: {listed}" if frames else "0"
