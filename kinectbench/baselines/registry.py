"""The baselines by name. A new one is a function in a file of its own and a line here."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from kinectbench.baselines.hull import hull
from kinectbench.baselines.trivial import constant, empty, partial
from kinectbench.voxels.pair_file import Pair

# (pair, base rate of its category) -> prediction (n, n, n); of the pair only the input may be looked at.
Baseline = Callable[[Pair, float], NDArray[np.bool_] | NDArray[np.float16]]

BASELINES: Mapping[str, Baseline] = {
    "empty": empty,
    "base-rate": constant,
    "partial": partial,
    "hull": hull,
}
