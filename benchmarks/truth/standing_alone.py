"""How often triage names a box that stands against an object, and how often one object alone.

Of each family some objects are drawn as exact solids, alone and with the box that the simulator puts against
their outermost point. The rule was chosen while the seeds below 8 were looked at; of every second family none
was looked at for `LEAST_AWAY`.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from figures import Figure, arguments, at_least, at_most, run, stated
from solid_cells import solid_cells

from kinectbench.lab.simulate.objects import families, make_object
from kinectbench.lab.simulate.scene import make_scene
from kinectbench.lab.simulate.spec import SceneSettings
from kinectbench.release.triage.stands_alone import CELLS, share_standing_alone

TOUCHING = SceneSettings(walls=0, clutter=0, touching=True)
# So far away stands what else is in the room, metres.
REACH_M = 2.0
LEAST_NAMED, MOST_FALSE = 0.85, 0.1


def measure(options: argparse.Namespace) -> Iterator[Figure]:
    names = [(family, seed) for family in options.families or families() for seed in options.seeds]
    missed, false = list[str](), list[str]()
    for family, seed in names:
        subject = make_object(family, seed)
        box = make_scene(subject, 0.0, REACH_M, TOUCHING, np.random.default_rng([seed]))[-1].mesh
        if share_standing_alone(solid_cells([subject.mesh], CELLS)) is not None:
            false.append(subject.name)
        if share_standing_alone(solid_cells([subject.mesh, box], CELLS)) is None:
            missed.append(subject.name)
    yield stated("objects", len(names))
    yield stated("alone, and named", false)
    yield stated("with a box, and not named", missed)
    yield at_least("named, of those with a box", 1 - len(missed) / len(names), LEAST_NAMED)
    yield at_most("named, of those alone", len(false) / len(names), MOST_FALSE)


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[8, 9, 10], help="objects of each family")
    parser.add_argument("--families", nargs="*", default=[], metavar="NAME", help="only these")
    options = parser.parse_args()
    run(options, lambda: [*measure(options)])
