"""READING.md: how to read a release without this package, from the template reading.md."""

from collections.abc import Sequence
from pathlib import Path
from string import Template

from kinectbench.release.release import Target
from kinectbench.voxels.pair_input import TRUTH_KEYS

TEMPLATE = Path(__file__).with_name("reading.md")
TRUTH = 'surface = points_world("shell")  # the surface of the true shape, in the same world'
NO_TRUTH = "# No pair of this part has its truth."


def reading(targets: Sequence[Target], held_back: Sequence[str]) -> str:
    """The page as Markdown; its example is the first pair that has its truth, if there is one.

    Args:
        targets: every pair.
        held_back: splits of which only the inputs are there.
    """
    open_targets = [target for target in targets if target.split not in held_back]
    keys = ", ".join(f"`{key}`" for key in (*TRUTH_KEYS, "occupancy_rule"))
    hidden = f"\nPairs of the split {', '.join(held_back)} do not have {keys}: their truth is held back.\n"
    return Template(TEMPLATE.read_text()).substitute(
        example=(open_targets or targets)[0].file,
        truth=TRUTH if open_targets else NO_TRUTH,
        held_back=hidden if held_back else "",
    )
