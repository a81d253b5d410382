"""Table rows of an evaluation's metrics, for terminal and page, in millimetres, degrees and per cent."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from kinectbench.core.artefacts.object import with_interval
from kinectbench.lab.evaluate.evaluation import AlignmentFigures, Evaluation, FloorFigures, TrajectoryFigures
from kinectbench.lab.evaluate.measured import FaceBias
from kinectbench.lab.evaluate.pairs import MaskFigures, PairFigures
from kinectbench.lab.evaluate.refined import RefinedFigures
from kinectbench.lab.evaluate.solid import SolidFigures
from kinectbench.lab.evaluate.surface import SurfaceComparison, SurfaceFigures

NOT_BUILT = "not built"
NONE = "–"
MAX_LISTED = 8


# {unit: (factor, decimals)} to show figures in metres, cubic metres or radians, and shares.
UNITS: Mapping[str, tuple[float, int]] = {
    "": (1, 4),
    "%": (100, 1),
    "mm": (1000, 2),
    "mm/m": (1000, 2),
    "°": (180 / np.pi, 3),
    "°/m": (180 / np.pi, 3),
    "l": (1000, 2),
}


@dataclass(frozen=True)
class FigureRow:
    """One row of the table: name of the metric, value as text, unit (may be empty)."""

    figure: str
    value: str
    unit: str = ""


@dataclass(frozen=True)
class Section:
    """A titled group of rows, such as those of one stage; it has no rows if the stage was not built."""

    title: str
    rows: tuple[FigureRow, ...]


def sections(evaluation: Evaluation) -> tuple[Section, ...]:
    """Return all metrics as sections, in the order of the stages of a build."""
    e = evaluation
    parts: tuple[tuple[str, Callable[[Any], Iterator[FigureRow]], Any], ...] = (
        ("Worlds", _alignment, e.alignment),
        ("Trajectory", _trajectory, e.trajectory),
        ("Fused scene, at the object", lambda of: _compared("seen", of.visible), e.scene),
        ("Floor", _floor, e.floor),
        ("Surface", _surface, e.surface),
        ("Measured surface, above the floor", lambda of: _compared("measured", of.visible), e.measured),
        ("Solid", _solid, e.solid),
        ("Solid, laid rigidly onto the true one", _refined, e.refined),
        ("Masks", _masks, e.masks),
        ("Pairs", _pairs, e.pairs),
    )
    return tuple(Section(title, tuple(rows(of)) if of else ()) for title, rows, of in parts)


def evaluation_table(evaluation: Evaluation) -> Table:
    """Return the evaluation as a table for the terminal, with columns figure, value and unit."""
    table = Table("figure", title=f"{evaluation.subject}: built against the truth", title_justify="left")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for section in sections(evaluation):
        table.add_row(Text(section.title, style="bold"), "" if section.rows else NOT_BUILT, "")
        for row in section.rows:
            table.add_row(f"  {row.figure}", row.value, row.unit)
        table.add_section()
    return table


def _row(figure: str, value: float | None, unit: str = "") -> FigureRow:
    factor, decimals = UNITS[unit]
    return FigureRow(figure, NONE if value is None else f"{factor * value:z.{decimals}f}", unit)


def _alignment(figures: AlignmentFigures) -> Iterator[FigureRow]:
    yield FigureRow("aligned by the trajectories", "yes" if figures.aligned else "no")
    yield _row("shift of the origin", figures.moved_m, "mm")
    yield _row("turn", figures.turned_rad, "°")


def _trajectory(figures: TrajectoryFigures) -> Iterator[FigureRow]:
    yield FigureRow("frames tracked", f"{figures.tracked} of {figures.frames}")
    yield _row("share tracked", figures.tracked_share, "%")
    yield FigureRow("frames lost", _frames(figures.lost))
    yield FigureRow("frames rejected", _frames(figures.rejected))
    if figures.foreign_tracked:
        yield FigureRow("frames of another scene with a pose", _frames(figures.foreign_tracked))
    clock = figures.given_clock
    if clock is not None:
        yield FigureRow("given poses' clock late by", f"{1000 * clock.late_s:.1f}", "ms")
        yield _row("given poses' ATE", clock.ate_m, "mm")
        yield _row("the same, at the right time", clock.ate_moved_m, "mm")
    error = figures.error
    if error is None:
        yield FigureRow("ATE, RPE", "fewer than 3 poses match")
        return
    yield FigureRow("poses compared", str(error.matched))
    for statistic in ("rmse", "mean", "median", "max"):
        yield _row(f"ATE, {statistic}", getattr(error.ate_m, statistic), "mm")
    for name, errors, unit in (
        ("RPE per frame", error.rpe_frame_m, "mm"),
        ("RPE per frame", error.rpe_frame_rad, "°"),
        ("drift per metre of path", error.rpe_metre_m, "mm/m"),
        ("drift per metre of path", error.rpe_metre_rad, "°/m"),
    ):
        yield _row(f"{name}, rmse", errors.rmse if errors else None, unit)


def _frames(frames: tuple[int, ...]) -> str:
    listed = ", ".join(map(str, frames[:MAX_LISTED])) + (" …" if len(frames) > MAX_LISTED else "")
    return f"{len(frames)}: {listed}" if frames else "0"


def _floor(figures: FloorFigures) -> Iterator[FigureRow]:
    yield _row("angle to the true floor", figures.angle_rad, "°")
    yield _row("height above it at the object", figures.height_m, "mm")


def _surface(figures: SurfaceFigures) -> Iterator[FigureRow]:
    yield _row("true surface that the camera saw", figures.visible_share, "%")
    yield _row("mean signed error (> 0: too far out)", figures.mean_signed_m, "mm")
    yield from _compared("all", figures.whole)
    yield from _compared("seen", figures.visible)


def _compared(part: str, compared: SurfaceComparison) -> Iterator[FigureRow]:
    for name, of in (("accuracy", compared.accuracy), ("completeness", compared.completeness)):
        for statistic, key in (("mean", "mean_m"), ("rms", "rms_m"), ("90 %", "quantile_90_m")):
            yield _row(f"{name}, {part}: {statistic}", getattr(of, key) if of else None, "mm")
    for score in compared.scores:
        for name, share in (("precision", score.precision), ("recall", score.recall), ("F", score.f)):
            yield _row(f"{name} at {score.threshold_m * 1000:g} mm, {part}", share, "%")


def _solid(figures: SolidFigures) -> Iterator[FigureRow]:
    for overlap in (figures.fine, figures.coarse, figures.exact_fine):
        grid = f"{overlap.cells}³" + (", exact solid" if overlap is figures.exact_fine else "")
        yield _row(f"IoU, {grid}", overlap.iou)
        yield _row(f"IoU, {grid}, known cells", overlap.known_iou)
        yield _row(f"true solid labelled unknown, {grid}", overlap.true_unknown_share, "%")
        yield _row(f"empty space labelled unknown, {grid}", overlap.empty_unknown_share, "%")
    yield _row("true volume", figures.true_volume_m3, "l")
    yield _row("solid by definition, of the true volume", figures.closed_by_definition_share, "%")
    yield _row("not judged (slits), of the true volume", figures.not_judged_share, "%")
    yield _row("built volume", figures.built_volume_m3, "l")
    yield _row("built solid outside the cube", figures.built_outside_share, "%")
    yield _row("known, but wrong by over 10 mm, of the true volume", figures.known_gross_share, "%")
    yield _row("the same: solid called air", figures.solid_called_air, "%")
    yield _row("the same: air called solid", figures.air_called_solid, "%")
    yield _row("known, but wrong by over 10 mm, exact solid", figures.exact_known_gross_share, "%")
    near = figures.unknown_near_measured
    yield _row("unknown within 10 mm of measured surface, solid", near.solid, "%")
    yield _row("unknown within 10 mm of measured surface, air", near.air, "%")
    yield _row("probability against share inside, ten bins", figures.calibration_error)
    yield from _bias(figures.face_bias_m)
    ends = figures.estimated_iou_low, figures.estimated_iou_high
    yield FigureRow("estimated IoU", with_interval(figures.estimated_iou, *ends) or NONE)
    if figures.iou_in_interval is not None:
        yield FigureRow("IoU lies between them", "yes" if figures.iou_in_interval else "no")
    yield _row("estimated IoU on known", figures.estimated_known_iou)


def _bias(bias: FaceBias) -> Iterator[FigureRow]:
    for name, bias_m in (("upper faces", bias.up), ("sides", bias.side), ("undersides", bias.down)):
        yield _row(f"measured {name} (> 0: too far out)", bias_m, "mm")


def _refined(figures: RefinedFigures) -> Iterator[FigureRow]:
    yield _row("lifted by", figures.lifted_m, "mm")
    yield _row("moved by", figures.moved_m, "mm")
    yield _row("turned by", figures.turned_rad, "°")
    yield _row("measured surface, mean distance before", figures.measured_distance_m, "mm")
    yield _row("measured surface, mean distance after", figures.refined_distance_m, "mm")
    yield from _bias(figures.face_bias_m)
    yield _row("IoU, 256³", figures.iou)
    yield _row("IoU, 256³, known cells", figures.known_iou)


def _masks(figures: MaskFigures) -> Iterator[FigureRow]:
    yield FigureRow("views compared", str(len(figures.rows)))
    if figures.without_truth:
        yield FigureRow("views without truth", ", ".join(figures.without_truth))
    yield _row("IoU on valid depth, mean", figures.mean_valid_iou)
    worst = f" (view {figures.worst_view})" if figures.worst_view else ""
    yield _row(f"IoU on valid depth, worst{worst}", figures.worst_valid_iou)
    yield _row("IoU on all pixels, mean", figures.mean_iou)
    yield _row("IoU on all pixels, worst", figures.worst_iou)


def _pairs(figures: PairFigures) -> Iterator[FigureRow]:
    yield FigureRow("pairs compared", str(len(figures.rows)))
    if figures.without_truth:
        yield FigureRow("pairs without truth", ", ".join(figures.without_truth))
    for name, summary in (
        ("IoU of full, 256³", figures.iou),
        ("IoU of full, 256³, known cells", figures.known_iou),
        ("IoU of full, 256³, exact solid", figures.exact_iou),
        ("true solid not known", figures.true_unknown_share),
        ("containment of the partial", figures.containment),
    ):
        if summary is None:
            yield FigureRow(name, NONE)
        else:
            yield _row(f"{name}, mean", summary.mean)
            yield _row(f"{name}, worst (view {summary.worst_view})", summary.worst)
