"""Objects of simulated recordings: read from mesh files, or drawn at random from a family by a seed.

Packages add families by the entry point `kinectbench.families` (`kinectbench.lab.plugins`); a checkout after
`make setup` has the families of `benchmarks/plugins`.
"""

import re
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from kinectbench.core import SettingsError, listed
from kinectbench.lab.plugins import plugins
from kinectbench.lab.simulate.objects.benches import bench
from kinectbench.lab.simulate.objects.chairs import chair
from kinectbench.lab.simulate.objects.couches import couch
from kinectbench.lab.simulate.objects.joinery import Draw, Family, glue
from kinectbench.lab.simulate.objects.shapes import Subject
from kinectbench.lab.simulate.objects.tables import table
from kinectbench.settings.words import near_miss

# The paper's categories that are furniture: `synthesize` draws these if no family is named.
PAPER_FURNITURE: Mapping[str, Family] = {
    "chair": Family(chair, looked_at=True, furniture=True, closed_below=True),
    "table": Family(table, looked_at=True, furniture=True, closed_below=True),
    "bench": Family(bench, looked_at=True, furniture=True),
    "couch": Family(couch, looked_at=True, furniture=True, closed_below=True),
}


class ObjectName(NamedTuple):
    """An object's name: its family, and the seed that draws it."""

    family: str
    seed: int


@cache
def families() -> Mapping[str, Family]:
    """Return {name: family} of all families: the paper's furniture, then those of plug-ins.

    Raises:
        SettingsError: a plug-in cannot be used.
    """
    return plugins("kinectbench.families", Family, PAPER_FURNITURE)


# Words for a family that are not like its name.
OTHER_WORDS = {"sofa": "couch", "settee": "couch", "desk": "table", "cup": "mug", "refrigerator": "fridge"}


def check_family(family: str) -> str:
    """Return the name of a family unchanged if the family exists.

    Raises:
        SettingsError: the family is unknown; the message suggests the most similar name.
    """
    if family in families():
        return family
    one = family.lower()
    near = near_miss(OTHER_WORDS.get(one) or OTHER_WORDS.get(one.removesuffix("s"), family), list(families()))
    hint = f"{near} choose one of {listed(families())}".lstrip()
    raise SettingsError(f"object family '{family}': unknown; {hint}")


def parse_object(text: str) -> ObjectName:
    """Parse an object's name, such as `chair` or `chair:seed=3`.

    Raises:
        SettingsError: the text is not of this form, or there is no such family.
    """
    match = re.fullmatch(r"([^:]+)(?::seed=(\d{1,9}))?", text.strip())
    if not match:
        raise SettingsError(f"object '{text}': write the family and its seed, such as chair:seed=3")
    return ObjectName(check_family(match[1]), int(match[2] or 0))


def make_object(family: str, seed: int) -> Subject:
    """Draw an object of a family in its object frame: z up, standing on z = 0, centred at x = y = 0.

    Chairs, benches and couches face +y; no part of the paper's furniture is thinner than 15 mm. The mesh is
    the union of the parts. The same family and seed give the same vertices.

    Raises:
        SettingsError: unknown family.
    """
    rng = np.random.default_rng([*check_family(family).encode(), seed])
    drawn = families()[family]
    kind = "furniture" if drawn.furniture else "object"
    origin = f"parametric {kind}: exact union of its pieces"
    return glue(f"{family}:seed={seed}", drawn.draw(Draw(rng)), origin)
