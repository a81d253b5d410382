"""Ladders that stand on their own, and trays with a rim on folding, turned or legged stands."""

from dataclasses import dataclass

import numpy as np

from kinectbench.lab.simulate.objects import bases, looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Outline,
    Vector3,
    bar_between,
    box,
    ellipse,
    leg,
    plate,
    rectangle,
    rod,
    rounded_path,
    tube,
    turned,
)


@dataclass(frozen=True)
class _Rails:
    """Two leaning side rails, mirror images in x, each from a foot on the floor to a head; metres."""

    foot: Vector3
    head: Vector3

    def at(self, z_m: float) -> Vector3:
        """The right rail's middle at a height."""
        share = (z_m - self.foot[2]) / (self.head[2] - self.foot[2])
        x, y = (a + share * (b - a) for a, b in zip(self.foot[:2], self.head[:2], strict=True))
        return x, y, z_m

    def drawn(self, name: str, size_m: tuple[float, float], look: Look) -> Parts:
        """Both rails, `size_m` thick in x and y."""
        for s in SIDES:
            foot, head = (s * self.foot[0], *self.foot[1:]), (s * self.head[0], *self.head[1:])
            yield Part(name, leg(foot, head, size_m, size_m), look)


def ladder(draw: Draw) -> Parts:
    """Draw a step ladder that stands open; one climbs it from the front, +y."""
    return draw.choose([_platform_ladder, _platform_ladder, _double_ladder, _step_stool])(draw)


def _platform_ladder(draw: Draw) -> Parts:
    """Flat treads between two leaning rails, a platform, two legs behind, and perhaps a loop to hold."""
    count, rise = draw.integer(3, 6), draw.between(0.21, 0.26)
    top, wide = count * rise, draw.between(0.19, 0.26)
    narrow, lean = wide * draw.between(0.72, 0.9), draw.between(0.28, 0.36)
    deep = draw.between(0.2, 0.28)
    metal = draw.pick((*looks.METALS[:2], *looks.WOODS[:2]))
    step = metal if draw.chance(0.4) else draw.pick(looks.PLASTICS[:4] + looks.WOODS[:3])
    thick, broad = draw.between(0.02, 0.028), draw.between(0.04, 0.065)
    # The rails end inside the platform.
    head = top - 0.008
    front = _Rails((wide, lean * top + deep / 2, 0.0), (narrow, deep / 2, head))
    rear = _Rails((wide - 0.01, -0.18 * top - deep / 2, 0.0), (narrow - thick / 2, 0.02 - deep / 2, head))
    yield from front.drawn("rail", (thick, broad), metal)
    yield from rear.drawn("leg", (thick, 0.7 * broad), metal)
    tread, high = draw.between(0.08, 0.12), draw.between(0.02, 0.035)
    for k in range(1, count):
        x, y, z = front.at(k * rise)
        yield Part("tread", box((-x, y - tread / 2, z - high), (x, y + tread / 2, z)), step)
    x, y = narrow + thick / 2 + 0.006, (deep + broad) / 2 + 0.012
    platform = box((-x, -y, top - 0.03), (x, y, top))
    yield Part("platform", platform, step)
    for z in np.linspace(0.12, 0.72, draw.integer(1, 4)).tolist():
        x, y, z = rear.at(z * top)
        yield Part("cross bar", box((-x, y - 0.009, z - 0.018), (x, y + 0.009, z + 0.018)), metal)
    if draw.chance(0.6):
        yield from _spreaders(front, rear, top * draw.between(0.45, 0.6), metal)
    if draw.chance(0.6):
        y, high = 0.02 - deep / 2, top + draw.between(0.3, 0.6)
        lean = draw.between(-0.05, 0.1) * (high - top)
        ends = [(s * narrow, y, top - 0.02) for s in SIDES]
        heads = [(s * narrow * 0.9, y + lean, high) for s in SIDES]
        loop = rounded_path([ends[0], *heads, ends[1]], 0.06)
        yield Part("handle", tube(loop, draw.between(0.01, 0.014)), metal)


def _spreaders(front: _Rails, rear: _Rails, z_m: float, look: Look) -> Parts:
    """Bars that hold the front and rear legs apart, one on each side."""
    a, b = front.at(z_m), rear.at(z_m)
    for s in SIDES:
        shape = bar_between((s * a[0], a[1], z_m), (s * b[0], b[1], z_m), 0.014, 0.025)
        yield Part("spreader", shape, look)


def _double_ladder(draw: Draw) -> Parts:
    """Rungs or narrow treads between two pairs of wooden rails that meet at the top."""
    count, rise = draw.integer(3, 7), draw.between(0.22, 0.28)
    top, wide = count * rise + draw.between(0.0, 0.06), draw.between(0.2, 0.28)
    head = top - 0.004
    narrow, spread = wide * draw.between(0.65, 0.9), draw.between(0.24, 0.33)
    wood, thick, broad = draw.pick(looks.WOODS), draw.between(0.022, 0.03), draw.between(0.045, 0.07)
    front = _Rails((wide, spread * top, 0.0), (narrow, 0.4 * broad, head))
    rear = _Rails((wide - 0.004, -spread * top, 0.0), (narrow - 0.004, -0.4 * broad, head))
    yield from front.drawn("rail", (thick, broad), wood)
    yield from rear.drawn("rail", (thick - 0.002, broad), wood)
    # A board rests on the four heads, or a bar goes through them.
    x, y = narrow + 0.03, broad + 0.012
    if draw.chance(0.5):
        yield Part("cap", box((-x, -y, top - 0.02), (x, y, top + 0.008)), wood)
    else:
        yield Part("hinge", box((-narrow, -0.03, top - 0.06), (narrow, 0.03, top - 0.005)), wood)
    round_rungs = draw.chance(0.5)
    for rails, number in ((front, count), (rear, draw.choose([count, 2, 3]))):
        for z in (np.arange(1, number) * (top / number)).tolist():
            x, y, z = rails.at(z)
            if round_rungs:
                yield Part("rung", rod((-x, y, z), (x, y, z), 0.014), wood)
            else:
                # A little less deep than the rails, so that no edge of it lies in their faces.
                half = broad / 2 - 0.003
                yield Part("tread", box((-x, y - half, z - 0.022), (x, y + half, z)), wood)
    if draw.chance(0.7):
        yield from _spreaders(front, rear, top * draw.between(0.3, 0.45), wood)


def _step_stool(draw: Draw) -> Parts:
    """Two or three deep steps, one behind the other, between frames of posts or on solid sides."""
    count, rise, run = draw.integer(2, 4), draw.between(0.2, 0.24), draw.between(0.16, 0.22)
    half, thick = draw.between(0.18, 0.24), draw.between(0.018, 0.028)
    wood, closed = draw.pick(looks.WOODS), draw.chance(0.3)
    step = wood if draw.chance(0.5) else draw.pick(looks.PLASTICS[:4] + looks.WOODS[:4])
    for k in range(count):
        # The highest step stands at the back.
        front, top = -k * run, (k + 1) * rise
        yield Part("step", box((-half, front - run - 0.03, top - thick), (half, front, top)), step)
        for s in SIDES:
            x = s * (half - 0.03)
            low, high = x - 0.0125, x + 0.0125
            if closed:
                yield Part("side", box((low, -count * run, 0.0), (high, front - 0.01, top - 0.004)), wood)
                continue
            post = box((low, front - 0.045, 0.0), (high, front - 0.015, top - 0.004))
            yield Part("post", post, wood)
            # A rail is 4 mm thinner than the posts that it goes through, so that the two share no plane.
            head, rear = top - thick + 0.002, -count * run
            rail = box((low + 0.002, rear, head - 0.032), (high - 0.002, front - 0.02, head))
            yield Part("rail", rail, wood)
    if not closed:
        for s in SIDES:
            x, rear = s * (half - 0.03), -count * run
            yield Part(
                "post", box((x - 0.0125, rear - 0.015, 0.0), (x + 0.0125, rear + 0.015, top - 0.004)), wood
            )
        cross = box((-half + 0.03, rear - 0.009, 0.1), (half - 0.03, rear + 0.009, 0.135))
        yield Part("cross bar", cross, wood)


def tray_stand(draw: Draw) -> Parts:
    """Draw a tray with a rim on a stand; its longer side lies along x."""
    round_tray, y = draw.chance(0.4), draw.between(0.16, 0.24)
    x = y * draw.choose([1.0, draw.between(1.1, 1.35)]) if round_tray else y * draw.between(1.2, 1.6)
    head = draw.between(0.42, 0.72)
    look, corner = draw.pick(looks.WOODS + looks.METALS[:2]), draw.choose([0.0, 0.03, 0.06])
    outline = ellipse((2 * x, 2 * y)) if round_tray else rectangle((2 * x, 2 * y), corner)
    yield from _tray(draw, outline, head, look)
    if not round_tray and draw.chance(0.6):
        yield from _grips(draw, (x, y - corner), head, look)
    # Legs and rods end inside the tray's floor.
    top, wood = head + 0.006, look if draw.chance(0.4) else draw.pick(looks.WOODS + looks.METALS[:2])
    kind = draw.choose(["folding", "turned", "legs"])
    if kind == "folding":
        # The rails end under the tray.
        share = 0.62 if round_tray else 0.74
        yield from _folding_stand(draw, (share * x, share * y), top, wood)
    elif kind == "turned":
        yield from _turned_stand(draw, 0.85 * y, top, wood)
    else:
        yield from _legged_stand(draw, (x, y), top, wood, round_tray=round_tray)


def _tray(draw: Draw, outline: Outline, low_m: float, look: Look) -> Parts:
    """A floor with a rim around it."""
    wall, high = draw.between(0.0125, 0.016), draw.between(0.035, 0.065)
    floor = draw.between(0.0125, 0.016)
    half = np.ptp(outline, axis=0) / 2
    inner = outline * (1 - wall / half)
    dish = plate(outline, low_m, low_m + high) - plate(inner, low_m + floor, low_m + high + 0.01)
    yield Part("tray", dish, look)


def _grips(draw: Draw, half_m: tuple[float, float], low_m: float, look: Look) -> Parts:
    """Higher ends with slots to grip; `half_m` is where they stand in x and how far they reach in y."""
    from manifold3d import Manifold

    (x, y), top = half_m, low_m + draw.between(0.085, 0.11)
    slot = box((-1.0, -0.045, low_m + 0.04), (1.0, 0.045, top - 0.02))
    for s in SIDES:
        low, high = sorted([s * (x - 0.001), s * (x - 0.017)])
        root = box((low, -0.9 * y, low_m + 0.003), (high, 0.9 * y, low_m + 0.03))
        head = box((low, -0.065, top - 0.01), (high, 0.065, top))
        yield Part("end", Manifold.batch_hull([root, head]) - slot, look)


def _folding_stand(draw: Draw, half_m: tuple[float, float], head_m: float, look: Look) -> Parts:
    """Two frames that cross, one a little narrower, each with a bar under the tray and one near the floor."""
    (x, y), thick = half_m, draw.between(0.02, 0.028)
    foot, low = y * draw.between(1.0, 1.25), draw.between(0.06, 0.14)
    for way, wide in ((1, x), (-1, x - thick + 0.003)):
        for s in SIDES:
            # Their sides are no planes of the other frame's, and the two overlap by 3 mm where they cross.
            size = (thick, thick * 1.2)
            ends = (s * wide, -way * foot, 0.0), (s * wide, way * y, head_m - 0.012)
            yield Part("leg", leg(*ends, size, size), look)
        at = way * (y - (y + foot) * (1 - low / head_m))
        yield Part("stretcher", rod((-wide, at, low), (wide, at, low), draw.between(0.008, 0.012)), look)
        shape = box((-wide - 0.01, way * y - 0.014, head_m - 0.034), (wide + 0.01, way * y + 0.014, head_m))
        yield Part("rail", shape, look)
    if draw.chance(0.5):
        middle = head_m * foot / (foot + y)
        yield Part("pivot", rod((-x, 0.0, middle), (x, 0.0, middle), 0.009), look)


def _turned_stand(draw: Draw, reach_m: float, head_m: float, look: Look) -> Parts:
    """A column turned on a lathe on three or four feet that curve down to the floor."""
    radius, low = draw.between(0.018, 0.028), draw.between(0.14, 0.2)
    beads = draw.integer(1, 4)
    share = np.linspace(0, 1, 33)
    swell = radius * (1 + draw.between(0.3, 0.7) * np.abs(np.sin(beads * np.pi * share)) ** 3)
    # The column ends in a plate under the tray.
    swell[-3:] = (1.6 * radius, 2.4 * radius, 2.4 * radius)
    heights = low - 0.03 + share * (head_m - low + 0.03)
    rings = list(zip(swell.tolist(), heights.tolist(), strict=True))
    yield Part("column", turned([(0.0, rings[0][1]), *rings, (0.0, head_m)]), look)
    count, thick = draw.integer(3, 5), draw.between(0.009, 0.012)
    for turn in np.arange(count) * 2 * np.pi / count + np.pi / 2:
        x, y = float(np.cos(turn)), float(np.sin(turn))
        path = [(0.0, low + 0.02), (0.45 * reach_m, low + 0.01), (0.8 * reach_m, 0.02), (reach_m, thick)]
        curve = rounded_path([(r * x, r * y, z) for r, z in path], 0.08)
        foot = tube(curve, thick)
        yield Part("foot", foot.trim_by_plane((0.0, 0.0, 1.0), 0.0), look)


def _legged_stand(
    draw: Draw, half_m: tuple[float, float], head_m: float, look: Look, *, round_tray: bool
) -> Parts:
    """Three or four legs, perhaps splayed, perhaps with bars that meet in the middle."""
    x, y = (0.7 * value for value in half_m)
    thick, splay = draw.between(0.024, 0.034), draw.between(1.0, 1.2)
    if round_tray:
        count, z = draw.integer(3, 5), head_m * draw.between(0.25, 0.5)
        yield from bases.round_legs(count, y * splay, 0.8 * y, head_m, thick, look)
        reach = y * splay + (0.8 * y - y * splay) * z / head_m
        for turn in np.arange(count) * 2 * np.pi / count + np.pi / 2:
            tip = (reach * float(np.cos(turn)), reach * float(np.sin(turn)), z)
            yield Part("stretcher", rod((0.0, 0.0, z), tip, 0.009), look)
        return
    for sx, sy in CORNERS:
        foot, top = (sx * x * splay, sy * y * splay, 0.0), (sx * x, sy * y, head_m)
        yield Part("leg", leg(foot, top, 0.85 * thick, thick), look)
    rails = (x, y), (head_m - 0.05, head_m)
    yield from bases.ring("apron", *rails, 0.008, look)
    if draw.chance(0.6):
        z = head_m * draw.between(0.2, 0.4)
        out = 1 + (splay - 1) * (1 - z / head_m)
        shelf = box((-x * out, -y * out, z), (x * out, y * out, z + 0.015))
        yield Part("shelf", shelf, look)
