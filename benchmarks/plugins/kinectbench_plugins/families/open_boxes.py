"""Boxes that are open at the top, of card, wood or plastic, and drawers that lie on the floor."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import Vector3, box, rectangle, rod, rounded_path, tube
from kinectbench_plugins import palettes
from kinectbench_plugins.families import vessels
from kinectbench_plugins.families.vessels import THIN_M, Rim, Vessel, both_sides

if TYPE_CHECKING:
    from manifold3d import Manifold

# Nearer to upright two flaps would touch at their corner; farther down a flap lies against its wall.
FLAP_LEAST_RAD, FLAP_MOST_RAD = 0.12, 2.2


def open_box(draw: Draw) -> Parts:
    """Draw a card box with flaps standing open, a wooden box, or a storage box."""
    return draw.choose([_card, _card, _wooden, _storage])(draw)


def _straight(draw: Draw, size: Vector3, base_m: float = 0.0) -> Vessel:
    """A vessel with upright walls and sharp corners, of outer width, depth and height."""
    wall, bottom = draw.between(THIN_M, 0.017), draw.between(THIN_M, 0.018)
    inside = rectangle((size[0] - 2 * wall, size[1] - 2 * wall))
    return Vessel(inside, inside, base_m, base_m + bottom, size[2], wall)


def _dividers(draw: Draw, hollow: Vessel, look: Look) -> Parts:
    """A board across the cavity, or two that cross."""
    half = np.ptp(hollow.low, axis=0) / 2 + 0.4 * hollow.wall_m
    thick = draw.between(THIN_M, 0.015) / 2
    high = hollow.floor_m + draw.between(0.55, 0.95) * (hollow.top_m - hollow.floor_m)
    at, low = draw.between(-0.4, 0.4) * float(half[0]), hollow.floor_m - 0.006
    long = box((at - thick, -half[1], low), (at + thick, half[1], high))
    yield Part("divider", long ^ hollow.core(), look)
    if draw.chance(0.4):
        y = draw.between(-0.3, 0.3) * float(half[1])
        cross = box((-half[0], y - thick, low), (half[0], y + thick, high - 0.004))
        yield Part("divider", cross ^ hollow.core(), look)


def _card(draw: Draw) -> Parts:
    """A card box; each of its flaps stands up, sticks out, or hangs, or is cut off."""
    wide = draw.between(0.26, 0.52)
    size = (wide, wide * draw.between(0.6, 0.95), draw.between(0.16, 0.42))
    look = draw.pick(palettes.CARDS + palettes.CARDS[:2])
    card = _straight(draw, size)
    yield Part("body", card.body(), look)
    long = min(0.22, draw.between(0.4, 0.5) * size[1])
    kept = draw.choose([(0, 1, 2, 3), (0, 1, 2, 3), (0, 2), (1, 3), (1, 2, 3), ()])
    same = draw.between(FLAP_LEAST_RAD, FLAP_MOST_RAD) if draw.chance(0.3) else None
    for side in kept:
        angle = draw.between(FLAP_LEAST_RAD, FLAP_MOST_RAD) if same is None else same
        across, along = (size[0], size[1]) if side % 2 == 0 else (size[1], size[0])
        flap = _flap(card, across / 2 - card.wall_m / 2, along - 2.4 * card.wall_m, long, angle)
        yield Part("flap", vessels.turned_by(flap, side * np.pi / 2), look)
    if draw.chance(0.3):
        hole = vessels.slot(card, (0.0, 0.72 * size[2]), 0.09, 0.028)
        patch = vessels.block_handle(card, 0.35 * size[2], 0.1, 0.004, 0.07)
        yield from both_sides(
            "label", patch - hole, draw.pick(palettes.CARDS[2:] + looks.PLASTICS[:5]), (0.0,)
        )


def _flap(card: Vessel, hinge_m: float, width_m: float, long_m: float, angle_rad: float) -> "Manifold":
    """A flap on the wall at +x, turned outward from upright by an angle, and its crease.

    Args:
        card: whose wall.
        hinge_m: distance of the wall's middle from the box's.
        width_m: along the wall.
        long_m: from the crease to its free edge, if that stays above the floor.
        angle_rad: 0 for upright, pi / 2 for level.
    """
    half, thick = width_m / 2, card.wall_m / 2
    down = max(0.0, -float(np.cos(angle_rad)))
    long_m = min(long_m, (card.top_m - 0.03) / down) if down > 0 else long_m
    flap = box((-thick, -half, 0.0), (thick, half, long_m))
    crease = rod((0.0, -half, 0.0), (0.0, half, 0.0), thick)
    whole = (flap + crease).rotate((0.0, float(np.degrees(angle_rad)), 0.0))
    return whole.translate((hinge_m, 0.0, card.top_m))


def _wooden(draw: Draw) -> Parts:
    """A box of boards with battens, hand holes or grips, and perhaps dividers."""
    wide = draw.between(0.3, 0.6)
    size = (wide, wide * draw.between(0.55, 0.9), draw.between(0.14, 0.36))
    look, base = draw.pick(looks.WOODS[:7]), draw.between(0.018, 0.03) if draw.chance(0.4) else 0.0
    trim = look if draw.chance(0.5) else draw.pick(looks.WOODS[:7])
    crate = _straight(draw, size, base)
    body, holes = crate.body(), draw.chance(0.5)
    if holes:
        hole = vessels.slot(
            crate, (0.0, size[2] - 0.055), draw.between(0.085, 0.12), draw.between(0.028, 0.034)
        )
        body = body - hole - vessels.turned_by(hole, np.pi)
    yield Part("body", body, look)
    x, y = size[0] / 2, size[1] / 2
    if base:
        for s in SIDES:
            at = s * (x - 0.06)
            yield Part("foot", box((at - 0.03, -y, 0.0), (at + 0.03, y, base + 0.005)), trim)
    style = draw.choose(["posts", "boards", "plain"])
    if style == "posts":
        thick, rise = draw.between(0.028, 0.04), draw.choose([0.0, 0.0, 0.025])
        for sx, sy in CORNERS:
            (x0, x1), (y0, y1) = (sorted([s * (e - thick), s * (e + 0.006)]) for s, e in ((sx, x), (sy, y)))
            post = box((x0, y0, base), (x1, y1, size[2] + 0.004 + rise))
            yield Part("post", post - crate.core() if not rise else post - crate.cavity(), trim)
    elif style == "boards":
        count = draw.integer(2, 4)
        pitch = (size[2] - base) / count
        for k in range(count):
            low = base + k * pitch
            if not (holes and k == count - 1):
                yield Part("board", crate.band(low + 0.006, low + pitch - 0.006, 0.006), trim)
    if not holes and draw.chance(0.7):
        radius, z = draw.between(0.0075, 0.01), size[2] - 0.05
        grip = vessels.loop_handle(crate, z, draw.between(0.1, 0.14), draw.between(0.04, 0.05), radius)
        yield from both_sides("handle", grip, draw.pick(looks.METALS + looks.CLOTHS[4:6]))
    if draw.chance(0.3):
        yield from _dividers(draw, crate, look)


def _storage(draw: Draw) -> Parts:
    """A tapered box of plastic with round corners and a rim, with lugs or hand holes."""
    wide = draw.between(0.32, 0.6)
    deep, high = wide * draw.between(0.6, 0.8), draw.between(0.16, 0.36)
    wall, bottom, share = draw.between(0.014, 0.018), draw.between(0.014, 0.018), draw.between(0.82, 0.97)
    inside, radius = np.array([wide, deep]) - 2 * wall, draw.between(0.02, 0.05)
    low, top = (rectangle((float(x), float(y)), radius) for x, y in (inside * share, inside))
    look = draw.pick(looks.PLASTICS[:5] + looks.PLASTICS)
    tub = Vessel(low, top, 0.0, bottom, high, wall, draw.choose([0.0, 0.015]))
    body, holes = tub.body(), draw.chance(0.4)
    if holes:
        hole = vessels.slot(tub, (0.0, high - 0.06), 0.1, 0.03)
        body = body - hole - vessels.turned_by(hole, np.pi)
    yield Part("body", body, look)
    rims: tuple[Rim, ...] = ("rolled", "plain") if holes else ("flanged", "flanged", "collar", "rolled")
    yield from vessels.rim(draw, tub, draw.choose(rims), look)
    if not holes and draw.chance(0.5):
        lug = vessels.block_handle(tub, high - 0.02, draw.between(0.1, 0.15), 0.05, 0.03)
        yield from both_sides("handle", lug, draw.pick(looks.PLASTICS[:5]))
    if draw.chance(0.2):
        yield from _dividers(draw, tub, look)


def drawer(draw: Draw) -> Parts:
    """Draw a drawer that lies on the floor, its front to +y, with knobs, a grip, or a notch."""
    x, y = draw.between(0.17, 0.4), draw.between(0.18, 0.27)
    high, wall = draw.between(0.09, 0.22), draw.between(THIN_M, 0.016)
    look, face_look = draw.pick(looks.WOODS[:7]), draw.pick(looks.WOODS)
    face_look = look if draw.chance(0.3) else face_look
    raised = draw.between(0.008, 0.014) if draw.chance(0.4) else 0.0
    back = high * draw.between(0.75, 0.95) if draw.chance(0.4) else high
    for s in SIDES:
        x0, x1 = sorted([s * x, s * (x - wall)])
        yield Part("side", box((x0, -y, 0.0), (x1, y, high)), look)
    yield Part("back", box((-x, -y, 0.0), (x, -y + wall, back)), look)
    floor = raised + draw.between(THIN_M, 0.016)
    yield Part("bottom", box((-x + 0.006, -y + 0.006, raised), (x - 0.006, y, floor)), look)
    if draw.chance(0.4):
        z, thick = draw.between(0.4, 0.7) * high, 0.007
        for s in SIDES:
            x0, x1 = sorted([s * (x - 0.006), s * (x + 0.012)])
            strip = box((x0, -y, z - thick - 0.002), (x1, y - 0.01, z + thick))
            yield Part("runner", strip, draw.pick(looks.METALS[:2] + looks.WOODS[:4]))
    if draw.chance(0.35):
        inside = rectangle((2 * (x - wall), 2 * (y - wall)))
        yield from _dividers(draw, Vessel(inside, inside, 0.0, floor, min(high, back), wall), look)
    yield from _front(draw, (x, y, high), face_look)


def _front(draw: Draw, half: Vector3, look: Look) -> Parts:
    """The front of a drawer: higher than its sides and perhaps wider, and what it is pulled by.

    Args:
        draw: draws it.
        half: half width, distance of the front's back face from the middle, and height of the sides.
        look: of the front.
    """
    x, y, top = half[0] + draw.choose([0.0, draw.between(0.008, 0.025)]), half[1] - 0.001, half[2]
    thick, top = draw.between(0.016, 0.022), top + draw.between(0.008, 0.04)
    front, face, z = box((-x, y, 0.0), (x, y + thick, top)), y + thick, top / 2
    pull = draw.choose(["knobs", "knobs", "bar", "notch", "block"])
    if pull == "notch":
        bite = rod((0.0, y - 0.05, top + 0.008), (0.0, face + 0.05, top + 0.008), draw.between(0.03, 0.038))
        front = front - bite
    yield Part("front", front, look)
    if draw.chance(0.3):
        yield from _frame((x, face, top), draw.between(0.02, 0.03), look)
    metal = draw.pick(looks.METALS + looks.WOODS[:5])
    if pull == "knobs":
        yield from _knobs(draw, (0.0,) if x < 0.26 else (-0.5 * x, 0.5 * x), face, z, metal)
    elif pull == "bar":
        reach, radius = draw.between(0.04, min(0.12, 0.6 * x)), draw.between(0.0068, 0.009)
        far, near = face + draw.between(0.03, 0.04), face - 0.01
        path = [(-reach, near, z), (-reach, far, z), (reach, far, z), (reach, near, z)]
        yield Part("grip", tube(rounded_path(path, 0.015), radius), metal)
    elif pull == "block":
        reach = draw.between(0.04, 0.08)
        yield Part("grip", box((-reach, face - 0.008, z - 0.008), (reach, face + 0.024, z + 0.008)), metal)


def _frame(corner: Vector3, width_m: float, look: Look) -> Parts:
    """A raised frame around a front whose upper right corner in front is `corner`."""
    x, y, top = corner
    z, face, back = top / 2, y + 0.006, y - 0.01
    outside = box((-x + 0.002, back, 0.002), (x - 0.002, face, top - 0.006))
    inside = box((-x + width_m, back - 0.1, width_m), (x - width_m, face + 0.1, 2 * z - width_m))
    yield Part("frame", outside - inside, look)


def _knobs(draw: Draw, places_m: Sequence[float], face_m: float, height_m: float, look: Look) -> Parts:
    """Round knobs on short necks."""
    neck, head, out = draw.between(0.0075, 0.01), draw.between(0.014, 0.02), draw.between(0.012, 0.018)
    for x in places_m:
        at = (face_m - 0.008, face_m + out, face_m + out + 0.014)
        stem = rod((x, at[0], height_m), (x, at[2], height_m), neck)
        yield Part("knob", stem + rod((x, at[1], height_m), (x, at[2], height_m), head), look)
