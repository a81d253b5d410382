"""Families of objects beyond the paper's furniture: what rules are chosen on, and what is only reported.

Each is in one of the two. Nothing is thinner than 15 mm in furniture, than 8 mm in mugs, vases, shoes,
watering cans and helmets, nor than 12 mm elsewhere.
"""

from kinectbench.lab.simulate.objects.joinery import Family
from kinectbench_plugins.families.cabinets import fridge, open_cabinet
from kinectbench_plugins.families.casework import piano, sideboard
from kinectbench_plugins.families.ceramics import bottle, kettle, mug, vase
from kinectbench_plugins.families.containers import basket, bucket, pot, waste_bin
from kinectbench_plugins.families.deceptive import flap_box, shell, sound_box, two_boxes
from kinectbench_plugins.families.figures import shoe, toy_animal
from kinectbench_plugins.families.frames import ladder, tray_stand
from kinectbench_plugins.families.headgear import helmet
from kinectbench_plugins.families.kennels import kennel
from kinectbench_plugins.families.lamps import lamp
from kinectbench_plugins.families.lattices import crate, wire_basket
from kinectbench_plugins.families.laundry import washing_machine
from kinectbench_plugins.families.open_boxes import drawer, open_box
from kinectbench_plugins.families.padded import bed, stool
from kinectbench_plugins.families.shelves import bookshelf, rack
from kinectbench_plugins.families.sinks import sink
from kinectbench_plugins.families.smooth import blob, sculpture
from kinectbench_plugins.families.stands import clothes_horse, easel
from kinectbench_plugins.families.toys import toy_car
from kinectbench_plugins.families.yard import trough, watering_can, wheelbarrow

FAMILIES = {
    "bin": Family(waste_bin, looked_at=True),
    "bucket": Family(bucket, looked_at=True),
    "basket": Family(basket, looked_at=True),
    "pot": Family(pot, looked_at=True),
    "open_box": Family(open_box, looked_at=True, closed_below=True),
    "drawer": Family(drawer, looked_at=True),
    "sink": Family(sink, looked_at=True),
    "rack": Family(rack, looked_at=True, closed_below=True),
    "lamp": Family(lamp, looked_at=True),
    "crate": Family(crate, looked_at=True, closed_below=True),
    "bookshelf": Family(bookshelf, looked_at=True, closed_below=True),
    "ladder": Family(ladder, looked_at=True, closed_below=True),
    "wire_basket": Family(wire_basket, looked_at=True),
    "tray_stand": Family(tray_stand, looked_at=True),
    "open_cabinet": Family(open_cabinet, looked_at=True, closed_below=True),
    "fridge": Family(fridge, looked_at=True),
    "mug": Family(mug, looked_at=True),
    "kettle": Family(kettle, looked_at=True),
    "vase": Family(vase, looked_at=True),
    "shoe": Family(shoe, looked_at=True),
    "toy_animal": Family(toy_animal, looked_at=True),
    "blob": Family(blob, looked_at=True, closed_below=True),
    "sculpture": Family(sculpture, looked_at=True, closed_below=True),
    "kennel": Family(kennel, looked_at=True),
    "sideboard": Family(sideboard, furniture=True, closed_below=True),
    "piano": Family(piano, furniture=True, closed_below=True),
    "stool": Family(stool, furniture=True, closed_below=True),
    "bed": Family(bed, furniture=True),
    "wheelbarrow": Family(wheelbarrow),
    "trough": Family(trough),
    "clothes_horse": Family(clothes_horse),
    "easel": Family(easel),
    "washing_machine": Family(washing_machine),
    "watering_can": Family(watering_can),
    "toy_car": Family(toy_car, closed_below=True),
    "helmet": Family(helmet),
    "bottle": Family(bottle, closed_below=True),
    "shell": Family(shell, looked_at=True),
    "two_boxes": Family(two_boxes, looked_at=True, closed_below=True),
    "flap_box": Family(flap_box, looked_at=True),
    "sound_box": Family(sound_box, looked_at=True),
}
