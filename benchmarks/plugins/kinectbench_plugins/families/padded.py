"""Furniture that one sits or lies on without a back: stools, poufs and ottomans, beds and cots."""

from dataclasses import dataclass

import numpy as np

from kinectbench.lab.simulate.objects import bases, looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    box,
    cushion,
    ellipse,
    leg,
    plate,
    rectangle,
    rod,
    tube,
    turned,
)


def stool(draw: Draw) -> Parts:
    """Draw a stool, a bar stool, a pouf or an ottoman: a seat without a back."""
    return draw.choose([_pouf, _ottoman, _ottoman, _bar_stool, _bar_stool, _low_stool, _folding])(draw)


def _pouf(draw: Draw) -> Parts:
    """A round body of cloth, straight or bellied, perhaps with a lid's seam and on short feet."""
    radius, high = draw.between(0.2, 0.32), draw.between(0.3, 0.45)
    look, low = draw.pick(looks.COVERS), draw.choose([0.0, draw.between(0.06, 0.14)])
    belly, soft, share = draw.between(1.0, 1.14), draw.between(0.02, 0.07), np.linspace(0, 1, 13)
    middle = radius * (1 + (belly - 1) * np.sin(np.pi * share))
    rings = list(zip(middle.tolist(), (low + soft + share * (high - 2 * soft)).tolist(), strict=True))
    turn = np.linspace(0, np.pi / 2, 6)[:-1]
    foot = [(radius - soft * (1 - np.sin(t)), low + soft * (1 - np.cos(t))) for t in turn]
    crown = [(r, 2 * low + high - z) for r, z in reversed(foot)]
    profile = [(0.0, low), *foot, *rings, *crown, (0.0, low + high)]
    yield Part("seat", turned([(float(r), float(z - 0.0)) for r, z in profile]), look)
    if draw.chance(0.5):
        seam = low + high * draw.between(0.45, 0.75)
        wide = radius * belly + 0.006
        ring = turned([(0.0, seam - 0.009), (wide, seam - 0.009), (wide, seam + 0.009), (0.0, seam + 0.009)])
        yield Part("seam", ring, draw.pick(looks.COVERS))
    if low:
        wood, inner = draw.pick(looks.WOODS), 0.7 * radius
        yield from bases.round_legs(draw.choose([3, 4, 5]), inner + 0.02, inner, low + 0.02, 0.036, wood)


def _ottoman(draw: Draw) -> Parts:
    """A padded box, perhaps with a seat cushion of its own, on feet, legs, a plinth or a sled."""
    x, y = draw.between(0.22, 0.42), draw.between(0.2, 0.29)
    high, look = draw.between(0.38, 0.48), draw.pick(looks.COVERS)
    low, soft = draw.choose([0.02, 0.06, draw.between(0.12, 0.2)]), draw.between(0.018, 0.05)
    wood, kind = draw.pick(looks.WOODS), draw.choose(["one", "cushion", "tufted"])
    body = high - draw.between(0.08, 0.12) if kind == "cushion" else high
    # Where a cushion lies on it, its upper edge is sharper and lies within the cushion.
    edge = 0.012 if kind == "cushion" else soft
    yield Part("body", cushion((-x, -y, low), (x, y, body), edge), look)
    if kind == "cushion":
        top = cushion((-x - 0.008, -y - 0.008, body - 0.03), (x + 0.008, y + 0.008, high), 0.03, 0.02)
        yield Part("cushion", top, look if draw.chance(0.6) else draw.pick(looks.COVERS))
    elif kind == "tufted":
        for at in np.linspace(-0.6, 0.6, 3).tolist():
            for row in (-0.45, 0.45):
                button = rod((at * x, row * y, high - 0.02), (at * x, row * y, high + 0.008), 0.014)
                yield Part("button", button, wood)
    head = low + soft + 0.02
    if low < 0.05:
        yield Part("plinth", box((-x + 0.05, -y + 0.05, 0.0), (x - 0.05, y - 0.05, head)), wood)
    elif low > 0.1 and draw.chance(0.3):
        yield from bases.sled((x - 0.06, y - 0.06), head, draw.between(0.009, 0.012), draw.pick(looks.METALS))
    else:
        thick = draw.between(0.035, 0.05)
        for sx, sy in CORNERS:
            ends = (sx * (x - 0.04), sy * (y - 0.04), 0.0), (sx * (x - 0.055), sy * (y - 0.055), head)
            yield Part("leg", leg(*ends, 0.7 * thick, thick, is_round=draw.chance(0.5)), wood)


def _seat(draw: Draw, half: float, top: float, wood: Look) -> Parts:
    """A round or square seat of wood, perhaps padded; its upper face lies at `top`."""
    thick, outline = draw.between(0.022, 0.035), ellipse((2 * half, 2 * half))
    if draw.chance(0.4):
        outline = rectangle((2 * half, 1.9 * half), draw.between(0.02, 0.08))
    if draw.chance(0.45):
        pad = draw.between(0.03, 0.06)
        yield Part("pad", plate(0.99 * outline, top - pad, top, 0.4 * pad), draw.pick(looks.COVERS))
        top -= pad - 0.006
    yield Part("seat", plate(outline, top - thick, top, 0.006), wood)


def _bar_stool(draw: Draw) -> Parts:
    """A high seat on legs with a ring or bars for the feet, or on a column."""
    half, top = draw.between(0.15, 0.2), draw.between(0.6, 0.82)
    wood, metal = draw.pick(looks.WOODS), draw.pick(looks.METALS)
    yield from _seat(draw, half, top, wood)
    head, kind = top - 0.06, draw.choose(["ring", "ring", "column", "bars"])
    yield Part("block", plate(ellipse((half, half)), head - 0.012, top - 0.014), wood)
    if kind == "column":
        look, reach = metal, draw.between(0.19, 0.23)
        yield from bases.column(draw, reach, head, draw.between(0.045, 0.06), look)
        return
    look, thick = draw.choose([wood, metal]), draw.between(0.026, 0.036)
    foot, inner, z = half + draw.between(0.02, 0.07), 0.42 * half, top * draw.between(0.28, 0.42)
    if kind == "bars":
        inner = 0.6 * half
        yield Part(
            "frame", plate(rectangle((2 * inner + 0.05, 2 * inner + 0.05)), head - 0.02, head + 0.014), look
        )
        for sx, sy in CORNERS:
            ends = (sx * 0.8 * foot, sy * 0.8 * foot, 0.0), (sx * inner, sy * inner, head)
            yield Part("leg", leg(*ends, 0.8 * thick, thick), look)
        reach = 0.8 * foot + (inner - 0.8 * foot) * z / head
        yield from bases.stretchers(draw, (reach, reach), z, look)
        return
    count = draw.choose([3, 4, 4])
    yield from bases.round_legs(count, foot, inner, head, thick, look)
    reach, turn = foot + (inner - foot) * z / head, np.linspace(0, 2 * np.pi, 37)
    ring = np.column_stack([reach * np.cos(turn), reach * np.sin(turn), np.full(37, z)])
    yield Part("ring", tube(ring, draw.between(0.008, 0.011)), metal)


def _low_stool(draw: Draw) -> Parts:
    """A wooden stool on splayed legs, on two side panels, or on wooden legs with an apron."""
    half, top, wood = draw.between(0.16, 0.23), draw.between(0.36, 0.5), draw.pick(looks.WOODS)
    kind = draw.choose(["milking", "panels", "legs"])
    if kind == "milking":
        thick = draw.between(0.032, 0.05)
        yield Part("seat", plate(ellipse((2 * half, 2 * half)), top - thick, top, 0.01), wood)
        count, reach = draw.choose([3, 3, 4]), half + draw.between(0.0, 0.05)
        yield from bases.round_legs(count, reach, 0.6 * half, top - thick / 2, draw.between(0.03, 0.04), wood)
        return
    x, y = half, 0.75 * half
    thick = draw.between(0.02, 0.03)
    yield Part("seat", plate(rectangle((2 * x, 2 * y), 0.012), top - thick, top, 0.005), wood)
    head = top - thick + 0.01
    if kind == "panels":
        yield from bases.panels((0.8 * x, 0.9 * y), head, 0.022, wood)
        z = draw.between(0.4, 0.7) * top
        yield Part("stretcher", box((-0.82 * x, -0.011, z - 0.04), (0.82 * x, 0.011, z + 0.04)), wood)
    else:
        legs_m = (x - 0.035, y - 0.035)
        yield from bases.wooden_legs(draw, legs_m, head, draw.between(0.032, 0.042), wood, upright=True)
        yield from bases.apron(legs_m, head - 0.004, 0.05, wood)


def _folding(draw: Draw) -> Parts:
    """Two frames that cross, with a sling or slats from bar to bar."""
    x, y, top = draw.between(0.2, 0.27), draw.between(0.16, 0.21), draw.between(0.4, 0.47)
    wood, thick = draw.pick(looks.WOODS), draw.between(0.026, 0.032)
    yield from bases.crossed_legs((x, y), top - 0.01, thick, wood)
    for s in SIDES:
        at = s * (y - 0.004)
        yield Part(
            "rail", box((-x - 0.02, at - 0.018, top - 0.045), (x + 0.02, at + 0.018, top - 0.004)), wood
        )
        yield Part("foot rail", rod((-x, -s * 0.8 * y, 0.1 * top), (x, -s * 0.8 * y, 0.1 * top), 0.009), wood)
    if draw.chance(0.5):
        sling = box((-x + 0.03, -y - 0.02, top - 0.012), (x - 0.03, y + 0.02, top + 0.006))
        yield Part("sling", sling, draw.pick(looks.COVERS))
        return
    count = draw.integer(4, 7)
    wide = 2 * x / count * draw.between(0.6, 0.8)
    for at in np.linspace(-x + wide / 2, x - wide / 2, count).tolist():
        slat = box((at - wide / 2, -y - 0.015, top - 0.01), (at + wide / 2, y + 0.015, top + 0.007))
        yield Part("slat", slat, wood)


@dataclass(frozen=True)
class _Bed:
    """A bed's measures, metres, frame `object`; the head lies at -x.

    Attributes:
        x: half its length.
        y: half its width.
        low: lower edge of its side boards.
        rim: upper edge of its side boards.
        top: upper face of the mattress.
    """

    x: float
    y: float
    low: float
    rim: float
    top: float


def bed(draw: Draw) -> Parts:
    """Draw a bed for one, a box bed, or a cot; it lies along x, its head at -x."""
    kind = draw.choose(["frame", "frame", "frame", "box", "cot"])
    if kind == "cot":
        yield from _cot(draw)
        return
    low = draw.between(0.16, 0.3) if kind == "frame" else draw.choose([0.0, 0.05])
    rim = low + (draw.between(0.1, 0.16) if kind == "frame" else draw.between(0.22, 0.34))
    size = _Bed(draw.between(0.78, 1.02), draw.between(0.36, 0.56), low, rim, rim + draw.between(0.1, 0.2))
    look, wood = draw.pick(looks.COVERS), draw.pick(looks.WOODS)
    if kind == "frame":
        for s in SIDES:
            near, far = sorted([s * (size.y - 0.002), s * (size.y - 0.027)])
            yield Part("side", box((-size.x, near, low), (size.x, far, rim)), wood)
        reach = (size.x - 0.006, size.y - 0.012)
        yield Part("slats", box((-reach[0], -reach[1], rim - 0.05), (*reach, rim - 0.03)), wood)
        yield from _posts(draw, size, wood)
    else:
        body = cushion((-size.x, -size.y, low), (size.x, size.y, rim), 0.02)
        yield Part("body", body, look)
        if low:
            for sx, sy in CORNERS:
                at = (sx * (size.x - 0.08), sy * (size.y - 0.08))
                yield Part("foot", rod((*at, 0.0), (*at, low + 0.03), 0.03), wood)
        if draw.chance(0.7):
            high = size.top + draw.between(0.15, 0.5)
            back = cushion((-size.x - 0.06, -size.y, low), (-size.x + 0.015, size.y, high), 0.03)
            yield Part("headboard", back, look)
    yield from _bedding(draw, size)


def _posts(draw: Draw, size: _Bed, wood: Look) -> Parts:
    """Four posts, a headboard, and a footboard or a low rail between them."""
    thick, foot = draw.between(0.05, 0.075), draw.chance(0.5)
    heights = {
        -1: size.top + draw.between(0.2, 0.5),
        1: size.rim + (draw.between(0.12, 0.3) if foot else 0.004),
    }
    kind = draw.choose(["panel", "bars", "rails"])
    for end in SIDES:
        x, high, inner = end * (size.x + 0.01), heights[end], size.y - thick / 2
        for s in SIDES:
            yield Part("post", leg((x, s * inner, 0.0), (x, s * inner, high), 0.8 * thick, thick), wood)
        yield Part(
            "end", box((x - 0.012, -inner, size.low + 0.004), (x + 0.012, inner, size.rim - 0.004)), wood
        )
        if end > 0 and not foot:
            continue
        top, count = high - 0.02, max(5, round(2 * inner / draw.between(0.09, 0.14)))
        yield Part("rail", box((x - 0.016, -inner, top - 0.06), (x + 0.016, inner, top)), wood)
        if kind == "panel":
            yield Part(
                "panel", box((x - 0.009, -inner, size.rim - 0.02), (x + 0.009, inner, top - 0.02)), wood
            )
        elif kind == "rails":
            for z in np.linspace(size.rim + 0.05, top - 0.03, 4)[:-1].tolist():
                yield Part("rail", box((x - 0.011, -inner, z - 0.03), (x + 0.011, inner, z + 0.03)), wood)
        else:
            for at in np.linspace(-inner, inner, count)[1:-1].tolist():
                yield Part("bar", rod((x, at, size.rim - 0.02), (x, at, top - 0.02), 0.0095), wood)


def _bedding(draw: Draw, size: _Bed) -> Parts:
    """A mattress, perhaps with a pillow or two and a cover that hangs over the sides."""
    sheet, x, y = draw.pick(looks.CLOTHS[4:6] + looks.CLOTHS[1:3]), size.x - 0.02, size.y - 0.027
    yield Part("mattress", cushion((-x, -y, size.rim - 0.045), (x, y, size.top), 0.04), sheet)
    if draw.chance(0.65):
        count, soft = draw.integer(1, 3), draw.between(0.08, 0.12)
        wide, deep = y / count * 0.82, draw.between(0.19, 0.24)
        for k in range(count):
            at, near = (2 * k + 1 - count) * y / count, -x + draw.between(0.02, 0.06)
            low, high = (
                (near, at - wide, size.top - 0.025),
                (near + 2 * deep, at + wide, size.top + soft - 0.025),
            )
            yield Part("pillow", cushion(low, high, 0.035, 0.03), draw.pick(looks.CLOTHS))
    if draw.chance(0.6):
        start, hang = -x + draw.between(0.5, 0.9), draw.between(0.03, 0.3) * (size.top - 0.1)
        thick, out = draw.between(0.02, 0.05), size.y + 0.012
        end = size.x - 0.03
        hem = max(0.06, size.top - hang)
        cover = cushion((start, -out, hem), (end, out, size.top + thick), 0.02)
        under = box((start - 1.0, -out + 0.022, -1.0), (end + 1.0, out - 0.022, size.top - 0.012))
        yield Part("cover", cover - under, draw.pick(looks.CLOTHS))


def _cot(draw: Draw) -> Parts:
    """A child's bed: bars or panels on all sides, a mattress in the middle of its height, four posts."""
    x, y, top = draw.between(0.55, 0.68), draw.between(0.3, 0.38), draw.between(0.72, 0.95)
    wood, thick = draw.pick(looks.WOODS), draw.between(0.036, 0.05)
    low, floor = draw.between(0.14, 0.24), draw.between(0.26, 0.42)
    for sx, sy in CORNERS:
        yield Part("post", leg((sx * x, sy * y, 0.0), (sx * x, sy * y, top), thick, thick), wood)
    for z in (low, top - 0.05):
        yield from bases.ring("rail", (x, y), (z, z + 0.04), 0.0105, wood)
    gap, radius = draw.between(0.075, 0.1), draw.between(0.0078, 0.0095)
    panels, step = draw.chance(0.4), 2 * x / round(2 * x / gap)
    for s in SIDES:
        for at in np.arange(-x + step, x - step / 2, step).tolist():
            yield Part("bar", rod((at, s * y, low + 0.02), (at, s * y, top - 0.02), radius), wood)
        if panels:
            end = box((s * x - 0.0085, -y, low + 0.02), (s * x + 0.0085, y, top - 0.02))
            yield Part("panel", end, wood)
            continue
        for at in np.linspace(-y, y, round(2 * y / gap) + 1)[1:-1].tolist():
            yield Part("bar", rod((s * x, at, low + 0.02), (s * x, at, top - 0.02), radius), wood)
    yield Part("slats", box((-x, -y, floor - 0.02), (x, y, floor)), wood)
    reach = (x - 0.016, y - 0.016)
    mattress = cushion(
        (-reach[0], -reach[1], floor - 0.006), (*reach, floor + draw.between(0.08, 0.11)), 0.025
    )
    yield Part("mattress", mattress, draw.pick(looks.CLOTHS[4:6]))
