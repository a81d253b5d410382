"""Benches: park benches, planks on legs or panels, settles with a back, padded, steel and stone ones."""

from dataclasses import dataclass

import numpy as np

from kinectbench.lab.simulate.objects import backs, bases, looks
from kinectbench.lab.simulate.objects.backs import Back
from kinectbench.lab.simulate.objects.joinery import SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Points,
    bent,
    box,
    cushion,
    leg,
    plate,
    rectangle,
    ribbon,
    rounded_path,
)

BACKS = ("ladder", "slats", "spindles", "cross", "panel")


@dataclass(frozen=True)
class _Size:
    """Half length along x, half depth along y, and height of the seat's upper face; metres."""

    x: float
    y: float
    seat: float


def bench(draw: Draw) -> Parts:
    """Draw a bench whose front faces +y."""
    size = _Size(x=draw.between(0.47, 0.88), y=draw.between(0.17, 0.22), seat=draw.between(0.41, 0.47))
    kinds = [_park, _park, _park, _plank, _plank, _settle, _settle, _padded, _slatted, _stone, _box]
    return draw.choose(kinds)(draw, size)


def _park(draw: Draw, size: _Size) -> Parts:
    """Draw a park bench: a slatted seat and back on two or three cast frames, perhaps with armrests."""
    iron, wood = draw.pick(looks.IRONS), draw.pick(looks.WOODS)
    slat, lean, top = draw.between(0.02, 0.035), draw.between(0.1, 0.2), size.seat + draw.between(0.33, 0.45)
    thick, y = draw.between(0.028, 0.04), size.y
    rest_m = size.seat - slat - thick / 2 + 0.006
    spread, arms = draw.between(0.0, 0.06), draw.chance(0.7)
    frame = [(y + spread, thick / 2), (y + 0.005, rest_m), (-y, rest_m), (-y - lean, top - 0.02)]
    paths = [rounded_path(frame, 0.05), rounded_path([(-y + 0.02, rest_m), (-y - 0.1, thick / 2)], 0.05)]
    slope = lean / (top - 0.02 - rest_m)
    if arms:
        z = size.seat + draw.between(0.18, 0.24)
        arm = [(y - 0.02, rest_m), (y + 0.02, z), (-y - slope * (z - rest_m) - 0.01, z + 0.01)]
        paths.append(rounded_path(arm, draw.between(0.05, 0.12)))
    count = 3 if size.x > 0.75 and draw.chance(0.7) else 2
    for x in np.linspace(-size.x + 0.12, size.x - 0.12, count).tolist():
        for path in paths:
            yield Part("frame", ribbon(path, (x - 0.022, x + 0.022), thick), iron)
    ahead = thick / 2 + slat / 2 - 0.006
    yield from _slats(draw, size, slat, wood)
    yield from _back_slats(draw, size, slat, (slope, rest_m, top, ahead), wood)


def _slats(draw: Draw, size: _Size, thick: float, look: Look) -> Parts:
    """Draw the seat's boards, each as long as the bench."""
    count = draw.integer(3, 8)
    edges = np.linspace(-size.y + 0.015, size.y + 0.015, count + 1)
    wide = float(edges[1] - edges[0])
    gap = min(max(0.012, 0.15 * wide), wide - 0.03)
    for at in edges[:-1].tolist():
        low, high = (-size.x, at + gap / 2, size.seat - thick), (size.x, at + wide - gap / 2, size.seat)
        yield Part("slat", box(low, high), look)


def _back_slats(
    draw: Draw, size: _Size, thick: float, back: tuple[float, float, float, float], look: Look
) -> Parts:
    """Draw the back's boards in front of its leaning frame.

    `back` is (slope of the frame, height at which it starts to lean, height of the back's top, distance of
    the boards in front of the frame).
    """
    slope, rest, top, ahead = back
    count, low = draw.integer(2, 6), size.seat + draw.between(0.07, 0.14)
    step = (top - low) / count
    high = max(0.03, step - draw.between(0.012, 0.04))
    tilt = float(np.degrees(np.arctan(slope)))
    for k in range(count):
        z = low + (k + 0.5) * step
        board = box((-size.x, -thick / 2, -high / 2), (size.x, thick / 2, high / 2)).rotate((tilt, 0.0, 0.0))
        y = -size.y - slope * (z - rest) + ahead
        yield Part("back slat", board.translate((0.0, y, z)), look)


def _base(draw: Draw, size: _Size, head: float, wood: Look) -> Parts:
    """Draw the base of a wooden bench, up to the height `head`: legs, panels, crossed legs or trestles."""
    half = (size.x - draw.between(0.05, 0.16), size.y - 0.04)
    kind = draw.choose(["legs", "legs", "panels", "crossed", "trestle"])
    if kind == "legs":
        count = 6 if size.x > 0.65 and draw.chance(0.6) else 4
        yield from bases.wooden_legs(draw, half, head, draw.between(0.038, 0.06), wood, count)
        if draw.chance(0.5):
            yield from bases.apron(half, head - 0.004, 0.06, wood)
    elif kind == "panels":
        yield from bases.panels((half[0], size.y - 0.015), head, draw.between(0.03, 0.06), wood)
        z = head * draw.between(0.3, 0.75)
        yield Part("stretcher", box((-half[0], -0.014, z - 0.05), (half[0], 0.014, z + 0.05)), wood)
    elif kind == "crossed":
        yield from bases.crossed_legs((half[0] - 0.05, size.y - 0.02), head, 0.045, wood)
    else:
        yield from bases.trestle(draw, (half[0] - 0.05, size.y - 0.01), head, wood)


def _plank(draw: Draw, size: _Size) -> Parts:
    """Draw a backless bench: one board, straight or bent to an arc, or two boards side by side."""
    wood, thick = draw.pick(looks.WOODS), draw.between(0.025, 0.05)
    under, kind = size.seat - thick, draw.choose(["one", "one", "two", "rounded", "curved"])
    full = (2 * size.x, 2 * size.y)
    if kind == "two":
        yield Part("seat", box((-size.x, -size.y, under), (size.x, -0.008, size.seat)), wood)
        yield Part("seat", box((-size.x, 0.008, under), (size.x, size.y, size.seat)), wood)
        for x in (-0.6 * size.x, 0.0, 0.6 * size.x):
            low, high = (x - 0.03, -size.y + 0.03, under - 0.02), (x + 0.03, size.y - 0.03, under + 0.008)
            yield Part("batten", box(low, high), wood)
    elif kind == "rounded":
        yield Part("seat", plate(rectangle(full, 0.9 * size.y), under, size.seat, 0.3 * thick), wood)
    elif kind == "curved":
        yield from _curved(draw, size, thick, wood)
        return
    else:
        yield Part("seat", plate(rectangle(full), under, size.seat, 0.004), wood)
    yield from _base(draw, size, under + 0.012, wood)


def _curved(draw: Draw, size: _Size, thick: float, wood: Look) -> Parts:
    """Draw a bench whose seat is an arc as seen from above, on three pairs of legs."""
    bow, under = draw.between(0.08, 0.2), size.seat - thick

    def arc(points: Points) -> Points:
        back = bow * (points[:, 0] / size.x) ** 2
        return points + np.column_stack([np.zeros(len(points)), back, np.zeros(len(points))])

    yield Part("seat", bent(box((-size.x, -size.y, under), (size.x, size.y, size.seat)), arc), wood)
    for x in (-0.8 * size.x, 0.0, 0.8 * size.x):
        y = bow * (x / size.x) ** 2
        for s in SIDES:
            at = y + s * (size.y - 0.04)
            yield Part("leg", leg((x, at, 0.0), (x, at, under + 0.01), 0.035, 0.05), wood)


def _settle(draw: Draw, size: _Size) -> Parts:
    """Draw a wooden bench with a back between posts, and perhaps armrests."""
    wood, thick, post = draw.pick(looks.WOODS), draw.between(0.022, 0.035), draw.between(0.038, 0.05)
    under, x, y = size.seat - thick, size.x - post / 2, size.y - post / 2
    yield Part("seat", box((-size.x, -size.y, under), (size.x, size.y, size.seat)), wood)
    columns = [-x, 0.0, x] if size.x > 0.6 else [-x, x]
    for at in columns:
        for row in (-y, y):
            yield Part("leg", leg((at, row, 0.0), (at, row, size.seat - 0.004), post, post), wood)
    slope, top = draw.between(0.05, 0.2), size.seat + draw.between(0.35, 0.5)
    back = Back(x, -y, size.seat, top, slope, 0.0, post, wood)
    yield from back.posts()
    yield from backs.filling(draw, back, BACKS)
    if len(columns) == 3:
        yield back.upright("post", 0.0, size.seat - 0.012, top - 0.004, post, 0.03)
    yield from bases.apron((x, y), under + 0.005, draw.between(0.05, 0.08), wood)
    if draw.chance(0.7):
        z = size.seat + draw.between(0.18, 0.24)
        for s in SIDES:
            rear = back.point(x, z)[1]
            arm = plate(rectangle((0.07, y + 0.03 - rear), 0.02), z - 0.024, z, 0.006)
            arm = arm.translate((s * x, (y + 0.03 + rear) / 2, 0.0))
            front = leg((s * x, y, size.seat - 0.015), (s * x, y, z - 0.01), post, post * 0.8)
            yield Part("armrest", arm, wood)
            yield Part("arm post", front, wood)


def _padded(draw: Draw, size: _Size) -> Parts:
    """Draw a padded bench on wooden legs, sleds or loops, perhaps with raised ends."""
    look, wood, y = draw.pick(looks.COVERS), draw.pick(looks.WOODS), size.y + 0.02
    thick = draw.between(0.08, 0.14)
    under = size.seat - thick
    yield Part("seat", cushion((-size.x, -y, under), (size.x, y, size.seat), 0.03, 0.015), look)
    half, inner, head = (size.x - 0.06, y - 0.05), (0.75 * size.x, y - 0.05), under + 0.025
    kind = draw.choose(["legs", "loops", "sled"])
    if kind == "legs":
        yield from bases.wooden_legs(draw, half, head, draw.between(0.035, 0.05), wood)
    elif kind == "loops":
        yield from bases.square_loops(inner, head, draw.between(0.022, 0.035), draw.pick(looks.METALS))
    else:
        yield from bases.sled(inner, head, draw.between(0.01, 0.013), draw.pick(looks.METALS))
    if draw.chance(0.3):
        rise = size.seat + draw.between(0.1, 0.2)
        for s in SIDES:
            low, high = sorted([s * (size.x - 0.02), s * (size.x + 0.06)])
            yield Part("end", cushion((low, -y, under + 0.01), (high, y, rise), 0.03), look)


def _slatted(draw: Draw, size: _Size) -> Parts:
    """Draw a backless bench: a slatted seat on steel loops."""
    wood, steel, thick = draw.pick(looks.WOODS), draw.pick(looks.METALS), draw.between(0.022, 0.035)
    yield from _slats(draw, size, thick, wood)
    x, bar = size.x * draw.between(0.7, 0.9), draw.between(0.03, 0.05)
    yield from bases.square_loops((x, size.y + 0.012), size.seat - thick + 0.006, bar, steel)
    beam = box((-x, -0.02, size.seat - thick - 0.03), (x, 0.02, size.seat - thick - 0.002))
    yield Part("beam", beam, steel)


def _stone(draw: Draw, size: _Size) -> Parts:
    """Draw a stone bench: a thick slab on two or three blocks."""
    stone, thick = draw.pick(looks.STONES), draw.between(0.07, 0.12)
    look = stone if draw.chance(0.5) else draw.pick(looks.WOODS)
    under, y = size.seat - thick, size.y + 0.02
    slab = plate(rectangle((2 * size.x, 2 * y), 0.03), under, size.seat, 0.01)
    yield Part("slab", slab, look)
    wide, x, slim = draw.between(0.06, 0.13), size.x - draw.between(0.15, 0.25), draw.between(0.6, 1.0)
    for at in (-x, 0.0, x) if size.x > 0.7 and draw.chance(0.5) else (-x, x):
        shape = leg((at, 0.0, 0.0), (at, 0.0, under + 0.02), (2 * wide, 1.8 * y), (2 * wide * slim, 1.6 * y))
        yield Part("block", shape, stone)


def _box(draw: Draw, size: _Size) -> Parts:
    """Draw a hall bench: open shelves or a closed chest under the seat, perhaps a cushion or a back."""
    wood, thick, y = draw.pick(looks.WOODS), draw.between(0.02, 0.03), size.y + 0.01
    under = size.seat - thick
    yield Part("seat", box((-size.x, -y, under), (size.x, y, size.seat)), wood)
    half = (size.x - 0.03, y - 0.012)
    yield from bases.panels(half, under + 0.01, 0.024, wood)
    if draw.chance(0.5):
        bays = draw.integer(1, 4)
        for x in np.linspace(-half[0], half[0], bays + 1)[1:-1].tolist():
            yield Part("partition", box((x - 0.01, -half[1], 0.07), (x + 0.01, half[1], under + 0.01)), wood)
        for z in (0.07, draw.between(0.2, 0.25)):
            yield Part("shelf", box((-half[0], -half[1], z), (half[0], half[1], z + 0.018)), wood)
    else:
        chest = box((-half[0], -half[1] + 0.004, 0.06), (half[0], half[1] - 0.004, under + 0.01))
        yield Part("chest", chest, wood if draw.chance(0.5) else draw.pick(looks.WOODS))
    if draw.chance(0.6):
        pad = cushion(
            (-size.x + 0.01, -y + 0.01, size.seat - 0.006), (size.x - 0.01, y, size.seat + 0.045), 0.02
        )
        yield Part("cushion", pad, draw.pick(looks.CLOTHS))
    if draw.chance(0.35):
        back = box((-size.x, -y, size.seat - 0.01), (size.x, -y + 0.024, size.seat + draw.between(0.35, 0.5)))
        yield Part("back", back, wood)
