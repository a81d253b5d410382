"""Charts of the scores: bars by category, IoU against threshold and against visible share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import OVERALL, ScoreTable
from kinectbench.core.even_choice import spread
from kinectbench.core.pages import render_page
from kinectbench.core.types import Float64
from kinectbench.report.plan import svg_path
from kinectbench.report.tables import shown_figure
from kinectbench.scoring.counts import THRESHOLDS

WIDTH, HEIGHT = 340.0, 240.0
LEFT, RIGHT, TOP, BOTTOM = 34.0, 10.0, 20.0, 36.0
COLORS = 8  # in the style sheet; dashes distinguish further methods
TICKS = (0.05, 0.1, 0.2, 0.25, 0.5)
# Pairs are sorted by visible share and averaged in groups, which gives the line through the points.
GROUP_PAIRS, MAX_GROUPS = 6, 8
# Largest number of points of a method in a chart, at 13 bytes each: more would hide each other.
MOST_DOTS = 500


@dataclass(frozen=True)
class Bar:
    """A method's bar: `text` is its IoU; `length` and `interval` (start, length) are in % of the chart."""

    method: str
    text: str
    length: float
    interval: tuple[float, float] | None
    interval_text: str


def iou_bars(tables: Sequence[ScoreTable], protocol: str) -> dict[str, list[Bar]]:
    """Return {category: a bar for each method}; a bar shows the mean IoU and its confidence interval.

    If there are several categories, the group `OVERALL` comes first.
    """
    scores = {table.method: table.averages(protocol) for table in tables}
    names = sorted({c for of in scores.values() for c in of} - {OVERALL})
    values = [s.iou for of in scores.values() for s in of.values() if s.iou is not None]
    ends = [end for of in scores.values() for s in of.values() for end in s.intervals.get("iou") or ()]
    scale = 100 / nice_top(max([*values, *ends], default=1.0))
    groups: dict[str, list[Bar]] = {}
    for category in [OVERALL, *names] if len(names) > 1 else names:
        for method, of in scores.items():
            score = of.get(category)
            if score is not None and score.iou is not None:
                interval, words = None, ""
                if between := score.intervals.get("iou"):
                    interval = between[0] * scale, (between[1] - between[0]) * scale
                    words = f"{shown_figure(between[0])}–{shown_figure(between[1])}"
                bar = Bar(method, shown_figure(score.iou), score.iou * scale, interval, words)
                groups.setdefault(category, []).append(bar)
    return groups


def nice_top(value: float) -> float:
    """Return the upper end of an axis from 0 that shows `value`, a share: a multiple of 0.1, at most 1."""
    return min(1.0, max(0.1, float(np.ceil(round(value * 10, 6)) / 10)))


@dataclass(frozen=True)
class Axes:
    """The axes of a chart: x from `x_low` to `x_high`, y from 0 to `y_high`."""

    x_low: float
    x_high: float
    y_high: float

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Return the position in the chart, pixels, of a point with these values."""
        across = (x - self.x_low) / (self.x_high - self.x_low)
        return (
            LEFT + across * (WIDTH - LEFT - RIGHT),
            HEIGHT - BOTTOM - y / self.y_high * (HEIGHT - TOP - BOTTOM),
        )


@dataclass(frozen=True)
class Series:
    """One method in a chart; positions are in pixels of the chart.

    Attributes:
        index: the method's index in the legend.
        words: a sentence that describes the data, for readers who cannot see the chart.
        points: SVG path of its points, or "".
        line: SVG path of its line, or "".
        dot: position of a marked point; None if there is none.
    """

    index: int
    words: str
    points: str = ""
    line: str = ""
    dot: tuple[float, float] | None = None


@dataclass(frozen=True)
class Chart:
    """A chart: its heading and its SVG."""

    title: str
    svg: Markup


def _chart(
    title: str, label: str, x_name: str, axes: Axes, series: Sequence[Series], y_name: str = "IoU"
) -> Chart:
    content = {
        "label": f"{label}, {title}: {len(series)} methods. " + " ".join(each.words for each in series),
        "x_name": x_name,
        "y_name": y_name,
        "axes": axes,
        "size": (WIDTH, HEIGHT),
        "top": TOP,
        "x_ticks": _ticks(axes.x_low, axes.x_high),
        "y_ticks": _ticks(0, axes.y_high),
        "series": series,
        "series_class": series_class,
    }
    return Chart(title, Markup(render_page("report/chart.svg", content)))


def _ticks(low: float, high: float) -> list[float]:
    """Return three to six values at which an axis from `low` to `high` gets ticks."""
    step = next((s for s in TICKS if (high - low) / s <= 5), TICKS[-1])
    first = int(np.ceil(round(low / step, 6)))
    return [k * step for k in range(first, int(np.floor(round(high / step, 6))) + 1)]


def series_class(index: int) -> str:
    """Return the CSS class of a method, given its index in the legend."""
    return f"s{index % COLORS}" + (f" dash{index // COLORS % 3}" if index >= COLORS else "")


def threshold_charts(tables: Sequence[ScoreTable], protocol: str) -> tuple[Chart, ...]:
    """Draw IoU against threshold in a chart for each category; a dot marks the threshold used for scores.

    There is no dot if the threshold used is none of `THRESHOLDS`.
    """
    curves = [_curves_of(table, protocol) for table in tables]
    categories = sorted({category for of in curves for category in of})
    charts = []
    for category in categories:
        top = nice_top(max(max(of[category]) for of in curves if category in of))
        axes, series = Axes(THRESHOLDS[0], THRESHOLDS[-1], top), []
        for index, (table, of) in enumerate(zip(tables, curves, strict=True)):
            if category in of:
                points = [axes.at(*point) for point in zip(THRESHOLDS, of[category], strict=True)]
                used = table.thresholds.get(category)
                dot = points[THRESHOLDS.index(used)] if used in THRESHOLDS else None
                words = _curve_words(table.method, of[category], used)
                series.append(Series(index, words, line=svg_path(points), dot=dot))
        charts.append(_chart(category, "IoU against the threshold", "threshold", axes, series))
    return tuple(charts)


def _curves_of(table: ScoreTable, protocol: str) -> dict[str, list[float]]:
    """Return {category: IoU at each of `THRESHOLDS`}; curves with another number of values are left out."""
    curves = (table.iou_by_threshold or {}).get(protocol, {})
    return {category: curve for category, curve in curves.items() if len(curve) == len(THRESHOLDS)}


def visible_shares(table: ScoreTable) -> dict[str, float]:
    """Return {pair: share of the shape's known voxels that the input view saw}.

    It is 1 - a / b, where a and b are `coverage_shape` in the pair's scores under the protocols `occluded`
    and `known`. Pairs without both are left out.
    """
    known = {row.pair: row.coverage_shape for row in table.pairs("known")}
    shares = {}
    for row in table.pairs("occluded"):
        whole = known.get(row.pair)
        if whole and row.coverage_shape is not None:
            shares[row.pair] = min(max(1 - row.coverage_shape / whole, 0.0), 1.0)
    return shares


def visible_charts(tables: Sequence[ScoreTable], protocol: str) -> tuple[Chart, ...]:
    """Draw pairs' IoU against their `visible_shares` in a chart for each category.

    At most `MOST_DOTS` pairs of a method are drawn, evenly spread. Pairs with unknown IoU or visible share
    are left out, and so are categories without a pair.
    """
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
            series = [
                _scatter(axes, index, of, tables[index].method)
                for index, of in enumerate(by_method)
                if len(of)
            ]
            label = "IoU of each pair against the share of the shape seen"
            charts.append(_chart(category, label, "share of the shape that the view saw", axes, series))
    return tuple(charts)


def calibration_charts(tables: Sequence[ScoreTable], protocol: str) -> tuple[Chart, ...]:
    """Draw one reliability diagram of all methods with several hypotheses per view, if there are any.

    Cells are binned by the share of hypotheses in which they are solid; y is the share of a bin's cells that
    are solid in the truth.

    Args:
        tables: the methods' scores.
        protocol: the protocol, or the heading of one of its variants, such as `aligned-t+s`.
    """
    axes, series = Axes(0.0, 1.0, 1.0), []
    for index, table in enumerate(tables):
        # The rows of the mean over several predictions, such as aligned-t+s-mean-of-5, have the calibration.
        rows = (row for row in table.rows if row.heading.startswith(f"{protocol}-mean-of-"))
        found = [row.calibration for row in rows if row.calibration is not None]
        points = []
        for tenth in range(len(found[0].cells) if found else 0):
            of = [(one.cells[tenth], one.said[tenth] or 0.0, one.true[tenth] or 0.0) for one in found]
            if count := sum(n for n, _, _ in of):
                points.append((sum(n * s for n, s, _ in of) / count, sum(n * t for n, _, t in of) / count))
        if points:
            error = float(np.mean([one.error for one in found]))
            words = f"{table.method}: expected calibration error {shown_figure(error)}."
            dots = [axes.at(*point) for point in points]
            marks = "".join("M{:.1f},{:.1f}h0".format(*dot) for dot in dots)
            series.append(Series(index, words, marks, svg_path(dots)))
    names = "share of a view's predictions that are solid", "share of cells that are solid in the truth"
    return (_chart("all categories", "Calibration", names[0], axes, series, names[1]),) if series else ()


def _points(rows: Sequence[ScoreRow], shares: Mapping[str, float]) -> Float64:
    """Return (n, 2): visible share and IoU of each pair that has both, sorted by visible share."""
    points = sorted((shares[row.pair], row.iou) for row in rows if row.pair in shares and row.iou is not None)
    return np.array(points, np.float64).reshape(-1, 2)


def _curve_words(method: str, curve: Sequence[float], used: float | None) -> str:
    """Return a sentence on an IoU curve: its IoU at the threshold used, and its best IoU."""
    best = max(range(len(curve)), key=lambda step: curve[step])
    at = (
        f"{shown_figure(curve[THRESHOLDS.index(used)])} at the threshold used, {used:g}, "
        if used in THRESHOLDS
        else ""
    )
    return f"{method}: IoU {at}at best {shown_figure(curve[best])} at {THRESHOLDS[best]:g}."


def _scatter_words(method: str, points: Float64) -> str:
    """Return a sentence on a method's points (n, 2): their number, range of shares, and IoU."""
    (low, worst), (high, best) = points.min(axis=0), points.max(axis=0)
    return (
        f"{method}: {len(points)} pairs, {shown_figure(low)} to {shown_figure(high)} of the shape seen, "
        f"IoU {shown_figure(worst)} to {shown_figure(best)}, mean {shown_figure(float(points[:, 1].mean()))}."
    )


def _scatter(axes: Axes, index: int, points: Float64, method: str) -> Series:
    """Draw points (n, 2), at most `MOST_DOTS` of them, and a line through the means of equal groups."""
    drawn = spread(points.tolist(), MOST_DOTS)
    dots = "".join("M{:.1f},{:.1f}h0".format(*axes.at(*point)) for point in drawn)
    groups = np.array_split(points, min(MAX_GROUPS, max(1, len(points) // GROUP_PAIRS)))
    means = [axes.at(*group.mean(axis=0).tolist()) for group in groups]
    return Series(index, _scatter_words(method, points), dots, svg_path(means) if len(means) > 1 else "")
