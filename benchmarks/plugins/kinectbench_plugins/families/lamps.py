"""Lamps for floors and tables: a foot, a stem, and a shade with thin walls, open below and above."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinectbench.lab.simulate.objects import bases, looks
from kinectbench.lab.simulate.objects.joinery import Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    box,
    ellipse,
    plate,
    rod,
    rounded_path,
    tube,
    turned,
    union,
)

if TYPE_CHECKING:
    from manifold3d import Manifold

# Shades are of cloth, paper and plastic that reflect infrared light well, own choice.
SHADES = (
    Look((0.90, 0.86, 0.76), 0.78),
    Look((0.88, 0.87, 0.84), 0.80),
    Look((0.72, 0.60, 0.44), 0.70),
    *looks.CLOTHS[:6],
)
Profile = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class _Shade:
    """A lampshade around the z axis; metres.

    Attributes:
        form: "cone", "bell" or "square".
        low: height of its lower rim.
        high: height of its upper rim.
        wide: radius of its lower rim, half the edge of a square one.
        narrow: radius of its upper rim.
        wall: thickness of its wall, measured square to it.
    """

    form: str
    low: float
    high: float
    wide: float
    narrow: float
    wall: float

    def radius(self, share: float) -> float:
        """Outer radius at a share of its height, from the lower rim on."""
        power = 2.2 if self.form == "bell" else 1.0
        return float(self.narrow + (self.wide - self.narrow) * (1 - share) ** power)

    def solid(self) -> "Manifold":
        """Its wall, open below and above."""
        from manifold3d import CrossSection, FillRule, Manifold

        shares = np.linspace(0, 1, 13 if self.form == "bell" else 2)
        outer = np.array([(self.radius(share), share * (self.high - self.low)) for share in shares.tolist()])
        along = np.gradient(outer, axis=0)
        inward = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
        # Its rims are square to its wall, so that it is nowhere thinner than that.
        profile = np.concatenate([outer, (outer + self.wall * inward)[::-1]]) + np.array([0.0, self.low])
        if self.form != "square":
            return turned([(float(r), float(z)) for r, z in profile])
        # Turned in four steps through the corners, which lie farther out by the root of 2, it has flat sides.
        section = CrossSection([profile * np.array([np.sqrt(2), 1.0])], FillRule.NonZero)
        return Manifold.revolve(section, 4).rotate((0.0, 0.0, 45.0))


def lamp(draw: Draw) -> Parts:
    """Draw a lamp: for the floor on a column or three legs, with its shade on an arm, or for a table."""
    return draw.choose([_floor, _tripod, _arm, _table, _table])(draw)


def _shade(draw: Draw, high_m: float, size_m: float, tall_m: float) -> _Shade:
    """A shade whose upper rim lies at `high_m`, `size_m` in radius below, and about `tall_m` high."""
    form = draw.choose(["cone", "cone", "bell", "square"])
    narrow = size_m * (draw.between(0.45, 0.7) if form == "bell" else draw.between(0.45, 1.0))
    narrow = max(0.06, narrow)
    return _Shade(form, high_m - tall_m, high_m, size_m, narrow, draw.between(0.0125, 0.016))


def _fitting(draw: Draw, shade: _Shade, share: float, look: Look, *, hanging: bool = False) -> Parts:
    """The spokes that hold a shade at a share of its height, and a bulb above them, or below if it hangs."""
    z = shade.low + share * (shade.high - shade.low)
    reach, count = shade.radius(share) - 0.5 * shade.wall, draw.choose([2, 3, 4])
    if shade.form == "square":
        count = 4 if count == 3 else count
    turns = np.arange(count) * 2 * np.pi / count
    tips = [(reach * float(np.cos(turn)), reach * float(np.sin(turn)), z) for turn in turns]
    spokes = [rod((0.0, 0.0, z), tip, 0.007) for tip in tips]
    hub = rod((0.0, 0.0, z - 0.014), (0.0, 0.0, z + 0.014), 0.02)
    yield Part("spokes", union([hub, *spokes]), look)
    room = z - shade.low if hanging else shade.high - z
    if room > 0.11 and draw.chance(0.8):
        size = min(draw.between(0.028, 0.045), shade.narrow * 0.5)
        long = min(room - 0.02, 0.05 + 2 * size)
        angle = np.linspace(-1.1, np.pi / 2, 12)
        ball = [(size * float(np.cos(a)), long - size + size * float(np.sin(a))) for a in angle[:-1]]
        bulb = turned([(0.0, 0.0), (0.016, 0.0), (0.016, 0.02), *ball, (0.0, long)])
        bulb = bulb.rotate((180.0, 0.0, 0.0)) if hanging else bulb
        yield Part("bulb", bulb.translate((0.0, 0.0, z)), SHADES[1])


def _disc_foot(draw: Draw, reach_m: float, stem_m: float, look: Look) -> Part:
    """A round or square plate, or a dome, under the stem."""
    kind, high = draw.choose(["plate", "dome", "square"]), draw.between(0.018, 0.032)
    if kind == "plate":
        return Part("foot", plate(ellipse((2 * reach_m, 2 * reach_m)), 0.0, high, 0.3 * high), look)
    if kind == "square":
        return Part("foot", box((-reach_m, -reach_m, 0.0), (reach_m, reach_m, high)), look)
    share = np.linspace(0, 1, 10)
    radii = reach_m + (stem_m * 1.2 - reach_m) * share
    heights = 0.016 + draw.between(0.04, 0.07) * np.sin(share * np.pi / 2) ** 2
    rings = list(zip(radii.tolist(), heights.tolist(), strict=True))
    return Part("foot", turned([(0.0, 0.0), (reach_m, 0.0), *rings, (0.0, rings[-1][1])]), look)


def _floor(draw: Draw) -> Parts:
    """An upright stem on a foot, with a shade around its head, and perhaps a small table on the stem."""
    high, radius = draw.between(1.25, 1.65), draw.between(0.011, 0.018)
    shade = _shade(draw, high, draw.between(0.15, 0.26), draw.between(0.2, 0.36))
    metal, share = draw.pick(looks.METALS + looks.WOODS[:3]), draw.between(0.12, 0.4)
    yield _disc_foot(draw, draw.between(0.13, 0.18), radius, metal)
    head = shade.low + share * (shade.high - shade.low)
    yield Part("stem", rod((0.0, 0.0, 0.005), (0.0, 0.0, head), radius), metal)
    if draw.chance(0.3):
        z, wide = draw.between(0.45, 0.6), draw.between(0.32, 0.42)
        yield Part("shelf", plate(ellipse((wide, wide)), z, z + 0.018), draw.pick(looks.WOODS))
    yield Part("shade", shade.solid(), draw.pick(SHADES))
    yield from _fitting(draw, shade, share, metal)


def _tripod(draw: Draw) -> Parts:
    """Three legs that meet under a shade, perhaps with a shelf between them."""
    high = draw.between(1.2, 1.6)
    shade = _shade(draw, high, draw.between(0.18, 0.27), draw.between(0.22, 0.34))
    wood, share = draw.pick(looks.WOODS), draw.between(0.12, 0.35)
    head, inner, reach = shade.low - 0.03, draw.between(0.018, 0.035), draw.between(0.22, 0.32)
    thick = draw.between(0.028, 0.038)
    yield from bases.round_legs(3, reach, inner, head, thick, wood)
    yield Part("hub", rod((0.0, 0.0, head - 0.05), (0.0, 0.0, head + 0.01), inner + 0.022), wood)
    if draw.chance(0.35):
        z = head * draw.between(0.3, 0.45)
        wide = 2 * (reach + (inner - reach) * z / head)
        yield Part("shelf", plate(ellipse((wide, wide)), z, z + 0.018), wood)
    top = shade.low + share * (shade.high - shade.low)
    metal = draw.pick(looks.METALS)
    yield Part("stem", rod((0.0, 0.0, head - 0.02), (0.0, 0.0, top), 0.011), metal)
    yield Part("shade", shade.solid(), draw.pick(SHADES))
    yield from _fitting(draw, shade, share, metal)


def _arm(draw: Draw) -> Parts:
    """A stem on a heavy foot that bends over and holds a shade from above."""
    high, reach, radius = draw.between(1.2, 1.6), draw.between(0.22, 0.36), draw.between(0.012, 0.016)
    tall, drop = draw.between(0.14, 0.24), draw.between(0.03, 0.1)
    shade = _shade(draw, high - drop, draw.between(0.12, 0.19), tall)
    metal, share = draw.pick(looks.METALS), draw.between(0.75, 0.88)
    end = shade.low + share * tall
    bend = draw.between(0.08, 0.2)
    path = rounded_path([(-reach, 0.0, 0.01), (-reach, 0.0, high), (0.0, 0.0, high), (0.0, 0.0, end)], bend)
    yield Part("stem", tube(path, radius), metal)
    wide = draw.between(0.15, 0.19)
    # The foot reaches under the shade, so that the lamp does not tip over.
    foot = plate(ellipse((2 * wide, 2 * wide)), 0.0, draw.between(0.035, 0.06), 0.008)
    yield Part("foot", foot.translate((0.6 * wide - reach - 0.05, 0.0, 0.0)), metal)
    yield Part("shade", shade.solid(), draw.pick(SHADES + looks.METALS[:2]))
    yield from _fitting(draw, shade, share, metal, hanging=True)


def _table(draw: Draw) -> Parts:
    """A turned body, such as a vase, a stack of balls or a candlestick, under a shade."""
    high = draw.between(0.36, 0.68)
    size = high * draw.between(0.28, 0.36)
    shade = _shade(draw, high, size, high * draw.between(0.36, 0.46))
    look, share = draw.pick(looks.WOODS + looks.STONES + looks.PLASTICS[:5]), draw.between(0.15, 0.4)
    body, wide = shade.low + draw.between(-0.02, 0.02), size * draw.between(0.38, 0.6)
    profile = draw.choose([_vase, _balls, _cone, _candlestick])
    shares = np.linspace(0, 1, 40)
    radii = np.maximum(0.012, wide * profile(shares))
    rings = list(zip(radii.tolist(), (0.012 + shares * (body - 0.012)).tolist(), strict=True))
    yield Part("body", turned([(0.0, 0.012), *rings, (0.0, body)]), look)
    base = max(float(radii[0]) + 0.005, size * draw.between(0.42, 0.55))
    yield Part("foot", plate(ellipse((2 * base, 2 * base)), 0.0, 0.018), look)
    head = shade.low + share * (shade.high - shade.low)
    metal = draw.pick(looks.METALS)
    yield Part("stem", rod((0.0, 0.0, body - 0.02), (0.0, 0.0, head), 0.01), metal)
    yield Part("shade", shade.solid(), draw.pick(SHADES))
    yield from _fitting(draw, shade, share, metal)


def _vase(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """A belly that narrows to a neck: radius over height, both as shares."""
    return np.asarray(0.5 + 0.5 * np.sin(np.pi * np.minimum(1.0, share * 1.25)) - 0.25 * share)


def _balls(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Three balls one above the other, the upper ones smaller."""
    return np.asarray((0.35 + 0.65 * np.abs(np.sin(3 * np.pi * share)) ** 0.7) * (1 - 0.35 * share))


def _cone(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """A cone that grows thinner upwards."""
    return np.asarray(1 - 0.75 * share)


def _candlestick(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """A thin shaft with a flare below and a ring in its middle."""
    return np.asarray(0.28 + 0.7 * np.exp(-14 * share) + 0.25 * np.exp(-((share - 0.55) ** 2) / 0.002))
