"""Tables: dining, coffee and side tables and desks on legs, columns, trestles, frames and panels."""

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from kinectbench.lab.simulate.objects import bases, looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import box, ellipse, leg, plate, rectangle, rod


@dataclass(frozen=True)
class _Size:
    """Half length along x, half width along y, and height of the top's upper face; metres."""

    x: float
    y: float
    top: float


def table(draw: Draw) -> Parts:
    """Draw a table; its longer side is along x."""
    if draw.chance(0.6):
        y = draw.between(0.32, 0.45)
        size = _Size(x=draw.between(max(0.4, y), 0.9), y=y, top=draw.between(0.70, 0.78))
    else:
        y = draw.between(0.24, 0.36)
        size = _Size(x=draw.between(max(0.28, y), 0.65), y=y, top=draw.between(0.38, 0.6))
    kinds = [_wooden, _wooden, _wooden, _round, _round, _round, _trestle, _trestle, _steel, _steel, _panels]
    if size.top > 0.65:
        kinds += [_drop_leaf, _desk]
    return draw.choose(kinds)(draw, size)


def _top(draw: Draw, size: _Size, look: Look, thick: float) -> Part:
    """Draw a table top: rectangular, with round corners, or oval."""
    full, edge = (2 * size.x, 2 * size.y), thick * draw.between(0.1, 0.45) if draw.chance(0.5) else 0.0
    kind = draw.choose(["rectangle", "rectangle", "rounded", "super"])
    radius = {"rectangle": 0.0, "rounded": draw.between(0.03, 0.1), "super": 0.6 * size.y}[kind]
    return Part("top", plate(rectangle(full, radius), size.top - thick, size.top, edge), look)


def _wooden(draw: Draw, size: _Size) -> Parts:
    """Draw a table with four or six wooden legs, perhaps with aprons, a shelf or a drawer."""
    wood, thick, leg_m = draw.pick(looks.WOODS), draw.between(0.018, 0.04), draw.between(0.04, 0.08)
    top_look = wood if draw.chance(0.6) else draw.pick(looks.WOODS + looks.STONES)
    inset = leg_m / 2 + draw.between(0.01, 0.06)
    if size.top < 0.65:
        leg_m *= 0.8
    radius = 0.0 if draw.chance(0.6) else draw.between(0.03, 0.08)
    under, half = size.top - thick, (size.x - inset - radius / 3, size.y - inset - radius / 3)
    outline = rectangle((2 * size.x, 2 * size.y), radius)
    yield Part("top", plate(outline, under, size.top, 0.006 if draw.chance(0.5) else 0.0), top_look)
    count = 6 if size.x > 0.75 and draw.chance(0.4) else 4
    shelf = size.top < 0.65 and draw.chance(0.45)
    yield from bases.wooden_legs(draw, half, under + thick / 2, leg_m, wood, count, upright=shelf)
    if draw.chance(0.75):
        high = draw.between(0.06, 0.11)
        yield from bases.apron(half, under + 0.006, high, wood)
        if draw.chance(0.4):
            yield from _drawer(draw, half, under + 0.006, high, wood)
    if shelf:
        z = draw.between(0.1, 0.18)
        yield Part("shelf", box((-half[0], -half[1], z), (half[0], half[1], z + 0.018)), wood)


def _drawer(draw: Draw, half: tuple[float, float], head: float, high: float, wood: Look) -> Parts:
    """Draw the front of a drawer with a knob, in the front apron.

    `half` is x and y of the legs' centres; the apron is `high` and reaches up to the height `head`.
    """
    wide, middle, face = min(0.22, 0.6 * half[0]), head - high / 2, half[1] + 0.017
    front = box((-wide, half[1], head - high + 0.008), (wide, face, head - 0.014))
    knob = rod((0.0, face - 0.008, middle), (0.0, face + 0.02, middle), 0.012)
    return [Part("drawer", front, wood), Part("knob", knob, draw.pick(looks.METALS))]


def _round(draw: Draw, size: _Size) -> Parts:
    """Draw a round or oval table on a column, a star, three or four splayed legs, or two columns."""
    look = draw.pick(looks.WOODS + looks.STONES + looks.PLASTICS[:1])
    base = draw.pick(looks.WOODS + looks.METALS)
    oval = size.x if draw.chance(0.35) else min(size.x, size.y * draw.between(1.0, 1.35))
    y = oval if oval <= 1.35 * size.y else size.y
    thick = draw.between(0.017, 0.035)
    under = size.top - thick
    edge = 0.35 * thick if draw.chance(0.5) else 0.0
    yield Part("top", plate(ellipse((2 * oval, 2 * y)), under, size.top, edge), look)
    reach, head, column = draw.between(0.6, 0.75) * y, under + 0.6 * thick, draw.between(0.06, 0.1)
    if oval > 0.68 and oval > 1.4 * y:
        foot = list(bases.column(draw, 0.6 * y, head, column, base))
        for s, part in product(SIDES, foot):
            yield Part(part.name, part.shape.translate((s * 0.5 * oval, 0.0, 0.0)), part.look)
        return
    kind = draw.choose(["column", "star", "legs"])
    if kind == "column":
        yield from bases.column(draw, reach, head, column, base)
        return
    if kind == "star":
        yield Part("hub", plate(ellipse((0.3 * y, 0.3 * y)), under - 0.02, head), base)
        yield from bases.star(draw, draw.integer(3, 6), reach * 1.1, head, column, base, wheels=False)
        return
    count, reach_low, reach_high = draw.integer(3, 5), 0.85 * y, draw.between(0.4, 0.7) * y
    yield from bases.round_legs(count, reach_low, reach_high, head, draw.between(0.032, 0.05), base)
    if draw.chance(0.4):
        # The shelf reaches to the legs' axes at its height.
        reach = reach_low + (reach_high - reach_low) * 0.38
        shelf = plate(ellipse((2 * reach, 2 * reach)), 0.38 * head - 0.009, 0.38 * head + 0.009)
        yield Part("shelf", shelf, look)


def _trestle(draw: Draw, size: _Size) -> Parts:
    """Draw a long table on two trestles or on crossed legs."""
    wood, thick = draw.pick(looks.WOODS), draw.between(0.025, 0.045)
    under = size.top - thick
    half = (size.x * draw.between(0.62, 0.8), size.y * draw.between(0.75, 0.9))
    yield _top(draw, size, wood if draw.chance(0.6) else draw.pick(looks.WOODS), thick)
    if draw.chance(0.35):
        yield from bases.crossed_legs(half, under + 0.01, 0.05, wood)
    else:
        yield from bases.trestle(draw, half, under + 0.01, wood)


def _steel(draw: Draw, size: _Size) -> Parts:
    """Draw a table with a thin top on steel: hairpin legs, square loops, or a frame of thin tubes."""
    metal, look = draw.pick(looks.METALS), draw.pick(looks.WOODS + looks.STONES + looks.PLASTICS[:2])
    thick = draw.between(0.016, 0.03)
    under, half = size.top - thick, (size.x - 0.05, size.y - 0.05)
    yield Part("top", plate(rectangle((2 * size.x, 2 * size.y)), under, size.top), look)
    kind = draw.choose(["hairpins", "loops", "frame"])
    if kind == "hairpins":
        yield from bases.hairpins(half, under + 0.008, metal)
        return
    if kind == "loops":
        bar = draw.between(0.025, 0.05)
        yield from bases.square_loops(
            (half[0] * draw.between(0.75, 0.98), half[1]), under + 0.008, bar, metal
        )
        if draw.chance(0.5):
            yield Part("beam", box((-half[0], -0.02, under - 0.03), (half[0], 0.02, under + 0.006)), metal)
        return
    bar = draw.between(0.018, 0.028)
    thin, z = bar * 0.45, under - 0.01
    for sx, sy in CORNERS:
        at = (sx * half[0], sy * half[1])
        yield Part("leg", leg((*at, 0.0), (*at, under + 0.008), bar, bar), metal)
    yield from bases.ring("rail", half, (z - thin, z + thin), thin, metal)
    if draw.chance(0.5):
        low = draw.between(0.1, 0.2)
        yield from bases.ring("rail", half, (low - thin, low + thin), thin, metal)
        yield Part("shelf", box((-half[0], -half[1], low - 0.002), (half[0], half[1], low + 0.016)), look)


def _panels(draw: Draw, size: _Size) -> Parts:
    """Draw a table on two side panels, perhaps with a panel or a shelf between them."""
    look, thick = draw.pick(looks.WOODS), draw.between(0.02, 0.05)
    under, inset = size.top - thick, 0.0 if draw.chance(0.5) else draw.between(0.04, 0.15)
    half = (size.x - inset - thick / 2, size.y - min(inset, 0.03))
    yield Part("top", box((-size.x, -size.y, under), (size.x, size.y, size.top)), look)
    yield from bases.panels(half, under + 0.01, thick, look)
    kind = draw.choose(["shelf", "drop panel", "bare"])
    if kind == "shelf" or size.top < 0.65:
        z = size.top * draw.between(0.3, 0.55)
        yield Part("shelf", box((-half[0], -half[1] + 0.01, z), (half[0], half[1] - 0.01, z + 0.018)), look)
    elif kind == "drop panel":
        z, y = size.top * draw.between(0.25, 0.6), -half[1] * draw.between(0.3, 0.9)
        yield Part("drop panel", box((-half[0], y - 0.009, z), (half[0], y + 0.009, under + 0.01)), look)


def _drop_leaf(draw: Draw, size: _Size) -> Parts:
    """Draw a drop-leaf table: a narrow top on legs, with up to two leaves that hang down at its ends."""
    wood, thick = draw.pick(looks.WOODS), draw.between(0.018, 0.026)
    x, under = min(size.x, 0.55), size.top - thick
    yield Part("top", box((-x, -size.y, under), (x, size.y, size.top)), wood)
    fall = size.top * draw.between(0.35, 0.6)
    for s in SIDES:
        low, high = sorted([s * (x - 0.012), s * (x + 0.008)])
        if draw.chance(0.8):
            leaf = box((low, -size.y + 0.004, size.top - fall), (high, size.y - 0.004, size.top - 0.006))
            yield Part("leaf", leaf, wood)
    half = (x - 0.09, size.y - 0.06)
    yield from bases.wooden_legs(draw, half, under + 0.01, draw.between(0.045, 0.06), wood)
    yield from bases.apron(half, under + 0.006, draw.between(0.07, 0.1), wood)


def _desk(draw: Draw, size: _Size) -> Parts:
    """Draw a desk: a top on a chest of drawers on one side and on legs or a panel on the other."""
    look, body, thick = draw.pick(looks.WOODS), draw.pick(looks.WOODS), draw.between(0.02, 0.035)
    side, under = draw.choose(SIDES), size.top - thick
    wide, foot = min(0.42, 0.7 * size.x), draw.between(0.0, 0.06)
    yield Part("top", box((-size.x, -size.y, under), (size.x, size.y, size.top)), look)
    low, high = sorted([side * (size.x - 0.02), side * (size.x - 0.02 - wide)])
    face = size.y - 0.02
    yield Part("chest", box((low, -size.y + 0.02, foot), (high, face - 0.015, under + 0.01)), body)
    count = draw.integer(2, 5)
    edges = np.linspace(foot + 0.01, under - 0.01, count + 1)
    knobs = draw.pick(looks.METALS)
    for a, b in pairwise(edges.tolist()):
        yield Part(
            "drawer", box((low + 0.008, face - 0.03, a + 0.004), (high - 0.008, face, b - 0.004)), body
        )
        z, x = (a + b) / 2, (low + high) / 2
        handle = box((x - 0.05, face - 0.005, z - 0.008), (x + 0.05, face + 0.016, z + 0.008))
        yield Part("handle", handle, knobs)
    if foot > 0:
        for x, s in product((low + 0.04, high - 0.04), SIDES):
            at = (x, s * (size.y - 0.06))
            yield Part("foot", leg((*at, 0.0), (*at, foot + 0.02), 0.03, 0.04), body)
    if draw.chance(0.5):
        low, high = sorted([-side * (size.x - 0.02), -side * (size.x - 0.045)])
        yield Part("panel", box((low, -size.y + 0.02, 0.0), (high, face, under + 0.01)), look)
        return
    for s in SIDES:
        at = (-side * (size.x - 0.05), s * (size.y - 0.05))
        yield Part("leg", leg((*at, 0.0), (*at, under + 0.01), 0.03, 0.045), body)
