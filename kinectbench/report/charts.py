"""Charts of the scores: bars by category, IoU against threshold and against visible share.

Drawn here, as SVG or as numbers for the template; they hold no text from elsewhere.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from kinectbench.core.artefacts.scores import OVERALL, ScoreRow, ScoreTable
from kinectbench.core.types import Float64
from kinectbench.report.tables import shown
from kinectbench.scoring.counts import THRESHOLDS

WIDTH, HEIGHT = 340.0, 240.0
LEFT, RIGHT, TOP, BOTTOM = 34.0, 10.0, 20.0, 36.0
COLORS = 8  # of the style sheet; methods beyond are told apart by dashes
TICKS = (0.05, 0.1, 0.2, 0.25, 0.5)
# Pairs are sorted by visible share and averaged in groups, so that a line shows through the points.
GROUP_PAIRS, MAX_GROUPS = 6, 8


@dataclass(frozen=True)
class Bar:
    """One method in one category: lengths are per cent of the chart's width."""

    method: str
    text: str
    length: float
    interval: tuple[float, float] | None
    interval_text: str


@dataclass(frozen=True)
class Bars:
    """One category."""

    category: str
    bars: tuple[Bar, ...]


def iou_bars(tables: Sequence[ScoreTable], protocol: str) -> tuple[Bars, ...]:
    """Bars of the mean IoU with its interval, a group for each category and one over all."""
    scores = {table.method: table.averages(protocol) for table in tables}
    names = sorted({c for of in scores.values() for c in of} - {OVERALL})
    values = [s.iou for of in scores.values() for s in of.values() if s.iou is not None]
    ends = [end for of in scores.values() for s in of.values() for end in s.intervals.get("iou") or ()]
    scale = 100 / nice_top(max([*values, *ends], default=1.0))
    groups = []
    for category in [OVERALL, *names] if len(names) > 1 else names:
        bars = []
        for method, of in scores.items():
            score = of.get(category)
            if score is not None and score.iou is not None:
                ends_of = score.intervals.get("iou")
                interval = (
                    None if ends_of is None else (ends_of[0] * scale, (ends_of[1] - ends_of[0]) * scale)
                )
                words = "" if ends_of is None else f"{shown(ends_of[0])}–{shown(ends_of[1])}"
                bars.append(Bar(method, shown(score.iou), score.iou * scale, interval, words))
        groups.append(Bars(category, tuple(bars)))
    return tuple(group for group in groups if group.bars)


def nice_top(value: float) -> float:
    """The end of an axis from 0 that holds a share: a tenth, at most 1."""
    return min(1.0, max(0.1, float(np.ceil(round(value * 10, 6)) / 10)))


@dataclass(frozen=True)
class Axes:
    """A chart's frame: x from `x_low` to `x_high`, y from 0 to `y_high`."""

    x_low: float
    x_high: float
    y_high: float

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of a point."""
        across = (x - self.x_low) / (self.x_high - self.x_low)
        return (
            LEFT + across * (WIDTH - LEFT - RIGHT),
            HEIGHT - BOTTOM - y / self.y_high * (HEIGHT - TOP - BOTTOM),
        )

    def path(self, xs: Sequence[float], ys: Sequence[float]) -> str:
        """The `d` of a line through points."""
        return "M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in map(self.at, xs, ys))


def _steps(low: float, high: float) -> list[float]:
    """Ticks of an axis, four to six of them."""
    step = next((s for s in TICKS if (high - low) / s <= 5), TICKS[-1])
    first = int(np.ceil(round(low / step, 6)))
    return [k * step for k in range(first, int(np.floor(round(high / step, 6))) + 1)]


def _frame(axes: Axes, x_name: str, body: Sequence[str], label: str) -> Markup:
    """The SVG element: grid, ticks, names, and what is drawn in it."""
    parts = []
    for y in _steps(0, axes.y_high):
        (x0, y0), (x1, _) = axes.at(axes.x_low, y), axes.at(axes.x_high, y)
        parts.append(f'<path class="rule" d="M{x0:.1f},{y0:.1f}H{x1:.1f}"/>')
        parts.append(f'<text x="{x0 - 6:.1f}" y="{y0 + 4:.1f}" text-anchor="end">{y:.4g}</text>')
    for x in _steps(axes.x_low, axes.x_high):
        px, py = axes.at(x, 0)
        parts.append(f'<path class="tick" d="M{px:.1f},{py:.1f}v4"/>')
        parts.append(f'<text x="{px:.1f}" y="{py + 16:.1f}" text-anchor="middle">{x:.4g}</text>')
    middle = axes.at((axes.x_low + axes.x_high) / 2, 0)[0]
    parts.append(f'<text x="{middle:.1f}" y="{HEIGHT - 4:.1f}" text-anchor="middle">{x_name}</text>')
    parts.append(f'<text x="{LEFT:.1f}" y="{TOP - 9:.1f}">IoU</text>')
    head = f'<svg class="chart" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" role="img"'
    head += f' aria-label="{escape(label)}">'
    return Markup(head + "".join([*parts, *body]) + "</svg>")


def series_class(index: int) -> str:
    """The style of the method at an index of the legend."""
    return f"s{index % COLORS}" + (f" dash{index // COLORS % 3}" if index >= COLORS else "")


@dataclass(frozen=True)
class Chart:
    """A drawing and its heading."""

    title: str
    svg: Markup


def threshold_charts(tables: Sequence[ScoreTable], protocol: str) -> tuple[Chart, ...]:
    """IoU against the threshold, a chart for each category; a dot marks the threshold that was used."""
    curves = [_curves_of(table, protocol) for table in tables]
    categories = sorted({category for of in curves for category in of})
    charts = []
    for category in categories:
        top = nice_top(max(max(of[category]) for of in curves if category in of))
        axes, body = Axes(THRESHOLDS[0], THRESHOLDS[-1], top), []
        for index, (table, of) in enumerate(zip(tables, curves, strict=True)):
            if category in of:
                body.append(_curve(axes, index, of[category], table.thresholds.get(category)))
        label = f"IoU against the threshold, {category}: {len(body)} methods"
        charts.append(Chart(category, _frame(axes, "threshold", body, label)))
    return tuple(charts)


def _curves_of(table: ScoreTable, protocol: str) -> dict[str, list[float]]:
    """IoU at each threshold by category; a curve of another length than the thresholds is left out."""
    curves = (table.iou_by_threshold or {}).get(protocol, {})
    return {category: curve for category, curve in curves.items() if len(curve) == len(THRESHOLDS)}


def _curve(axes: Axes, index: int, curve: Sequence[float], used: float | None) -> str:
    line = f'<path class="line" d="{axes.path(THRESHOLDS, curve)}"/>'
    if used in THRESHOLDS:
        x, y = axes.at(used, curve[THRESHOLDS.index(used)])
        line += f'<circle class="used" cx="{x:.1f}" cy="{y:.1f}" r="3.2"/>'
    return _series(index, line)


def _series(index: int, content: str) -> str:
    return f'<g class="series {series_class(index)}" data-series="{index}">{content}</g>'


def visible_shares(table: ScoreTable) -> dict[str, float]:
    """{pair: share of the shape's known voxels that the input view saw}.

    What `occluded` leaves out of `known`: 1 - coverage_shape(occluded) / coverage_shape(known). Pairs that
    were not scored under both are left out. Source: own rule.
    """
    known = {row.pair: row.coverage_shape for row in table.pairs("known")}
    shares = {}
    for row in table.pairs("occluded"):
        whole = known.get(row.pair)
        if whole and row.coverage_shape is not None:
            shares[row.pair] = min(max(1 - row.coverage_shape / whole, 0.0), 1.0)
    return shares


def visible_charts(tables: Sequence[ScoreTable], protocol: str) -> tuple[Chart, ...]:
    """IoU of every pair against the share of the shape that the view saw, by category, where known."""
    shares: dict[str, float] = {}
    for table in tables:
        shares |= visible_shares(table)
    rows = [table.pairs(protocol) for table in tables]
    categories = sorted({row.category for of in rows for row in of})
    points = {c: [_points([r for r in of if r.category == c], shares) for of in rows] for c in categories}
    charts = []
    for category, by_method in points.items():
        every = np.concatenate(by_method)
        if len(every):
            axes = Axes(0.0, nice_top(float(every[:, 0].max())), nice_top(float(every[:, 1].max())))
            body = [_scatter(axes, index, of) for index, of in enumerate(by_method) if len(of)]
            label = f"IoU of each pair against the share of the shape seen, {category}: {len(body)} methods"
            charts.append(Chart(category, _frame(axes, "share of the shape that the view saw", body, label)))
    return tuple(charts)


def _points(rows: Sequence[ScoreRow], shares: Mapping[str, float]) -> Float64:
    """(n, 2) share and IoU of each pair, by share."""
    found = sorted((shares[row.pair], row.iou) for row in rows if row.pair in shares and row.iou is not None)
    return np.array(found, np.float64).reshape(-1, 2)


def _scatter(axes: Axes, index: int, points: Float64) -> str:
    """Points, and the means of groups of as many pairs each."""
    dots = "".join("M{:.1f},{:.1f}h0".format(*axes.at(*point)) for point in points.tolist())
    drawn = f'<path class="dots" d="{dots}"/>'
    groups = np.array_split(points, min(MAX_GROUPS, max(1, len(points) // GROUP_PAIRS)))
    if len(groups) > 1:
        means = np.array([group.mean(axis=0) for group in groups])
        drawn += f'<path class="line" d="{axes.path(means[:, 0].tolist(), means[:, 1].tolist())}"/>'
    return _series(index, drawn)
