"""Find predictions that do not depend on their view: they are constant, or equal for several views."""

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
