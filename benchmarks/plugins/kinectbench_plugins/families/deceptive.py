"""Shapes whose inside hardly any camera sees: shells on feet, gaps, hanging flaps, bodies with a hole."""

from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import box, plate, rectangle, rod, turned
from kinectbench_plugins import palettes
from kinectbench_plugins.families import vessels
from kinectbench_plugins.families.vessels import Vessel

if TYPE_CHECKING:
    from manifold3d import Manifold


def shell(draw: Draw) -> Parts:
    """Draw a bowl or a tub upside down on three or four low feet: nobody sees that it is hollow.

    Walls of 12 to 16 mm, 0.4 to 0.6 m wide, over a gap of 15 to 22 mm.
    """
    wall, gap = draw.between(0.012, 0.016), draw.between(0.015, 0.022)
    look = draw.pick(palettes.CERAMICS + looks.PLASTICS + palettes.CLAYS)
    half, high = draw.between(0.2, 0.3), draw.between(0.16, 0.32)
    count, round_one, deep = draw.integer(3, 5), draw.chance(0.5), draw.between(0.65, 1.0) * half
    if round_one:
        yield Part("shell", _bowl(half, high, gap) - _bowl(half - wall, high - wall, gap), look)
    else:
        side = rectangle((2 * half, 2 * deep))
        top = side * draw.between(0.8, 0.95)
        inner, inner_top = (outline * (1 - wall / outline.max(axis=0)) for outline in (side, top))
        tub = vessels.tub(side, top, gap, gap + high)
        yield Part("shell", tub - vessels.tub(inner, inner_top, gap - 0.01, gap + high - wall), look)
    for k in range(count):
        turn = 2 * np.pi * (k + 0.5) / count
        x, y = float(np.cos(turn)), float(np.sin(turn))
        # In the middle of the wall, on a circle or a rectangle.
        along = half - wall / 2 if round_one else min((half - wall / 2) / abs(x), (deep - wall / 2) / abs(y))
        foot = rod((0.0, 0.0, 0.0), (0.0, 0.0, gap + 0.012), 0.02)
        yield Part("foot", foot.translate((along * x, along * y, 0.0)), look)


def _bowl(radius_m: float, high_m: float, base_m: float) -> "Manifold":
    """Half an ellipsoid of revolution that stands on a height."""
    turn = np.linspace(0, np.pi / 2, 24)
    profile = [(radius_m * np.cos(at), base_m + high_m * np.sin(at)) for at in turn]
    return turned([(0.0, base_m), *profile])


def two_boxes(draw: Draw) -> Parts:
    """Draw two closed bodies side by side on one board, with a gap of 15 to 60 mm between them."""
    gap, board = draw.between(0.015, 0.06), draw.between(0.012, 0.02)
    deep, look = draw.between(0.25, 0.45), draw.pick(looks.WOODS + looks.PLASTICS)
    wide = draw.between(0.18, 0.4), draw.between(0.18, 0.4)
    high = draw.between(0.3, 0.7)
    other = high if draw.chance(0.5) else draw.between(0.3, 0.7)
    yield Part("board", box((-wide[0] - gap / 2, 0.0, 0.0), (wide[1] + gap / 2, deep, board)), look)
    bodies = (-wide[0] - gap / 2, -gap / 2, high), (gap / 2, wide[1] + gap / 2, other)
    for low_x, high_x, top in bodies:
        body_look = look if draw.chance(0.5) else draw.pick(looks.WOODS + looks.PLASTICS)
        yield Part("body", box((low_x, 0.0, board / 2), (high_x, deep, top)), body_look)


def flap_box(draw: Draw) -> Parts:
    """Draw a card box that stands open, with flaps that hang beside its walls: narrow wedges under them."""
    wide = draw.between(0.3, 0.5)
    size = wide, wide * draw.between(0.6, 0.95), draw.between(0.25, 0.45)
    wall, look = draw.between(0.012, 0.016), draw.pick(palettes.CARDS)
    inside = rectangle((size[0] - 2 * wall, size[1] - 2 * wall))
    card = Vessel(inside, inside, 0.0, wall, size[2], wall)
    yield Part("body", card.body(), look)
    for side in draw.choose([(0, 1, 2, 3), (0, 2), (1, 3), (0, 1, 2)]):
        angle = draw.between(2.35, 2.8)  # radians from upright: 20 to 45 degrees off the wall
        across, along = (size[0], size[1]) if side % 2 == 0 else (size[1], size[0])
        long = draw.between(0.35, 0.6) * size[2] / -np.cos(angle)
        half, thick = along / 2 - 1.2 * wall, wall / 2
        flap = box((-thick, -half, 0.0), (thick, half, long))
        crease = rod((0.0, -half, 0.0), (0.0, half, 0.0), thick)
        hung = (flap + crease).rotate((0.0, float(np.degrees(angle)), 0.0))
        placed = hung.translate((across / 2 - wall / 2, 0.0, size[2]))
        yield Part("flap", vessels.turned_by(placed, side * np.pi / 2), look)


def sound_box(draw: Draw) -> Parts:
    """Draw a hollow body of boards that stands upright, with one round hole of 40 to 110 mm in its front."""
    wall, look = draw.between(0.012, 0.016), draw.pick(looks.WOODS)
    wide, deep, high = draw.between(0.24, 0.45), draw.between(0.14, 0.3), draw.between(0.3, 0.7)
    radius = draw.between(0.02, 0.055)
    if draw.chance(0.5):
        outer = box((-wide / 2, -deep / 2, 0.0), (wide / 2, deep / 2, high))
        inner = box(
            (-wide / 2 + wall, -deep / 2 + wall, wall), (wide / 2 - wall, deep / 2 - wall, high - wall)
        )
    else:
        side = rectangle((wide, deep), 0.45 * deep)
        within = rectangle((wide - 2 * wall, deep - 2 * wall), 0.45 * deep - wall)
        outer, inner = plate(side, 0.0, high), plate(within, wall, high - wall)
    at = draw.between(-0.15, 0.15) * wide, draw.between(0.45, 0.75) * high
    hole = rod((at[0], 0.0, at[1]), (at[0], deep, at[1]), radius)
    yield Part("body", outer - inner - hole, look)
    if draw.chance(0.5):
        yield from _ring(at, deep, radius, draw.pick(looks.WOODS))


def _ring(at: tuple[float, float], deep_m: float, radius_m: float, look: Look) -> Parts:
    """A ring around the hole."""
    front = deep_m / 2
    outer = rod((at[0], front - 0.006, at[1]), (at[0], front + 0.008, at[1]), radius_m + 0.018)
    inner = rod((at[0], front - 0.02, at[1]), (at[0], front + 0.02, at[1]), radius_m)
    yield Part("ring", outer - inner, look)
