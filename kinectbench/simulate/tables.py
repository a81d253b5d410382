"""Tables: a rectangular, rounded or round top on four legs, a pedestal or two side panels."""

import numpy as np

from kinectbench.simulate.joinery import WOODS, board, four_legs, pedestal, pick
from kinectbench.simulate.solid import Outline, Part

SHAPES: tuple[Outline, ...] = ("rectangle", "rounded", "ellipse")


def table(rng: np.random.Generator) -> list[Part]:
    """Draw a dining or a coffee table."""
    low = rng.random() < 0.3
    height = float(rng.uniform(0.40, 0.50) if low else rng.uniform(0.68, 0.76))
    length, width = float(rng.uniform(0.85, 1.25)), float(rng.uniform(0.55, 0.80))
    shape = SHAPES[int(rng.choice(3, p=[0.45, 0.25, 0.3]))]
    if shape == "ellipse":
        length = width = float(rng.uniform(0.7, 1.0))
    thick = float(rng.uniform(0.026, 0.045))
    top_color, wood = pick(rng, WOODS), pick(rng, WOODS)
    half = (length / 2, width / 2)
    low_corner = (-half[0], -half[1], height - thick)
    parts = [board("top", low_corner, (*half, height), top_color, shape)]
    under = height - thick / 2
    stand = rng.random()
    if stand < 0.3 or (shape == "ellipse" and stand < 0.6):
        reach = min(half) * float(rng.uniform(0.55, 0.75))
        return parts + pedestal(rng, reach, under, float(rng.uniform(0.07, 0.12)), wood)
    if stand > 0.85 and shape != "ellipse":
        return parts + _panels(rng, half, under, top_color)
    leg = float(rng.uniform(0.04, 0.075))
    inset = 0.38 * min(half) if shape == "ellipse" else leg / 2 + float(rng.uniform(0.01, 0.06))
    at = (half[0] - inset, half[1] - inset)
    parts += four_legs(rng, at, under, leg, wood)
    if rng.random() < 0.6:
        drop = height - thick - float(rng.uniform(0.06, 0.10))
        for side in (-1, 1):
            x, y = side * at[0], side * at[1]
            parts.append(board("apron", (x - 0.0125, -at[1], drop), (x + 0.0125, at[1], under), wood))
            parts.append(board("apron", (-at[0], y - 0.0125, drop), (at[0], y + 0.0125, under), wood))
    return parts


def _panels(
    rng: np.random.Generator,
    half_m: tuple[float, float],
    under_m: float,
    color_rgb: tuple[float, float, float],
) -> list[Part]:
    """Two upright side panels joined by a rail or a shelf."""
    x, y, thick = half_m[0] - float(rng.uniform(0.03, 0.15)), half_m[1] - 0.03, 0.032
    parts = [
        board("panel", (s * x - thick / 2, -y, 0.0), (s * x + thick / 2, y, under_m), color_rgb)
        for s in (-1, 1)
    ]
    z = under_m * float(rng.uniform(0.2, 0.45))
    deep = y - 0.02 if rng.random() < 0.5 else 0.06
    parts.append(board("shelf", (-x, -deep, z), (x, deep, z + 0.028), color_rgb))
    return parts
