"""Racks for boots, pots and clothes, open all around, and bookshelves with closed sides and a few books."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from kinectbench.lab.simulate.objects import bases, looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import Vector2, bar_between, box, leg, rod

# How far one part reaches into the next, so that the two are one solid; metres, own choice.
JOINT_M = 0.002
TIERS = ("board", "slats", "rods")


@dataclass(frozen=True)
class _Cell:
    """A compartment of a bookshelf: from the left to the right and from its shelf up to the next; metres."""

    x: Vector2
    z: Vector2


def rack(draw: Draw) -> Parts:
    """Draw an open rack; its longer side lies along x."""
    return draw.choose([_open_shelves, _open_shelves, _shoes, _clothes, _stepped])(draw)


def _tiers(
    draw: Draw, kind: str, half_m: Vector2, heights_m: Sequence[float], look: Look, tilt_deg: float = 0.0
) -> Parts:
    """What lies between four posts at some heights: boards, or slats or rods on two rails, perhaps tilted."""
    (x, y), thick = half_m, draw.between(0.015, 0.024)
    gap, placed = draw.between(0.022, 0.05), []
    if kind == "board":
        placed.append(("board", box((-x, -y, 0.0), (x, y, thick))))
    else:
        for s in SIDES:
            low, high = s * x - 0.009, s * x + 0.009
            placed.append(("rail", box((low, -y, -0.026), (high, y, 0.0))))
        wide = draw.between(0.035, 0.07) if kind == "slats" else draw.between(0.014, 0.018)
        count = max(3, round((2 * y + gap) / (wide + gap)))
        for at in np.linspace(wide / 2 - y, y - wide / 2, count).tolist():
            if kind == "slats":
                shape = box((-x, at - wide / 2, -JOINT_M), (x, at + wide / 2, thick))
                placed.append(("slat", shape))
            else:
                placed.append(("bar", rod((-x, at, -0.008), (x, at, -0.008), wide / 2)))
    for z, (name, shape) in product(heights_m, placed):
        yield Part(name, shape.rotate((tilt_deg, 0.0, 0.0)).translate((0.0, 0.0, z)), look)


def _posts(half_m: Vector2, head_m: float, thick_m: float, look: Look, *, is_round: bool) -> Parts:
    """Four upright posts at the corners."""
    for sx, sy in CORNERS:
        at = (sx * half_m[0], sy * half_m[1])
        yield Part("post", leg((*at, 0.0), (*at, head_m), thick_m, thick_m, is_round=is_round), look)


def _open_shelves(draw: Draw) -> Parts:
    """Boards or grids between four posts, perhaps with crossed bars behind, or rails at the sides."""
    half = (draw.between(0.28, 0.55), draw.between(0.13, 0.21))
    head, low = draw.between(0.7, 1.65), draw.between(0.06, 0.2)
    kind, is_round = draw.choose(TIERS), draw.chance(0.4)
    frame = draw.pick(looks.METALS if is_round else looks.WOODS + looks.METALS[:2])
    look = frame if draw.chance(0.5) else draw.pick(looks.WOODS)
    yield from _posts(half, head, draw.between(0.025, 0.04), frame, is_round=is_round)
    count = max(2, round((head - low) / draw.between(0.27, 0.45)) + 1)
    # The uppermost tier is flush with the posts, or these stand out above it.
    top = head - (0.03 if draw.chance(0.5) else draw.between(0.05, 0.12))
    heights = np.linspace(low, top, count).tolist()
    yield from _tiers(draw, kind, half, heights, look)
    (x, y), behind = half, draw.choose(["crossed", "rails", "bare"])
    if behind == "crossed":
        a, b = heights[0], heights[-1]
        for s, deep in ((1, 0.014), (-1, 0.018)):
            yield Part("brace", bar_between((-s * x, -y, a), (s * x, -y, b), deep, 0.025), frame)
    elif behind == "rails":
        for z, s in product(heights, SIDES):
            rail = min(z + draw.between(0.06, 0.09), head - 0.012)
            yield Part("side rail", rod((s * x, -y, rail), (s * x, y, rail), 0.0075), frame)


def _shoes(draw: Draw) -> Parts:
    """A low rack for shoes: slats or bars, perhaps tilted, between two panels or two pairs of posts."""
    half, count = (draw.between(0.28, 0.5), draw.between(0.12, 0.17)), draw.integer(2, 5)
    step, look = draw.between(0.15, 0.21), draw.pick(looks.WOODS + looks.METALS[:2])
    tilt, low = draw.choose([0.0, 0.0, -12.0, -18.0]), draw.between(0.08, 0.11)
    head = low + step * (count - 1) + draw.between(0.05, 0.12)
    frame, thick = look if draw.chance(0.6) else draw.pick(looks.WOODS), draw.between(0.018, 0.03)
    if draw.chance(0.3):
        yield from bases.panels((half[0], half[1] + 0.01), head, thick, frame)
    else:
        yield from _posts(half, head, max(0.024, thick), frame, is_round=False)
        for s in SIDES:
            x, y = s * half[0], half[1]
            yield Part("side rail", box((x - 0.01, -y, head - 0.03), (x + 0.01, y, head)), frame)
    yield from _tiers(draw, draw.choose(TIERS[1:]), half, [low + k * step for k in range(count)], look, tilt)


def _clothes(draw: Draw) -> Parts:
    """A rail for clothes on two uprights with feet or on two pairs of leaning legs, with a shelf low down."""
    x, head, reach = draw.between(0.35, 0.6), draw.between(1.2, 1.65), draw.between(0.18, 0.26)
    look, thick = draw.pick(looks.WOODS + looks.METALS[:2]), draw.between(0.024, 0.036)
    z, leaning = draw.between(0.1, 0.25), draw.chance(0.5)
    if leaning:
        # The legs cross a hand's breadth below their heads, where the rail lies.
        share, over = 0.93, draw.between(0.0, 0.05)
        for s, way in CORNERS:
            size = (thick - 0.003 * (way > 0), thick)
            foot, top = (s * x, way * reach, 0.0), (s * x, -way * (0.01 + over * 0.4), head)
            yield Part("leg", leg(foot, top, size, size), look)
        rail = share * head
        y = reach - (reach + 0.01 + over * 0.4) * z / head
    else:
        for s in SIDES:
            at = (s * x, 0.0)
            yield Part("upright", leg((*at, 0.02), (*at, head), thick, thick), look)
            low, high = s * x - thick / 2 - 0.003, s * x + thick / 2 + 0.003
            yield Part("foot", box((low, -reach, 0.0), (high, reach, 0.035)), look)
        rail, y, z = head - draw.between(0.03, 0.1), reach - 0.03, 0.06
    over = draw.choose([0.0, 0.05, 0.09])
    yield Part("rail", rod((-x - over, 0.0, rail), (x + over, 0.0, rail), draw.between(0.011, 0.016)), look)
    if draw.chance(0.35):
        low = head * draw.between(0.5, 0.62)
        lower = 0.0
        if leaning:
            lower = reach - (reach + 0.01) * low / head
        yield Part("rail", rod((-x, -lower, low), (x, -lower, low), 0.011), look)
    kind = draw.choose(TIERS)
    yield from _tiers(draw, kind, (x, y), [z], look if draw.chance(0.6) else draw.pick(looks.WOODS))


def _stepped(draw: Draw) -> Parts:
    """Shelves that grow deeper downwards, between two upright posts behind and two leaning ones before."""
    x, head = draw.between(0.22, 0.45), draw.between(0.9, 1.6)
    deep, shallow = draw.between(0.36, 0.5), draw.between(0.1, 0.18)
    look, thick = draw.pick(looks.WOODS + looks.METALS[:2]), draw.between(0.022, 0.034)
    shelf = look if draw.chance(0.4) else draw.pick(looks.WOODS)
    for s in SIDES:
        rear = (s * x, 0.0)
        yield Part("post", leg((*rear, 0.0), (*rear, head), thick, thick), look)
        size = (thick - 0.003, thick)
        yield Part("leg", leg((s * x, deep, 0.0), (s * x, shallow, head), size, size), look)
    count = draw.integer(3, 6)
    high = draw.between(0.016, 0.024)
    rim = draw.chance(0.4)
    for z in np.linspace(draw.between(0.1, 0.25), head - draw.between(0.03, 0.1), count).tolist():
        front = deep + (shallow - deep) * z / head
        yield Part("board", box((-x, 0.0, z - high), (x, front, z)), shelf)
        if rim:
            yield Part("rim", box((-x, -0.009, z - high), (x, 0.009, z + 0.045)), shelf)


def bookshelf(draw: Draw) -> Parts:
    """Draw a bookshelf; it is open to the front, +y, and perhaps to the back."""
    half = (draw.between(0.2, 0.55), draw.between(0.12, 0.18))
    head, thick = draw.between(0.6, 1.65), draw.between(0.015, 0.025)
    if half[0] > 0.45 and draw.chance(0.4):
        head = draw.between(0.6, 0.95)
    look, base = draw.pick(looks.WOODS), draw.choose(["plinth", "legs", "floor"])
    foot = {"plinth": draw.between(0.04, 0.08), "legs": draw.between(0.08, 0.18), "floor": 0.0}[base]
    (x, y), low = half, foot if base == "legs" else 0.0
    for s in SIDES:
        a, b = sorted([s * x, s * (x - thick)])
        yield Part("side", box((a, -y, low), (b, y, head)), look)
    inner = x - thick + JOINT_M
    over = draw.choose([0.0, 0.0, 0.015])
    wide = x + over if over else inner
    yield Part("top", box((-wide, -y, head - thick), (wide, y + over, head + over * 0.3)), look)
    yield Part("bottom", box((-inner, -y, foot), (inner, y, foot + thick)), look)
    if base == "plinth":
        yield Part("plinth", box((-inner, y - 0.04, 0.0), (inner, y - 0.02, foot + JOINT_M)), look)
    elif base == "legs":
        yield from _posts(
            (x - 0.04, y - 0.04), foot + JOINT_M, draw.between(0.03, 0.045), look, is_round=True
        )
    back = draw.choose(["whole", "whole", "half", "none"])
    if back != "none":
        z = foot if back == "whole" else foot + (head - foot) * draw.between(0.35, 0.55)
        yield Part("back", box((-inner, -y, z), (inner, 0.0125 - y, head - JOINT_M)), look)
    cells = []
    for part, column in _shelves(draw, inner, y, (foot + thick, head - thick), look):
        yield from part
        cells += column
    share = draw.choose([0.0, 0.3, 0.6])
    for cell in cells:
        if draw.chance(share):
            yield from _books(draw, cell, y)


def _shelves(
    draw: Draw, inner_m: float, y_m: float, z_m: Vector2, look: Look
) -> list[tuple[list[Part], list[_Cell]]]:
    """The shelves of each column, its divider to the left if there is one, and its compartments."""
    thick = draw.between(0.015, 0.022)
    columns = 1 if inner_m < 0.32 else draw.integer(1, 2 + int(inner_m / 0.18))
    edges = np.linspace(-inner_m, inner_m, columns + 1).tolist()
    pitch, staggered = draw.between(0.24, 0.36), draw.chance(0.4)
    set_back = draw.choose([0.0, 0.012])
    found = []
    for left, right in pairwise(edges):
        parts = []
        if left > -inner_m:
            low, high = z_m[0] - JOINT_M, z_m[1] + JOINT_M
            parts.append(
                Part("divider", box((left - thick / 2, -y_m, low), (left + thick / 2, y_m, high)), look)
            )
        count = max(1, round((z_m[1] - z_m[0]) / pitch))
        heights = np.linspace(*z_m, count + 1)
        if staggered and count > 1:
            heights[1:-1] += draw.between(-0.25, 0.25) * (z_m[1] - z_m[0]) / count
        for z in heights[1:-1].tolist():
            shape = box((left, -y_m, z - thick / 2), (right, y_m - set_back, z + thick / 2))
            parts.append(Part("shelf", shape, look))
        floors = [z_m[0], *(heights[1:-1] + thick / 2).tolist()]
        ceilings = [*(heights[1:-1] - thick / 2).tolist(), z_m[1]]
        cells = [
            _Cell((left + thick / 2, right - thick / 2), (low, high))
            for low, high in zip(floors, ceilings, strict=True)
        ]
        found.append((parts, cells))
    return found


def _books(draw: Draw, cell: _Cell, y_m: float) -> Parts:
    """A row of upright books from the left, the last one perhaps leaning, or a pile of lying ones."""
    room, floor = cell.z[1] - cell.z[0], cell.z[0] - JOINT_M
    colors = looks.CLOTHS + looks.PLASTICS[:2]
    rear = 0.0125 - y_m - JOINT_M
    if draw.chance(0.25):
        x, z = draw.between(cell.x[0] + 0.11, max(cell.x[0] + 0.12, cell.x[1] - 0.14)), floor
        for _ in range(draw.integer(2, 5)):
            thick, half = draw.between(0.02, 0.045), draw.between(0.08, 0.1)
            if z + thick > cell.z[1] - 0.02:
                return
            front = rear + draw.between(0.14, min(0.2, 2 * y_m - 0.02))
            shape = box((x - half, rear, z), (min(x + half, cell.x[1]), front, z + thick))
            yield Part("book", shape, draw.pick(colors))
            z += thick - JOINT_M
        return
    x, end = cell.x[0] - JOINT_M, cell.x[0] + draw.between(0.3, 1.0) * (cell.x[1] - cell.x[0]) - 0.02
    high = room
    while x + 0.05 < end:
        thick = draw.between(0.018, 0.048)
        high = draw.between(0.55, 0.9) * min(room, 0.33)
        front = rear + draw.between(0.13, min(0.21, 2 * y_m - 0.01))
        yield Part("book", box((x, rear, floor), (x + thick, front, floor + high)), draw.pick(colors))
        x += thick - JOINT_M
    if draw.chance(0.5) and cell.x[1] - x > 0.12:
        tall, turn = 0.85 * high, draw.between(8.0, 16.0)
        # It rests on its lower left edge and leans to the left against the row.
        book = box((0.0, rear, 0.0), (0.03, rear + 0.14, tall)).rotate((0.0, -turn, 0.0))
        at = x + tall * float(np.sin(np.radians(turn))) - JOINT_M
        yield Part("book", book.translate((at, 0.0, floor)), draw.pick(colors))
