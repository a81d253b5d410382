"""Couches of one to three seats: many kinds of arms and feet, corner couches, tubs, wooden frames."""

from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from manifold3d import Manifold

from kinectbench.lab.simulate.objects import bases, looks
from kinectbench.lab.simulate.objects.backs import Back
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import box, cushion, leaned, leg, plate, rectangle, rod, union


@dataclass(frozen=True)
class _Size:
    """The dimensions of a couch, metres, frame `object`.

    Attributes:
        x: half width between the arms' outer faces.
        y: half depth.
        seats: number of seats.
        arm: width of an arm, 0 for none.
        foot: height of the body's lower face.
        base: height of the body's upper face, below the cushions.
        seat: height of the cushions' upper face.
        arm_top: height of the arms.
        top: height of the back.
        deep: thickness of the back.
        slope: metres backwards for each metre up.
    """

    x: float
    y: float
    seats: int
    arm: float
    foot: float
    base: float
    seat: float
    arm_top: float
    top: float
    deep: float
    slope: float


def _size(draw: Draw) -> _Size:
    seats = draw.choose([1, 2, 2, 3, 3])
    each = draw.between(0.52, 0.64) if seats < 3 else draw.between(0.50, 0.58)
    arm = draw.choose([0.0, draw.between(0.07, 0.1), draw.between(0.12, 0.18), draw.between(0.16, 0.2)])
    if seats == 1:
        arm = max(arm, 0.15)
    foot = draw.between(0.0, 0.16) if draw.chance(0.8) else 0.0
    seat = draw.between(0.39, 0.46)
    base = seat - draw.between(0.1, 0.15)
    return _Size(
        x=seats * each / 2 + arm,
        y=draw.between(0.38, 0.45),
        seats=seats,
        arm=arm,
        foot=foot if foot > 0.035 else 0.0,
        base=base,
        seat=seat,
        arm_top=seat + draw.between(0.12, 0.22),
        top=seat + draw.between(0.3, 0.48),
        deep=draw.between(0.14, 0.22),
        slope=draw.between(0.05, 0.22),
    )


def couch(draw: Draw) -> Parts:
    """Draw a couch whose front faces +y."""
    size = _size(draw)
    kinds = [_sofa, _sofa, _sofa, _sofa, _corner, _chesterfield, _wooden, _wooden, _tub]
    return draw.choose(kinds)(draw, size)


def _sofa(draw: Draw, size: _Size) -> Parts:
    """Draw a sofa: a body with a back, arms, cushions and feet."""
    look, soft = draw.pick(looks.COVERS), draw.between(0.02, 0.045)
    inner = size.x - size.arm
    yield _body(size, look)
    yield _back(size, soft, look)
    yield from _arms(draw, size, soft, look)
    cushions = look if draw.chance(0.75) else draw.pick(looks.CLOTHS)
    yield from _seat_cushions(draw, size, inner, cushions)
    loose = draw.chance(0.65)
    if loose:
        yield from _back_cushions(draw, size, inner, cushions)
    if draw.chance(0.35):
        yield from _pillows(draw, size, inner, 0.2 if loose else 0.06)
    yield from _feet(draw, size, (size.x, size.y))


def _body(size: _Size, look: Look) -> Part:
    """Make the body below the cushions."""
    low, high = (-size.x + 0.004, -size.y, size.foot), (size.x - 0.004, size.y - 0.02, size.base)
    return Part("body", cushion(low, high, 0.018), look)


def _back(size: _Size, soft: float, look: Look) -> Part:
    """Make a board behind the seat, edges rounded by radius `soft`, from the body's bottom to the top."""
    inner = size.x - max(0.0, size.arm - 0.012)
    block = cushion((-inner, -size.y, size.foot + 0.02), (inner, -size.y + size.deep, size.top), soft)
    return Part("back", leaned(block, size.base, size.slope), look)


def _arms(draw: Draw, size: _Size, soft: float, look: Look) -> Parts:
    """Draw two arms: a box, a slim panel, a slope to the front, or a roll on top.

    `soft` is the radius of the rounded edges of a box and of a slope.
    """
    if size.arm == 0:
        return
    kind = draw.choose(["box", "sloped", "rolled"] if size.arm > 0.11 else ["box", "sloped"])
    front, top = size.y - draw.between(0.0, 0.05), size.arm_top
    for s in SIDES:
        low, high = sorted([s * (size.x - size.arm), s * size.x])
        if kind == "box":
            shape = cushion((low, -size.y + 0.006, size.foot), (high, front, top), soft)
        elif kind == "sloped":
            rear = cushion((low, -size.y + 0.006, size.foot), (high, -size.y + 0.2, top + 0.08), soft)
            shape = type(rear).batch_hull(
                [rear, cushion((low, front - 0.15, size.foot), (high, front, top - 0.04), soft)]
            )
        else:
            radius = size.arm * 0.55
            middle = s * (size.x - size.arm / 2)
            roll = rod((middle, -size.y + 0.03, top - radius), (middle, front, top - radius), radius)
            thin = cushion(
                (low + 0.02, -size.y + 0.02, size.foot), (high - 0.02, front - 0.012, top - radius), 0.02
            )
            shape = union([thin, roll])
        yield Part("arm", shape, look)


def _seat_cushions(draw: Draw, size: _Size, inner: float, look: Look) -> Parts:
    """Draw seat cushions, one for each seat or one for all, in the width from x = -`inner` to `inner`."""
    count = size.seats if draw.chance(0.8) else 1
    front = size.y + draw.between(-0.02, 0.02)
    soft, crown = draw.between(0.03, 0.05), draw.between(0.008, 0.03)
    rear = -size.y + size.deep - 0.06
    for left, right in pairwise(np.linspace(-inner, inner, count + 1).tolist()):
        low, high = (left + 0.003, rear, size.base - 0.012), (right - 0.003, front, size.seat)
        yield Part("cushion", cushion(low, high, soft, crown), look)


def _back_cushions(draw: Draw, size: _Size, inner: float, look: Look) -> Parts:
    """Draw back cushions, one for each seat, in the width from x = -`inner` to `inner`."""
    thick, soft = draw.between(0.1, 0.16), draw.between(0.04, 0.06)
    top = size.top + draw.between(-0.06, 0.06)
    y = -size.y + size.deep
    for left, right in pairwise(np.linspace(-inner, inner, size.seats + 1).tolist()):
        block = cushion((left + 0.004, y - 0.03, size.seat - 0.02), (right - 0.004, y + thick, top), soft)
        yield Part("back cushion", leaned(block, size.base, size.slope + 0.05), look)


def _pillows(draw: Draw, size: _Size, inner: float, ahead: float) -> Parts:
    """Draw one or two square pillows in the seat's corners, leaning in front of the back.

    The seat reaches from x = -`inner` to `inner`; the pillows' middles are `ahead` metres in front of the
    back's face.
    """
    look, edge = draw.pick(looks.CLOTHS), draw.between(0.34, 0.42)
    y = -size.y + size.deep + ahead
    for s in SIDES[: draw.integer(1, 3)]:
        x = s * (inner - edge / 2 - 0.01)
        block = cushion(
            (x - edge / 2, y - 0.08, size.seat - 0.015), (x + edge / 2, y + 0.08, size.seat + edge), 0.06
        )
        yield Part("pillow", leaned(block, size.base, size.slope + 0.2), look)


def _feet(draw: Draw, size: _Size, half: tuple[float, float]) -> Parts:
    """Draw short feet, tapered legs, steel runners or a plinth; nothing for a couch on the floor.

    `half` is half the couch's width along x and half its depth along y; the feet stand inside of that.
    """
    if size.foot == 0:
        return
    wood, metal, x, y = draw.pick(looks.WOODS), draw.pick(looks.METALS), half[0] - 0.07, half[1] - 0.08
    kind = draw.choose(["block", "tapered", "round", "runner"] if size.foot > 0.07 else ["block", "plinth"])
    head = size.foot + 0.03
    if kind == "plinth":
        yield Part("plinth", box((-x, -y, 0.0), (x, y, head)), wood)
        return
    if kind == "runner":
        yield from bases.square_loops((x, half[1] - 0.05), head, 0.026, metal)
        return
    foot, thick = {"block": (0.05, 0.05), "tapered": (0.026, 0.05), "round": (0.028, 0.045)}[kind]
    splay = 0.03 if kind == "tapered" else 0.0
    for sx, sy in product((-1, 0, 1) if size.seats == 3 else SIDES, SIDES):
        at = (sx * (x + splay), sy * (y + splay), 0.0)
        yield Part("foot", leg(at, (sx * x, sy * y, head), foot, thick, is_round=kind == "round"), wood)


def _corner(draw: Draw, size: _Size) -> Parts:
    """Draw a corner couch, an L in plan: its last seat extends to the front as a chaise."""
    look, soft, side = draw.pick(looks.COVERS), draw.between(0.02, 0.04), draw.choose(SIDES)
    size = replace(size, seats=max(2, size.seats), arm=max(0.1, size.arm))
    size = replace(size, x=min(1.04, max(0.85, size.x)))
    inner, reach = size.x - size.arm, size.y + draw.between(0.4, 0.62)
    start = inner - 2 * inner / size.seats
    low, high = sorted([side * start, side * (size.x - 0.004)])
    chaise = cushion((low, -size.y + 0.01, size.foot + 0.003), (high, reach - 0.015, size.base), 0.018)
    yield _body(size, look)
    yield Part("chaise", chaise, look)
    yield _back(size, soft, look)
    yield from _arms(draw, size, soft, look)
    rear, top = -size.y + size.deep - 0.06, size.seat
    low, high = sorted([side * (start + 0.003), side * (inner + size.arm * 0.4)])
    lounge = cushion((low, rear, size.base - 0.012), (high, reach, top), 0.045, 0.015)
    yield Part("chaise cushion", lounge, look)
    low, high = sorted([side * start, -side * inner])
    for left, right in pairwise(np.linspace(low, high, size.seats).tolist()):
        block = cushion((left + 0.003, rear, size.base - 0.012), (right - 0.003, size.y, top), 0.045, 0.015)
        yield Part("cushion", block, look)
    yield from _back_cushions(draw, size, inner, look)
    if size.foot == 0:
        return
    if draw.chance(0.5):
        yield from _pillows(draw, size, inner, 0.2)
    wood, head = draw.pick(looks.WOODS), size.foot + 0.03
    corners = [(s * (size.x - 0.07), y) for s, y in product(SIDES, (-size.y + 0.08, size.y - 0.1))]
    corners += [(x, reach - 0.1) for x in (side * (start + 0.07), side * (size.x - 0.07))]
    for at in corners:
        yield Part("foot", leg((*at, 0.0), (*at, head), 0.04, 0.05), wood)


def _chesterfield(draw: Draw, size: _Size) -> Parts:
    """Draw a Chesterfield: arms and a back of one height with a roll on top, and turned feet."""
    look, wood = draw.pick(looks.LEATHERS + looks.CLOTHS), draw.pick(looks.WOODS)
    size = replace(size, foot=draw.between(0.07, 0.12), seats=max(2, size.seats))
    size = replace(size, x=max(0.72, min(1.05, size.x)), base=max(size.base, size.foot + 0.12))
    roll = draw.between(0.075, 0.1)
    z, x, y = size.seat + draw.between(0.24, 0.34), size.x - roll, size.y - roll
    wall, front = 1.3 * roll, size.y - 0.02
    body = cushion((-x, -y, size.foot), (x, front - 0.03, size.base), 0.02)
    rear = cushion((-x, -y - 0.7 * wall, size.foot), (x, -y + 0.7 * wall, z), 0.03)
    yield Part("body", body, look)
    yield Part("back", union([rear, rod((-x, -y, z), (x, -y, z), roll)]), look)
    for s in SIDES:
        side = cushion((s * x - wall / 2, -y, size.foot), (s * x + wall / 2, front - 0.012, z), 0.03)
        arm = [side, rod((s * x, -y, z), (s * x, front, z), roll), _ball((s * x, -y, z), roll)]
        yield Part("arm", union(arm), look)
    inner = x - wall / 2 + 0.01
    edges = np.linspace(-inner, inner, size.seats + 1 if draw.chance(0.7) else 2)
    for left, right in pairwise(edges.tolist()):
        low, high = (left + 0.003, -y + 0.02, size.base - 0.012), (right - 0.003, front, size.seat)
        yield Part("cushion", cushion(low, high, 0.04, 0.02), look)
    for sx, sy in CORNERS:
        at = (sx * (x - 0.04), sy * (y - 0.02))
        yield Part("foot", leg((*at, 0.0), (*at, size.foot + 0.03), 0.035, 0.07, is_round=True), wood)


def _wooden(draw: Draw, size: _Size) -> Parts:
    """Draw a couch with a wooden frame: open arms, and loose cushions on slats."""
    wood, look = draw.pick(looks.WOODS), draw.pick(looks.COVERS)
    size = replace(
        size, arm=0.05, x=max(0.42, size.x - size.arm + 0.05), top=size.seat + draw.between(0.34, 0.44)
    )
    post, y, x = draw.between(0.035, 0.05), size.y, size.x - 0.025
    low, slope = size.base - 0.03, draw.between(0.15, 0.3)
    back_y = -y + 0.16
    for s in SIDES:
        for at in (-y + 0.05, y - 0.05):
            end = size.arm_top - 0.012
            yield Part("leg", leg((s * x, at, 0.0), (s * x, at, end), post * 0.75, post), wood)
        arm = plate(rectangle((0.065, 2 * y), 0.025), size.arm_top - 0.026, size.arm_top, 0.008)
        yield Part("armrest", arm.translate((s * x, 0.0, 0.0)), wood)
        rail = box((s * x - 0.014, -y + 0.05, low - 0.03), (s * x + 0.014, y - 0.05, low + 0.03))
        yield Part("side rail", rail, wood)
    for at in (-y + 0.1, y - 0.06):
        yield Part("rail", box((-x, at - 0.014, low - 0.028), (x, at + 0.014, low + 0.028)), wood)
    for at in np.linspace(-y + 0.2, y - 0.14, 4).tolist():
        yield Part("slat", box((-x, at - 0.03, low + 0.008), (x, at + 0.03, low + 0.03)), wood)
    frame = Back(x, back_y - 0.03, size.base, size.top - 0.04, slope, 0.0, 0.03, wood)
    yield from [
        frame.upright("back post", at, low - 0.02, size.top - 0.04, 0.035)
        for at in np.linspace(-x + 0.03, x - 0.03, 4 if size.seats > 1 else 3).tolist()
    ]
    yield from [frame.rail(size.top - 0.1, size.top - 0.04), frame.rail(size.seat + 0.04, size.seat + 0.08)]
    yield Part("rail", box((-x, back_y - 0.05, low - 0.026), (x, back_y + 0.01, low + 0.02)), wood)
    inner = x - post / 2 - 0.004
    for left, right in pairwise(np.linspace(-inner, inner, size.seats + 1).tolist()):
        corner, opposite = (left + 0.003, back_y - 0.02, low + 0.022), (right - 0.003, y, size.seat)
        yield Part("cushion", cushion(corner, opposite, 0.035, 0.012), look)
        corner, opposite = (
            (left + 0.004, back_y - 0.025, size.seat - 0.01),
            (right - 0.004, back_y + 0.1, size.top),
        )
        pad = cushion(corner, opposite, 0.04)
        yield Part("back cushion", leaned(pad, size.base, slope), look)


def _tub(draw: Draw, size: _Size) -> Parts:
    """Draw a tub couch: a round wall, lower at the front, around one or two seats."""
    look, wide = draw.pick(looks.COVERS), draw.between(0.09, 0.13)
    x, y = draw.between(0.40, 0.46) + (0.26 if draw.chance(0.4) else 0.0), size.y
    radius = draw.between(0.55, 0.95) * min(x, y)
    outer = plate(rectangle((2 * x, 2 * y), radius), size.foot, size.top, 0.02)
    hollow = rectangle((2 * (x - wide), 2 * y), max(0.05, radius - wide))
    wall = outer - plate(hollow, size.base, size.top + 0.1).translate((0.0, wide, 0.0))
    fall = (size.top - size.arm_top) / (2 * y)
    normal = np.array([0.0, -fall, -1.0]) / np.hypot(1.0, fall)
    wall = wall.trim_by_plane((0.0, float(normal[1]), float(normal[2])), float(normal @ [0.0, -y, size.top]))
    seat = plate(hollow * 0.995, size.base - 0.012, size.seat, 0.04).translate((0.0, wide - 0.02, 0.0))
    front = plate(rectangle((2 * x + 1, 2 * y), 0.0), 0.0, 2.0)
    yield Part("wall", wall, look)
    yield Part("cushion", seat ^ front, look if draw.chance(0.6) else draw.pick(looks.CLOTHS))
    yield from _feet(draw, replace(size, seats=1), (0.8 * x + 0.02, 0.8 * y + 0.02))


def _ball(at: tuple[float, float, float], radius: float) -> Manifold:
    return Manifold.sphere(radius, 24).translate(at)
