"""The camera's path seen from above, as a small inline SVG."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from kinectbench.core.pages import render_page
from kinectbench.core.types import Float64

WIDTH_PX = 460
MAX_HEIGHT_PX = 420
MARGIN_PX = 30
LEGEND_PX = 34
TIME_BAR_X_PX = WIDTH_PX - 165
MAX_PIECES = 48
MAX_TICKS = 60
TICK_PX = 13.0
MAX_BAR_PX = 130
BAR_LENGTHS_M = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
# Start to end of the recording: blue, violet, magenta, orange; legible on a light and a dark page.
TIME_COLORS = np.array([(47, 107, 196), (124, 88, 190), (196, 78, 142), (232, 140, 46)], np.float64)


def time_color(fraction: float) -> str:
    """Colour of a moment of the recording: 0 is its start, 1 its end; as #rrggbb."""
    position = min(max(fraction, 0.0), 1.0) * (len(TIME_COLORS) - 1)
    channels = [np.interp(position, np.arange(len(TIME_COLORS)), TIME_COLORS[:, c]) for c in range(3)]
    return "#" + "".join(f"{round(float(c)):02x}" for c in channels)


def svg_path(points_px: Iterable[Sequence[float]]) -> str:
    """The `d` of a line through points."""
    return "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in points_px)


def draw_plan(T_floor_camera: Float64, left_out_floor: Float64, outlines_floor: Sequence[Float64]) -> Markup:
    """Draw the plan as an SVG element, in frame `floor`: x to the right and y up, to scale.

    The path is coloured by time, ticks show where the cameras look (short if straight down), crosses are
    frames left out, the closed shape is the object, and the bar gives the scale.

    Args:
        T_floor_camera: (n, 4, 4) the cameras in order of time, n > 0.
        left_out_floor: (k, 3) where the cameras of frames left out are believed to be.
        outlines_floor: closed polygons (m, 2) of the object.
    """
    points_m = np.concatenate([T_floor_camera[:, :2, 3], left_out_floor[:, :2], *outlines_floor])
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    # Something that stands still is drawn too: never less than 0.2 m across.
    grow_m = np.maximum(0.2 - (high_m - low_m), 0) / 2
    low_m, high_m = low_m - grow_m, high_m + grow_m
    size_m = high_m - low_m
    free_px = np.array([WIDTH_PX, MAX_HEIGHT_PX]) - 2 * MARGIN_PX
    px_per_m = float((free_px / size_m).min())
    corner_px = np.array([(WIDTH_PX - size_m[0] * px_per_m) / 2, MARGIN_PX])

    def place(points_floor: Float64) -> list[list[float]]:
        # The picture's y goes down.
        across_down_m = (points_floor[:, :2] - [low_m[0], high_m[1]]) * [1, -1]
        placed: list[list[float]] = (across_down_m * px_per_m + corner_px).tolist()
        return placed

    path = place(T_floor_camera[:, :3, 3])
    last = len(path) - 1
    # Pieces of one colour each, and a tick now and then.
    cuts = np.unique(np.linspace(0, last, min(last, MAX_PIECES) + 1).astype(int)).tolist()
    chosen = np.unique(np.linspace(0, last, MAX_TICKS).astype(int)).tolist()
    ahead_px = (T_floor_camera[:, :2, 2] * [1, -1] * TICK_PX).tolist()
    bar_m = max((b for b in BAR_LENGTHS_M if b * px_per_m <= MAX_BAR_PX), default=BAR_LENGTHS_M[0])
    height_px = size_m[1] * px_per_m + 2 * MARGIN_PX + LEGEND_PX
    content = {
        "width": WIDTH_PX,
        "height": height_px,
        "margin": MARGIN_PX,
        "svg_path": svg_path,
        "time_color": time_color,
        "outlines": [place(outline) for outline in outlines_floor],
        "ticks": [(path[i], ahead_px[i], time_color(i / max(last, 1))) for i in chosen],
        "pieces": [(path[a : b + 1], time_color((a + b) / 2 / last)) for a, b in pairwise(cuts)],
        "left_out": place(left_out_floor),
        "start": path[0],
        "bar_m": bar_m,
        "bar_end": MARGIN_PX + bar_m * px_per_m,
        "time_x": TIME_BAR_X_PX,
        "legend_y": height_px - LEGEND_PX / 2,
    }
    # Only numbers of our own making go into the drawing: it is safe as it is.
    return Markup(render_page("report/plan.svg", content))
