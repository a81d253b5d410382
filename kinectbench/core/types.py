"""Types shared by all rooms."""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
# A color picture, (height, width, 3), or colors, (n, 3).
Rgb = NDArray[np.uint8]
# An array of a file: of the dtype that the file states, which its reader checks.
FileArray = NDArray[Any]
Arrays = dict[str, FileArray]

MM_PER_M = 1000.0

# Called with (done, total) while something long is at work.
Progress = Callable[[int, int], None]
# Called with (name, done, total), where several named things are at work.
NamedProgress = Callable[[str, int, int], None]

# The part of a benchmark that a recording belongs to.
Split = Literal["train", "validation", "test"]
# A person's statement on an object's underside that no camera saw. Closed:
# no space behind it that is open to the air; open: there is; unseen: nobody looked.
Underside = Literal["closed", "open", "unseen"]
# How the cube of a pair is placed, and how 4 x 4 x 4 of its cells become one.
# How 16-bit depth is to be read: as it is; with its low 3 bits as its high ones; as the bits of a float16 in
# metres; as the distance along the ray.
DepthCode = Literal["plain", "rotated", "float16", "ray_distance"]
Framing = Literal["object", "view"]
PartialRule = Literal["any", "majority"]
