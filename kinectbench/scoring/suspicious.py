"""Find predictions that can be counted but are probably wrong, or do not depend on their view."""

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.targets import Target
from kinectbench.scoring.counts import THRESHOLDS
from kinectbench.scoring.thresholds import Thresholds

# Largest share of a mesh's volume outside the cube that is plausible: a cube that is placed by the view alone
# may cut off as much of the true shape (setting `framing: view` of pairs).
MOST_OUTSIDE = 0.05
# A smaller share of a mesh outside the grid is not reported.
LEAST_OUTSIDE = 0.001


def suspicious_lines(
    results: Mapping[Target, PairResult], thresholds: Thresholds, of_baseline: bool
) -> Iterator[str]:
    """Yield lines on how many meshes are cut off at the cube, and how many predictions are empty or full.

    Args:
        results: the result of every counted pair; its `cells` is 0 if there was no prediction.
        thresholds: threshold of every category of the test split.
        of_baseline: whether they are a baseline's; then empty and full predictions are not reported.
    """
    outside = {t.name: of.outside_share for t, of in results.items() if of.outside_share >= LEAST_OUTSIDE}
    if outside:
        worst = max(outside, key=lambda name: outside[name])
        frame = ": in another frame?" if outside[worst] > MOST_OUTSIDE else ""
        files = "1 mesh lies" if len(outside) == 1 else f"{len(outside)} meshes lie"
        yield (
            f"{files} partly outside the cube and {'is' if len(outside) == 1 else 'are'} cut off there, "
            f"{worst} by {outside[worst]:.1%} of its volume{frame}"
        )
    if of_baseline:
        return
    test = {t: of for t, of in results.items() if t.split == "test" and of.cells}
    empty: list[str] = []
    full: list[str] = []
    for target, of in sorted(test.items(), key=lambda item: item[0]):
        above = int(of.tally.above[THRESHOLDS.index(thresholds.of[target.category])].sum())
        if above in (0, int(of.tally.voxels.sum())):
            (full if above else empty).append(target.name)
    for names, what in ((empty, "predict nothing"), (full, "fill the whole cube")):
        if names:
            yield f"{len(names)} of {len(test)} predictions {what} at their threshold, such as {names[0]}"


# Minimum share of equal predictions that is reported. A lower share may be valid: the mean shape of a
# category is the same for all its views, and two coarse grids may be equal by chance.
LEAST_EQUAL = 0.5


class Held(NamedTuple):
    """A summary of the content of a prediction.

    Attributes:
        digest: hash of its values.
        constant: the value of all its cells; None if they differ, or if the prediction has no cells.
    """

    digest: str
    constant: float | None = None


def content_of(*arrays: NDArray[np.generic]) -> Held:
    """Summarise a prediction: a hash of its arrays and, if all cells of its grid are equal, their value.

    Args:
        arrays: the grid alone, or the points and faces of a predicted surface (then `constant` is None).
    """
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(f"{array.shape} {array.dtype}".encode())
        digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    constant = None
    if len(arrays) == 1 and (low := arrays[0].min()) == arrays[0].max():
        constant = float(low)
    return Held(digest.hexdigest(), constant)


def same_lines(contents: Mapping[str, Held]) -> Iterator[str]:
    """Report constant predictions (a line for each value), and many equal ones (a line if half are equal).

    Args:
        contents: {name of a prediction: its content}.
    """
    constant: dict[float, list[str]] = {}
    for name, content in contents.items():
        if content.constant is not None:
            constant.setdefault(content.constant, []).append(name)
    for value, names in sorted(constant.items()):
        yield f"{len(names)} of {len(contents)} predictions are {value:g} in every cell, such as {names[0]}"
    rest = {name: content.digest for name, content in contents.items() if content.constant is None}
    counts = Counter(rest.values())
    equal = [name for name, digest in rest.items() if counts[digest] > 1]
    if equal and len(equal) >= LEAST_EQUAL * len(contents):
        first, second = [name for name in equal if rest[name] == rest[equal[0]]][:2]
        every = "the same for every view" if len(counts) == 1 else "the same as for another view"
        yield f"{len(equal)} of {len(contents)} predictions are {every}, such as {first} and {second}"
