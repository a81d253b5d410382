"""What all families of furniture share: parts with a look, drawing by chance, gluing parts to an object."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from kinectbench.core.geometry import TriangleMesh
from kinectbench.lab.simulate.objects.shapes import Piece, Subject, Vector3, standing, surface, union

if TYPE_CHECKING:
    from manifold3d import Manifold

Choice = TypeVar("Choice")

# Signs of x for what stands at the left and the right, and of x and y for what stands at all four corners.
SIDES = (-1, 1)
CORNERS = tuple(product(SIDES, SIDES))


@dataclass(frozen=True)
class Look:
    """How a material looks.

    Attributes:
        color_rgb: each in [0, 1].
        albedo: share of infrared light that it reflects, in [0, 1].
    """

    color_rgb: Vector3
    albedo: float


@dataclass(frozen=True)
class Part:
    """A closed part of a piece of furniture, with one look; frame `object`, metres."""

    name: str
    shape: "Manifold"
    look: Look


# What furniture is glued of, in the order in which it is drawn by chance.
Parts = Iterable[Part]

# Colours and infrared albedos are own choices: dyes and varnish take little infrared light, black pigment
# takes most.
BLACK_STEEL = Look((0.09, 0.09, 0.10), 0.07)
WOODS: tuple[Look, ...] = (
    Look((0.76, 0.60, 0.40), 0.72),
    Look((0.62, 0.43, 0.26), 0.65),
    Look((0.45, 0.28, 0.17), 0.55),
    Look((0.84, 0.72, 0.53), 0.78),
    Look((0.55, 0.29, 0.17), 0.58),
    Look((0.27, 0.18, 0.13), 0.42),
    Look((0.88, 0.87, 0.84), 0.80),
    Look((0.12, 0.11, 0.11), 0.12),
)
CLOTHS: tuple[Look, ...] = (
    Look((0.62, 0.17, 0.16), 0.66),
    Look((0.19, 0.31, 0.52), 0.58),
    Look((0.27, 0.44, 0.30), 0.60),
    Look((0.78, 0.60, 0.22), 0.72),
    Look((0.50, 0.49, 0.47), 0.62),
    Look((0.78, 0.73, 0.65), 0.78),
    Look((0.28, 0.29, 0.31), 0.45),
    Look((0.58, 0.42, 0.50), 0.64),
)
LEATHERS: tuple[Look, ...] = (
    Look((0.47, 0.26, 0.14), 0.55),
    Look((0.70, 0.48, 0.30), 0.62),
    Look((0.08, 0.08, 0.08), 0.06),
    Look((0.80, 0.76, 0.70), 0.70),
)
PLASTICS: tuple[Look, ...] = (
    Look((0.90, 0.90, 0.88), 0.80),
    Look((0.76, 0.20, 0.16), 0.68),
    Look((0.90, 0.70, 0.18), 0.74),
    Look((0.22, 0.52, 0.54), 0.62),
    Look((0.46, 0.54, 0.36), 0.62),
    Look((0.12, 0.12, 0.13), 0.10),
)
METALS: tuple[Look, ...] = (
    Look((0.66, 0.67, 0.69), 0.50),
    Look((0.86, 0.86, 0.85), 0.76),
    BLACK_STEEL,
    Look((0.40, 0.41, 0.43), 0.45),
)
IRONS: tuple[Look, ...] = (BLACK_STEEL, Look((0.16, 0.27, 0.21), 0.40), Look((0.40, 0.41, 0.43), 0.45))
STONES: tuple[Look, ...] = (Look((0.66, 0.65, 0.62), 0.62), Look((0.52, 0.48, 0.45), 0.52))


class Draw:
    """What a family or a scene draws by chance."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw from a generator (`rng`), one number after another."""
        self.rng = rng

    def choose(self, options: Sequence[Choice]) -> Choice:
        """One of the options, all alike likely."""
        return options[int(self.rng.integers(len(options)))]

    def pick(self, looks: Sequence[Look]) -> Look:
        """One of the looks, a little lighter or darker."""
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


def assemble(name: str, parts: Parts, origin: str) -> Subject:
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
    shift = standing(mesh)

    def placed(mesh: TriangleMesh) -> TriangleMesh:
        return TriangleMesh(mesh.vertices + shift, mesh.faces)

    pieces = [
        Piece(part.name, placed(surface(part.shape)), part.look.color_rgb, part.look.albedo) for part in glued
    ]
    return Subject(name, tuple(pieces), placed(mesh), origin)
