"""Chairs: seat, four legs or a pedestal, a solid, slatted or ladder back, perhaps armrests."""

from dataclasses import dataclass

import numpy as np

from kinectbench.simulate.joinery import CLOTHS, WOODS, board, four_legs, pedestal, pick
from kinectbench.simulate.solid import Outline, Part, Vector3


@dataclass(frozen=True)
class _Back:
    """Where the back stands: all in metres, object frame."""

    half_width: float
    y: float
    seat: float
    top: float
    lean: float
    thick: float
    color: Vector3

    def y_at(self, z: float) -> float:
        """The middle of the leaning back at height z."""
        return self.y - self.lean * (z - self.seat) / (self.top - self.seat)

    def upright(self, name: str, low_x: float, high_x: float) -> Part:
        """A leaning piece from the seat to the top."""
        half = self.thick / 2
        low, high = (low_x, self.y - half, self.seat), (high_x, self.y + half, self.top)
        return board(name, low, high, self.color, lean_m=self.lean)

    def rail(self, low_z: float, high_z: float) -> Part:
        """A cross piece over the whole width, leaning as the back does."""
        y, half = self.y_at(low_z), self.thick / 2
        low, high = (-self.half_width, y - half, low_z), (self.half_width, y + half, high_z)
        return board("rail", low, high, self.color, lean_m=y - self.y_at(high_z))


def chair(rng: np.random.Generator) -> list[Part]:
    """Draw a chair whose front faces +y."""
    width, depth = float(rng.uniform(0.40, 0.52)), float(rng.uniform(0.40, 0.50))
    seat, thick = float(rng.uniform(0.41, 0.48)), float(rng.uniform(0.03, 0.08))
    wood, cloth = pick(rng, WOODS), pick(rng, CLOTHS + WOODS)
    outline: Outline = "rounded" if rng.random() < 0.5 else "rectangle"
    half = (width / 2, depth / 2)
    parts = [board("seat", (-half[0], -half[1], seat - thick), (*half, seat), cloth, outline)]
    leg = float(rng.uniform(0.032, 0.055))
    under = seat - thick / 2
    if rng.random() < 0.7:
        inset = leg / 2 + 0.015
        parts += four_legs(rng, (half[0] - inset, half[1] - inset), under, leg, wood)
    else:
        parts += pedestal(rng, float(rng.uniform(0.22, 0.29)), under, float(rng.uniform(0.05, 0.08)), wood)
    back_thick = float(rng.uniform(0.028, 0.045))
    back = _Back(
        half_width=half[0] - 0.015,
        y=-half[1] + back_thick / 2 + 0.012,
        seat=under,
        top=seat + float(rng.uniform(0.36, 0.55)),
        lean=float(rng.uniform(0.0, 0.13)),
        thick=back_thick,
        color=wood if rng.random() < 0.6 else cloth,
    )
    parts += _back(rng, back)
    if rng.random() < 0.4:
        parts += _arms(rng, back, half[1], seat, wood)
    return parts


def _back(rng: np.random.Generator, back: _Back) -> list[Part]:
    """A solid panel, vertical slats under a top rail, or a ladder of rails."""
    kind = rng.choice(["solid", "slats", "ladder"])
    if kind == "solid":
        return [back.upright("back", -back.half_width, back.half_width)]
    post = max(0.03, back.thick)
    parts = [
        back.upright("upright", -back.half_width, -back.half_width + post),
        back.upright("upright", back.half_width - post, back.half_width),
        back.rail(back.top - float(rng.uniform(0.06, 0.1)), back.top),
    ]
    clear = back.top - back.seat
    if kind == "slats":
        slats = int(rng.integers(2, 5))
        for x in np.linspace(-back.half_width, back.half_width, slats + 2)[1:-1]:
            parts.append(back.upright("slat", float(x) - 0.02, float(x) + 0.02))
        return parts
    for share in np.linspace(0.35, 0.7, int(rng.integers(1, 3))):
        z = back.seat + clear * float(share)
        parts.append(back.rail(z - 0.03, z + 0.03))
    return parts


def _arms(
    rng: np.random.Generator, back: _Back, half_depth: float, seat: float, color: Vector3
) -> list[Part]:
    """Two armrests from the back to posts that stand on the seat."""
    z, wide = seat + float(rng.uniform(0.18, 0.24)), float(rng.uniform(0.04, 0.06))
    front = half_depth - float(rng.uniform(0.03, 0.12))
    parts = []
    for side in (-1, 1):
        x = side * (back.half_width - wide / 2)
        low, high = (x - wide / 2, back.y_at(z), z - 0.03), (x + wide / 2, front, z)
        parts.append(board("armrest", low, high, color))
        post = board("post", (x - 0.016, front - 0.05, seat - 0.02), (x + 0.016, front - 0.015, z), color)
        parts.append(post)
    return parts
