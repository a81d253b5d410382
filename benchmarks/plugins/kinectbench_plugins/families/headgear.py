"""Helmets that lie on their rims: for cycling, motorcycling, riding and building, hollow from below."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import Points, Vector3, bent, box, cushion
from kinectbench_plugins import palettes

if TYPE_CHECKING:
    from manifold3d import Manifold

# Sides of a sphere's equator: facets of 8 mm on a helmet of 26 cm; own choice.
SEGMENTS = 96
# Above it, the rim of a shell is cut off level; below it is what the field's ball would go on with.
BELOW_M = 1.0


@dataclass(frozen=True)
class _Dome:
    """The upper half of an ellipsoid on a low cylinder's height, metres; the face looks to +y.

    Attributes:
        x: half its width.
        y: half its length.
        high: from its equator to its top.
        low: height of its equator above the rim.
    """

    x: float
    y: float
    high: float
    low: float

    def solid(self, in_m: float = 0.0) -> "Manifold":
        """The dome, smaller by `in_m` on all sides, going on below the rim."""
        from manifold3d import Manifold

        ball = Manifold.sphere(1.0, SEGMENTS).scale((self.x - in_m, self.y - in_m, self.high - in_m))
        ball = ball.translate((0.0, 0.0, self.low))
        # Below its equator it goes straight down, or a little inward as a head does.
        foot = ball.trim_by_plane((0.0, 0.0, -1.0), -self.low).translate((0.0, 0.0, -0.4))
        return Manifold.batch_hull([ball, foot]) if self.low > 0 else ball


def helmet(draw: Draw) -> Parts:
    """Draw a helmet that lies on its rim and looks to +y; its shell is 8 mm thick or more."""
    dome = _Dome(
        x=draw.between(0.095, 0.115),
        y=draw.between(0.12, 0.145),
        high=draw.between(0.11, 0.14),
        low=draw.between(0.02, 0.05),
    )
    kind = draw.choose([_cycling, _cycling, _full_face, _full_face, _building, _riding])
    look = draw.pick(looks.PLASTICS[:5] + palettes.GLAZES[1:8])
    yield from kind(draw, dome, look)


def _shell(dome: _Dome, wall: float) -> tuple["Manifold", "Manifold"]:
    """A shell that is open below, its rim level, and the room inside it."""
    outer = dome.solid().trim_by_plane((0.0, 0.0, 1.0), 0.0)
    return outer, dome.solid(wall)


def _arched(shape: "Manifold", rise: Vector3) -> "Manifold":
    """A shell whose rim rises at its front, its back and its sides by so much; above, it stays as it is."""

    def move(points: Points) -> Points:
        """Points (n, 3), metres, frame `object`, lifted the less, the higher they lie."""
        x, y, z = points.T
        turn = np.arctan2(y, x)
        front, back, side = rise
        lift = np.where(y > 0, front, back) * np.sin(turn) ** 4 + side * np.cos(turn) ** 4
        fade = np.clip(1 - z / 0.1, 0, 1)
        moved: Points = points + np.column_stack([0 * x, 0 * x, lift * fade])
        return moved

    return bent(shape, move, 0.008)


def _cycling(draw: Draw, dome: _Dome, look: Look) -> Parts:
    """A thick light shell with long vents, its ridges between them, perhaps a peak."""
    outer, room = _shell(dome, draw.between(0.022, 0.03))
    shell, count = outer - room, draw.choose([3, 4])
    for row, (middle, half) in enumerate(((0.29, 0.24), (-0.29, 0.24))):
        for k in range(count):
            share = (2 * k + 1 - count) / count
            if draw.chance(0.15):
                continue
            shell = shell - _vent(dome, share, middle + 0.03 * (1 - 2 * row) * abs(share), half)
    yield Part("shell", shell, look)
    if draw.chance(0.5):
        band = _shell(_Dome(dome.x + 0.003, dome.y + 0.003, dome.high, dome.low), 0.012)
        ring = (band[0] - band[1]) ^ box((-1, -1, 0.0), (1, 1, 0.018))
        yield Part("edge", ring, draw.pick(looks.PLASTICS))
    if draw.chance(0.4):
        yield _peak(draw, dome, 0.03, looks.PLASTICS[5])


def _vent(dome: _Dome, across: float, along: float, half: float) -> "Manifold":
    """A long slot from front to back through the shell, its middle at shares of the half width and length."""
    x, wide = 0.6 * across * dome.x, 0.0095
    low, high = (along - half) * dome.y, (along + half) * dome.y
    return cushion((x - wide, low, dome.low + 0.1 * dome.high), (x + wide, high, 0.5), 0.009)


def _peak(draw: Draw, dome: _Dome, low: float, look: Look) -> Part:
    """A peak that stands out at the front."""
    from manifold3d import Manifold

    long, wide = draw.between(0.035, 0.06), draw.between(0.7, 0.9)
    outline = Manifold.cylinder(0.011, 1.0, 1.0, 64).scale((wide * dome.x, dome.y + long, 1.0))
    peak = outline.trim_by_plane((0.0, 1.0, 0.0), 0.3 * dome.y).rotate((-draw.between(2.0, 9.0), 0.0, 0.0))
    return Part("peak", peak.translate((0.0, 0.0, low + 0.02)) - dome.solid(0.006), look)


def _jaw(dome: _Dome, ahead_m: float, in_m: float, high_m: float) -> "Manifold":
    """The lower part of a helmet that reaches farther to the front, smaller by `in_m` all around."""
    from manifold3d import Manifold

    jaw = Manifold.cylinder(high_m, 1.0, 1.0, SEGMENTS)
    return jaw.scale((0.86 * dome.x - in_m, dome.y + ahead_m - in_m, 1.0)).trim_by_plane((0.0, 1.0, 0.0), 0.0)


def _full_face(draw: Draw, dome: _Dome, look: Look) -> Parts:
    """A shell that goes down around the chin, with an opening for the eyes, perhaps with a visor above it."""
    from manifold3d import Manifold

    deep = draw.between(0.1, 0.13)
    whole = _Dome(dome.x + 0.018, dome.y + 0.01, dome.high + 0.01, deep)
    wall = draw.between(0.024, 0.032)
    outer, room = _shell(whole, wall)
    chin = draw.between(0.02, 0.04)
    outer = (
        Manifold.batch_hull([outer ^ box((-1, -1, 0), (1, 1, 0.14)), _jaw(whole, chin, 0.0, 0.085)]) + outer
    )
    low, top = draw.between(0.068, 0.08), draw.between(0.15, 0.175)
    # The room behind the chin opens into the opening for the eyes.
    inside = _jaw(whole, chin, wall, (low + top) / 2).translate((0.0, 0.0, -0.001))
    eyes = cushion((-1.3 * whole.x, 0.12 * whole.y, low), (1.3 * whole.x, 2.0 * whole.y, top), 0.025)
    yield Part("shell", outer - room - inside - eyes, look)
    if draw.chance(0.6):
        # A visor that is turned up: a strip of a somewhat larger shell above the opening.
        larger = _Dome(whole.x + 0.008, whole.y + 0.008, whole.high + 0.008, deep)
        strip = larger.solid() - larger.solid(0.0125)
        strip = strip ^ box((-1.0, 0.15 * whole.y, top + 0.012), (1.0, 1.0, top + draw.between(0.05, 0.075)))
        yield Part("visor", strip, looks.METALS[3])
    if draw.chance(0.5):
        tint = draw.pick(looks.PLASTICS)
        for s in SIDES:
            scoop = cushion(
                (s * 0.35 * whole.x - 0.014, -0.5 * whole.y, deep),
                (s * 0.35 * whole.x + 0.014, 0.3 * whole.y, deep + whole.high + 0.004),
                0.012,
            )
            yield Part("scoop", scoop - room, tint)


def _building(draw: Draw, dome: _Dome, look: Look) -> Parts:
    """A hard hat: a thin dome with a brim, a longer peak in front, and ridges over its top."""
    from manifold3d import Manifold

    wall, brim = draw.between(0.0095, 0.012), draw.between(0.012, 0.03)
    outer, room = _shell(dome, wall)
    yield Part("shell", outer - room, look)
    edge = Manifold.cylinder(0.0105, 1.0, 1.0, SEGMENTS).scale((dome.x + brim, dome.y + brim, 1.0))
    yield Part("brim", edge - dome.solid(0.5 * wall), look)
    peak = Manifold.cylinder(0.0105, 1.0, 1.0, SEGMENTS).scale((0.85 * dome.x, dome.y + brim + 0.03, 1.0))
    peak = peak.trim_by_plane((0.0, 1.0, 0.0), 0.3 * dome.y)
    yield Part("peak", peak.translate((0.0, 0.0, 0.0005)) - dome.solid(0.5 * wall), look)
    ridge = draw.pick(looks.PLASTICS[:3]) if draw.chance(0.3) else look
    higher = _Dome(dome.x, dome.y + 0.002, dome.high + 0.008, dome.low).solid() - dome.solid(0.5 * wall)
    for at in draw.choose([(0.0,), (-0.3, 0.3), (-0.4, 0.0, 0.4)]):
        strip = box((at * dome.x - 0.009, -0.8 * dome.y, dome.low), (at * dome.x + 0.009, 0.8 * dome.y, 1.0))
        yield Part("ridge", higher ^ strip, ridge)
    if draw.chance(0.4):
        lamp = cushion(
            (-0.026, dome.y - 0.03, dome.low + 0.02), (0.026, dome.y + 0.024, dome.low + 0.065), 0.01
        )
        yield Part("lamp", lamp - room, looks.METALS[3])


def _riding(draw: Draw, dome: _Dome, look: Look) -> Parts:
    """A smooth cap whose rim rises in front, with a peak, a button on top and a stripe."""
    outer, room = _shell(dome, draw.between(0.018, 0.026))
    rise = (draw.between(0.01, 0.03), 0.0, 0.0)
    yield Part("shell", _arched(outer - room, rise), look)
    yield _peak(draw, dome, rise[0], draw.choose([look, looks.PLASTICS[5]]))
    if draw.chance(0.6):
        top = dome.low + dome.high
        yield Part("button", cushion((-0.014, -0.014, top - 0.02), (0.014, 0.014, top + 0.008), 0.01), look)
    if draw.chance(0.6):
        higher = _Dome(dome.x + 0.002, dome.y + 0.002, dome.high + 0.002, dome.low)
        strip = (higher.solid() - dome.solid(0.01)) ^ box(
            (-0.02, -0.9 * dome.y, dome.low + 0.03), (0.02, 0.8 * dome.y, 1.0)
        )
        yield Part("stripe", strip, draw.pick(looks.CLOTHS))
