"""Wide seats: benches and couches."""

from itertools import pairwise

import numpy as np

from kinectbench.simulate.joinery import CLOTHS, WOODS, board, four_legs, pick
from kinectbench.simulate.solid import Part


def bench(rng: np.random.Generator) -> list[Part]:
    """Draw a bench on four legs or two panels, perhaps with a railed back; its front faces +y."""
    x, y = float(rng.uniform(0.5, 0.65)), float(rng.uniform(0.16, 0.2))
    seat, thick, wood = float(rng.uniform(0.42, 0.48)), float(rng.uniform(0.03, 0.05)), pick(rng, WOODS)
    parts = [board("seat", (-x, -y, seat - thick), (x, y, seat), wood)]
    under = seat - thick / 2
    if rng.random() < 0.5:
        parts += four_legs(rng, (x - 0.06, y - 0.04), under, float(rng.uniform(0.04, 0.06)), wood)
    else:
        for side in (-1, 1):
            at = side * (x - 0.1)
            parts.append(board("panel", (at - 0.025, -y + 0.02, 0.0), (at + 0.025, y - 0.02, under), wood))
    if rng.random() < 0.5:
        return parts
    top = seat + float(rng.uniform(0.3, 0.4))
    for at in (-x + 0.05, 0.0, x - 0.05):
        parts.append(board("upright", (at - 0.025, -y, under), (at + 0.025, -y + 0.03, top), wood))
    for z in (top - 0.09, top - 0.24):
        parts.append(board("rail", (-x, -y, z), (x, -y + 0.03, z + 0.09), wood))
    return parts


def couch(rng: np.random.Generator) -> list[Part]:
    """Draw a couch of one or two cushions on short feet; its front faces +y."""
    count = int(rng.integers(1, 3))
    x, y = 0.3 * count + float(rng.uniform(0.08, 0.16)), float(rng.uniform(0.36, 0.42))
    foot, base = float(rng.uniform(0.06, 0.12)), float(rng.uniform(0.27, 0.32))
    cushion, arm = float(rng.uniform(0.09, 0.14)), float(rng.uniform(0.10, 0.16))
    cloth, wood = pick(rng, CLOTHS), pick(rng, WOODS)
    deep, top = float(rng.uniform(0.16, 0.22)), base + float(rng.uniform(0.42, 0.5))
    low_arm = base + float(rng.uniform(0.2, 0.28))
    parts = [
        board("base", (-x, -y, foot), (x, y, base), cloth),
        board("back", (-x, -y, base - 0.02), (x, -y + deep, top), cloth, lean_m=0.06),
    ]
    for side in (-1, 1):
        at = side * (x - arm / 2)
        parts.append(board("arm", (at - arm / 2, -y + 0.02, foot), (at + arm / 2, y, low_arm), cloth))
    edges = np.linspace(-x + arm, x - arm, count + 1)
    for left, right in pairwise(edges.tolist()):
        corner = (left + 0.005, -y + deep - 0.03, base - 0.01)
        parts.append(board("cushion", corner, (right - 0.005, y - 0.01, base + cushion), cloth, "rounded"))
    feet = [(sx * (x - 0.06), sy * (y - 0.06)) for sx in (-1, 1) for sy in (-1, 1)]
    parts += [
        board("foot", (fx - 0.03, fy - 0.03, 0.0), (fx + 0.03, fy + 0.03, foot), wood) for fx, fy in feet
    ]
    return parts
