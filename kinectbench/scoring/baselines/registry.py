"""The baselines by name, and the simplest baselines. To add one, write a function and a `BASELINES` line."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.voxels.pair_file import unpack
from kinectbench.scoring.baselines.hull import carved_hull, hull, silhouette
from kinectbench.scoring.baselines.inputs import Inputs
from kinectbench.scoring.baselines.mirror import mirror
from kinectbench.scoring.truth import read_parts

CONSTANT_CELLS = 16
# Limits of float16: smaller rates would lose digits, larger ones would become 1.
SMALLEST_RATE, LARGEST_RATE = 2.0**-14, 1 - 2.0**-11


def empty(inputs: Inputs) -> NDArray[np.bool_]:
    """Return an empty grid: (16, 16, 16) bool."""
    return np.zeros((CONSTANT_CELLS,) * 3, np.bool_)


def constant(inputs: Inputs) -> NDArray[np.float16]:
    """Return the category's base rate in every cell: (16, 16, 16) float16, accurate to 0.05 %.

    Rates near 0 and 1 are clipped to what float16 can hold.
    """
    return np.full((CONSTANT_CELLS,) * 3, np.clip(inputs.base_rate, SMALLEST_RATE, LARGEST_RATE), np.float16)


def partial(inputs: Inputs) -> NDArray[np.bool_]:
    """Return the input itself: `partial_256`, (256, 256, 256) bool."""
    return inputs.partial


def mean_shape(inputs: Inputs) -> NDArray[np.float16]:
    """Return the mean occupancy of the category's training shapes: (64, 64, 64) float16.

    The shapes are not aligned: each is taken as it lies in the grid of its own pair.
    """
    assert inputs.training is not None
    return inputs.training.mean.astype(np.float16)


def nearest(inputs: Inputs) -> NDArray[np.bool_]:
    """Return the true shape of the training pair whose partial view is most similar: (256, 256, 256) bool.

    Similarity is the IoU of the two partial views at 64^3. Of equally similar pairs, the first is taken.
    """
    assert inputs.training is not None
    partials = inputs.training.partials
    ious = []
    for other in partials:
        union = np.bitwise_count(other | inputs.pair.partial).sum(dtype=np.int64)
        shared = np.bitwise_count(other & inputs.pair.partial).sum(dtype=np.int64)
        ious.append(shared / union if union else 1.0)
    (full,) = read_parts(*inputs.training.files[int(np.argmax(ious))], ("full",))
    return unpack(full)


# Returns a prediction (n, n, n). It may read only the input of the pair.
Baseline = Callable[[Inputs], NDArray[np.bool_] | NDArray[np.float16]]

BASE_RATE = "base-rate"
BASELINES: Mapping[str, Baseline] = {
    "empty": empty,
    BASE_RATE: constant,
    "partial": partial,
    "hull": hull,
    "carved-hull": carved_hull,
    "mirror": mirror,
    "silhouette": silhouette,
    "mean-shape": mean_shape,
    "nearest": nearest,
}
# Baselines without a usable surface in space. `base-rate` is constant. `silhouette` becomes a comb of rays
# where depth pixels are farther apart than cells (3.8 to 9.1 million faces on four views of the sample's
# chairs and table).
WITHOUT_SURFACE = (BASE_RATE, "silhouette")
# Baselines that need training pairs of the category.
LEARNED = ("mean-shape", "nearest")
