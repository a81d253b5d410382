"""Backrests of chairs and benches between two posts: ladders, slats, spindles, crosses, splats, panels."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Vector3,
    bar_between,
    bowed,
    cushion,
    leaned,
    leg,
    plate,
    rectangle,
    rod,
    tube,
)


@dataclass(frozen=True)
class Back:
    """The dimensions of a backrest, metres, frame `object`; it leans to -y.

    Attributes:
        half: distance in x of the posts' centres from the middle.
        y: y of the posts' centres at the height of the seat.
        seat: height of the seat's upper face.
        top: height of the back's upper end.
        slope: metres backwards for each metre up.
        bow: how far the middle of the back is bent behind its posts.
        thick: thickness of the posts.
        look: material of all parts.
    """

    half: float
    y: float
    seat: float
    top: float
    slope: float
    bow: float
    thick: float
    look: Look

    def point(self, x: float, z: float) -> Vector3:
        """Return the point (x, y, z) halfway through the back's thickness at x and height z."""
        bend = self.bow * (1 - (x / self.half) ** 2)
        return x, self.y - self.slope * (z - self.seat) - bend, z

    def posts(self) -> Parts:
        """Make the two posts, from inside the seat to the back's upper end."""
        return [self.upright("post", s * self.half, self.seat - 0.012, self.top, self.thick) for s in SIDES]

    def upright(self, name: str, x: float, low: float, high: float, wide: float, deep: float = 0.0) -> Part:
        """Make a bar that leans with the back, at x, between the heights `low` and `high`.

        It is `wide` along x and `deep` (0: as thick as the posts) along y.
        """
        size = (wide, deep or self.thick)
        return Part(name, leg(self.point(x, low), self.point(x, high), size, size), self.look)

    def rail(self, low: float, high: float, deep: float = 0.02, name: str = "rail") -> Part:
        """Make a board bent with the back, post to post, `deep` thick, between heights `low` and `high`."""
        y, half = self.point(self.half, self.seat)[1], self.half
        board = bowed((-half, y - deep / 2, low), (half, y + deep / 2, high), self.bow)
        return Part(name, leaned(board, self.seat, self.slope), self.look)


def _ladder(draw: Draw, back: Back) -> Parts:
    count, high = draw.integer(2, 5), back.top - back.seat
    wide = min(draw.between(0.04, 0.09), 0.55 * high / count)
    tops = np.linspace(back.top - 0.01, back.seat + 0.35 * high, count)
    return [back.rail(float(top) - wide, float(top)) for top in tops]


def _between_rails(draw: Draw, back: Back) -> tuple[float, float, Parts]:
    """Make a lower and an upper rail. Return the heights where bars between them end, and both rails."""
    low = back.seat + draw.between(0.06, 0.14)
    crest = draw.between(0.05, 0.09)
    rails = [back.rail(low - 0.025, low + 0.015), back.rail(back.top - crest, back.top, 0.024, "crest")]
    return low, back.top - crest + 0.015, rails


def _slats(draw: Draw, back: Back) -> Parts:
    low, high, rails = _between_rails(draw, back)
    yield from rails
    count = max(3, round(2 * back.half / draw.between(0.08, 0.14)))
    wide = 2 * back.half / count * draw.between(0.35, 0.65)
    for x in np.linspace(-back.half, back.half, count + 2)[1:-1]:
        yield back.upright("slat", float(x), low, high, wide, 0.016)


def _spindles(draw: Draw, back: Back) -> Parts:
    crest = draw.between(0.05, 0.1)
    yield back.rail(back.top - crest, back.top, 0.024, "crest")
    count = max(4, round(2 * back.half / draw.between(0.055, 0.08)))
    radius = draw.between(0.008, 0.011)
    for x in np.linspace(-back.half, back.half, count + 2)[1:-1]:
        ends = back.point(float(x), back.seat - 0.01), back.point(float(x), back.top - crest + 0.015)
        yield Part("spindle", rod(*ends, radius), back.look)


def _cross(draw: Draw, back: Back) -> Parts:
    low, high, rails = _between_rails(draw, back)
    yield from rails
    count = max(1, round(back.half / 0.3))
    edges = np.linspace(-back.half, back.half, count + 1)
    # A straight bar from post to post lies on the chord of the bent back.
    flat = replace(back, bow=0.0)
    for left, right in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        for z0, z1, deep in ((low, high, 0.016), (high, low, 0.018)):
            yield Part(
                "cross", bar_between(flat.point(left, z0), flat.point(right, z1), deep, 0.03), back.look
            )
    for x in edges[1:-1].tolist():
        yield flat.upright("slat", x, back.seat - 0.01, back.top - 0.01, 0.03, 0.02)


def _splat(draw: Draw, back: Back) -> Parts:
    low, high, rails = _between_rails(draw, back)
    wide = back.half * draw.between(0.5, 0.8)
    yield from rails
    yield back.upright("splat", 0.0, low, high, wide, 0.016)


def _panel(draw: Draw, back: Back) -> Parts:
    low = back.seat + (draw.between(0.08, 0.2) if draw.chance(0.5) else -0.01)
    return [back.rail(low, back.top - 0.005, 0.018, "panel")]


def _padded(draw: Draw, back: Back) -> Parts:
    look = draw.pick(looks.CLOTHS)
    low, y = back.seat + draw.between(0.03, 0.1), back.y
    panel = back.rail(low, back.top - 0.01, 0.018, "panel")
    inner = back.half - back.thick / 2 - 0.004
    pad = cushion((-inner, y - 0.02, low + 0.015), (inner, y + 0.035, back.top - 0.03), 0.022)
    bend = pad.translate((0.0, -0.6 * back.bow, 0.0))
    return [panel, Part("back cushion", leaned(bend, back.seat, back.slope), look)]


KINDS: dict[str, Callable[[Draw, Back], Parts]] = {
    "ladder": _ladder,
    "slats": _slats,
    "spindles": _spindles,
    "cross": _cross,
    "splat": _splat,
    "panel": _panel,
    "padded": _padded,
}


def filling(draw: Draw, back: Back, kinds: tuple[str, ...] = tuple(KINDS)) -> Parts:
    """Make the parts between a back's posts, of a kind drawn from `kinds`."""
    return KINDS[draw.choose(kinds)](draw, back)


def hoop(draw: Draw, back: Back) -> Parts:
    """Make a backrest without posts: a bent hoop with spindles, as on a Windsor chair."""
    # An even number, so that no corner of the hoop lies on the middle spindle's axis.
    angle = np.linspace(0, np.pi, 20)
    flat = 0.62
    x = back.half * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** flat
    z = back.seat - 0.012 + (back.top - back.seat) * np.sin(angle) ** flat
    path = np.array([back.point(float(a), float(b)) for a, b in zip(x, z, strict=True)])
    yield Part("hoop", tube(path, 0.012), back.look)
    count = draw.integer(5, 9)
    for share in np.linspace(-0.8, 0.8, count):
        at = back.half * float(share)
        high = float(np.interp(at, x[::-1], z[::-1]))
        ends = back.point(0.8 * at, back.seat - 0.012), back.point(at, high)
        yield Part("spindle", rod(*ends, 0.0085), back.look)


def board_back(draw: Draw, back: Back) -> Parts:
    """Make a backrest of a bent board with round corners, perhaps with an opening, on two short posts."""
    high = back.top - back.seat
    low = back.seat + high * draw.between(0.3, 0.5)
    # The posts are behind the board and reach into it.
    behind = replace(back, y=back.y - 0.014)
    posts = [behind.upright("post", s * back.half * 0.55, back.seat - 0.012, low + 0.1, 0.03) for s in SIDES]
    board = back.rail(low, back.top, 0.018, "back")
    middle, size = (low + back.top) / 2, (2 * back.half, back.top - low)
    corner = min(size) * draw.between(0.15, 0.45)
    window = plate(rectangle(size, corner), -1.0, 1.0).rotate((90.0, 0.0, 0.0)).translate((0.0, 0.0, middle))
    shape = board.shape ^ window
    if draw.chance(0.3):
        hole = plate(rectangle((0.12, 0.035), 0.016), -1.0, 1.0).rotate((90.0, 0.0, 0.0))
        shape = shape - hole.translate((0.0, 0.0, back.top - 0.06))
    return [*posts, Part("back", shape, back.look)]
