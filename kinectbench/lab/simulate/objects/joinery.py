"""Shared code of object families: parts with a look, random draws, gluing parts into an object."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from kinectbench.core.geometry import TriangleMesh
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import Piece, Subject, standing_shift, surface, union

if TYPE_CHECKING:
    from manifold3d import Manifold

Choice = TypeVar("Choice")

# Signs of x for parts at the left and right, and of x and y for parts at all four corners.
SIDES = (-1, 1)
CORNERS = tuple(product(SIDES, SIDES))


@dataclass(frozen=True)
class Part:
    """A closed part of an object, with one look; frame `object`, metres."""

    name: str
    shape: "Manifold"
    look: Look


# The parts that an object is glued from, in the order in which they are drawn.
Parts = Iterable[Part]


class Draw:
    """Random choices of a family or scene."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw from a generator (`rng`), one number after another."""
        self.rng = rng

    def choose(self, options: Sequence[Choice]) -> Choice:
        """Return one of the options, with equal probability."""
        return options[int(self.rng.integers(len(options)))]

    def pick(self, looks: Sequence[Look]) -> Look:
        """Return one of the looks, with random brightness."""
        look, tint = self.choose(looks), self.between(0.88, 1.08)
        red, green, blue = (min(1.0, value * tint) for value in look.color_rgb)
        return Look((red, green, blue), look.albedo)

    def between(self, low: float, high: float) -> float:
        """Return a number drawn uniformly from a range."""
        return float(self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        """Return True with that probability."""
        return bool(self.rng.random() < probability)

    def integer(self, low: int, above: int) -> int:
        """Return a whole number from `low` to below `above`."""
        return int(self.rng.integers(low, above))


@dataclass(frozen=True)
class Family:
    """Objects of one kind, drawn by chance.

    Some families are for development: rules and constants are chosen on them (`looked_at`). Nobody looks at
    results of the rest meanwhile, so that reported figures hold for unseen shapes. A family whose results
    were looked at after all becomes a development family, and another replaces it.

    Attributes:
        draw: draws the parts of one object.
        looked_at: whether rules may be chosen on this family.
        furniture: whether the thresholds for furniture apply to it.
        closed_below: whether no space behind the underside is open to the air, by the parts; then `underside:
            closed` is true. Slats, trays, shells and vessels on feet are open.
    """

    draw: Callable[[Draw], Parts]
    looked_at: bool = False
    furniture: bool = False
    closed_below: bool = False


def glue(name: str, parts: Parts, origin: str) -> Subject:
    """Glue parts into one solid, centred by its bounding box at x = y = 0 and standing on z = 0.

    Args:
        name: the subject's name.
        parts: closed parts that overlap, metres.
        origin: where the solid comes from, one line.
    """
    glued = tuple(parts)
    whole = union([part.shape for part in glued])
    # Where round parts fit into each other, a crack may be enclosed: it is filled.
    mesh = surface(union([body for body in whole.decompose() if body.volume() > 0]))
    shift = standing_shift(mesh)

    def placed(mesh: TriangleMesh) -> TriangleMesh:
        return TriangleMesh(mesh.vertices + shift, mesh.faces)

    pieces = [
        Piece(part.name, placed(surface(part.shape)), part.look.color_rgb, part.look.albedo) for part in glued
    ]
    return Subject(name, tuple(pieces), placed(mesh), origin)
