"""Chairs: wooden ones, Windsors, shells, upholstered ones, tubular cantilevers and office chairs."""

from dataclasses import dataclass

import numpy as np

from kinectbench.lab.simulate.objects import backs, bases, looks
from kinectbench.lab.simulate.objects.backs import Back
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Points,
    bent,
    bowed,
    box,
    cushion,
    ellipse,
    leaned,
    leg,
    plate,
    rectangle,
    ribbon,
    rod,
    rounded_path,
    tube,
)


@dataclass(frozen=True)
class _Size:
    """Half width and half depth of the seat, heights of its upper face and of the back's top; metres."""

    x: float
    y: float
    seat: float
    top: float


def chair(draw: Draw) -> Parts:
    """Draw a chair whose front faces +y."""
    size = _Size(
        x=draw.between(0.20, 0.255),
        y=draw.between(0.20, 0.24),
        seat=(seat := draw.between(0.42, 0.48)),
        top=seat + draw.between(0.34, 0.55),
    )
    kinds = [_wooden, _wooden, _wooden, _board, _windsor, _shell, _shell, _upholstered, _tubular, _office]
    return draw.choose(kinds)(draw, size)


def _wooden(draw: Draw, size: _Size) -> Parts:
    """Draw a wooden chair whose rear legs continue as posts of the back, perhaps with aprons and armrests."""
    wood, thick, post = draw.pick(looks.WOODS), draw.between(0.018, 0.03), draw.between(0.028, 0.042)
    under, x, y = size.seat - thick, size.x - post / 2, size.y - post / 2
    rake, slope = draw.between(0.0, 0.06), draw.between(0.05, 0.26)
    foot = max(0.022, post * draw.between(0.7, 1.0))
    yield Part("seat", plate(rectangle((2 * size.x, 2 * size.y)), under, size.seat), wood)
    for s in SIDES:
        front = leg((s * x, y, 0.0), (s * x, y, under + 0.01), foot, post)
        rear = leg((s * x, -y - rake, 0.0), (s * x, -y, size.seat), foot, post)
        yield Part("front leg", front, wood)
        yield Part("rear leg", rear, wood)
    bow = draw.between(0.015, 0.045) if draw.chance(0.6) else 0.0
    back = Back(x, -y, size.seat, size.top, slope, bow, post, wood)
    yield from back.posts()
    yield from backs.filling(draw, back)
    if draw.chance(0.7):
        yield from bases.apron((x, y), under + 0.005, draw.between(0.045, 0.08), wood)
    if draw.chance(0.5):
        z = draw.between(0.12, 0.24)
        yield from bases.stretchers(draw, (x, y), z, wood, rake * (1 - z / size.seat))
    yield from _seat_pad(draw, size)
    if draw.chance(0.35):
        yield from _post_arms(draw, size, back)


def _seat_pad(draw: Draw, size: _Size) -> Parts:
    """Draw a cushion on the seat by chance, else nothing."""
    if draw.chance(0.55):
        return []
    look, inset, thick = draw.pick(looks.COVERS), draw.between(0.012, 0.03), draw.between(0.025, 0.05)
    low = (-size.x + inset, -size.y + 0.05, size.seat - 0.008)
    high = (size.x - inset, size.y - inset * 0.5, size.seat + thick)
    return [Part("cushion", cushion(low, high, 0.018, 0.015), look)]


def _post_arms(draw: Draw, size: _Size, back: Back) -> Parts:
    """Draw wooden armrests from the back's posts to posts on the front legs or on the seat."""
    z, wide = size.seat + draw.between(0.18, 0.24), draw.between(0.035, 0.06)
    front = size.y - (back.thick / 2 if draw.chance(0.6) else draw.between(0.08, 0.14))
    out = draw.between(0.0, 0.03)
    for s in SIDES:
        rear = back.point(back.half, z)[1] - back.thick / 4
        x = s * back.half
        bottom = box((x - 0.016, rear, z - 0.024), (x + 0.016, rear + 0.03, z))
        tip = box(
            (x + s * out - wide / 2, front - 0.03, z - 0.022), (x + s * out + wide / 2, front + 0.03, z)
        )
        arm = type(tip).batch_hull([bottom, tip])
        post = leg((x, front, size.seat - 0.015), (x + s * out, front, z - 0.008), 0.028, 0.024)
        yield Part("armrest", arm, back.look)
        yield Part("arm post", post, back.look)


def _board(draw: Draw, size: _Size) -> Parts:
    """Draw a modern wooden or plastic chair: a seat with round corners on legs, a bent board as a back."""
    wood = draw.pick(looks.WOODS)
    look = wood if draw.chance(0.5) else draw.pick(looks.PLASTICS)
    thick = draw.between(0.024, 0.04)
    under = size.seat - thick
    outline = rectangle((2 * size.x, 2 * size.y), draw.between(0.04, 0.15))
    yield Part("seat", plate(outline, under, size.seat, 0.01), look)
    leg_m = draw.between(0.03, 0.04)
    yield from bases.wooden_legs(draw, (size.x - 0.06, size.y - 0.06), under + 0.014, leg_m, wood)
    back = Back(
        size.x - 0.03,
        -size.y + 0.05,
        size.seat,
        size.top - 0.05,
        draw.between(0.1, 0.25),
        draw.between(0.02, 0.05),
        0.026,
        look,
    )
    yield from backs.board_back(draw, back)


def _windsor(draw: Draw, size: _Size) -> Parts:
    """Draw a Windsor chair: a thick seat on splayed round legs, and a hoop with spindles as its back."""
    wood, thick = draw.pick(looks.WOODS), draw.between(0.032, 0.045)
    seat = plate(ellipse((2 * size.x, 2 * size.y)), size.seat - thick, size.seat, 0.012)
    yield Part("seat", seat, wood)
    x, y, splay, head = 0.55 * size.x, 0.55 * size.y, draw.between(0.05, 0.08), size.seat - thick / 2
    for sx, sy in CORNERS:
        foot = (sx * (x + splay), sy * (y + splay), 0.0)
        yield Part("leg", leg(foot, (sx * x, sy * y, head), 0.024, 0.036, is_round=True), wood)
    z = 0.4 * head
    out = splay * (1 - z / head)
    for s in SIDES:
        ends = (s * (x + out), -y - out, z), (s * (x + out), y + out, z)
        yield Part("stretcher", rod(*ends, 0.01), wood)
    yield Part("stretcher", rod((-x - out, 0.0, z), (x + out, 0.0, z), 0.0085), wood)
    # The hoop's ends are where the round seat is still wide enough.
    slope = draw.between(0.12, 0.25)
    half = 0.72 * size.x
    back = Back(half, -0.56 * size.y, size.seat, size.top + 0.04, slope, 0.2 * size.y, 0.024, wood)
    yield from backs.hoop(draw, back)


def _shell(draw: Draw, size: _Size) -> Parts:
    """Draw a shell chair: seat and back in one bent piece, on legs, a tube frame, a column or a star."""
    look = draw.pick(looks.PLASTICS + looks.WOODS[:5] + looks.CLOTHS[:5])
    thick, lean = draw.between(0.017, 0.022), draw.between(0.08, 0.17)
    under = size.seat - thick
    path = [
        (size.y, size.seat - 0.035),
        (size.y - 0.06, under + thick / 2),
        (-size.y + 0.02, under + thick / 2),
        (-size.y - lean, size.top),
    ]
    wide = size.x + 0.01
    strip = ribbon(rounded_path(path, draw.between(0.07, 0.14)), (-wide, wide), thick)
    corner = draw.between(0.05, 0.14)
    plan = plate(rectangle((2 * size.x, 2.0), corner), -1.0, 3.0).translate(
        (0.0, size.y + thick / 2 - 1.002, 0.0)
    )
    front = plate(rectangle((2 * size.x, 3.0), corner), -2.0, 2.0).rotate((90.0, 0.0, 0.0))
    strip = strip ^ plan ^ front.translate((0.0, 0.0, size.top + thick / 2 - 1.502))
    if draw.chance(0.25):
        hole = plate(rectangle((0.14, 0.04), 0.019), -2.0, 2.0).rotate((90.0, 0.0, 0.0))
        strip = strip - hole.translate((0.0, 0.0, size.top - 0.09))
    dish, hug = draw.between(0.0, 0.02), draw.between(0.0, 0.06)

    def bucket(points: Points) -> Points:
        """Bend the strip, (n, 3) metres, into the shape of a seat."""
        side = (points[:, 0] / size.x) ** 2
        upright = np.clip((points[:, 2] - size.seat) / 0.2, 0, 1)
        upright = upright**2 * (3 - 2 * upright)
        # The sides of the seat rise, and the sides of the back come forward.
        return points + np.column_stack(
            [np.zeros(len(points)), hug * side * upright, dish * side * (1 - upright)]
        )

    yield Part("shell", bent(strip, bucket, 0.04), look)
    yield from _shell_base(draw, size, under)


def _shell_base(draw: Draw, size: _Size, under: float) -> Parts:
    """Draw the base of a shell chair; it reaches a little above the shell's underside at height `under`."""
    metal, wood, head = draw.pick(looks.METALS), draw.pick(looks.WOODS), under + 0.008
    kind = draw.choose(["wood", "tube", "sled", "star", "column"])
    if kind == "wood":
        yield Part("hub", box((-0.12, -0.12, under - 0.02), (0.12, 0.12, head)), wood)
        for sx, sy in CORNERS:
            foot = (sx * (size.x - 0.02), sy * (size.y - 0.02), 0.0)
            shape = leg(foot, (sx * 0.1, sy * 0.1, head - 0.006), 0.024, 0.036, is_round=True)
            yield Part("leg", shape, wood)
    elif kind == "tube":
        yield from bases.tube_legs(
            (0.6 * size.x, 0.7 * size.y), head, draw.between(0.009, 0.012), 0.06, metal
        )
    elif kind == "sled":
        yield from bases.sled((0.6 * size.x, size.y), head, draw.between(0.009, 0.011), metal)
    elif kind == "star":
        count, wheels = draw.integer(4, 6), draw.chance(0.4)
        yield from bases.star(draw, count, draw.between(0.27, 0.31), head, 0.05, metal, wheels=wheels)
    else:
        yield from bases.column(draw, draw.between(0.23, 0.27), head, draw.between(0.05, 0.07), metal)


def _upholstered(draw: Draw, size: _Size) -> Parts:
    """Draw an upholstered chair: padded seat and back on wooden legs, perhaps with padded sides."""
    look, wood = draw.pick(looks.COVERS), draw.pick(looks.WOODS)
    x, y, thick = size.x + draw.between(0.0, 0.04), size.y + draw.between(0.0, 0.03), draw.between(0.07, 0.11)
    under, deep = size.seat - thick, draw.between(0.06, 0.09)
    slope = draw.between(0.08, 0.25)
    seat = cushion((-x, -y, under), (x, y, size.seat), 0.03, 0.02)
    low = (-x + 0.004, -y, under + 0.02)
    high = (x - 0.004, -y + deep, size.top - draw.between(0.0, 0.1))
    back = leaned(cushion(low, high, 0.03), size.seat, slope)
    yield Part("seat", seat, look)
    yield Part("back", back, look)
    yield from bases.wooden_legs(draw, (x - 0.05, y - 0.045), under + 0.02, draw.between(0.03, 0.042), wood)
    if draw.chance(0.4):
        top, wide = size.seat + draw.between(0.14, 0.22), draw.between(0.055, 0.08)
        for s in SIDES:
            out = s * (x + wide / 2 - 0.015)
            side = cushion((out - wide / 2, -y + 0.01, under), (out + wide / 2, y - 0.03, top), 0.026)
            yield Part("armrest", side, look)


def _tubular(draw: Draw, size: _Size) -> Parts:
    """Draw a cantilever chair: a bent tube on each side carries the pads of seat and back."""
    metal, look = draw.pick(looks.METALS), draw.pick(looks.LEATHERS + looks.CLOTHS + looks.WOODS[:3])
    radius, x, y = draw.between(0.0095, 0.0125), size.x, size.y
    lean, z = draw.between(0.05, 0.13), size.seat - 0.03
    for s in SIDES:
        path = [
            (s * x, -y - lean, size.top),
            (s * x, -y, z + 0.06),
            (s * x, -y + 0.02, z),
            (s * x, y, z),
            (s * x, y - 0.03, radius),
            (s * x, -y - 0.02, radius),
        ]
        yield Part("frame", tube(rounded_path(path, 0.07), radius), metal)
    for at, height in ((-y - 0.02, radius), (y - 0.08, z), (-y + 0.1, z)):
        # A rail a little thinner than the frame touches none of the frame's edges.
        yield Part("rail", rod((-x, at, height), (x, at, height), 0.9 * radius), metal)
    pad = cushion((-x - 0.004, -y + 0.05, z - 0.004), (x + 0.004, y - 0.02, size.seat + 0.01), 0.016)
    low, slope = size.top - draw.between(0.2, 0.3), lean / (size.top - z - 0.06)
    deep = draw.between(0.018, 0.035)
    board = bowed((-x, -y - deep / 2, low), (x, -y + deep / 2, size.top - 0.01), draw.between(0.0, 0.04))
    yield Part("seat", pad, look)
    yield Part("back", leaned(board, z + 0.06, slope), look)
    if draw.chance(0.45):
        yield from _tube_arms(draw, size, slope, z, radius, metal)


def _tube_arms(draw: Draw, size: _Size, slope: float, frame_z: float, radius: float, look: Look) -> Parts:
    """Draw armrests: two bent tubes, each from the back to the front of the frame on its side."""
    z, front = size.seat + draw.between(0.17, 0.23), size.y - draw.between(0.05, 0.12)
    wood = draw.pick(looks.WOODS)
    for s in SIDES:
        rear = -size.y - slope * (z - frame_z - 0.06)
        path = [(s * size.x, rear, z), (s * size.x, front, z), (s * size.x, front, frame_z)]
        yield Part("armrest", tube(rounded_path(path, 0.06), 0.94 * radius), look)
        pad = cushion(
            (s * size.x - 0.022, rear + 0.07, z), (s * size.x + 0.022, front - 0.07, z + radius + 0.016), 0.01
        )
        yield Part("arm pad", pad, wood)


def _office(draw: Draw, size: _Size) -> Parts:
    """Draw an office chair: a padded seat on a star with castors, a back on a spine, perhaps armrests."""
    look, metal = draw.pick(looks.COVERS), draw.pick(looks.METALS)
    thick, x, y = draw.between(0.06, 0.09), size.x, size.y
    under, slope = size.seat - thick, draw.between(0.08, 0.2)
    yield Part("seat", cushion((-x, -y, under), (x, y, size.seat), 0.03, 0.015), look)
    yield from bases.star(draw, 5, draw.between(0.29, 0.32), under + 0.02, 0.055, metal, wheels=True)
    low, wide, rear = size.seat + draw.between(0.02, 0.14), x * draw.between(0.8, 1.0), -y - 0.02
    pad = cushion((-wide, rear - 0.01, low), (wide, rear + 0.05, size.top + 0.05), 0.024)
    hug = draw.between(0.02, 0.05)

    def wrap(points: Points) -> Points:
        return points + np.array([0.0, hug, 0.0]) * (points[:, :1] / wide) ** 2

    yield Part("back", leaned(bent(pad, wrap, 0.06), size.seat, slope), look)
    top = size.seat + 0.65 * (size.top - size.seat)
    path = [(0.05, under - 0.004), (rear - 0.01, under - 0.004), (rear - slope * (top - size.seat), top)]
    yield Part("spine", ribbon(rounded_path(path, 0.06), (-0.03, 0.03), 0.02), metal)
    if draw.chance(0.6):
        yield from _office_arms(draw, size, under, metal)


def _office_arms(draw: Draw, size: _Size, under: float, look: Look) -> Parts:
    """Draw T-shaped armrests or closed loops, on brackets at the height `under` of the seat's underside."""
    z, out = size.seat + draw.between(0.19, 0.24), size.x + 0.035
    loop = draw.chance(0.4)
    for s in SIDES:
        if loop:
            x = s * out
            path = [
                (x, 0.1, under + 0.002),
                (x, 0.14, z - 0.012),
                (x, -0.16, z - 0.012),
                (x, -0.08, under + 0.002),
            ]
            yield Part("arm post", tube(rounded_path([*path, path[0]], 0.05), 0.012), look)
        else:
            post = box((s * out - 0.012, -0.03, under - 0.012), (s * out + 0.012, 0.03, z - 0.01))
            yield Part("arm post", post, look)
        low, high = sorted([s * out + s * 0.01, s * 0.08])
        yield Part("bracket", box((low, -0.025, under - 0.012), (high, 0.025, under + 0.008)), look)
        pad = cushion((s * out - 0.035, -0.13, z - 0.02), (s * out + 0.035, 0.13, z + 0.012), 0.014)
        yield Part("arm pad", pad, Look((0.12, 0.12, 0.13), 0.10))
