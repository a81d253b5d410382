"""Wash basins that stand on a pedestal or a cabinet, and trough sinks on legs."""

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Vector3,
    box,
    cushion,
    leg,
    plate,
    rectangle,
    rod,
    rounded_path,
    tube,
    turned,
)
from kinectbench_plugins import palettes
from kinectbench_plugins.families import vessels
from kinectbench_plugins.families.vessels import Footprint, Vessel, footprint

BASIN_KINDS: tuple[Footprint, ...] = ("oval", "oval", "rectangle", "rectangle", "round")
# A pedestal's heights and radii, as shares of its height and of its foot's radius.
PEDESTAL = ((0.0, 1.0), (0.05, 1.0), (0.12, 0.82), (0.5, 0.66), (0.8, 0.72), (1.0, 1.0))


def sink(draw: Draw) -> Parts:
    """Draw a wash basin on a pedestal or a cabinet, or a trough; its taps are at the back (-y)."""
    return draw.choose([_pedestal, _cabinet, _trough])(draw)


def _basin(draw: Draw, top_m: float, *, deep_m: float) -> Vessel:
    """A bowl with a round lower edge whose underside is `deep_m` under its rim."""
    kind = draw.choose(BASIN_KINDS)
    wide = draw.between(0.42, 0.62) if kind != "round" else draw.between(0.38, 0.46)
    deep = wide if kind == "round" else wide * draw.between(0.66, 0.8)
    wall, share = draw.between(0.014, 0.02), draw.between(0.62, 0.85)
    inside = (wide - 2 * wall, deep - 2 * wall)
    radius = draw.between(0.04, 0.09) if kind == "rectangle" else 0.0
    low = footprint(kind, (share * inside[0], share * inside[1]), min(radius, 0.3 * share * inside[1]))
    high = footprint(kind, inside, min(radius, 0.3 * share * inside[1]))
    base = top_m - deep_m
    return Vessel(low, high, base, base + draw.between(0.016, 0.024), top_m, wall, draw.between(0.015, 0.045))


def _deck(draw: Draw, basin: Vessel, look: Look) -> tuple[Part, float]:
    """The slab behind a bowl on which the taps stand, and the y of its middle."""
    outline = basin.outer(basin.top_m)
    half, back = float(outline[:, 0].max()) * draw.between(0.75, 1.0), float(outline[:, 1].min())
    deep, thick = draw.between(0.08, 0.12), draw.between(0.025, 0.05)
    slab = box((-half, back - deep, basin.top_m - thick), (half, 0.4 * back, basin.top_m + 0.003))
    return Part("deck", slab - basin.core(), look), back - deep / 2


def _tap(draw: Draw, back_m: float, top_m: float, reach_m: float) -> Parts:
    """A spout that bends over the bowl, and one lever or two taps beside it.

    Args:
        draw: draws it.
        back_m: y where it stands.
        top_m: height of what it stands on.
        reach_m: y of its mouth.
    """
    metal, radius = draw.pick(looks.METALS[:2]), draw.between(0.0095, 0.013)
    high, low = top_m + draw.between(0.12, 0.26), top_m - 0.012
    mouth = high - draw.between(0.03, 0.06)
    path = [(0.0, back_m, low), (0.0, back_m, high), (0.0, reach_m, high), (0.0, reach_m, mouth)]
    yield Part("spout", tube(rounded_path(path, draw.between(0.03, 0.06)), radius), metal)
    if draw.chance(0.5):
        for s in SIDES:
            at = (s * draw.between(0.07, 0.1), back_m)
            yield Part("tap", rod((*at, low), (*at, top_m + 0.05), 0.014), metal)
            cross = box(
                (at[0] - 0.03, back_m - 0.008, top_m + 0.04), (at[0] + 0.03, back_m + 0.008, top_m + 0.056)
            )
            yield Part("tap", cross, metal)
    else:
        lever = rod((0.0, back_m, top_m + 0.07), (0.09, back_m, top_m + draw.between(0.08, 0.12)), 0.0085)
        yield Part("lever", lever, metal)


def _pedestal(draw: Draw) -> Parts:
    """A basin with a deck on a turned, round or square pedestal."""
    top, look = draw.between(0.78, 0.9), draw.pick(palettes.CERAMICS)
    basin = _basin(draw, top, deep_m=draw.between(0.16, 0.22))
    yield Part("body", basin.body(), look)
    deck, at = _deck(draw, basin, look)
    yield deck
    yield from vessels.rim(draw, basin, draw.choose(("plain", "rolled", "flanged")), look)
    yield from _tap(draw, at, top, 0.35 * float(basin.low[:, 1].min()))
    head, foot = basin.base_m + 0.012, draw.between(0.11, 0.15)
    kind = draw.choose(["turned", "square", "round"])
    # The pedestal stands a little behind the middle, under the deck's weight.
    shift = -draw.between(0.0, 0.04)
    if kind == "turned":
        # The slimmer its waist, the more of each radius is taken away.
        slim = draw.between(0.5, 1.3)
        profile = [((1 - slim * (1 - r)) * foot, share * head) for share, r in PEDESTAL]
        yield Part("pedestal", turned([(0.0, 0.0), *profile, (0.0, head)]).translate((0.0, shift, 0.0)), look)
        return
    ends = ((0.0, shift, 0.0), (0.0, shift, head))
    widths = (1.9 * foot, 1.6 * foot * draw.between(0.75, 1.1))
    yield Part("pedestal", leg(*ends, *widths, is_round=kind == "round"), look)
    plinth = rectangle((2.2 * foot, 2.2 * foot), 0.03)
    yield Part("plinth", plate(plinth, 0.0, draw.between(0.03, 0.06)).translate((0.0, shift, 0.0)), look)


def _cabinet(draw: Draw) -> Parts:
    """A basin sunk into a cabinet with doors or drawers, on a plinth or feet."""
    top, wood = draw.between(0.76, 0.88), draw.pick(looks.WOODS[:7])
    basin = _basin(draw, top, deep_m=draw.between(0.12, 0.2))
    look = draw.pick(palettes.CERAMICS)
    half = basin.outer(top).max(axis=0) + draw.between(0.012, 0.05)
    x, front, back = float(half[0]), float(half[1]), -float(half[1]) - draw.between(0.06, 0.1)
    slab = draw.between(0.02, 0.04)
    raised = draw.choose([0.0, 0.0, draw.between(0.005, 0.05)])
    yield Part("body", basin.body(), look)
    counter = box((-x, back, top - slab - raised), (x, front, top - raised + (0.0 if raised else 0.003)))
    yield Part(
        "top", counter - basin.core(), look if draw.chance(0.5) else draw.pick(looks.STONES + looks.WOODS[:7])
    )
    foot = draw.between(0.05, 0.12)
    low, high = (-x + 0.012, back + 0.012, foot), (x - 0.012, front - 0.03, top - slab - raised + 0.008)
    yield Part("cabinet", box(low, high) - basin.core(), wood)
    yield from _doors(draw, low, high, wood)
    if draw.chance(0.5):
        base = box((low[0] + 0.03, low[1] + 0.02, 0.0), (high[0] - 0.03, high[1] - 0.04, foot + 0.01))
        yield Part("plinth", base, wood)
    else:
        for sx, sy in CORNERS:
            at = ((high[0] - 0.03) * sx, (low[1] + high[1]) / 2 + ((high[1] - low[1]) / 2 - 0.03) * sy)
            yield Part(
                "foot", leg((*at, 0.0), (*at, foot + 0.01), 0.03, 0.045, is_round=draw.chance(0.5)), wood
            )
    yield from _tap(draw, (back + float(basin.outer(top)[:, 1].min())) / 2, top - raised, -0.04)


def _doors(draw: Draw, low: Vector3, high: Vector3, look: Look) -> Parts:
    """Doors or drawer fronts on the front of a cabinet between two corners, each with a knob."""
    edge, face, knobs = 0.008, high[1], draw.pick(looks.METALS)
    rows, columns = draw.choose([(1, 2), (1, 2), (2, 1), (1, 1), (3, 1)])
    xs, zs = np.linspace(low[0], high[0], columns + 1), np.linspace(low[2], high[2] - 0.02, rows + 1)
    for row in range(rows):
        for column in range(columns):
            x0, x1, z0, z1 = (float(v) for v in (*xs[column : column + 2], *zs[row : row + 2]))
            door = box((x0 + edge, face - 0.008, z0 + edge), (x1 - edge, face + 0.014, z1 - edge))
            yield Part("door", door, look)
            x = (x0 + x1) / 2 if columns == 1 else (x1 - 0.04 if column == 0 else x0 + 0.04)
            z = z1 - min(0.08, (z1 - z0) / 2)
            yield Part("knob", rod((x, face + 0.006, z), (x, face + 0.034, z), 0.013), knobs)


def _trough(draw: Draw) -> Parts:
    """A long rectangular sink with one or two bowls and perhaps a board behind it, on legs or blocks."""
    x, y, top = draw.between(0.28, 0.52), draw.between(0.2, 0.27), draw.between(0.74, 0.9)
    look, wall = draw.pick(palettes.CERAMICS + looks.STONES + looks.METALS[:1]), draw.between(0.014, 0.02)
    base, share = top - draw.between(0.2, 0.32), draw.between(0.9, 1.0)
    radius = draw.between(0.02, 0.05)
    inside = np.array([2 * (x - wall), 2 * (y - wall)])
    low, high = (rectangle((float(a), float(b)), radius) for a, b in (inside * share, inside))
    tub = Vessel(low, high, base, base + draw.between(0.016, 0.024), top, wall, draw.between(0.0, 0.02))
    yield Part("body", tub.body(), look)
    yield from vessels.rim(draw, tub, draw.choose(("plain", "rolled", "flanged")), look)
    if x > 0.4 and draw.chance(0.5):
        across = box((-0.009, -y, tub.floor_m - 0.006), (0.009, y, top - 0.02))
        yield Part("divider", across ^ tub.core(), look)
    back = -y + wall * 0.5
    if draw.chance(0.6):
        splash = top + draw.between(0.1, 0.3)
        board = box((-x, -y - 0.012, top - 0.05), (x, -y + 0.004, splash))
        yield Part("splashback", board - tub.core(), look)
        yield from _wall_tap(draw, -y, (top + splash) / 2)
    else:
        block = box((-0.13, -y - 0.05, top - 0.04), (0.13, -y + 0.6 * wall, top + 0.003))
        yield Part("deck", block - tub.core(), look)
        yield from _tap(draw, back - 0.03, top, -0.3 * y)
    yield from _stand(draw, tub, look)


def _wall_tap(draw: Draw, back_m: float, height_m: float) -> Parts:
    """Two taps that stick out of a board behind a trough."""
    metal, reach = draw.pick(looks.METALS[:2]), draw.between(0.1, 0.15)
    for s in SIDES if draw.chance(0.5) else (1,):
        x, y = s * draw.between(0.06, 0.1), back_m + reach
        path = [(x, back_m - 0.006, height_m), (x, y, height_m), (x, y, height_m - 0.04)]
        yield Part("spout", tube(rounded_path(path, 0.02), 0.011), metal)
        yield Part("tap", rod((x, y - 0.05, height_m - 0.005), (x, y - 0.05, height_m + 0.04), 0.012), metal)


def _stand(draw: Draw, tub: Vessel, look: Look) -> Parts:
    """What a trough stands on: four legs with rails, two blocks, or one cushion-edged plinth."""
    half, head = tub.outer(tub.base_m).max(axis=0), tub.base_m + 0.01
    x, y = float(half[0]), float(half[1])
    kind = draw.choose(["legs", "legs", "blocks", "plinth"])
    if kind == "legs":
        metal, thick = draw.pick(looks.METALS + looks.WOODS[:5]), draw.between(0.03, 0.055)
        at = (x - 0.6 * thick - 0.01, y - 0.6 * thick - 0.01)
        for sx, sy in CORNERS:
            place = (sx * at[0], sy * at[1])
            yield Part("leg", leg((*place, 0.0), (*place, head), 0.9 * thick, thick), metal)
        if draw.chance(0.6):
            z = draw.between(0.1, 0.22)
            shelf = box((-at[0], -at[1], z), (at[0], at[1], z + draw.between(0.016, 0.025)))
            yield Part("shelf", shelf, metal)
    elif kind == "blocks":
        wide, stone = draw.between(0.06, 0.12), draw.pick(looks.STONES + palettes.CERAMICS)
        for s in SIDES:
            at_x = s * (x - wide / 2 - 0.03)
            block = box((at_x - wide / 2, -y + 0.02, 0.0), (at_x + wide / 2, y - 0.02, head))
            yield Part("block", block, stone)
    else:
        solid = cushion((-0.7 * x, -0.75 * y, -0.05), (0.7 * x, 0.75 * y, head + 0.05), 0.05)
        yield Part("plinth", solid.trim_by_plane((0, 0, 1), 0.0).trim_by_plane((0, 0, -1), -head), look)
