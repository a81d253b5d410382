"""Frames that carry sheets and lines: clothes horses, easels, whiteboards and pavement signs."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Points,
    Vector2,
    Vector3,
    bar_between,
    box,
    leaned,
    leg,
    plate,
    rectangle,
    ribbon,
    rod,
    rounded_path,
    tube,
)
from kinectbench_plugins import palettes

if TYPE_CHECKING:
    from manifold3d import Manifold

# Lines and bars are round, of this radius at the least; own choice.
LINE_M = 0.0066


def clothes_horse(draw: Draw) -> Parts:
    """Draw a clothes horse with lines along x, perhaps with clothes on them; 12.5 mm thick or more."""
    return draw.choose([_winged, _winged, _gable, _tower])(draw)


def _cloth(draw: Draw, at_yz: Vector2, half_m: float, clear_m: float) -> Part:
    """A towel that hangs over a line along x, its two sides some centimetres apart.

    Args:
        draw: its width, lengths and colour.
        at_yz: y and z of the line.
        half_m: half the line's length.
        clear_m: least height of its hems.
    """
    y, z = at_yz
    wide = half_m * draw.between(0.35, 0.85)
    x = draw.between(-1.0, 1.0) * (half_m - wide) * 0.8
    apart, thick = draw.between(0.012, 0.022), draw.between(0.013, 0.016)
    drops = [max(clear_m, z - draw.between(0.2, 0.65)) for _ in SIDES]
    path = [
        (y - 1.6 * apart, drops[0]),
        (y - apart, z),
        (y, z + 0.006),
        (y + apart, z),
        (y + 1.6 * apart, drops[1]),
    ]
    return Part("cloth", ribbon(path, (x - wide, x + wide), thick), draw.pick(looks.CLOTHS))


def _hung(draw: Draw, lines_yz: Sequence[Vector2], half_m: float, clear_m: float) -> Parts:
    """Clothes on a few lines that are not neighbours, or on none."""
    count = draw.choose([0, 0, 1, 2, 3])
    places = list(lines_yz[draw.integer(0, 2) :: 2])
    for at in places[:count]:
        yield _cloth(draw, at, half_m, clear_m)


def _winged(draw: Draw) -> Parts:
    """Crossed legs at both ends, a level frame with lines, and perhaps two wings that rise to the sides."""
    half, reach, top = draw.between(0.26, 0.45), draw.between(0.26, 0.34), draw.between(0.78, 1.0)
    metal, radius = draw.pick(looks.METALS[:2] + looks.PLASTICS[:4]), draw.between(0.0085, 0.011)
    plastic, spread = draw.pick(looks.PLASTICS), reach * draw.between(0.8, 1.1)
    for s, way in CORNERS:
        # The two legs of an end stand side by side and touch where they cross.
        x = s * (half - 0.9 * radius * (1 + way))
        foot, head = (x, -way * spread, radius), (x, way * 0.75 * reach, top)
        # A little thinner than the frame, whose outer sides they would touch.
        yield Part("leg", rod(foot, head, radius - 0.001), metal)
    for way in SIDES:
        # A little thicker than the legs that end in it, so that the two share no edge.
        x, low = half - 0.9 * radius * (1 + way), radius + 0.0015
        yield Part("foot", rod((-x - 0.03, -way * spread, low), (x + 0.03, -way * spread, low), low), metal)
    corners = [(-half, -reach), (half, -reach), (half, reach), (-half, reach)]
    path = [(x, y, top) for x, y in (*corners, corners[0])]
    yield Part("frame", tube(path, radius), metal)
    lines = np.linspace(-reach, reach, draw.integer(7, 12))[1:-1].tolist()
    for y in lines:
        yield Part("line", rod((-half, y, top), (half, y, top), LINE_M), metal)
    hung = [(y, top) for y in lines]
    if draw.chance(0.65):
        wing, rise = draw.between(0.25, 0.38), draw.between(5, 40) * np.pi / 180
        for s in SIDES:
            outward = wing * np.array([0.0, s * np.cos(rise), np.sin(rise)])
            start = np.array([0.0, s * reach, top])
            tip, inner = start + outward, half - 0.03
            loop = rounded_path(
                [(-inner, *start[1:]), (-inner, *tip[1:]), (inner, *tip[1:]), (inner, *start[1:])], 0.04
            )
            yield Part("wing", tube(loop, radius), metal)
            for share in np.linspace(0, 1, draw.integer(4, 6))[1:-1].tolist():
                y, z = (start + share * outward)[1:].tolist()
                yield Part("line", rod((-inner, y, z), (inner, y, z), LINE_M), metal)
            yield from _struts(
                s, (half - 0.9 * radius * (1 + s), inner), (spread, reach, top), start, outward, metal
            )
            hinge = box(
                (-half - 0.014, s * reach - 0.016, top - 0.016),
                (half + 0.014, s * reach + 0.016, top + 0.016),
            )
            ends = box((-inner + 0.03, -2.0, 0.0), (inner - 0.03, 2.0, 3.0))
            yield Part("hinge", hinge - ends, plastic)
    yield from _hung(draw, hung, half - 0.03, 0.12)


def _struts(side: int, x_m: Vector2, legs_m: Vector3, hinge: Points, wing: Points, look: Look) -> Parts:
    """A rod from a leg to the middle of a wing, at the left and the right.

    Args:
        side: of the wing, the sign of its y.
        x_m: of the legs and of the wing's frame.
        legs_m: y of their feet, of the frame's edge, and height of the frame.
        hinge: (3,) where the wing begins.
        wing: (3,) from there to its tip.
        look: of the rods.
    """
    spread, reach, top = legs_m
    low = (side * (0.8 * (0.75 * reach + spread) - spread), 0.8 * top)
    y, z = (hinge + 0.45 * wing)[1:].tolist()
    for s in SIDES:
        yield Part("strut", rod((s * x_m[0], *low), (s * x_m[1], y, z), LINE_M), look)


def _gable(draw: Draw) -> Parts:
    """Two wooden frames that lean against each other at the top, with a line from side to side in each."""
    half, top, spread = draw.between(0.25, 0.42), draw.between(0.75, 1.3), draw.between(0.2, 0.34)
    wood, thick = draw.pick(looks.WOODS), draw.between(0.022, 0.028)
    radius, count = draw.between(0.0072, 0.0095), draw.integer(3, 7)
    lines = []
    for way, x in ((1, half), (-1, half - thick + 0.004)):
        for s in SIDES:
            # The two frames overlap by 4 mm where they meet at the top.
            foot, head = (s * x, way * spread, 0.0), (s * x, -way * 0.02, top)
            yield Part("post", leg(foot, head, (thick, 1.3 * thick), (thick, 1.3 * thick)), wood)
        for share in np.linspace(0.16, 0.97, count).tolist():
            y, z = way * (spread - (spread + 0.02) * share), top * share
            yield Part("line", rod((-x, y, z), (x, y, z), radius), wood)
            if share > 0.5:
                lines.append((y, z))
    if draw.chance(0.6):
        z = 0.3 * top
        y = spread - (spread + 0.02) * 0.3
        for s in SIDES:
            x = s * (half - 0.5 * thick)
            yield Part(
                "strut", box((x - 0.007, -y - 0.01, z - 0.014), (x + 0.007, y + 0.01, z + 0.014)), wood
            )
    yield from _hung(draw, lines, half - 0.03, 0.1)


def _tower(draw: Draw) -> Parts:
    """Four posts with two or three tiers of lines one above the other."""
    half, y, top = draw.between(0.28, 0.4), draw.between(0.2, 0.3), draw.between(1.0, 1.35)
    metal, radius = draw.pick(looks.METALS[:2] + looks.PLASTICS[:4]), draw.between(0.0085, 0.011)
    for s in SIDES:
        path = [(s * half, -y, 0.0), (s * half, -y, top), (s * half, y, top), (s * half, y, 0.0)]
        yield Part("post", tube(rounded_path(path, draw.between(0.04, 0.12)), radius), metal)
        yield Part("foot", rod((s * half, -y, 0.12), (s * half, y, 0.12), radius - 0.001), metal)
    lines: list[Vector2] = []
    tiers = draw.integer(2, 4)
    for z in np.linspace(0.36, 0.88, tiers).tolist():
        at, out = z * top, y + draw.choose([0.0, 0.12])
        for s in SIDES:
            yield Part("arm", rod((s * half, -out, at), (s * half, out, at), radius - 0.001), metal)
        rows = np.linspace(-out + 0.01, out - 0.01, draw.integer(4, 8)).tolist()
        for row in rows:
            yield Part("line", rod((-half, row, at), (half, row, at), LINE_M), metal)
        lines = [(row, at) for row in rows[1:-1]]
    yield from _hung(draw, lines, half - 0.03, 0.3 * top)


def easel(draw: Draw) -> Parts:
    """Draw an easel with a canvas, a whiteboard on a frame, or a pavement sign; its face looks to +y."""
    return draw.choose([_tripod, _tripod, _whiteboard, _whiteboard, _sign])(draw)


def _board(half_m: Vector2, thick_m: float, corner_m: float = 0.0) -> "Manifold":
    """An upright board around the origin, its faces to +y and -y."""
    outline = rectangle((2 * half_m[0], 2 * half_m[1]), corner_m)
    return plate(outline, -thick_m / 2, thick_m / 2).rotate((90.0, 0.0, 0.0))


def _tripod(draw: Draw) -> Parts:
    """Two front legs that lean together, one behind them, a ledge and a canvas or a panel on it."""
    top, foot, slope = draw.between(1.1, 1.65), draw.between(0.24, 0.36), draw.between(0.14, 0.24)
    wood, thick, deep = draw.pick(looks.WOODS), draw.between(0.026, 0.036), draw.between(0.5, 0.75)
    behind = -slope * top
    for s in SIDES:
        ends = (s * foot, 0.0, 0.0), (s * 0.035, behind, top)
        yield Part("leg", leg(*ends, (thick, 0.8 * thick), (thick, 0.8 * thick)), wood)
    rear = leg((0.0, -deep, 0.0), (0.0, behind + 0.006, 0.97 * top), thick, thick)
    yield Part("rear leg", rear, wood)
    head = box(
        (-0.08, behind + slope * 0.05 - 0.02, top - 0.09), (0.08, behind + slope * 0.05 + 0.02, top - 0.03)
    )
    yield Part("head", head, wood)
    low, ledge = draw.between(0.28, 0.45) * top, draw.between(0.055, 0.08)
    reach = foot * draw.between(0.9, 1.25)
    face = -slope * low
    yield Part("ledge", box((-reach, face - 0.02, low - 0.025), (reach, face + ledge, low)), wood)
    lip = box((-reach, face + ledge - 0.016, low - 0.025), (reach, face + ledge, low + 0.02))
    yield Part("ledge", lip, wood)
    if draw.chance(0.5):
        z = 0.15 * top
        x = foot * (1 - 0.15) + 0.035 * 0.15
        yield Part("cross bar", bar_between((-x, -slope * z, z), (x, -slope * z, z), 0.018, 0.035), wood)
    room = top - low
    half = (draw.between(0.22, 0.42), min(draw.between(0.2, 0.42), 0.5 * room + 0.12))
    canvas, look = draw.between(0.016, 0.03), draw.pick(looks.CLOTHS + looks.PLASTICS[:1])
    y = 0.4 * thick + canvas / 2 - 0.003
    picture = _board(half, canvas).translate((0.0, y, low + half[1] - 0.006))
    yield Part("canvas", leaned(picture, 0.0, slope), look)
    if draw.chance(0.4):
        field = _board((0.6 * half[0], 0.5 * half[1]), 0.02).translate(
            (0.0, y + canvas / 2 - 0.007, low + half[1])
        )
        yield Part("picture", leaned(field, 0.0, slope), draw.pick(looks.CLOTHS))
    if draw.chance(0.35):
        z = low + 2 * half[1]
        clip = box((-0.03, -0.01, z - 0.03), (0.03, y + canvas / 2 + 0.014, z + 0.02))
        if z < top - 0.05:
            yield Part("clip", leaned(clip, 0.0, slope), wood)


def _whiteboard(draw: Draw) -> Parts:
    """A board between two posts on feet, perhaps tilted, with a frame, a tray and a flip chart's paper."""
    half = (draw.between(0.38, 0.6), draw.between(0.3, 0.45))
    middle, thick = draw.between(1.0, 1.2), draw.between(0.018, 0.028)
    metal, radius = draw.pick(looks.METALS), draw.between(0.012, 0.018)
    x, deep = half[0] + radius - 0.006, draw.between(0.22, 0.32)
    top, wheels = middle + draw.between(-0.05, 0.3), draw.chance(0.5)
    low = 0.05 if wheels else radius
    for s in SIDES:
        yield Part("post", rod((s * x, 0.0, low), (s * x, 0.0, top), radius), metal)
        yield Part("foot", rod((s * x, -deep, low), (s * x, deep, low), radius), metal)
        for y in (-deep + 0.02, deep - 0.02) if wheels else ():
            yield Part(
                "castor", rod((s * x - 0.013, y, 0.026), (s * x + 0.013, y, 0.026), 0.026), looks.BLACK_STEEL
            )
    z = draw.between(0.15, 0.45)
    yield Part("cross bar", rod((-x, 0.0, z), (x, 0.0, z), radius - 0.002), metal)
    tilt = draw.choose([0.0, draw.between(-20, 20)])
    parts = [
        Part("board", _board(half, thick), draw.choose([looks.PLASTICS[0], draw.pick(palettes.ENAMELS[:3])]))
    ]
    outer = _board((half[0] + 0.003, half[1] + 0.003), thick + 0.012)
    inner = _board((half[0] - 0.022, half[1] - 0.022), 1.0)
    parts.append(Part("frame", outer - inner, draw.pick(looks.METALS + looks.WOODS[:3])))
    if draw.chance(0.7):
        wide = half[0] * draw.between(0.3, 0.9)
        tray = box((-wide, 0.0, -half[1] - 0.006), (wide, draw.between(0.06, 0.09), -half[1] + 0.012))
        parts.append(Part("tray", tray, metal))
    if draw.chance(0.4):
        paper = _board((0.62 * half[0], 0.9 * half[1]), 0.016).translate((0.0, thick / 2 + 0.004, 0.01))
        parts.append(Part("paper", paper, draw.pick(palettes.CARDS)))
    for part in parts:
        shape = part.shape.rotate((tilt, 0.0, 0.0)).translate((0.0, 0.0, middle))
        yield Part(part.name, shape, part.look)
    yield Part("axle", rod((-x, 0.0, middle), (x, 0.0, middle), min(radius, 0.5 * thick) - 0.001), metal)


def _sign(draw: Draw) -> Parts:
    """Two boards that lean against each other at the top, with frames, legs and a bar or a chain's board."""
    half, top = draw.between(0.27, 0.4), draw.between(0.75, 1.15)
    spread, thick = draw.between(0.2, 0.3) * top, draw.between(0.02, 0.03)
    wood, face, slope = draw.pick(looks.WOODS), draw.pick(looks.PLASTICS[:1] + looks.CLOTHS), spread / top
    low = draw.between(0.06, 0.16)
    for s in SIDES:
        frame = box((-half, -thick / 2, low), (half, thick / 2, top))
        posts = [
            # Those behind stand a little farther inside, so that the two share no plane.
            box((side - 0.022, -thick / 2 - 0.004, 0.0), (side + 0.022, thick / 2 + 0.004, top + 0.004))
            for side in (-half + 0.021 - 0.001 * s, half - 0.021 + 0.001 * s)
        ]
        yield Part("board", leaned(frame, top, s * slope), face)
        for post in posts:
            yield Part("post", leaned(post, top, s * slope), wood)
        for z in (low + 0.03, top - 0.05):
            rail = box((-half, -thick / 2 - 0.004, z - 0.028), (half, thick / 2 + 0.004, z + 0.028))
            yield Part("rail", leaned(rail, top, s * slope), wood)
    z = draw.between(0.25, 0.45) * top
    y = slope * (top - z)
    for s in SIDES:
        x = s * (half - 0.02)
        yield Part("spreader", box((x - 0.009, -y, z - 0.013), (x + 0.009, y, z + 0.013)), wood)
    if draw.chance(0.4):
        loop = [
            (-0.07, 0.0, top - 0.02),
            (-0.07, 0.0, top + 0.05),
            (0.07, 0.0, top + 0.05),
            (0.07, 0.0, top - 0.02),
        ]
        yield Part("handle", tube(rounded_path(loop, 0.03), 0.009), draw.pick(looks.METALS))
