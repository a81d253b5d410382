"""Shared code of object families: parts with a material, random draws, and the union of parts."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TypeVar

import numpy as np
from manifold3d import Manifold

from kinectbench.core.geometry import TriangleMesh
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import Piece, Subject, standing_shift, surface, union

Choice = TypeVar("Choice")

# Signs of x for parts at the left and right, and of x and y for parts at all four corners.
SIDES = (-1, 1)
CORNERS = tuple(product(SIDES, SIDES))


@dataclass(frozen=True)
class Part:
    """A closed part of an object, of one material; frame `object`, metres."""

    name: str
    shape: Manifold
    look: Look


# The parts that an object is glued from, in the order in which they are drawn.
Parts = Iterable[Part]


class Draw:
    """Makes the random choices of a family or a scene."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Take all random numbers from the generator `rng`, in order."""
        self.rng = rng

    def choose(self, options: Sequence[Choice]) -> Choice:
        """Return one of the options, with equal probability."""
        return options[int(self.rng.integers(len(options)))]

    def pick(self, looks: Sequence[Look]) -> Look:
        """Return one of the materials, with equal probability, at a random brightness."""
        look, tint = self.choose(looks), self.between(0.88, 1.08)
        red, green, blue = (min(1.0, value * tint) for value in look.color_rgb)
        return Look((red, green, blue), look.albedo)

    def between(self, low: float, high: float) -> float:
        """Return a number drawn uniformly from a range."""
        return float(self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        """Return True with the given probability."""
        return bool(self.rng.random() < probability)

    def integer(self, low: int, above: int) -> int:
        """Return an integer drawn uniformly from `low` to `above` - 1."""
        return int(self.rng.integers(low, above))


@dataclass(frozen=True)
class Family:
    """A kind of objects, drawn at random.

    Rules and constants of the package are chosen on development families (`looked_at`) only. The results of
    all other families stay unseen meanwhile, so that reported results hold for new shapes. A family whose
    results were seen becomes a development family, and another one replaces it.

    Attributes:
        draw: draws the parts of one object.
        looked_at: whether this is a development family.
        furniture: whether benchmarks check its results against the thresholds for furniture.
        closed_below: whether the setting `underside: closed` is true of its objects: there is no space behind
            their underside that is open to the air. Slats, trays, shells and vessels on feet have such a
            space.
    """

    draw: Callable[[Draw], Parts]
    looked_at: bool = False
    furniture: bool = False
    closed_below: bool = False


def glue(name: str, parts: Parts, origin: str) -> Subject:
    """Unite parts into one solid, with its bounding box centred at x = y = 0 and standing on z = 0.

    The parts are closed and overlap, metres; `origin` says in one line where the solid comes from.
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
