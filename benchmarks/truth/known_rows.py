"""A row for each simulated object that was built: what is known of it, what is right, and tables of rows."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from kinectbench.core.errors import KinectBenchError
from kinectbench.lab.evaluate.build import read_build
from kinectbench.lab.evaluate.evaluation import evaluate
from kinectbench.lab.evaluate.known import CalibrationBin
from kinectbench.lab.evaluate.measured import FaceBias
from kinectbench.lab.evaluate.refined import RefinedFigures
from kinectbench.lab.simulate.objects import families
from kinectbench.lab.simulate.truth import read_truth

NONE = "–"
WIDTH = 220
AT_5_MM = 0


@dataclass(frozen=True)
class Task:
    """What to measure: a recording's name, its object's family, how it was recorded, its build and truth."""

    name: str
    family: str
    path: str
    build: Path
    truth: Path


@dataclass(frozen=True)
class Row:
    """One object; shares in [0, 1], of the true volume where nothing else is said.

    Attributes:
        name: of the recording.
        family: of the object.
        path: the preset that it was recorded by.
        ate_m: RMSE of the tracked positions; None if fewer than three match.
        iou: of the whole solid, 256^3.
        known_iou: the same over known cells; None if none of the true solid is known.
        known_gross: known, wrong and more than 10 mm from the true surface.
        air_called_solid: the part of it outside the true solid.
        not_known: of the true solid, labelled unknown.
        near_solid: unknown, of the true solid within 10 mm of measured surface; None if none was measured.
        near_air: the same of true air.
        estimated: `estimated_iou` of quality.json.
        low: `estimated_iou_low`.
        high: `estimated_iou_high`.
        in_interval: whether `iou` lies between the two; None without them.
        estimated_known: `estimated_known_iou` of quality.json.
        known_in_interval: whether `known_iou` lies in its interval; None without one.
        frontiers: how many quality.json reports; None if it does not say.
        calibration: error of the probability, ten bins.
        bins: these bins.
        bias: signed, metres, of measured faces.
        refined: the measured surface before and after a rigid motion onto the true one.
        scene_f: F at 5 mm of the fused scene at the object, on what was seen; None if there is nothing.
        fused_f: F at 5 mm of the part of the object's mesh that was measured, on what was measured.
        mesh_f: F at 5 mm of the whole mesh, which is closed, on what was seen.
        warnings: of quality.json.
    """

    name: str
    family: str
    path: str
    ate_m: float | None
    iou: float
    known_iou: float | None
    known_gross: float
    air_called_solid: float
    not_known: float
    near_solid: float | None
    near_air: float | None
    estimated: float | None
    low: float | None
    high: float | None
    in_interval: bool | None
    estimated_known: float | None
    known_in_interval: bool | None
    frontiers: int | None
    calibration: float | None
    bins: tuple[CalibrationBin, ...]
    bias: FaceBias
    refined: RefinedFigures
    scene_f: float | None
    fused_f: float | None
    mesh_f: float
    warnings: tuple[str, ...]

    @property
    def is_furniture(self) -> bool:
        """Whether its family is one of those with bars of their own."""
        return families()[self.family].furniture

    @property
    def off(self) -> float | None:
        """By how much the estimated IoU is too high."""
        return None if self.estimated is None else self.estimated - self.iou

    @property
    def has_frontier(self) -> bool:
        """Whether quality.json reports an opening that nobody looked into."""
        return bool(self.frontiers)


@dataclass(frozen=True)
class NotBuilt:
    """An object that has no solid, or none that can be evaluated, and why."""

    name: str
    family: str
    why: str


def measure_row(task: Task) -> Row | NotBuilt:
    """Measure what was built of an object; later stages than the solid do not matter."""
    try:
        build, truth = read_build(task.build), read_truth(task.truth)
        found = evaluate(build, truth)
    except KinectBenchError as error:
        return NotBuilt(task.name, task.family, str(error))
    if build.model is None or found.solid is None or found.surface is None or found.refined is None:
        return NotBuilt(task.name, task.family, "no solid was built")
    solid, quality = found.solid, build.model.quality
    frontiers = getattr(quality, "frontiers", None)
    of_poses = found.trajectory.error if found.trajectory else None
    return Row(
        name=task.name,
        family=task.family,
        path=task.path,
        ate_m=of_poses.ate_m.rmse if of_poses else None,
        iou=solid.fine.iou,
        known_iou=solid.fine.known_iou,
        known_gross=solid.known_gross_share,
        air_called_solid=solid.air_called_solid,
        not_known=solid.fine.true_unknown_share,
        near_solid=solid.unknown_near_measured.solid,
        near_air=solid.unknown_near_measured.air,
        estimated=solid.estimated_iou,
        low=solid.estimated_iou_low,
        high=solid.estimated_iou_high,
        in_interval=solid.iou_in_interval,
        estimated_known=solid.estimated_known_iou,
        known_in_interval=solid.known_iou_in_interval,
        frontiers=None if frontiers is None else len(frontiers),
        calibration=solid.calibration_error,
        bins=solid.calibration_bins,
        bias=solid.face_bias_m,
        refined=found.refined,
        scene_f=found.scene.visible.scores[AT_5_MM].f if found.scene else None,
        fused_f=found.measured.visible.scores[AT_5_MM].f if found.measured else None,
        mesh_f=found.surface.visible.scores[AT_5_MM].f,
        warnings=tuple(quality.warnings),
    )


# A column: its title, a row's value, by what it is multiplied, and decimals.
Column = tuple[str, Callable[[Row], float | None], float, int]
COLUMNS: tuple[Column, ...] = (
    ("IoU", lambda row: row.iou, 1, 3),
    ("known", lambda row: row.known_iou, 1, 3),
    ("gross %", lambda row: row.known_gross, 100, 2),
    ("not known %", lambda row: row.not_known, 100, 1),
    ("near, solid %", lambda row: row.near_solid, 100, 1),
    ("near, air %", lambda row: row.near_air, 100, 1),
    ("est.", lambda row: row.estimated, 1, 3),
    ("low", lambda row: row.low, 1, 2),
    ("high", lambda row: row.high, 1, 2),
    ("frontiers", lambda row: row.frontiers, 1, 0),
    ("calib.", lambda row: row.calibration, 1, 3),
    ("up mm", lambda row: row.bias.up, 1000, 2),
    ("side mm", lambda row: row.bias.side, 1000, 2),
    ("down mm", lambda row: row.bias.down, 1000, 2),
    ("|e| mm", lambda row: row.refined.measured_distance_m, 1000, 2),
    ("refined", lambda row: row.refined.refined_distance_m, 1000, 2),
    ("known", lambda row: row.refined.known_iou, 1, 3),
    ("scene F", lambda row: row.scene_f, 1, 3),
    ("fused F", lambda row: row.fused_f, 1, 3),
    ("mesh F", lambda row: row.mesh_f, 1, 3),
    ("ATE mm", lambda row: row.ate_m, 1000, 1),
)


def mean_of(rows: Sequence[Row], value: Callable[[Row], float | None]) -> float | None:
    """Mean over the rows that have the value; None if none has."""
    values = [found for found in map(value, rows) if found is not None]
    return float(np.mean(values)) if values else None


def line(row: Row) -> str:
    """One object in a line, while others are still measured."""
    return "  ".join([f"{row.name:14}", *(f"{title} {text}" for title, text in _texts([row]))])


def print_tables(rows: Sequence[Row], missing: Sequence[NotBuilt]) -> None:
    """A table of objects, and one of families: means over their objects."""
    console = Console()
    if not console.is_terminal:
        console.width = WIDTH
    console.print(_table("objects", [(row.name, [row]) for row in rows]))
    families = list(dict.fromkeys(row.family for row in rows))
    groups = [(f"{one} ({len(of)})", of) for one, of in ((f, _of(rows, f)) for f in families)]
    furniture = [row for row in rows if row.is_furniture]
    others = [row for row in rows if not row.is_furniture]
    groups += [
        (f"{name} ({len(of)})", of) for name, of in (("furniture", furniture), ("others", others)) if of
    ]
    console.print(_table("families, means", groups))
    for one in missing:
        console.print(f"{one.name}: not built: {one.why}")


def as_json(rows: Sequence[Row], missing: Sequence[NotBuilt]) -> dict[str, Any]:
    """The rows as JSON values."""
    return {"objects": [asdict(row) for row in rows], "not_built": [asdict(one) for one in missing]}


def _of(rows: Sequence[Row], family: str) -> list[Row]:
    return [row for row in rows if row.family == family]


def _table(title: str, groups: Sequence[tuple[str, Sequence[Row]]]) -> Table:
    table = Table(title, title=None)
    for name, *_ in COLUMNS:
        table.add_column(name, justify="right")
    for name, rows in groups:
        table.add_row(name, *(text for _, text in _texts(rows)))
    return table


def _texts(rows: Sequence[Row]) -> Iterator[tuple[str, str]]:
    for title, value, factor, decimals in COLUMNS:
        mean = mean_of(rows, value)
        yield title, NONE if mean is None else f"{factor * mean:.{decimals}f}"
