"""What is recorded: objects from mesh files, and objects drawn by a seed, related families in one file.

Rules are chosen on the families of `LOOKED_AT` and never on those of `REPORTED_ONLY`: nobody looks at their
results while a rule or a figure is chosen, so that what is reported of them tells how it goes with shapes
that nobody thought of. Each family is in one of the two; one whose results were looked at after all moves
to `LOOKED_AT`, and others take its place.
"""

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kinectbench.core.errors import SettingsError
from kinectbench.lab.simulate.objects.benches import bench
from kinectbench.lab.simulate.objects.cabinets import fridge, open_cabinet
from kinectbench.lab.simulate.objects.casework import piano, sideboard
from kinectbench.lab.simulate.objects.ceramics import bottle, kettle, mug, vase
from kinectbench.lab.simulate.objects.chairs import chair
from kinectbench.lab.simulate.objects.containers import basket, bucket, pot, waste_bin
from kinectbench.lab.simulate.objects.couches import couch
from kinectbench.lab.simulate.objects.deceptive import flap_box, shell, sound_box, two_boxes
from kinectbench.lab.simulate.objects.figures import shoe, toy_animal
from kinectbench.lab.simulate.objects.frames import ladder, tray_stand
from kinectbench.lab.simulate.objects.headgear import helmet
from kinectbench.lab.simulate.objects.joinery import Draw, Parts, assemble
from kinectbench.lab.simulate.objects.kennels import kennel
from kinectbench.lab.simulate.objects.lamps import lamp
from kinectbench.lab.simulate.objects.lattices import crate, wire_basket
from kinectbench.lab.simulate.objects.laundry import washing_machine
from kinectbench.lab.simulate.objects.open_boxes import drawer, open_box
from kinectbench.lab.simulate.objects.padded import bed, stool
from kinectbench.lab.simulate.objects.shapes import Subject
from kinectbench.lab.simulate.objects.shelves import bookshelf, rack
from kinectbench.lab.simulate.objects.sinks import sink
from kinectbench.lab.simulate.objects.smooth import blob, sculpture
from kinectbench.lab.simulate.objects.stands import clothes_horse, easel
from kinectbench.lab.simulate.objects.tables import table
from kinectbench.lab.simulate.objects.toys import toy_car
from kinectbench.lab.simulate.objects.yard import trough, watering_can, wheelbarrow
from kinectbench.settings.words import listed, near_miss

FAMILIES: dict[str, Callable[[Draw], Parts]] = {
    "chair": chair,
    "table": table,
    "bench": bench,
    "couch": couch,
    "bin": waste_bin,
    "bucket": bucket,
    "basket": basket,
    "pot": pot,
    "open_box": open_box,
    "drawer": drawer,
    "sink": sink,
    "rack": rack,
    "lamp": lamp,
    "crate": crate,
    "bookshelf": bookshelf,
    "ladder": ladder,
    "wire_basket": wire_basket,
    "tray_stand": tray_stand,
    "open_cabinet": open_cabinet,
    "fridge": fridge,
    "mug": mug,
    "kettle": kettle,
    "vase": vase,
    "shoe": shoe,
    "toy_animal": toy_animal,
    "blob": blob,
    "sculpture": sculpture,
    "kennel": kennel,
    "sideboard": sideboard,
    "piano": piano,
    "stool": stool,
    "bed": bed,
    "wheelbarrow": wheelbarrow,
    "trough": trough,
    "clothes_horse": clothes_horse,
    "easel": easel,
    "washing_machine": washing_machine,
    "watering_can": watering_can,
    "toy_car": toy_car,
    "helmet": helmet,
    "bottle": bottle,
    "shell": shell,
    "two_boxes": two_boxes,
    "flap_box": flap_box,
    "sound_box": sound_box,
}
# Those of the paper's categories that are furniture: what `synthesize` draws where no family is named.
PAPER_FURNITURE = ("chair", "table", "bench", "couch")
# What the bars of furniture hold for.
FURNITURE = (*PAPER_FURNITURE, "sideboard", "piano", "stool", "bed")
LOOKED_AT: tuple[str, ...] = (
    *PAPER_FURNITURE,
    *("bin", "open_box", "drawer", "bucket", "basket", "pot", "sink"),
    *("rack", "lamp", "crate", "bookshelf", "ladder", "wire_basket", "tray_stand"),
    *("open_cabinet", "fridge", "kennel"),
    *("mug", "shoe", "kettle", "vase", "toy_animal"),
    *("blob", "sculpture"),
    *("shell", "two_boxes", "flap_box", "sound_box"),
)
REPORTED_ONLY: tuple[str, ...] = (
    *("sideboard", "piano", "stool", "bed"),
    *("wheelbarrow", "trough"),
    *("clothes_horse", "easel"),
    "washing_machine",
    *("watering_can", "toy_car", "helmet", "bottle"),
)

# By their parts, families with no space behind the underside that is open to the air: of these
# `underside: closed` is true. Slats, trays, shells and vessels on feet are none of them.
CLOSED_BELOW: tuple[str, ...] = (
    *("chair", "table", "couch", "sideboard", "piano", "stool"),
    *("open_box", "crate", "bookshelf", "rack", "ladder", "open_cabinet", "two_boxes"),
    *("blob", "sculpture", "toy_car", "bottle"),
)


class ObjectName(NamedTuple):
    """An object: its family and the seed that draws it."""

    family: str
    seed: int


def check_family(family: str) -> str:
    """Accept the name of a family of objects.

    Raises:
        SettingsError: there is no such family; the nearest name is suggested.
    """
    if family in FAMILIES:
        return family
    hint = f"{near_miss(family, list(FAMILIES))} choose one of {listed(FAMILIES)}".lstrip()
    raise SettingsError(f"object family '{family}': unknown; {hint}")


def parse_object(text: str) -> ObjectName:
    """Read `chair` or `chair:seed=3`.

    Raises:
        SettingsError: the text is not of this form, or there is no such family.
    """
    match = re.fullmatch(r"([^:]+)(?::seed=(\d{1,9}))?", text.strip())
    if not match:
        raise SettingsError(f"object '{text}': write the family and its seed, such as chair:seed=3")
    return ObjectName(check_family(match[1]), int(match[2] or 0))


def make_object(family: str, seed: int) -> Subject:
    """Draw an object in its object frame: z up, on z = 0, centred at x = y = 0.

    Chairs, benches and couches face +y. Nothing is thinner than 15 mm in furniture, than 8 mm in mugs, vases,
    shoes, watering cans and helmets, nor than 12 mm elsewhere.
    Its mesh is the union of its pieces. Same family and seed, same vertices. The proportions are own choices.

    Raises:
        SettingsError: there is no such family.
    """
    rng = np.random.default_rng([*check_family(family).encode(), seed])
    name = f"{family}:seed={seed}"
    kind = "furniture" if family in FURNITURE else "object"
    return assemble(name, FAMILIES[family](Draw(rng)), f"parametric {kind}: exact union of its pieces")
