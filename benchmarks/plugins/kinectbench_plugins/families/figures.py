"""Smooth things of daily life: shoes that a foot fits into, and plump toy animals."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.core.types import Float64
from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import Points, Vector3, box, tube
from kinectbench_plugins.families.smooth import Field, blended, body, cone, ellipsoid, limb

if TYPE_CHECKING:
    from manifold3d import Manifold

# Edge of the cells in which the surfaces of shoes and toys are sought; own choice.
STEP_M = 0.004
# Parts that are glued to one another overlap by this much; own choice.
LAP_M = 0.004


@dataclass(frozen=True)
class _Last:
    """A foot with its ankle that a shoe is made around; the toes point to +y, it stands on z = `floor`.

    Attributes:
        scale: its length, 1 for a foot of about 26 cm.
        wide: its width, 1 for a common one.
        bow: how far the toes lie to the inner side, per metre; its sign tells a left foot from a right one.
        floor: height of the sole's upper face, metres.
        pointed: 0 for a round toe, 1 for a pointed one.
        rise: how much higher the heel stands than the ball of the foot, metres.
        spring: how the toes bend up: metres for each square metre before the ball of the foot.
    """

    scale: float
    wide: float
    bow: float
    floor: float
    pointed: float
    rise: float
    spring: float

    def field(self) -> Field:
        """About the distance to the foot and to a shaft above its ankle."""
        toe = 0.026 - 0.008 * self.pointed
        # Balls of heel, arch, foot and toes; the ridge from ankle to toes; the shaft's two foots.
        sole = np.array([(0, -0.098, 0.03), (0, -0.03, 0.03), (0, 0.05, 0.03), (0, 0.096, toe)])
        ridge = np.array([(0, -0.05, 0.07), (0, -0.005, 0.056), (0, 0.05, 0.034), (0, 0.09, toe)])
        thick, high = np.array([0.034, 0.031, 0.037, toe + 0.004]), np.array([0.032, 0.03, 0.03, toe])
        heel, ankle, up = np.array([(0, -0.092, 0.05), (0, -0.055, 0.07), (0.0, -0.004, 0.2)])

        def field(points: Points) -> Float64:
            """Signed distance (n,) of points (n, 3), metres, negative inside."""
            foot = (points - [0.0, 0.0, self.floor]) / self.scale
            x = (foot[:, 0] - self.bow * np.clip(foot[:, 1] + 0.05, 0, None) ** 2) / self.wide
            foot = np.column_stack([x, foot[:, 1:]])
            shaft = [cone(foot, at, at + up, (0.033, 0.036)) for at in (heel, ankle)]
            parts = [limb(foot, sole, thick), limb(foot, ridge, high), *shaft]
            return self.scale * blended(parts, 0.006)

        return field

    def solid(self, out_m: float) -> "Manifold":
        """The foot, grown by `out_m` on all sides."""
        field, s = self.field(), self.scale
        low, high = (-0.085 * s, -0.17 * s, -0.04), (0.085 * s, 0.17 * s, 0.36 * s)
        return body(lambda points: field(points) - out_m, low, high, STEP_M)

    def raised(self, shape: "Manifold") -> "Manifold":
        """Raise the heel and the toes of a shape that was made for a flat foot."""

        def move(points: Points) -> Points:
            y = points[:, 1] / self.scale
            back, ahead = np.clip((0.035 - y) / 0.08, 0, 1), self.scale * np.clip(y - 0.05, 0, None)
            lift = self.rise * back**2 * (3 - 2 * back) + self.spring * ahead**2
            return points + np.column_stack([0 * lift, 0 * lift, lift])

        return shape.warp_batch(move)

    def layer(self, low: float, high: float) -> "Manifold":
        """All around the foot between two heights, which rise at the heel and the toes.

        It is cut into small triangles before it is raised: a cap of few long ones would fold.
        """
        block = box((-0.12, -0.22, low), (0.12, 0.22, high)).refine_to_length(0.01)
        return self.raised(block)


def shoe(draw: Draw) -> Parts:
    """Draw a shoe or a boot that a foot fits into; nothing is thinner than 8 mm. Its toes point to +y."""
    kind = draw.choose(["sneaker", "sneaker", "loafer", "boot"])
    sole = {"sneaker": (0.02, 0.03), "loafer": (0.012, 0.016), "boot": (0.016, 0.026)}[kind]
    s = draw.between(0.9, 1.06)
    last = _Last(
        scale=s,
        wide=draw.between(0.98, 1.2),
        bow=draw.choose(SIDES) * draw.between(0.3, 1.0),
        floor=draw.between(*sole),
        pointed=draw.between(0.4, 1.0) if kind == "loafer" else draw.between(0.0, 0.5),
        rise=0.0 if kind == "sneaker" else draw.between(0.012, 0.032),
        spring=draw.between(0.4, 1.6) / s,
    )
    floor, wall = last.floor, draw.between(0.0105, 0.014)
    collar, tilt = s * draw.between(0.066, 0.082), draw.between(0.0, 0.25)
    if kind == "boot":
        collar, tilt = s * draw.between(0.13, 0.22), draw.between(-0.1, 0.2)
    flat = last.solid(wall)
    foot = last.raised(last.solid(0.0)) - last.layer(-0.1, floor + LAP_M)
    outer = last.raised(flat) - last.layer(-0.1, floor - LAP_M)
    at = floor + last.rise + collar + 0.075 * s * tilt
    upper, front = _collared(outer, foot, (at, tilt), wall)
    yield Part("upper", upper, draw.pick(looks.LEATHERS[:2] + looks.CLOTHS))
    slab = flat.trim_by_plane((0.0, 0.0, -1.0), -floor - 0.03).trim_by_plane((0.0, 0.0, 1.0), floor)
    plan = slab.project().simplify(2e-4)
    rim = draw.between(0.006, 0.016) if kind == "sneaker" else LAP_M
    column = type(flat).extrude(plan.offset(0.003), 0.5).translate((0.0, 0.0, -0.1))
    # The sole ends within the upper, so that no face of the one lies on one of the other.
    within = last.raised(last.solid(wall / 2)) - last.layer(-0.1, floor)
    tread = (column ^ last.layer(0.0, floor + rim)) - within
    rubber, wood = draw.pick(looks.PLASTICS[:5]), draw.pick(looks.WOODS[:6])
    yield Part("sole", tread, rubber if kind == "sneaker" else wood)
    if last.rise:
        block = type(flat).extrude(plan, last.rise + LAP_M).trim_by_plane((0.0, -1.0, 0.0), 0.055 * s)
        yield Part("heel", block, draw.pick(looks.WOODS[:6]))
    if kind != "loafer":
        lace = draw.pick(looks.PLASTICS[:3])
        for y in np.arange(max(0.025 * s, front + 0.01), 0.066 * s, draw.between(0.011, 0.018)).tolist():
            yield Part("lace", last.raised(_lace(last, wall, y)), lace)


def _collared(
    outer: "Manifold", foot: "Manifold", collar: tuple[float, float], edge_m: float
) -> tuple["Manifold", float]:
    """An upper with an opening for the foot.

    Args:
        outer: its outer shape, filled.
        foot: what it is hollowed out by.
        collar: height of the collar's plane at y = 0, metres, and its slope along y.
        edge_m: least thickness of the collar's edge, metres.

    Returns:
        The upper; and the y of the foremost point of its collar.
    """
    height, slope = collar
    turn = float(np.degrees(np.arctan(slope)))
    at = height / float(np.hypot(1.0, slope))
    # With the plane level, what is above it goes, and what is above the foot's section a little below it:
    # there the opening's edge would be as sharp as the angle between the instep and the plane.
    level = outer.rotate((-turn, 0.0, 0.0)).trim_by_plane((0.0, 0.0, -1.0), -at)
    inside = foot.rotate((-turn, 0.0, 0.0))
    # It keeps off the foot's own surface by 1.5 mm, so that the two do not cut each other into splinters.
    hole = inside.slice(at - edge_m).offset(-0.0015)
    throat = type(outer).extrude(hole, 0.1).translate((0.0, 0.0, at - edge_m))
    upper = (level - inside - throat).rotate((turn, 0.0, 0.0))
    rim = level.slice(at - 1e-5).bounds()[3]
    return upper, float(rim / np.hypot(1.0, slope))


def _lace(last: _Last, wall: float, y: float) -> "Manifold":
    """A lace across the instep, half sunk into the upper."""
    field, z = last.field(), np.arange(0.02, 0.16, 5e-4)
    path = []
    for x in np.linspace(-0.024, 0.024, 7) * last.wide * last.scale:
        column = np.column_stack([np.full((len(z), 2), (x, y)), z])
        path.append((float(x), y, float(z[field(column) < wall].max()) - 0.002))
    return tube(path, 0.0056)


@dataclass(frozen=True)
class _Animal:
    """A toy animal's shape, metres before it is scaled; it looks to +y.

    Attributes:
        belly: height of the trunk's middle.
        trunk: half its width, length and height.
        leg: radius of a leg.
        head: middle of the head.
        skull: half its width, length and height.
        ears: "round", "pointed", "long", "floppy" or "large".
        tail: "stump", "long" or "curled".
        nose: "short", "snout", or an elephant's "trunk".
    """

    belly: float
    trunk: Vector3
    leg: float
    head: Vector3
    skull: Vector3
    ears: str
    tail: str
    nose: str


# What goes together: ears, tail, nose.
_KINDS = (
    ("round", "stump", "short"),
    ("pointed", "long", "short"),
    ("floppy", "curled", "snout"),
    ("long", "stump", "short"),
    ("large", "long", "trunk"),
    ("pointed", "curled", "snout"),
    ("floppy", "long", "snout"),
)


def toy_animal(draw: Draw) -> Parts:
    """Draw a plump animal on four legs that looks to +y; nothing is thinner than 12 mm."""
    ears, tail, nose = draw.choose(_KINDS)
    belly, long = draw.between(0.105, 0.14), draw.between(0.08, 0.11)
    skull = draw.between(0.045, 0.06)
    animal = _Animal(
        belly=belly,
        trunk=(draw.between(0.055, 0.072), long, draw.between(0.05, 0.064)),
        leg=draw.between(0.022, 0.03),
        head=(0.0, long + draw.between(0.0, 0.02), belly + draw.between(0.045, 0.09)),
        skull=(skull * draw.between(0.95, 1.15), skull * draw.between(0.95, 1.1), skull),
        ears=ears,
        tail=tail,
        nose=nose,
    )
    shape = body(_animal_field(draw, animal), (-0.2, -0.27, -0.05), (0.2, 0.31, 0.42), STEP_M)
    shape = shape.trim_by_plane((0.0, 0.0, 1.0), 0.007)
    look, dark = draw.pick(looks.CLOTHS + looks.LEATHERS[:2]), looks.PLASTICS[5]
    x0, y0, z0, x1, y1, z1 = shape.bounding_box()
    size = draw.between(0.22, 0.38) / max(x1 - x0, y1 - y0, z1 - z0)
    parts = [Part("body", shape, look), *_face(draw, animal, dark)]
    if draw.chance(0.4):
        lo, hi = -0.02, draw.between(0.01, 0.03)
        grown = tuple(1.06 * r for r in animal.trunk)
        blanket = _ball((0.0, 0.0, belly), (grown[0], grown[1], grown[2])) ^ box(
            (-1, 2 * lo, belly), (1, 2 * hi, 1)
        )
        parts.append(Part("blanket", blanket, draw.pick(looks.CLOTHS)))
    for part in parts:
        yield Part(part.name, part.shape.scale((size, size, size)), part.look)


def _ball(at: Vector3, radii: Vector3) -> "Manifold":
    from manifold3d import Manifold

    return Manifold.sphere(1.0, 48).scale(radii).translate(at)


def _face(draw: Draw, animal: _Animal, dark: Look) -> Parts:
    """Two eyes and the tip of the nose."""
    (_, y, z), (wide, long, high) = animal.head, animal.skull
    eye = draw.between(0.0095, 0.012)
    for side in SIDES:
        # On the skull: the squares of these shares add up to one.
        at = (side * 0.5 * wide, y + 0.77 * long, z + 0.4 * high)
        yield Part("eye", _ball(at, (eye, eye, eye)), dark)
    if animal.nose != "trunk":
        reach = {"short": 0.022, "snout": 0.05}[animal.nose]
        yield Part(
            "nose", _ball((0.0, y + long + reach, z - 0.2 * high + 0.008), (0.014, 0.011, 0.011)), dark
        )


def _animal_field(draw: Draw, animal: _Animal) -> Field:
    """Trunk, neck, head, nose, ears, legs and tail, blended."""
    (_, y, z), (_, long, high), belly = animal.head, animal.skull, animal.belly
    half_wide, half_long, half_high = animal.trunk
    stand = (half_wide - 0.6 * animal.leg, half_long - animal.leg)
    limbs = []
    for sx in SIDES:
        for sy in SIDES:
            x_foot, y_foot = (
                sx * stand[0] * draw.between(0.98, 1.12),
                sy * stand[1] + draw.between(-0.008, 0.008),
            )
            ends = np.array([(x_foot, y_foot, animal.leg), (sx * stand[0], sy * stand[1], belly)])
            limbs.append((ends, np.array([animal.leg, 1.15 * animal.leg])))
    limbs.append(
        (np.array([(0, 0.55 * half_long, belly), (0, y, z)]), np.array([0.75 * half_high, 0.6 * high]))
    )
    rear, share = -half_long + 0.01, np.linspace(0, 1, 9)
    reach = {"stump": 0.012, "long": draw.between(0.07, 0.1), "curled": 0.05}[animal.tail]
    turn = {"stump": 0.5, "long": draw.between(-0.8, 1.2), "curled": 2.6}[animal.tail]
    tail = [
        np.zeros(9),
        rear - reach * np.sin(share * turn) / turn,
        belly + 0.02 + reach * (1 - np.cos(share * turn)) / turn,
    ]
    limbs.append((np.column_stack(tail), np.linspace(0.018, 0.018 if animal.tail == "stump" else 0.0125, 9)))
    mouth = (0.0, y + long, z - 0.2 * high)
    if animal.nose == "trunk":
        hang = [(0.0, y + 0.7 * long, z), (0.0, y + long + 0.02, z - 0.03), (0.0, y + long + 0.03, z - 0.08)]
        limbs.append(
            (np.array([*hang, (0.0, y + long + 0.055, z - 0.1)]), np.array([0.028, 0.021, 0.016, 0.0145]))
        )
    elif animal.nose == "snout":
        limbs.append(
            (np.array([(0.0, y, z - 0.1 * high), (0.0, mouth[1] + 0.025, mouth[2])]), np.array([0.03, 0.023]))
        )
    for side in SIDES:
        limbs += _ear(animal, side)

    def field(points: Points) -> Float64:
        """Signed distance (n,) of points (n, 3), metres, negative inside."""
        parts = [
            ellipsoid(points, (0.0, 0.0, belly), animal.trunk),
            ellipsoid(points, animal.head, animal.skull),
        ]
        parts += [limb(points, path, thick) for path, thick in limbs]
        if animal.nose == "short":
            parts.append(ellipsoid(points, mouth, (0.03, 0.024, 0.022)))
        return blended(parts, 0.006)

    return field


def _ear(animal: _Animal, side: int) -> list[tuple[Points, Points]]:
    """An ear, as bars with round ends."""
    (_, y, z), (wide, _, high) = animal.head, animal.skull

    def at(x: float, back: float, up: float) -> Vector3:
        return (side * x * wide, y - back * wide, z + up * high)

    if animal.ears == "round":
        return [(np.array([at(0.6, 0.1, 0.6), at(0.78, 0.1, 0.85)]), np.array([0.018, 0.022]))]
    if animal.ears == "pointed":
        return [(np.array([at(0.5, 0.1, 0.5), at(0.72, 0.15, 1.35)]), np.array([0.026, 0.0105]))]
    if animal.ears == "long":
        return [
            (
                np.array([at(0.35, 0.1, 0.6), at(0.5, 0.4, 1.6), at(0.62, 0.9, 2.3)]),
                np.array([0.015, 0.018, 0.012]),
            )
        ]
    if animal.ears == "floppy":
        return [
            (
                np.array([at(0.7, 0.1, 0.6), at(1.12, 0.1, 0.3), at(1.2, 0.1, -0.5)]),
                np.array([0.014, 0.013, 0.016]),
            )
        ]
    # An elephant's: a fan of bars.
    tips = [(1.75, 0.4, 0.7), (1.95, 0.5, 0.1), (1.7, 0.4, -0.5)]
    return [(np.array([at(0.6, 0.1, 0.2), at(*tip)]), np.array([0.02, 0.014])) for tip in tips]
