"""Baselines that know the training truth: the mean shape, and the nearest training pair."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.baselines.inputs import Inputs
from kinectbench.scoring.truth import read_grids
from kinectbench.voxels.pair_file import unpack


def mean_shape(inputs: Inputs) -> NDArray[np.float16]:
    """The mean of the category's training shapes, each in its own view's box: (64, 64, 64) float16."""
    assert inputs.training is not None
    return inputs.training.mean.astype(np.float16)


def nearest(inputs: Inputs) -> NDArray[np.bool_]:
    """The full shape of the training pair whose partial has the highest IoU at 64^3: (256, 256, 256) bool.

    Of several the first. Own rule.
    """
    assert inputs.training is not None
    partials = inputs.training.partials
    ious = []
    for other in partials:
        union = np.bitwise_count(other | inputs.pair.partial).sum(dtype=np.int64)
        shared = np.bitwise_count(other & inputs.pair.partial).sum(dtype=np.int64)
        ious.append(shared / union if union else 1.0)
    (full,) = read_grids(*inputs.training.files[int(np.argmax(ious))], ("full",))
    return unpack(full)
