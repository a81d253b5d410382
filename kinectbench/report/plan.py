"""Draw the camera's path, seen from above, as a small inline SVG."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from kinectbench.core.artefacts.object import FrontierPart
from kinectbench.core.even_choice import evenly
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
# A line of sight steeper than this comes from above or below, and is drawn as a ring.
LEVEL_COSINE = 0.5
HEAD_PX = 11.0
BAR_LENGTHS_M = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
# Colours from start to end of the recording: blue, violet, magenta, orange; legible on a light and a dark
# page.
TIME_COLORS = np.array([(47, 107, 196), (124, 88, 190), (196, 78, 142), (232, 140, 46)], np.float64)


def time_color(fraction: float) -> str:
    """Return the colour, #rrggbb, for a time in the recording: 0 is its start, 1 its end."""
    position = min(max(fraction, 0.0), 1.0) * (len(TIME_COLORS) - 1)
    channels = [np.interp(position, np.arange(len(TIME_COLORS)), TIME_COLORS[:, c]) for c in range(3)]
    return "#" + "".join(f"{round(float(c)):02x}" for c in channels)


def svg_path(points_px: Iterable[Sequence[float]]) -> str:
    """Return the SVG path of a line through points."""
    return "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in points_px)


def look_arrows(T_floor_camera: Float64, frontiers: Sequence[FrontierPart]) -> list[Float64]:
    """Return an arrow to each frontier (unobserved opening) from where it should be recorded.

    An arrow is (2, 2), its tail and its tip, x and y of the floor frame, metres. The tip is the opening's
    centre, and the length is the cameras' mean distance from it. If the opening should be seen from above or
    below, both ends are its centre, and a ring is drawn.
    """
    arrows = []
    for frontier in frontiers:
        center, look = np.array(frontier.center_m[:2]), np.array(frontier.look_from[:2])
        level = float(np.hypot(*look))
        away_m = float(np.linalg.norm(T_floor_camera[:, :2, 3] - center, axis=1).mean())
        tail = center + away_m * look / level if level >= LEVEL_COSINE else center
        arrows.append(np.stack([tail, center]))
    return arrows


def draw_plan(
    T_floor_camera: Float64,
    left_out_floor: Float64,
    outlines_floor: Sequence[Float64],
    frontiers: Sequence[FrontierPart] = (),
) -> Markup:
    """Draw the plan as an SVG element: x of the floor frame to the right, y up, to scale.

    The path is coloured by time. Ticks show viewing directions (short if straight down), crosses are frames
    left out, the closed shape is the object, and the bar gives the scale. For arrows see `look_arrows`.

    Args:
        T_floor_camera: (n, 4, 4) camera poses in order of time, metres, n > 0.
        left_out_floor: (k, 3) estimated camera positions of frames left out, metres.
        outlines_floor: closed polygons (m, 2) of the object, metres.
        frontiers: unobserved openings.
    """
    arrows = look_arrows(T_floor_camera, frontiers)
    points_m = np.concatenate([T_floor_camera[:, :2, 3], left_out_floor[:, :2], *outlines_floor, *arrows])
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    # A camera that stands still is drawn, too: the plan is at least 0.2 m across.
    grow_m = np.maximum(0.2 - (high_m - low_m), 0) / 2
    low_m, high_m = low_m - grow_m, high_m + grow_m
    size_m = high_m - low_m
    free_px = np.array([WIDTH_PX, MAX_HEIGHT_PX]) - 2 * MARGIN_PX
    px_per_m = float((free_px / size_m).min())
    corner_px = np.array([(WIDTH_PX - size_m[0] * px_per_m) / 2, MARGIN_PX])

    def place(points_floor: Float64) -> list[list[float]]:
        # The picture's y points down.
        across_down_m = (points_floor[:, :2] - [low_m[0], high_m[1]]) * [1, -1]
        placed: list[list[float]] = (across_down_m * px_per_m + corner_px).tolist()
        return placed

    path = place(T_floor_camera[:, :3, 3])
    last = len(path) - 1
    # The path is cut into pieces of one colour each, with some ticks.
    cuts, chosen = (evenly(last + 1, most).tolist() for most in (MAX_PIECES + 1, MAX_TICKS))
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
        "looks": [(tail, tip, _head(tail, tip)) for tail, tip in (place(arrow) for arrow in arrows)],
        "start": path[0],
        "bar_m": bar_m,
        "bar_end": MARGIN_PX + bar_m * px_per_m,
        "time_x": TIME_BAR_X_PX,
        "legend_y": height_px - LEGEND_PX / 2,
    }
    # The drawing contains only numbers computed here, so it is safe as it is.
    return Markup(render_page("report/plan.svg", content))


def _head(tail_px: Sequence[float], tip_px: Sequence[float]) -> list[list[float]]:
    """Return the three corners of the triangle at an arrow's tip, pixels; empty if the length is 0."""
    along = np.subtract(tip_px, tail_px)
    length = float(np.hypot(*along))
    if not length:
        return []
    back = -HEAD_PX * along / length
    across = np.array([-back[1], back[0]]) * 0.45
    corners: list[list[float]] = (np.array([back * 0, back + across, back - across]) + tip_px).tolist()
    return corners
