"""Parametric furniture drawn by a seed: a registry of families, each in its own file."""

import difflib
import re
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinectbench.errors import SettingsError
from kinectbench.simulate.chairs import chair
from kinectbench.simulate.seats import bench, couch
from kinectbench.simulate.solid import Part, Solid
from kinectbench.simulate.tables import table

FAMILIES: dict[str, Callable[[np.random.Generator], list[Part]]] = {
    "chair": chair,
    "table": table,
    "bench": bench,
    "couch": couch,
}


class ObjectName(NamedTuple):
    """A piece of furniture: its family and the seed that draws it."""

    family: str
    seed: int


def check_family(family: str) -> str:
    """Accept the name of a family of furniture.

    Raises:
        SettingsError: there is no such family; the nearest name is suggested.
    """
    if family in FAMILIES:
        return family
    near = difflib.get_close_matches(family, FAMILIES, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    raise SettingsError(f"object family '{family}': unknown; {hint}choose one of {', '.join(FAMILIES)}")


def parse_object(text: str) -> ObjectName:
    """Read `chair` or `chair:seed=3`.

    Raises:
        SettingsError: the text is not of this form, or there is no such family.
    """
    match = re.fullmatch(r"([^:]+)(?::seed=(\d{1,9}))?", text.strip())
    if not match:
        raise SettingsError(f"object '{text}': write the family and its seed, such as chair:seed=3")
    return ObjectName(check_family(match[1]), int(match[2] or 0))


def make_object(family: str, seed: int) -> Solid:
    """Draw a piece of furniture in its object frame: z up, on z = 0, centred at x = y = 0.

    Chairs, benches and couches face +y. Every part is at least 25 mm thick. Same family and seed, same
    solid. The proportions are own choices.

    Raises:
        SettingsError: there is no such family.
    """
    rng = np.random.default_rng([*check_family(family).encode(), seed])
    return centred(Solid(tuple(FAMILIES[family](rng))))


def centred(solid: Solid) -> Solid:
    """Move a solid so that its bounding box is centred at x = y = 0 and stands on z = 0."""
    low, high = solid.bounds_m()
    shift = np.array([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])

    def moved(part: Part) -> Part:
        (bx, by, bz), (tx, ty, tz) = (
            (np.array(part.bottom_m) + shift).tolist(),
            (np.array(part.top_m) + shift).tolist(),
        )
        return replace(part, bottom_m=(bx, by, bz), top_m=(tx, ty, tz))

    return Solid(tuple(moved(part) for part in solid.parts))
