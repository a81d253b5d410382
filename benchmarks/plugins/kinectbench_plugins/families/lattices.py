"""Open boxes with gaps all around: crates of slats, and baskets of thick wire."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Outline,
    Vector2,
    Vector3,
    box,
    ellipse,
    rectangle,
    rod,
    rounded_path,
    tube,
)

if TYPE_CHECKING:
    from manifold3d import Manifold

# How far one board reaches into the next, and how far it may be out of place: own choices, so that boards
# overlap by 2.4 mm at least, and are one solid.
JOINT_M = 0.004
SLACK_M = 0.0008
# Crates are of raw wood, seldom painted.
RAW_WOODS = (*looks.WOODS[:5], looks.WOODS[3], looks.WOODS[6])


@dataclass(frozen=True)
class _Crate:
    """Half length along x, half width along y, height; thickness and breadth of slats, gap; metres."""

    x: float
    y: float
    high: float
    thick: float
    broad: float
    gap: float

    def rows(self, length_m: float) -> list[Vector2]:
        """Where slats begin and end that fill a length with gaps between them."""
        count = max(2, round((length_m + self.gap) / (self.broad + self.gap)))
        broad = (length_m - (count - 1) * self.gap) / count
        starts = np.arange(count) * (broad + self.gap)
        return [(float(at), float(at) + broad) for at in starts]


def crate(draw: Draw) -> Parts:
    """Draw a crate of wooden slats, open above; its longer side lies along x."""
    y = draw.between(0.13, 0.22)
    size = _Crate(
        x=y * draw.between(1.15, 1.6),
        y=y,
        high=draw.between(0.19, 0.36),
        thick=draw.between(0.0125, 0.019),
        broad=draw.between(0.045, 0.08),
        gap=draw.between(0.02, 0.057),
    )
    if draw.chance(0.25):
        # A large one, such as for potatoes or as a bed for plants.
        size = _Crate(1.7 * size.x, 1.7 * size.y, 1.6 * size.high, size.thick, 1.3 * size.broad, size.gap)
    return draw.choose([_posted, _posted, _ended, _upright])(draw, size)


def _nailed(draw: Draw, low_m: Vector3, high_m: Vector3) -> "Manifold":
    """A board between two corners, up to 0.8 mm out of place: no two faces of a crate lie in one plane."""
    shift = [draw.between(-SLACK_M, SLACK_M) for _ in range(3)]
    return box(low_m, high_m).translate((shift[0], shift[1], shift[2] + SLACK_M))


def _side(
    draw: Draw, name: str, across_m: Vector2, along_m: Vector2, z_m: Vector2, wood: Look, axis: int
) -> Parts:
    """A board on each of two opposite sides.

    Args:
        draw: moves them a little.
        name: of the boards.
        across_m: distance from the middle of their inner and outer faces.
        along_m: where they begin and end along their side.
        z_m: their lower and upper edge.
        wood: how they look.
        axis: 0 for boards of the ends, which face along x, 1 for those of the long sides.
    """
    for s in SIDES:
        a, b = sorted([s * across_m[0], s * across_m[1]])
        low, high = (a, along_m[0], z_m[0]), (b, along_m[1], z_m[1])
        if axis == 1:
            low, high = (along_m[0], a, z_m[0]), (along_m[1], b, z_m[1])
        yield Part(name, _nailed(draw, low, high), wood)


def _floor(draw: Draw, size: _Crate, wood: Look) -> Parts:
    """Slats from end to end, a little apart, the outermost ones fixed to the sides as well."""
    x, y = size.x - size.thick + JOINT_M, size.y - size.thick + JOINT_M
    for a, b in size.rows(2 * y):
        yield Part("floor slat", _nailed(draw, (-x, a - y, 0.0), (x, b - y, size.thick)), wood)


def _posted(draw: Draw, size: _Crate) -> Parts:
    """Slats around four posts in the corners, perhaps with battens, grips, a divider or skids."""
    wood, (x, y, thick) = draw.pick(RAW_WOODS), (size.x, size.y, size.thick)
    post, over = draw.between(0.024, 0.036), draw.choose([-0.008, -0.008, 0.02])
    inner = (x - thick + JOINT_M, y - thick + JOINT_M)
    for sx, sy in CORNERS:
        a, b = (
            sorted([sx * inner[0], sx * (inner[0] - post)]),
            sorted([sy * inner[1], sy * (inner[1] - post)]),
        )
        yield Part("post", _nailed(draw, (a[0], b[0], 0.002), (a[1], b[1], size.high + over)), wood)
    rows, grips = size.rows(size.high), draw.chance(0.4)
    for low, high in rows:
        yield from _side(draw, "slat", (y - thick, y), (-x, x), (low, high), wood, 1)
        for part in _side(draw, "slat", (x - thick, x), (-inner[1], inner[1]), (low, high), wood, 0):
            grip = grips and high == rows[-1][1] and high - low > 0.062
            slot = box((-2.0, -0.05, low + 0.018), (2.0, 0.05, high - 0.018))
            yield Part("slat", part.shape - slot if grip else part.shape, wood)
    yield from _floor(draw, size, wood)
    if x > 0.32:
        across = (inner[1] - 0.018, inner[1])
        yield from _side(draw, "batten", across, (-0.025, 0.025), (0.004, size.high - 0.004), wood, 1)
    elif draw.chance(0.25):
        at, head = x * draw.between(-0.3, 0.3), size.high * draw.between(0.5, 0.9)
        divider = _nailed(draw, (at - 0.007, -inner[1], 0.004), (at + 0.007, inner[1], head))
        yield Part("divider", divider, wood)
    if draw.chance(0.35):
        for at in (-0.75 * x, 0.75 * x):
            skid = _nailed(draw, (at - 0.03, 0.004 - y, -0.025), (at + 0.03, y - 0.004, JOINT_M))
            yield Part("skid", skid, wood)


def _ended(draw: Draw, size: _Crate) -> Parts:
    """Two whole end boards with a hole to grip, and slats from one to the other."""
    from manifold3d import Manifold

    wood, (x, y, thick) = draw.pick(RAW_WOODS), (size.x, size.y, size.thick)
    board, inner = max(0.015, thick), y - thick + JOINT_M
    # The ends may be a little higher than the sides.
    head = size.high + draw.choose([-0.004, 0.03])
    hole = rod((-2.0, -0.035, head - 0.055), (2.0, -0.035, head - 0.055), 0.017)
    slot = Manifold.batch_hull([hole, hole.translate((0.0, 0.07, 0.0))])
    for end in _side(draw, "end", (x - board, x), (-inner, inner), (0.0, head), wood, 0):
        yield Part("end", end.shape - slot, wood)
    for row in size.rows(size.high):
        yield from _side(draw, "slat", (y - thick, y), (-x, x), row, wood, 1)
    yield from _floor(draw, size, wood)


def _upright(draw: Draw, size: _Crate) -> Parts:
    """Upright slats around two rings of bars."""
    wood, (x, y, thick) = draw.pick(RAW_WOODS), (size.x, size.y, size.thick)
    inner = (x - thick + JOINT_M, y - thick + JOINT_M)
    for low in (0.004, size.high - 0.045):
        z = (low, low + 0.03)
        yield from _side(draw, "rail", (inner[1] - 0.02, inner[1]), (-inner[0], inner[0]), z, wood, 1)
        yield from _side(draw, "rail", (inner[0] - 0.02, inner[0]), (-inner[1], inner[1]), z, wood, 0)
    z = (0.0, size.high)
    for a, b in size.rows(2 * x):
        yield from _side(draw, "slat", (y - thick, y), (a - x, b - x), z, wood, 1)
    for a, b in size.rows(2 * y):
        yield from _side(draw, "slat", (x - thick, x), (a - y, b - y), z, wood, 0)
    yield from _floor(draw, size, wood)


def wire_basket(draw: Draw) -> Parts:
    """Draw a basket of bars, open above: round, oval or with corners, perhaps wider above, with handles."""
    y, kind = draw.between(0.13, 0.22), draw.choose(["round", "oval", "corners", "corners"])
    x = y if kind == "round" else y * draw.between(1.2, 1.6)
    high, radius = draw.between(0.16, 0.5), draw.between(0.0064, 0.0078)
    outline = ellipse((2 * x, 2 * y))
    if kind == "corners":
        outline = rectangle((2 * x, 2 * y), draw.between(0.03, 0.07))
    base, look = draw.between(0.7, 1.0), draw.pick(looks.METALS + looks.PLASTICS[:4])
    rings = draw.integer(2, 5)
    for k, share in enumerate(np.linspace(0, 1, rings).tolist()):
        # Rings are thicker than bars, the rim most of all: each bar ends inside of them.
        thick = radius * (1.4 if k == rings - 1 else 1.13)
        z, grow = 1.13 * radius + share * (high - radius), base + (1 - base) * share
        yield Part("ring", _loop(outline * grow, z, thick), look)
    around = np.linalg.norm(np.diff(outline, axis=0, append=outline[:1]), axis=1).sum() * base
    count = int(around / (2 * radius + draw.between(0.028, 0.05)))
    for at in _along(outline, count):
        foot, head = (*(at * base).tolist(), 1.13 * radius), (*at.tolist(), high)
        yield Part("bar", rod(foot, head, radius), look)
    yield from _grid(draw, outline * base, radius, look)
    handles = draw.choose(["none", "arch", "loops"])
    if handles == "arch":
        angle = np.linspace(0, np.pi, 15)
        rise = draw.between(0.12, 0.2)
        path = [(x * float(np.cos(a)), 0.0, high + rise * float(np.sin(a))) for a in angle]
        yield Part("handle", tube(path, radius), look)
    elif handles == "loops":
        for s in SIDES:
            at, out, top = s * _reach(outline, 0, 0.06), s * (x + 0.03), high + 0.06
            path = [(at, -0.06, high), (out, -0.05, top), (out, 0.05, top), (at, 0.06, high)]
            yield Part("handle", tube(rounded_path(path, 0.03), radius), look)


def _loop(outline: Outline, z_m: float, radius_m: float) -> "Manifold":
    """A level ring of round bar along an outline (n, 2)."""
    points = np.column_stack([outline, np.full(len(outline), z_m)])
    return tube(np.concatenate([points, points[:1]]), radius_m)


def _along(outline: Outline, count: int) -> Outline:
    """Points (count, 2), evenly spaced along a closed outline (n, 2)."""
    closed = np.concatenate([outline, outline[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(count) * length[-1] / count
    return np.column_stack([np.interp(at, length, closed[:, axis]) for axis in (0, 1)])


def _grid(draw: Draw, outline: Outline, radius_m: float, look: Look) -> Parts:
    """Bars across an outline (n, 2) near the floor, along x, and one or two along y."""
    half = np.ptp(outline, axis=0) / 2
    gap = 2 * radius_m + draw.between(0.026, 0.045)
    for axis, count in ((0, int(2 * half[1] / gap)), (1, draw.integer(1, 3))):
        places = np.linspace(-half[1 - axis], half[1 - axis], count + 2)[1:-1]
        for place in places.tolist():
            reach = _reach(outline, axis, place)
            # The bars along y lie a little higher, so that no two share a plane.
            z = (1.1 if axis == 0 else 1.35) * radius_m
            ends: list[Vector3] = [
                (s * reach, place, z) if axis == 0 else (place, s * reach, z) for s in SIDES
            ]
            yield Part("floor bar", rod(ends[0], ends[1], radius_m), look)


def _reach(outline: Outline, axis: int, place_m: float) -> float:
    """How far a convex outline, symmetric in x and y, reaches along an axis at a place of the other."""
    along, across = np.abs(outline[:, axis]), np.abs(outline[:, 1 - axis])
    order = np.lexsort((-along, across))
    return float(np.interp(abs(place_m), across[order], along[order]))
