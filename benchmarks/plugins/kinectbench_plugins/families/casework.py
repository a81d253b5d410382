"""Closed furniture of boards: sideboards, chests of drawers and bedside cabinets, and upright pianos."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kinectbench.lab.simulate.objects import bases, looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Vector2,
    box,
    leg,
    plate,
    rectangle,
    rod,
    rounded_path,
    tube,
)

# Parts that are glued to one another overlap by this much; own choice.
LAP_M = 0.004
# Boards are this thick at the least; own choice.
BOARD_M = 0.016


@dataclass(frozen=True)
class _Field:
    """A part of a front between two corners in x and z, metres, frame `object`.

    Attributes:
        left: its least x.
        right: its greatest x.
        low: its lower edge.
        top: its upper edge.
        face: y of the body's front behind it.
    """

    left: float
    right: float
    low: float
    top: float
    face: float

    @property
    def middle(self) -> Vector2:
        """Its middle in x and z."""
        return (self.left + self.right) / 2, (self.low + self.top) / 2

    def board(self, inset_m: float, thick_m: float, name: str, look: Look) -> Part:
        """A board before the body, smaller than the field by `inset_m` on all sides."""
        low = (self.left + inset_m, self.face - max(LAP_M, BOARD_M - thick_m), self.low + inset_m)
        high = (self.right - inset_m, self.face + thick_m, self.top - inset_m)
        return Part(name, box(low, high), look)


@dataclass(frozen=True)
class _Style:
    """What the doors and drawers of one case have in common, metres.

    Attributes:
        thick: of a front.
        gap: around a front, on each side; more than the top reaches down over the case.
        edge: width of a front's frame; 0 for plain ones.
        rise: how far the frame stands out.
        pull: "knob", "bar", "bow" or "none".
        look: of the fronts.
        metal: of what they are pulled by.
    """

    thick: float
    gap: float
    edge: float
    rise: float
    pull: str
    look: Look
    metal: Look


def sideboard(draw: Draw) -> Parts:
    """Draw a sideboard, a chest of drawers or a bedside cabinet; doors and drawers are shut, niches open."""
    kind = draw.choose(["sideboard", "chest", "bedside"])
    wide, deep, high = {
        "sideboard": ((0.5, 0.85), (0.18, 0.24), (0.5, 0.72)),
        "chest": ((0.28, 0.5), (0.2, 0.26), (0.65, 1.15)),
        "bedside": ((0.18, 0.28), (0.17, 0.22), (0.32, 0.52)),
    }[kind]
    x, y, rise = draw.between(*wide), draw.between(*deep), draw.between(*high)
    look = draw.pick(looks.WOODS[:7])
    style = _Style(
        thick=draw.between(0.012, 0.02),
        gap=draw.between(LAP_M + 0.0006, 0.007),
        edge=draw.choose([0.0, 0.0, draw.between(0.045, 0.065)]),
        rise=draw.between(0.006, 0.012),
        pull=draw.choose(["knob", "bar", "bow", "none"]),
        look=look if draw.chance(0.5) else draw.pick(looks.WOODS[:7]),
        metal=draw.pick(looks.METALS + looks.WOODS[:2]),
    )
    stand = draw.choose(["floor", "plinth", "legs", "legs", "sled", "panels"])
    low = {"floor": 0.0, "plinth": draw.between(0.05, 0.1)}.get(stand, draw.between(0.1, 0.24))
    yield from _stand(draw, stand, (x, y), low, look)
    over, thick = draw.choose([0.0, draw.between(0.008, 0.03)]), draw.between(0.018, 0.035)
    top = low + rise
    body = box((-x, -y, low), (x, y, top))
    columns = {"sideboard": draw.integer(2, 5), "chest": 1, "bedside": 1}[kind]
    edges = np.linspace(-x, x, columns + 1)
    # Columns need not be alike wide; a row of drawers may run over all of them.
    edges[1:-1] += np.array([draw.between(-0.12, 0.12) for _ in edges[1:-1]]) * 2 * x / columns
    row = top - draw.between(0.1, 0.17) if kind != "chest" and draw.chance(0.4) else top
    fields = [_Field(a, b, row, top, y) for a, b in pairwise(edges.tolist()) if row < top]
    fronts = [part for field in fields for part in _front(draw, field, "drawer", style)]
    for a, b in pairwise(edges.tolist()):
        field, what = _Field(a, b, low, row, y), _what(draw, kind)
        if what == "niche":
            inner = 2 * y - draw.between(0.018, 0.05)
            body = body - box((a + 0.018, y - inner, low + 0.018), (b - 0.018, y + 0.1, row - 0.018))
            fronts += _shelves(draw, field, inner, look)
        elif what == "drawers":
            count = max(1, round((row - low) / draw.between(0.13, 0.27)))
            for z0, z1 in pairwise(np.linspace(low, row, count + 1).tolist()):
                fronts += _front(draw, _Field(a, b, z0, z1, y), "drawer", style)
        else:
            halves = [(a, (a + b) / 2), ((a + b) / 2, b)] if b - a > 0.55 else [(a, b)]
            for left, right in halves:
                fronts += _front(draw, _Field(left, right, low, row, y), "door", style)
    yield Part("case", body, look)
    cover = box((-x - over, -y, top - LAP_M), (x + over, y + 0.018 + over, top + thick))
    yield Part("top", cover, draw.pick(looks.WOODS[:7] + looks.STONES) if draw.chance(0.4) else look)
    yield from fronts
    if draw.chance(0.2):
        rail = box((-x, -y, top), (x, -y + BOARD_M, top + thick + draw.between(0.04, 0.12)))
        yield Part("gallery", rail, look)


def _what(draw: Draw, kind: str) -> str:
    """What a column of a front is made of."""
    return draw.choose(
        {
            "sideboard": ["door", "door", "door", "drawers", "niche"],
            "chest": ["drawers"],
            "bedside": ["door", "drawers", "drawers", "niche"],
        }[kind]
    )


def _stand(draw: Draw, kind: str, half_m: Vector2, low_m: float, look: Look) -> Parts:
    """What carries a case: a plinth, legs, tube runners or its own side panels; nothing on the floor."""
    (x, y), head = half_m, low_m + LAP_M + 0.006
    wood = look if draw.chance(0.5) else draw.pick(looks.WOODS)
    if kind == "plinth":
        yield Part("plinth", box((-x + 0.015, -y + 0.01, 0.0), (x - 0.015, y - 0.035, head)), look)
    elif kind == "sled":
        inset = draw.between(0.03, 0.3) * x
        yield from bases.sled(
            (x - inset, y - 0.03), head, draw.between(0.009, 0.013), draw.pick(looks.METALS)
        )
    elif kind == "panels":
        thick = draw.between(0.02, 0.035)
        yield from bases.panels((x - thick / 2 - 0.002, y - 0.006), head, thick, look)
        if draw.chance(0.6):
            yield Part("rail", box((-x + 0.01, -0.01, 0.02), (x - 0.01, 0.01, head)), look)
    elif kind == "legs":
        thick, inset, splay = draw.between(0.032, 0.05), draw.between(0.03, 0.06), draw.between(0.0, 0.035)
        foot, is_round = max(0.022, thick * draw.between(0.5, 1.0)), draw.chance(0.6)
        for sx, sy in CORNERS:
            at = sx * (x - inset), sy * (y - inset)
            ends = (at[0] + sx * splay, at[1] + sy * splay, 0.0), (*at, head)
            yield Part("leg", leg(*ends, foot, thick, is_round=is_round), wood)


def _shelves(draw: Draw, field: _Field, deep_m: float, look: Look) -> list[Part]:
    """Boards across a niche, none in a low one."""
    count = max(1, round((field.top - field.low) / draw.between(0.18, 0.34)))
    rear, front = field.face - deep_m - LAP_M, field.face - draw.between(0.0, 0.03) - 0.002
    ends = (field.left + 0.012, field.right - 0.012)
    return [
        Part("shelf", box((ends[0], rear, z), (ends[1], front, z + 0.018)), look)
        for z in np.linspace(field.low, field.top, count + 1)[1:-1].tolist()
    ]


def _front(draw: Draw, field: _Field, name: str, style: _Style) -> list[Part]:
    """A door or a drawer's front that is shut, plain or framed, and what it is pulled by."""
    thick, look = style.thick, style.look
    parts = [field.board(style.gap, thick, name, look)]
    (x, z), face = field.middle, field.face + thick
    wide, high = field.right - field.left, field.top - field.low
    if style.edge and min(wide, high) > 2 * style.edge + 0.04:
        raised = field.board(style.gap, thick + style.rise, "frame", look)
        inner = field.board(style.gap + style.edge, 1.0, "room", look)
        parts.append(Part("frame", raised.shape - inner.shape, look))
        face += style.rise if name == "door" else 0.0
    if name == "door":
        # Doors are pulled at the side that is not hinged.
        x += draw.choose(SIDES) * (wide / 2 - 0.035)
        z += draw.between(-0.1, 0.3) * high
    reach = min(0.065, 0.3 * (high if name == "door" else wide))
    along = (0.0, reach) if name == "door" else (reach, 0.0)
    pull = None
    if style.pull == "knob":
        pull = rod((x, face - 0.012, z), (x, face + 0.028, z), 0.013)
    elif style.pull == "bar":
        low = (x - along[0] - 0.008, face - 0.012, z - along[1] - 0.008)
        pull = box(low, (x + along[0] + 0.008, face + 0.022, z + along[1] + 0.008))
    elif style.pull == "bow" and reach > 0.04:
        a, b = (x - along[0], z - along[1]), (x + along[0], z + along[1])
        rear, out = face - 0.012, face + 0.034
        path = [(a[0], rear, a[1]), (a[0], out, a[1]), (b[0], out, b[1]), (b[0], rear, b[1])]
        pull = tube(rounded_path(path, 0.02), 0.008)
    return parts if pull is None else [*parts, Part("handle", pull, style.metal)]


def piano(draw: Draw) -> Parts:
    """Draw an upright piano, or an electric one on side panels; whoever plays it looks to -y."""
    x, look = draw.between(0.68, 0.77), draw.pick(looks.WOODS[:7])
    electric = draw.chance(0.4)
    deep, keys = draw.between(0.2, 0.28), draw.between(0.62, 0.68)
    shelf, high = draw.between(0.17, 0.24), draw.between(0.1, 0.14)
    cheek = draw.between(0.035, 0.06)
    if electric:
        top, deep = keys + draw.between(0.1, 0.2), 0.7 * deep
        for s in SIDES:
            low, end = sorted([s * x, s * (x - cheek)])
            yield Part("side", box((low, -deep, 0.0), (end, 0.02, top)), look)
            yield Part("foot", box((low, -deep - 0.02, 0.0), (end, shelf + 0.05, 0.04)), look)
        panel = box((-x + 0.01, -deep + 0.02, draw.between(0.15, 0.4)), (x - 0.01, -deep + 0.04, keys))
        yield Part("panel", panel, look)
        yield Part("body", box((-x + 0.004, -deep + 0.01, keys - high), (x - 0.004, 0.01, top - 0.006)), look)
    else:
        top = draw.between(1.02, 1.3)
        low = draw.choose([0.0, 0.04])
        yield Part("body", box((-x, -deep, low), (x, 0.0, top)), look)
        over, thick = draw.between(0.01, 0.025), draw.between(0.02, 0.035)
        cover = box((-x - over, -deep, top - LAP_M), (x + over, 2 * over, top + thick))
        yield Part("lid", cover, look)
        if low:
            yield from _castors(x, deep, low)
        yield from _panels(draw, x, keys - high, top, look)
        yield from _legs(draw, x - cheek / 2, shelf, keys - high, look)
    yield Part("keybed", box((-x + 0.002, -0.02, keys - high), (x - 0.002, shelf, keys)), look)
    for s in SIDES:
        low, end = sorted([s * x, s * (x - cheek)])
        ends = (low, -0.01, keys - high + 0.01), (end, shelf - 0.006, keys + draw.between(0.045, 0.05))
        yield Part("cheek", box(*ends), look)
    if draw.chance(0.7):
        yield from _keyboard(x - cheek - 0.01, shelf, keys)
    else:
        # The fallboard is shut: a slanting cover over the keys.
        ends = (0.0, shelf / 2 - 0.005, keys - 0.01), (0.0, shelf / 2 - 0.02, keys + 0.012)
        cover = leg(*ends, (2 * x - 0.02, shelf - 0.01), (2 * x - 0.02, shelf - 0.04))
        ridge = box((-x + 0.01, -0.01, keys - 0.01), (x - 0.01, 0.35 * shelf, keys + 0.042))
        yield Part("fallboard", (cover + ridge).hull(), look)
    if draw.chance(0.6):
        yield from _music_desk(draw, keys + 0.07 if not electric else top - 0.012, look, on_top=electric)


def _castors(x: float, deep: float, high: float) -> Parts:
    """Four small wheels under a body."""
    for s, y in ((s, y) for s in SIDES for y in (-deep + 0.04, -0.04)):
        at = s * (x - 0.08)
        wheel = rod((at - 0.015, y, 0.024), (at + 0.015, y, 0.024), 0.024)
        fork = box((at - 0.012, y - 0.012, 0.02), (at + 0.012, y + 0.012, high + 0.01))
        yield Part("castor", wheel + fork, looks.METALS[3])


def _panels(draw: Draw, x: float, under: float, top: float, look: Look) -> Parts:
    """Framed panels above and below the keys, and two or three pedals."""
    above = [_Field(-x + 0.03, x - 0.03, under + 0.25, top - 0.02, 0.0)]
    below = [_Field(-x + 0.03, x - 0.03, 0.14, under - 0.01, 0.0)]
    if draw.chance(0.5):
        above = [_Field(a, b, under + 0.25, top - 0.02, 0.0) for a, b in ((-x + 0.03, 0.0), (0.0, x - 0.03))]
    for field in above + below:
        if field.top - field.low > 0.18:
            frame = field.board(0.004, 0.012, "frame", look)
            inner = field.board(draw.between(0.05, 0.07), 1.0, "room", look)
            yield Part("frame", frame.shape - inner.shape, look)
    count = draw.choose([2, 3])
    for at in np.linspace(-0.09, 0.09, count).tolist():
        yield Part("pedal", box((at - 0.02, -0.03, 0.055), (at + 0.02, 0.1, 0.072)), looks.METALS[0])


def _legs(draw: Draw, x: float, shelf: float, head: float, look: Look) -> Parts:
    """Two legs from the keys' shelf to the floor, each on a foot that goes back to the body, or none."""
    if draw.chance(0.25):
        return
    thick, turned = draw.between(0.045, 0.06), draw.chance(0.5)
    at = shelf - thick / 2 - 0.01
    for s in SIDES:
        foot = box((s * x - thick / 2, -0.01, 0.0), (s * x + thick / 2, shelf + 0.02, 0.05))
        yield Part("foot", foot, look)
        if turned:
            yield Part("leg", bases.turned_leg((s * x, at), head + 0.01, thick), look)
        else:
            post = leg((s * x, at, 0.0), (s * x, at, head + 0.01), 0.75 * thick, thick)
            yield Part("leg", post, look)


def _keyboard(half: float, shelf: float, keys: float) -> Parts:
    """White keys as one board, and black ones in groups of two and three."""
    front = shelf - 0.012
    yield Part("keys", box((-half, -0.005, keys - 0.01), (half, front, keys + 0.014)), looks.PLASTICS[0])
    octave = 2 * half / 7.43
    for start in np.arange(-half, half, octave).tolist():
        for share in (1, 2, 4, 5, 6):
            at = start + share / 7 * octave
            if at < half - 0.015:
                low = (at - 0.0076, -0.004, keys + 0.008)
                high = (at + 0.0076, 0.6 * front, keys + 0.026)
                yield Part("black key", box(low, high), looks.PLASTICS[5])


def _music_desk(draw: Draw, low: float, look: Look, *, on_top: bool) -> Parts:
    """A board that leans back and a ledge below it, on top of an electric piano or before the body."""
    half, high, lean = draw.between(0.2, 0.42), draw.between(0.18, 0.26), draw.between(8, 20)
    thick = 0.016
    board = plate(rectangle((2 * half, high), 0.02), -thick / 2, thick / 2).rotate((90.0 + lean, 0.0, 0.0))
    back = -0.1 if on_top else 0.02 + high / 2 * float(np.sin(np.radians(lean)))
    rise = high / 2 * float(np.cos(np.radians(lean)))
    yield Part("music desk", board.translate((0.0, back, low + rise)), look)
    near = back + high / 2 * float(np.sin(np.radians(lean)))
    ledge = box((-half + 0.02, near - 0.03, low - 0.006), (half - 0.02, near + 0.03, low + 0.012))
    yield Part("ledge", ledge, look)
    if not on_top:
        yield Part("ledge", box((-0.06, -0.01, low - 0.004), (0.06, near, low + 0.012)), look)
