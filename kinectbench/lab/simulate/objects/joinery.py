"""Shared code of object families: parts with a look, random draws, joining parts to an object."""

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

# Signs of x for what stands at the left and the right, and of x and y for what stands at all four corners.
SIDES = (-1, 1)
CORNERS = tuple(product(SIDES, SIDES))


@dataclass(frozen=True)
class Part:
    """A closed part of an object, with one look; frame `object`, metres."""

    name: str
    shape: "Manifold"
    look: Look


# What an object is glued of, in the order in which it is drawn by chance.
Parts = Iterable[Part]


class Draw:
    """Random choices of a family or scene."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw from a generator (`rng`), one number after another."""
        self.rng = rng

    def choose(self, options: Sequence[Choice]) -> Choice:
        """One of the options, with equal probability."""
        return options[int(self.rng.integers(len(options)))]

    def pick(self, looks: Sequence[Look]) -> Look:
        """One of the looks, with random brightness."""
        look, tint = self.choose(looks), self.between(0.88, 1.08)
        red, green, blue = (min(1.0, value * tint) for value in look.color_rgb)
        return Look((red, green, blue), look.albedo)

    def between(self, low: float, high: float) -> float:
        """A number drawn evenly from a range."""
        return float(self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        """True with that probability."""
        return bool(self.rng.random() < probability)

    def integer(self, low: int, above: int) -> int:
        """A whole number from `low` to below `above`."""
        return int(self.rng.integers(low, above))


@dataclass(frozen=True)
class Family:
    """Objects of one kind, drawn by chance.

    Rules are chosen on families that are looked at, and never on the others: nobody looks at their results
    while a rule or a figure is chosen, so that what is reported of them holds for shapes that nobody thought
    of. A family whose results were looked at after all becomes one of the first, and another takes its place.

    Attributes:
        draw: the parts of one object.
        looked_at: rules may be chosen on it.
        furniture: the bars of furniture hold for it.
        closed_below: by its parts, no space behind the underside is open to the air; then
            `underside: closed` is true. Slats, trays, shells and vessels on feet are open.
    """

    draw: Callable[[Draw], Parts]
    looked_at: bool = False
    furniture: bool = False
    closed_below: bool = False


def glue(name: str, parts: Parts, origin: str) -> Subject:
    """Glue parts to one solid, centred by its bounding box at x = y = 0 and standing on z = 0.

    Args:
        name: of the subject.
        parts: closed, overlapping one another, metres.
        origin: where the solid comes from, one line.
    """
    glued = tuple(parts)
    whole = union([part.shape for part in glued])
    # Where round parts fit into one another, a crack may be shut in: it is filled.
    mesh = surface(union([body for body in whole.decompose() if body.volume() > 0]))
    shift = standing_shift(mesh)

    def placed(mesh: TriangleMesh) -> TriangleMesh:
        return TriangleMesh(mesh.vertices + shift, mesh.faces)

    pieces = [
        Piece(part.name, placed(surface(part.shape)), part.look.color_rgb, part.look.albedo) for part in glued
    ]
    return Subject(name, tuple(pieces), placed(mesh), origin)
