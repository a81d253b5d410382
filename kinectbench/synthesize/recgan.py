"""The paper authors' files: their folders, names, arrays and axes."""

from typing import Literal

import numpy as np

from kinectbench.synthesize.models import synset_of
from kinectbench.synthesize.views import ViewAngles
from kinectbench.voxels.pair_file import Pair, unpack
from kinectbench.voxels.recgan_file import recgan_file_bytes

SPLIT_NAMES = {"train": "train", "validation": "val", "test": "test"}


def recgan_path(kind: Literal["25d", "3d"], category: str, split: str, model: str, view: ViewAngles) -> str:
    """`P1_<synset>_<category>/<split>_<views>_<kind>_vox256/<model>_<roll>_<pitch>_<yaw>.npz`.

    Args:
        kind: "25d", what is seen, or "3d", the full shape.
        category: such as "chair".
        split: "train", "validation" or "test".
        model: its name.
        view: of a group of n^3 views.
    """
    group = f"{SPLIT_NAMES[split]}_{view.n**3}_{kind}_vox256"
    return f"P1_{synset_of(category)}_{category}/{group}/{model}_{view.name}.npz"


def recgan_bytes(pair: Pair) -> tuple[bytes, bytes]:
    """The two files of a pair, what is seen and the full shape, both at 256^3 cells.

    Both are cropped alike to the box of the full shape (and of surface cells that lie just beyond it, since
    their centre is outside the solid). Key `arr_0`, int8, (x, y, z, 1), with x to the left and y up: their
    back-projection is x = -(u - w/2) z / f, y = -(v - h/2) z / f, so theirs is ours with x and y reversed.
    """
    seen, full = unpack(pair.partial_256), unpack(pair.full)
    occupied = seen | full
    box = tuple(
        slice(int(used[0]), int(used[-1]) + 1)
        for used in (np.flatnonzero(occupied.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
    )
    return recgan_file_bytes(seen[box]), recgan_file_bytes(full[box])
