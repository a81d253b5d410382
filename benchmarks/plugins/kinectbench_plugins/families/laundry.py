"""Washing machines that stand open: a drum behind a round door, or below a lid."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import box, cushion, rod, turned
from kinectbench_plugins import palettes

if TYPE_CHECKING:
    from manifold3d import Manifold

# Parts that are glued to one another overlap by this much; own choice.
LAP_M = 0.004


@dataclass(frozen=True)
class _Housing:
    """A machine's measures, metres, frame `object`; its front faces +y.

    Attributes:
        x: half its width.
        y: half its depth.
        low: height of its underside above the floor.
        top: height of its upper face.
    """

    x: float
    y: float
    low: float
    top: float

    def shell(self, soft_m: float) -> "Manifold":
        """The housing without openings."""
        low, high = (-self.x, -self.y, self.low), (self.x, self.y, self.top)
        return cushion(low, high, soft_m) if soft_m else box(low, high)


def washing_machine(draw: Draw) -> Parts:
    """Draw a washing machine or a dryer that stands open; nothing is thinner than 15 mm."""
    front = draw.chance(0.75)
    housing = _Housing(
        x=draw.between(0.27, 0.31) if front else draw.between(0.2, 0.29),
        y=draw.between(0.2, 0.31),
        low=draw.between(0.02, 0.05),
        top=draw.between(0.78, 0.92),
    )
    look, soft = draw.pick(palettes.ENAMELS), draw.choose([0.0, draw.between(0.008, 0.025)])
    dark = draw.pick((looks.METALS[3], looks.METALS[0], looks.PLASTICS[5]))
    yield from _feet(housing, looks.METALS[3])
    if draw.chance(0.5) and front:
        over = box(
            (-housing.x - 0.006, -housing.y, housing.top - soft - LAP_M),
            (housing.x + 0.006, housing.y + 0.012, housing.top + 0.018),
        )
        yield Part("top", over, draw.pick(looks.WOODS + palettes.ENAMELS[:2] + looks.STONES))
    yield from (_front_loader if front else _top_loader)(draw, housing, soft, look, dark)


def _feet(housing: _Housing, look: Look) -> Parts:
    """Four short feet."""
    for sx, sy in CORNERS:
        at = (sx * (housing.x - 0.05), sy * (housing.y - 0.05))
        yield Part("foot", rod((*at, 0.0), (*at, housing.low + 0.03), 0.022), look)


def _level(shape: "Manifold") -> "Manifold":
    """What was turned about the z axis, its axis laid along y, its top to +y."""
    return shape.rotate((-90.0, 0.0, 0.0))


def _front_loader(draw: Draw, housing: _Housing, soft: float, look: Look, dark: Look) -> Parts:
    """A round opening in the front with a drum behind it, a door that stands open, a panel with a dial."""
    radius = draw.between(0.14, 0.185)
    drum = min(radius + draw.between(0.01, 0.06), housing.x - 0.03)
    middle = housing.low + draw.between(0.38, 0.48) * (housing.top - housing.low)
    middle = max(middle, housing.low + drum + 0.03)
    deep = 2 * housing.y - draw.between(0.05, 0.1)
    # The drum is wider than its mouth.
    y = housing.y
    mouth = [
        (0.0, 0.01),
        (radius, 0.01),
        (radius, -0.05),
        (drum, -0.08),
        (drum, 0.05 - deep),
        (0.9 * drum, -deep),
    ]
    room = _level(turned([(0.0, -deep), *reversed(mouth)])).translate((0.0, y, middle))
    yield Part("housing", housing.shell(soft) - room, look)
    collar = [
        (radius - 0.012, -0.03),
        (radius + 0.03, -0.03),
        (radius + 0.03, 0.016),
        (radius - 0.004, 0.016),
    ]
    yield Part("collar", _level(turned(collar)).translate((0.0, y, middle)), dark)
    start = draw.between(0, 2 * np.pi / 3)
    for turn in (start + np.arange(3) * 2 * np.pi / 3).tolist():
        paddle = box((-0.016, -deep + 0.012, drum - 0.035), (0.016, -0.1, drum + 0.02))
        paddle = paddle.rotate((0.0, float(np.degrees(turn)), 0.0)).translate((0.0, y, middle))
        yield Part("paddle", paddle ^ housing.shell(0.0), looks.METALS[0])
    yield from _porthole(draw, radius, (y, middle), look, dark)
    yield from _panel(draw, housing, middle + drum + 0.02, look)


def _porthole(draw: Draw, radius: float, at_yz: tuple[float, float], look: Look, dark: Look) -> Parts:
    """A round door that stands open: a ring with a bowl of glass that points inward, on a hinge."""
    side, angle = draw.choose(SIDES), draw.between(70, 160)
    thick, wide, (y, z) = draw.between(0.024, 0.04), radius + draw.between(0.02, 0.04), at_yz
    out = y + 0.022 + thick / 2
    # Made shut, its hinge on the z axis, the room at -y; the bowl is solid, as thick glass looks.
    disc = _level(turned([(0.0, -thick / 2), (wide, -thick / 2), (wide, thick / 2), (0.0, thick / 2)]))
    bowl = _level(
        turned(
            [
                (0.0, -0.1),
                (0.55 * radius, -0.095),
                (0.72 * radius, -0.05),
                (0.78 * radius, -0.002),
                (0.0, -0.002),
            ]
        )
    )
    grip = box((wide - 0.03, 0.0, -0.05), (wide + 0.014, thick / 2 + 0.012, 0.05))
    if draw.chance(0.5):
        disc = disc - _level(
            turned([(0.0, -0.006), (0.62 * radius, -0.006), (0.7 * radius, 0.2), (0.0, 0.2)])
        )
        bowl = bowl - _level(
            turned([(0.0, -0.08), (0.38 * radius, -0.075), (0.62 * radius, 0.2), (0.0, 0.2)])
        )
    hinge_x = wide + 0.014

    def hung(shape: "Manifold") -> "Manifold":
        turned_open = shape.translate((hinge_x, 0.0, 0.0)).rotate((0.0, 0.0, angle))
        turned_open = turned_open.mirror((1.0, 0.0, 0.0)) if side > 0 else turned_open
        return turned_open.translate((side * hinge_x, out, z))

    yield Part("door", hung(disc), draw.choose([look, dark]))
    yield Part("glass", hung(bowl), looks.METALS[3])
    yield Part("handle", hung(grip), dark)
    # The hinge: a pin, a leaf to the door, and a block on the housing.
    pin = rod((side * hinge_x, out, z - 0.05), (side * hinge_x, out, z + 0.05), 0.011)
    block = box((side * hinge_x - 0.02, y - 0.012, z - 0.055), (side * hinge_x + 0.02, out, z + 0.055))
    yield Part("hinge", pin + block, dark)
    yield Part("hinge", hung(box((-hinge_x, -0.0085, -0.045), (-hinge_x + 0.05, 0.0085, 0.045))), dark)


def _panel(draw: Draw, housing: _Housing, low: float, look: Look) -> Parts:
    """A panel with a dial, a drawer for the powder, perhaps pulled out, buttons, and a flap below."""
    x, y = housing.x, housing.y
    low, top = min(low, housing.top - 0.14), housing.top - 0.02
    low = max(low, top - 0.14)
    face = y + draw.between(0.004, 0.014)
    yield Part(
        "panel",
        box((-x + 0.012, y - 0.016, low), (x - 0.012, face, top)),
        draw.choose([look, looks.PLASTICS[0]]),
    )
    side, z, dial = draw.choose(SIDES), (low + top) / 2, draw.between(0.024, 0.036)
    at = draw.choose([0.0, -side * draw.between(0.06, 0.2) * x])
    yield Part(
        "dial", rod((at, face - 0.012, z), (at, face + 0.024, z), dial), draw.choose([look, looks.METALS[0]])
    )
    for k in range(draw.integer(0, 5)):
        place = -side * (0.45 * x + 0.04 * k)
        if abs(place) < x - 0.04:
            yield Part(
                "button", rod((place, face - 0.012, z), (place, face + 0.008, z), 0.011), looks.METALS[0]
            )
    left, right = sorted([side * (x - 0.03), side * (0.35 * x)])
    out = draw.choose([0.012, 0.012, draw.between(0.08, 0.16)])
    drawer = box((left, y - 0.02, low + 0.016), (right, face + out, top - 0.012))
    if out > 0.05:
        wall = 0.016
        room = box((left + wall, y + 0.018, low + 0.034), (right - wall, face + out - 0.022, top + 0.1))
        drawer = drawer - room
    yield Part("powder drawer", drawer, looks.PLASTICS[0])
    if draw.chance(0.6):
        flap = box(
            (side * 0.7 * x - 0.06, y - 0.012, housing.low + 0.03),
            (side * 0.7 * x + 0.06, y + 0.006, housing.low + 0.11),
        )
        yield Part("flap", flap, look)


def _top_loader(draw: Draw, housing: _Housing, soft: float, look: Look, dark: Look) -> Parts:
    """An opening in the top with an upright drum below it, a lid that stands up, and a panel behind."""
    x, y, top = housing.x, housing.y, housing.top
    panel = draw.between(0.07, 0.11)
    middle, room = panel / 2 - 0.01, min(x, y - panel / 2) - 0.035
    deep = draw.between(0.35, 0.5)
    drum = turned(
        [
            (0.0, top - deep),
            (0.92 * room, top - deep),
            (room, top - deep + 0.04),
            (room, top + 0.1),
            (0.0, top + 0.1),
        ]
    )
    yield Part("housing", housing.shell(soft) - drum.translate((0.0, middle, 0.0)), look)
    if draw.chance(0.6):
        post = turned(
            [
                (0.0, top - deep - 0.01),
                (0.35 * room, top - deep - 0.01),
                (0.2 * room, top - deep + 0.06),
                (0.16 * room, top - 0.12),
                (0.0, top - 0.1),
            ]
        )
        yield Part("agitator", post.translate((0.0, middle, 0.0)), looks.PLASTICS[0])
    rise = draw.between(0.06, 0.14)
    yield Part("panel", box((-x + 0.006, -y, top - soft - LAP_M), (x - 0.006, -y + panel, top + rise)), look)
    for at in np.linspace(-0.6, 0.6, draw.integer(2, 5)).tolist():
        dial = rod(
            (at * x, -y + panel - 0.012, top + 0.6 * rise),
            (at * x, -y + panel + 0.016, top + 0.6 * rise),
            0.02,
        )
        yield Part("dial", dial, dark)
    thick, long = draw.between(0.017, 0.024), 2 * room + 0.03
    lean = draw.between(0.0, 12.0)
    lid = box((-room - 0.02, -thick / 2, 0.0), (room + 0.02, thick / 2, long)).rotate((lean, 0.0, 0.0))
    lid = (
        lid.translate((0.0, -y + panel + thick, top - 0.006))
        if lean < 4
        else lid.translate((0.0, -y + panel + 0.01, top + rise - 0.012))
    )
    yield Part("lid", lid, look if draw.chance(0.6) else looks.METALS[3])
