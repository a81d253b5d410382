"""The baselines by name. A new one is a function in a file of its own and a line here."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from kinectbench.baselines.hull import hull
from kinectbench.baselines.inputs import Inputs
from kinectbench.baselines.learned import mean_shape, nearest
from kinectbench.baselines.mirror import mirror
from kinectbench.baselines.silhouette import silhouette
from kinectbench.baselines.trivial import constant, empty, partial

# -> prediction (n, n, n); of the pair only the input may be looked at.
Baseline = Callable[[Inputs], NDArray[np.bool_] | NDArray[np.float16]]

BASE_RATE = "base-rate"
BASELINES: Mapping[str, Baseline] = {
    "empty": empty,
    BASE_RATE: constant,
    "partial": partial,
    "hull": hull,
    "mirror": mirror,
    "silhouette": silhouette,
    "mean-shape": mean_shape,
    "nearest": nearest,
}
# Those that need training pairs of the category.
LEARNED = ("mean-shape", "nearest")
