"""Tables: dining, coffee and side tables and desks on legs, columns, trestles, frames and panels."""

from dataclasses import dataclass

import numpy as np

from kinectbench.simulate.objects import bases
from kinectbench.simulate.objects.joinery import (
    METALS,
    PLASTICS,
    STONES,
    WOODS,
    Look,
    Part,
    between,
    chance,
    choose,
    pick,
)
from kinectbench.simulate.objects.shapes import box, ellipse, leg, plate, rectangle, rod

SIDES = (-1, 1)


@dataclass(frozen=True)
class _Size:
    """Half length along x, half width along y, and height of the top's upper face; metres."""

    x: float
    y: float
    top: float


def table(rng: np.random.Generator) -> list[Part]:
    """Draw a table; its longer side lies along x."""
    if chance(rng, 0.6):
        y = between(rng, 0.32, 0.45)
        size = _Size(x=between(rng, max(0.4, y), 0.9), y=y, top=between(rng, 0.70, 0.78))
    else:
        y = between(rng, 0.24, 0.36)
        size = _Size(x=between(rng, max(0.28, y), 0.65), y=y, top=between(rng, 0.38, 0.6))
    kinds = [_wooden, _wooden, _wooden, _round, _round, _round, _trestle, _trestle, _steel, _steel, _panels]
    if size.top > 0.65:
        kinds += [_drop_leaf, _desk]
    return choose(rng, kinds)(rng, size)


def _top(rng: np.random.Generator, size: _Size, look: Look, thick: float) -> Part:
    """A rectangular, rounded, or oval top."""
    full, edge = (2 * size.x, 2 * size.y), thick * between(rng, 0.1, 0.45) if chance(rng, 0.5) else 0.0
    kind = choose(rng, ["rectangle", "rectangle", "rounded", "super"])
    radius = {"rectangle": 0.0, "rounded": between(rng, 0.03, 0.1), "super": 0.6 * size.y}[kind]
    return Part("top", plate(rectangle(full, radius), size.top - thick, size.top, edge), look)


def _wooden(rng: np.random.Generator, size: _Size) -> list[Part]:
    """Four or six wooden legs with aprons, and perhaps a shelf or a drawer."""
    wood, thick, leg_m = pick(rng, WOODS), between(rng, 0.018, 0.04), between(rng, 0.04, 0.08)
    top_look = wood if chance(rng, 0.6) else pick(rng, WOODS + STONES)
    inset = leg_m / 2 + between(rng, 0.01, 0.06)
    if size.top < 0.65:
        leg_m *= 0.8
    radius = 0.0 if chance(rng, 0.6) else between(rng, 0.03, 0.08)
    under, half = size.top - thick, (size.x - inset - radius / 3, size.y - inset - radius / 3)
    outline = rectangle((2 * size.x, 2 * size.y), radius)
    parts = [Part("top", plate(outline, under, size.top, 0.006 if chance(rng, 0.5) else 0.0), top_look)]
    count = 6 if size.x > 0.75 and chance(rng, 0.4) else 4
    shelf = size.top < 0.65 and chance(rng, 0.45)
    parts += bases.wooden_legs(rng, half, under + thick / 2, leg_m, wood, count, upright=shelf)
    if chance(rng, 0.75):
        high = between(rng, 0.06, 0.11)
        parts += bases.apron(half, under + 0.006, high, wood)
        if chance(rng, 0.4):
            parts += _drawer(rng, half, under + 0.006, high, wood)
    if shelf:
        z = between(rng, 0.1, 0.18)
        parts.append(Part("shelf", box((-half[0], -half[1], z), (half[0], half[1], z + 0.018)), wood))
    return parts


def _drawer(
    rng: np.random.Generator, half: tuple[float, float], head: float, high: float, wood: Look
) -> list[Part]:
    """The front of a drawer with a knob, in the front apron."""
    wide, middle, face = min(0.22, 0.6 * half[0]), head - high / 2, half[1] + 0.017
    front = box((-wide, half[1], head - high + 0.008), (wide, face, head - 0.014))
    knob = rod((0.0, face - 0.008, middle), (0.0, face + 0.02, middle), 0.012)
    return [Part("drawer", front, wood), Part("knob", knob, pick(rng, METALS))]


def _round(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A round or oval top on a column, a star, three or four splayed legs, or two columns."""
    look, base = pick(rng, WOODS + STONES + PLASTICS[:1]), pick(rng, WOODS + METALS)
    oval = size.x if chance(rng, 0.35) else min(size.x, size.y * between(rng, 1.0, 1.35))
    y = oval if oval <= 1.35 * size.y else size.y
    thick = between(rng, 0.017, 0.035)
    under = size.top - thick
    edge = 0.35 * thick if chance(rng, 0.5) else 0.0
    parts = [Part("top", plate(ellipse((2 * oval, 2 * y)), under, size.top, edge), look)]
    reach, head, column = between(rng, 0.6, 0.75) * y, under + 0.6 * thick, between(rng, 0.06, 0.1)
    if oval > 0.68 and oval > 1.4 * y:
        foot = bases.column(rng, 0.6 * y, head, column, base)
        for s in SIDES:
            parts += [
                Part(part.name, part.shape.translate((s * 0.5 * oval, 0.0, 0.0)), part.look) for part in foot
            ]
        return parts
    kind = choose(rng, ["column", "star", "legs"])
    if kind == "column":
        return parts + bases.column(rng, reach, head, column, base)
    if kind == "star":
        parts.append(Part("hub", plate(ellipse((0.3 * y, 0.3 * y)), under - 0.02, head), base))
        return parts + bases.star(rng, int(rng.integers(3, 6)), reach * 1.1, head, column, base, wheels=False)
    count, reach_low, reach_high = int(rng.integers(3, 5)), 0.85 * y, between(rng, 0.4, 0.7) * y
    parts += bases.round_legs(count, reach_low, reach_high, head, between(rng, 0.032, 0.05), base)
    if chance(rng, 0.4):
        # The shelf reaches to the legs' axes at its height.
        reach = reach_low + (reach_high - reach_low) * 0.38
        shelf = plate(ellipse((2 * reach, 2 * reach)), 0.38 * head - 0.009, 0.38 * head + 0.009)
        parts.append(Part("shelf", shelf, look))
    return parts


def _trestle(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A long top on two trestles or on crossed legs."""
    wood, thick = pick(rng, WOODS), between(rng, 0.025, 0.045)
    under = size.top - thick
    half = (size.x * between(rng, 0.62, 0.8), size.y * between(rng, 0.75, 0.9))
    parts = [_top(rng, size, wood if chance(rng, 0.6) else pick(rng, WOODS), thick)]
    if chance(rng, 0.35):
        return parts + bases.crossed_legs(half, under + 0.01, 0.05, wood)
    return parts + bases.trestle(rng, half, under + 0.01, wood)


def _steel(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A thin top on hairpins, square loops, or a frame of thin tubes."""
    metal, look = pick(rng, METALS), pick(rng, WOODS + STONES + PLASTICS[:2])
    thick = between(rng, 0.016, 0.03)
    under, half = size.top - thick, (size.x - 0.05, size.y - 0.05)
    parts = [Part("top", plate(rectangle((2 * size.x, 2 * size.y)), under, size.top), look)]
    kind = choose(rng, ["hairpins", "loops", "frame"])
    if kind == "hairpins":
        return parts + bases.hairpins(half, under + 0.008, metal)
    if kind == "loops":
        bar = between(rng, 0.025, 0.05)
        loops = bases.square_loops((half[0] * between(rng, 0.75, 0.98), half[1]), under + 0.008, bar, metal)
        beam = box((-half[0], -0.02, under - 0.03), (half[0], 0.02, under + 0.006))
        return [*parts, *loops, Part("beam", beam, metal)] if chance(rng, 0.5) else parts + loops
    bar = between(rng, 0.018, 0.028)
    for sx in SIDES:
        for sy in SIDES:
            at = (sx * half[0], sy * half[1])
            parts.append(Part("leg", leg((*at, 0.0), (*at, under + 0.008), (bar, bar), (bar, bar)), metal))
    parts += _ring(half, under - 0.01, bar, metal)
    if chance(rng, 0.5):
        low = between(rng, 0.1, 0.2)
        parts += _ring(half, low, bar, metal)
        board = box((-half[0], -half[1], low - 0.002), (half[0], half[1], low + 0.016))
        parts.append(Part("shelf", board, look))
    return parts


def _ring(half: tuple[float, float], z: float, bar: float, look: Look) -> list[Part]:
    """Four bars from leg to leg."""
    x, y, thin = *half, bar * 0.45
    rails = [box((-x, s * y - thin, z - thin), (x, s * y + thin, z + thin)) for s in SIDES]
    rails += [box((s * x - thin, -y, z - thin), (s * x + thin, y, z + thin)) for s in SIDES]
    return [Part("rail", rail, look) for rail in rails]


def _panels(rng: np.random.Generator, size: _Size) -> list[Part]:
    """Two side panels under a top, with a panel or a shelf between them."""
    look, thick = pick(rng, WOODS), between(rng, 0.02, 0.05)
    under, inset = size.top - thick, 0.0 if chance(rng, 0.5) else between(rng, 0.04, 0.15)
    half = (size.x - inset - thick / 2, size.y - min(inset, 0.03))
    parts = [Part("top", box((-size.x, -size.y, under), (size.x, size.y, size.top)), look)]
    parts += bases.panels(half, under + 0.01, thick, look)
    kind = choose(rng, ["shelf", "drop panel", "bare"])
    if kind == "shelf" or size.top < 0.65:
        z = size.top * between(rng, 0.3, 0.55)
        parts.append(
            Part("shelf", box((-half[0], -half[1] + 0.01, z), (half[0], half[1] - 0.01, z + 0.018)), look)
        )
    elif kind == "drop panel":
        z, y = size.top * between(rng, 0.25, 0.6), -half[1] * between(rng, 0.3, 0.9)
        parts.append(
            Part("drop panel", box((-half[0], y - 0.009, z), (half[0], y + 0.009, under + 0.01)), look)
        )
    return parts


def _drop_leaf(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A narrow top on legs whose two leaves hang down at its ends."""
    wood, thick = pick(rng, WOODS), between(rng, 0.018, 0.026)
    x, under = min(size.x, 0.55), size.top - thick
    parts = [Part("top", box((-x, -size.y, under), (x, size.y, size.top)), wood)]
    fall = size.top * between(rng, 0.35, 0.6)
    for s in SIDES:
        low, high = sorted([s * (x - 0.012), s * (x + 0.008)])
        if chance(rng, 0.8):
            leaf = box((low, -size.y + 0.004, size.top - fall), (high, size.y - 0.004, size.top - 0.006))
            parts.append(Part("leaf", leaf, wood))
    half = (x - 0.09, size.y - 0.06)
    parts += bases.wooden_legs(rng, half, under + 0.01, between(rng, 0.045, 0.06), wood)
    return parts + bases.apron(half, under + 0.006, between(rng, 0.07, 0.1), wood)


def _desk(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A top on a chest of drawers at one side and on legs or a panel at the other."""
    look, body, thick = pick(rng, WOODS), pick(rng, WOODS), between(rng, 0.02, 0.035)
    side, under = choose(rng, SIDES), size.top - thick
    wide, foot = min(0.42, 0.7 * size.x), between(rng, 0.0, 0.06)
    parts = [Part("top", box((-size.x, -size.y, under), (size.x, size.y, size.top)), look)]
    low, high = sorted([side * (size.x - 0.02), side * (size.x - 0.02 - wide)])
    face = size.y - 0.02
    parts.append(Part("chest", box((low, -size.y + 0.02, foot), (high, face - 0.015, under + 0.01)), body))
    count = int(rng.integers(2, 5))
    edges = np.linspace(foot + 0.01, under - 0.01, count + 1)
    knobs = pick(rng, METALS)
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        parts.append(
            Part("drawer", box((low + 0.008, face - 0.03, a + 0.004), (high - 0.008, face, b - 0.004)), body)
        )
        z, x = (a + b) / 2, (low + high) / 2
        parts.append(
            Part(
                "handle", box((x - 0.05, face - 0.005, z - 0.008), (x + 0.05, face + 0.016, z + 0.008)), knobs
            )
        )
    if foot > 0:
        foot_xy = [(x, s * (size.y - 0.06)) for x in (low + 0.04, high - 0.04) for s in SIDES]
        for at in foot_xy:
            parts.append(Part("foot", leg((*at, 0.0), (*at, foot + 0.02), (0.03, 0.03), (0.04, 0.04)), body))
    if chance(rng, 0.5):
        low, high = sorted([-side * (size.x - 0.02), -side * (size.x - 0.045)])
        parts.append(Part("panel", box((low, -size.y + 0.02, 0.0), (high, face, under + 0.01)), look))
        return parts
    for s in SIDES:
        at = (-side * (size.x - 0.05), s * (size.y - 0.05))
        parts.append(Part("leg", leg((*at, 0.0), (*at, under + 0.01), (0.03, 0.03), (0.045, 0.045)), body))
    return parts
