"""The camera's path seen from above, as a small inline SVG drawn by hand."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kinectbench.core.types import Float64

WIDTH_PX = 460.0
MAX_HEIGHT_PX = 420.0
MARGIN_PX = 30.0
LEGEND_PX = 34.0
MAX_PIECES = 48
MAX_TICKS = 60
TICK_PX = 13.0
BAR_LENGTHS_M = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
# Start to end of the recording: blue, violet, magenta, orange; legible on a light and a dark page.
TIME_COLORS = np.array([(47, 107, 196), (124, 88, 190), (196, 78, 142), (232, 140, 46)], np.float64)


@dataclass(frozen=True)
class PlanView:
    """What is drawn, in frame `floor` (z up; the plan shows x to the right and y up, metres).

    Attributes:
        T_floor_camera: (n, 4, 4) the cameras in order of time, n > 0.
        left_out_floor: (k, 3) where the cameras of frames left out are believed to be.
        outlines_floor: closed polygons (m, 2) of the object.
    """

    T_floor_camera: Float64
    left_out_floor: Float64
    outlines_floor: Sequence[Float64]


@dataclass(frozen=True)
class _Paper:
    """Maps metres to the drawing's pixels: y turned over, so that the plan is seen from above."""

    low_m: Float64
    high_m: Float64
    px_per_m: float

    @property
    def height_px(self) -> float:
        return float((self.high_m - self.low_m)[1] * self.px_per_m) + 2 * MARGIN_PX

    def place(self, points_m: Float64) -> Float64:
        across = (WIDTH_PX - float((self.high_m - self.low_m)[0]) * self.px_per_m) / 2
        x = (points_m[..., 0] - self.low_m[0]) * self.px_per_m + across
        y = (self.high_m[1] - points_m[..., 1]) * self.px_per_m + MARGIN_PX
        return np.stack([x, y], axis=-1)


def _paper(view: PlanView) -> _Paper:
    everything = [view.T_floor_camera[:, :2, 3], view.left_out_floor[:, :2], *view.outlines_floor]
    points = np.concatenate([p for p in everything if len(p)])
    low, high = points.min(axis=0), points.max(axis=0)
    # Something that stands still is drawn too: never less than 0.2 m across.
    grow = np.maximum(0.2 - (high - low), 0) / 2
    low, high = low - grow, high + grow
    size = high - low
    px_per_m = min((WIDTH_PX - 2 * MARGIN_PX) / size[0], (MAX_HEIGHT_PX - 2 * MARGIN_PX) / size[1])
    return _Paper(low, high, float(px_per_m))


def time_color(fraction: float) -> str:
    """Colour of a moment of the recording: 0 is its start, 1 its end; as #rrggbb."""
    position = min(max(fraction, 0.0), 1.0) * (len(TIME_COLORS) - 1)
    channels = [np.interp(position, np.arange(len(TIME_COLORS)), TIME_COLORS[:, c]) for c in range(3)]
    return "#" + "".join(f"{round(float(c)):02x}" for c in channels)


def _path(points_px: Float64, closed: bool = False) -> str:
    return "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in points_px) + ("Z" if closed else "")


def _line(a: Float64, b: Float64, style: str) -> str:
    return f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" {style}/>'


def _track(positions_px: Float64) -> list[str]:
    """The path in pieces, each of one colour."""
    last = len(positions_px) - 1
    cuts = np.unique(np.linspace(0, last, min(last, MAX_PIECES) + 1).astype(int))
    return [
        f'<path d="{_path(positions_px[a : b + 1])}" stroke="{time_color((a + b) / 2 / last)}" class="path"/>'
        for a, b in pairwise(cuts.tolist())
    ]


def _ticks(T_floor_camera: Float64, positions_px: Float64) -> list[str]:
    """Where the cameras look; a camera that looks straight down has a short tick."""
    last = max(len(positions_px) - 1, 1)
    chosen = np.unique(np.linspace(0, len(positions_px) - 1, MAX_TICKS).astype(int))
    forward = T_floor_camera[:, :2, 2] * np.array([1, -1]) * TICK_PX
    return [
        _line(positions_px[i], positions_px[i] + forward[i], f'stroke="{time_color(i / last)}" class="tick"')
        for i in chosen
    ]


def _crosses(points_px: Float64) -> list[str]:
    return [
        f'<path d="M{x - 4:.1f},{y - 4:.1f}l8,8m0,-8l-8,8" class="left-out"/>' for x, y in points_px.tolist()
    ]


def _legend(paper: _Paper, n_left_out: int) -> list[str]:
    y = paper.height_px + LEGEND_PX / 2
    length_m = max((b for b in BAR_LENGTHS_M if b * paper.px_per_m <= 130), default=BAR_LENGTHS_M[0])
    end = MARGIN_PX + length_m * paper.px_per_m
    bar_x = WIDTH_PX - 165
    time_bar = [
        f'<rect x="{bar_x + 6 * i:.0f}" y="{y - 4:.1f}" width="6.5" height="8" fill="{time_color(i / 14)}"/>'
        for i in range(15)
    ]
    parts = [
        f'<path d="M{MARGIN_PX:.1f},{y - 4:.1f}v8m0,-4H{end:.1f}m0,-4v8" class="bar"/>',
        f'<text x="{end + 7:.1f}" y="{y + 4:.1f}">{length_m:g} m</text>',
        *time_bar,
        f'<text x="{bar_x - 6:.0f}" y="{y + 4:.1f}" text-anchor="end">start</text>',
        f'<text x="{bar_x + 97:.0f}" y="{y + 4:.1f}">end</text>',
    ]
    if n_left_out:
        center = np.array([[WIDTH_PX / 2 - 60, y]])
        parts += [*_crosses(center), f'<text x="{center[0, 0] + 9:.0f}" y="{y + 4:.1f}">left out</text>']
    return parts


def draw_plan(view: PlanView) -> str:
    """Draw the plan as an SVG element.

    The path is coloured by time, ticks show where the cameras look, crosses are frames left out, the
    closed shape is the object, and the bar gives the scale. The text holds nothing but numbers made
    here, so it needs no escaping.
    """
    paper = _paper(view)
    positions_px = paper.place(view.T_floor_camera[:, :2, 3])
    start = positions_px[0]
    parts = [
        *(f'<path d="{_path(paper.place(o), closed=True)}" class="object"/>' for o in view.outlines_floor),
        *_ticks(view.T_floor_camera, positions_px),
        *_track(positions_px),
        *_crosses(paper.place(view.left_out_floor)),
        f'<circle cx="{start[0]:.1f}" cy="{start[1]:.1f}" r="4" fill="{time_color(0)}"/>',
        *_legend(paper, len(view.left_out_floor)),
    ]
    height = paper.height_px + LEGEND_PX
    head = f'<svg class="plan" viewBox="0 0 {WIDTH_PX:.0f} {height:.0f}" role="img"'
    return f'{head} aria-label="camera path seen from above">{"".join(parts)}</svg>'
