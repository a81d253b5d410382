"""Re-check the input of a pair whose truth is held back."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from kinectbench.errors import PairError
from kinectbench.release.pair_check import ORTHONORMAL_TOLERANCE
from kinectbench.voxels.pair_file import unpack
from kinectbench.voxels.pair_input import holds_truth, read_input
from kinectbench.voxels.resample import reduce_blocks


def held_back_problems(path: Path, *, framing: str, partial_rule: str) -> Iterator[str]:
    """Yield what is wrong with the pair file of a held-back pair, a clause each, without the file's name.

    Args:
        path: the file.
        framing: the benchmark's.
        partial_rule: the benchmark's.
    """
    try:
        pair = read_input(path)
        if holds_truth(path):
            yield "it holds the truth, which is to be held back"
    except PairError as error:
        yield str(error).removeprefix(f"{path}: ")
        return
    for name in ("T_world_grid", "T_world_camera"):
        T = getattr(pair, name)
        R = T[:3, :3]
        orthonormal = np.allclose(R @ R.T, np.eye(3), rtol=0, atol=ORTHONORMAL_TOLERANCE)
        if not (orthonormal and np.linalg.det(R) > 0 and np.array_equal(T[3], [0, 0, 0, 1])):
            yield f"{name} is not a rotation and a shift"
    if not np.allclose(pair.T_world_grid[:3, :3], pair.T_world_camera[:3, :3], atol=ORTHONORMAL_TOLERANCE):
        yield "the grid's axes are not the view's"
    for name, expected in (("framing", framing), ("partial_rule", partial_rule)):
        if getattr(pair, name) != expected:
            yield f"{name} is '{getattr(pair, name)}' where the benchmark has '{expected}'"
    if not pair.partial.any():
        yield "'partial' is empty"
    if pair.partial_rule in ("any", "majority"):
        reduced = reduce_blocks(unpack(pair.partial_256), pair.partial_rule)
        differ = int(np.count_nonzero(reduced != unpack(pair.partial)))
        if differ:
            yield f"{differ} cells of 'partial' are not 'partial_256' reduced by '{pair.partial_rule}'"
