"""Houses for pets, and ovens: a room wider than the low doorway through which one looks into it."""

from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.shapes import box, cushion, plate, rectangle, rod, turned
from kinectbench_plugins import palettes

if TYPE_CHECKING:
    from manifold3d import Manifold

# Sides of a dome's equator: facets of 20 mm on an oven of 60 cm; own choice.
SEGMENTS = 96


def kennel(draw: Draw) -> Parts:
    """Draw a dog's house, a domed oven or a cat's cave; its doorway faces +y, its walls are 14 mm or more."""
    yield from draw.choose([_gabled, _gabled, _domed, _cave])(draw)


def _prism(outline_xz: list[tuple[float, float]], low_y: float, high_y: float) -> "Manifold":
    """A convex outline (n, 2) of x and z, extruded along y."""
    from manifold3d import Manifold

    points = [(x, y, z) for y in (low_y, high_y) for x, z in outline_xz]
    return Manifold.hull_points(np.array(points))


def _doorway(half: float, low: float, top: float, from_y: float, arched: bool) -> "Manifold":
    """What is cut out of the front for a doorway, from a y onwards; perhaps with a round arch."""
    from manifold3d import Manifold

    if not arched:
        return box((-half, from_y, low), (half, 2.0, top))
    round_part = Manifold.cylinder(2.0 - from_y, half, half, SEGMENTS).rotate((-90.0, 0.0, 0.0))
    return box((-half, from_y, low), (half, 2.0, top - half)) + round_part.translate(
        (0.0, from_y, top - half)
    )


def _gabled(draw: Draw) -> Parts:
    """A dog's house of boards with a gabled roof that stands out, perhaps on feet, perhaps with a sill."""
    x, y = draw.between(0.24, 0.36), draw.between(0.28, 0.45)
    foot = draw.choose([0.0, draw.between(0.03, 0.07)])
    eaves = foot + draw.between(0.34, 0.5)
    ridge = eaves + draw.between(0.5, 0.9) * x
    wall, floor = draw.between(0.016, 0.024), draw.between(0.016, 0.03)
    look, roof_look = draw.pick(looks.WOODS + looks.PLASTICS[:4]), draw.pick(looks.WOODS + looks.IRONS)
    outer = _prism([(-x, foot), (x, foot), (x, eaves), (0.0, ridge), (-x, eaves)], -y, y)
    inner = [
        (-x + wall, foot + floor),
        (x - wall, foot + floor),
        (x - wall, eaves),
        (0.0, ridge - 1.2 * wall),
        (-x + wall, eaves),
    ]
    half = draw.between(0.3, 0.5) * x
    door_low = foot + floor + draw.choose([0.0, draw.between(0.03, 0.08)])
    door_top = door_low + draw.between(0.55, 0.8) * (eaves - door_low)
    aside = draw.choose([0.0, draw.between(-0.35, 0.35) * x])
    door = _doorway(half, door_low, door_top, y - 0.1, draw.chance(0.6)).translate((aside, 0.0, 0.0))
    yield Part("house", outer - _prism(inner, -y + wall, y - wall) - door, look)
    thick, over, front = draw.between(0.016, 0.026), draw.between(0.03, 0.09), draw.between(0.02, 0.09)
    steep = (ridge - eaves) / x
    low = eaves - over * steep
    slopes = [
        (-x - over, low - 0.004),
        (-x - over, low + thick),
        (0.0, ridge + thick),
        (x + over, low + thick),
        (x + over, low - 0.004),
        (0.0, ridge - 0.004),
    ]
    halves = [
        _prism([slopes[0], slopes[1], slopes[2], slopes[5]], -y - 0.02, y + front),
        _prism([slopes[2], slopes[3], slopes[4], slopes[5]], -y - 0.02, y + front),
    ]
    yield Part("roof", halves[0] + halves[1], roof_look)
    if foot:
        for sx, sy in CORNERS:
            at = (sx * (x - 0.04), sy * (y - 0.04))
            yield Part(
                "foot",
                box((at[0] - 0.025, at[1] - 0.025, 0), (at[0] + 0.025, at[1] + 0.025, foot + 0.004)),
                look,
            )
    if draw.chance(0.4):
        sill = box(
            (aside - half - 0.02, y - wall, door_low - 0.03), (aside + half + 0.02, y + 0.03, door_low)
        )
        yield Part("sill", sill, roof_look)


def _domed(draw: Draw) -> Parts:
    """An oven for bread: a dome of clay on a plate, an arched mouth with a frame, perhaps a flue."""
    from manifold3d import Manifold

    radius, rise = draw.between(0.27, 0.38), draw.between(0.26, 0.36)
    wall, base = draw.between(0.035, 0.06), draw.between(0.03, 0.08)
    look = draw.pick(palettes.CLAYS + looks.STONES)
    ball = Manifold.sphere(1.0, SEGMENTS)
    dome = (
        ball.scale((radius, radius, rise)).translate((0.0, 0.0, base)).trim_by_plane((0, 0, 1), base - 0.004)
    )
    room = ball.scale((radius - wall, radius - wall, rise - wall)).translate((0.0, 0.0, base))
    room = room.trim_by_plane((0, 0, 1), base)
    half = draw.between(0.32, 0.5) * radius
    top = base + draw.between(0.5, 0.66) * (rise - wall)
    half = min(half, top - base - 0.02)
    door = _doorway(half, base, top, 0.3 * radius, True)
    stone = _doorway(half + 0.035, base - 0.004, top + 0.035, 0.5 * radius, True)
    stone = stone ^ box((-1, 0, 0), (1, radius + draw.between(0.02, 0.06), 1))
    side = radius + draw.between(0.03, 0.09)
    plinth = plate(rectangle((2 * side, 2 * side), draw.choose([0.01, 0.1])), 0.0, base)
    yield Part("dome", (dome - room) - door, look)
    yield Part("frame", stone - room - door, draw.pick(looks.STONES))
    yield Part("plate", plinth, draw.pick(looks.STONES + looks.WOODS))
    if draw.chance(0.5):
        at_y = draw.between(-0.2, 0.2) * radius
        flue = rod((0, at_y, base + 0.8 * rise), (0, at_y, base + rise + draw.between(0.1, 0.25)), 0.05)
        yield Part("flue", flue - room, draw.pick(looks.IRONS))


def _cave(draw: Draw) -> Parts:
    """A cat's cave of felt: a round thick shell with a round hole at the front, perhaps with ears."""
    from manifold3d import Manifold

    radius, high = draw.between(0.2, 0.27), draw.between(0.28, 0.38)
    wall = draw.between(0.014, 0.03)
    look = draw.pick(looks.CLOTHS)
    heights = np.linspace(-1.0, 1.0, 25)

    def shell(in_m: float) -> "Manifold":
        """A body of revolution, flat below, smaller by `in_m` on all sides."""
        widths = (radius - in_m) * np.maximum(1 - np.abs(heights) ** 2.6, 0) ** (1 / 2.6)
        rows = [
            (float(w), float(in_m + (h + 1) / 2 * (high - 2 * in_m)))
            for w, h in zip(widths, heights, strict=True)
        ]
        return turned(
            [(0.0, rows[0][1]), (0.7 * (radius - in_m), rows[0][1]), *rows[3:-1], (0.0, rows[-1][1])]
        )

    hole = draw.between(0.075, 0.1)
    middle = draw.between(0.4, 0.5) * high
    low = Manifold.cylinder(1.0, hole, 1.1 * hole, SEGMENTS).rotate((-90.0, 0.0, 0.0))
    room = shell(wall)
    yield Part("shell", shell(0.0) - room - low.translate((0.0, 0.3 * radius, middle)), look)
    if draw.chance(0.5):
        for side in SIDES:
            foot = np.array([(-0.06, -0.014, 0), (0.06, -0.014, 0), (0.06, 0.014, 0), (-0.06, 0.014, 0)])
            tip = np.array([(0.01 * side, -0.008, 0.1), (0.01 * side, 0.008, 0.1)])
            ear = Manifold.hull_points(np.concatenate([foot, tip])).translate(
                (side * 0.45 * radius, 0.0, 0.85 * high)
            )
            yield Part("ear", ear - room, look)
    if draw.chance(0.5):
        pad = cushion(
            (-0.55 * radius, -0.55 * radius, wall - 0.004), (0.55 * radius, 0.55 * radius, wall + 0.03), 0.014
        )
        yield Part("pad", pad ^ shell(wall / 2), draw.pick(looks.CLOTHS))
