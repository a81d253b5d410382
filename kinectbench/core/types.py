"""Types shared by the whole package."""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
# A colour picture, (height, width, 3), or colours, (n, 3).
Rgb = NDArray[np.uint8]
# An array from a file, with the dtype that the file states; its reader checks it.
FileArray = NDArray[Any]
Arrays = dict[str, FileArray]

MM_PER_M = 1000.0

# Called with (done, total) during a long computation.
Progress = Callable[[int, int], None]
# Called with (name, done, total) during a long computation on several named things.
NamedProgress = Callable[[str, int, int], None]


def no_progress(*_done: str | int) -> None:
    """Do nothing: a `Progress` or `NamedProgress` for callers that do not watch."""


# The part of a benchmark to which a recording belongs.
Split = Literal["train", "validation", "test"]
# A person's statement on the underside of an object, which no camera saw, and what it means.
Underside = Literal["closed", "open", "unseen"]
CLOSED_MEANS = "no space behind it is open to the air"
OPEN_MEANS = "a space behind it is open to the air"
# How to read 16-bit depth: as it is; with its low 3 bits moved to the top; as the bits of a float16 in
# metres; or as the distance along the ray.
DepthCode = Literal["plain", "rotated", "float16", "ray_distance"]
Framing = Literal["object", "view"]
PartialRule = Literal["any", "majority"]
