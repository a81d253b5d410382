"""Decode 16-bit depth whose values are no plain distances along the axis.

Of rotated depth, as SUN3D and the Amazon Picking Challenge store it, the lowest three bits are the highest
three of the depth in mm (`depthRead` of SUN3D's own tools): what is nearer than 8.192 m is stored as eight
times its mm.
"""

from collections.abc import Iterable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.core.types import DepthCode
from kinectbench.stages.ingest.images import quantised

UInt16 = NDArray[np.uint16]
# SUN3D turns the 16 bits of its depth by three to the left.
BITS = 3
# Nearly all depth is nearer than 2^13 mm; what is not lies nearer than 2^14, where the sensors' range ends.
NEAR_SHARE, FARTHER_BITS = 0.95, 1
# A picture of depth with 8 bits, eight times as bright, ends here.
BRIGHTEST = 255 << BITS
# Fewer values would have steps of eight by chance.
LEAST_LEVELS = 16
# Of rooms and shelves, metres; half way between depth and eight times that depth, by the logarithm, the two
# readings of a recording are as likely: (1.5 m of a usual median) * sqrt(8).
EVEN_MEDIAN_MM = 4243.0
# Evenly spread, and one pixel of so many along rows and columns: enough to tell a pattern.
SAMPLED_IMAGES, SAMPLED_EVERY_PX = 5, 3


def read_by_code(code: DepthCode, depth: UInt16, camera: Camera) -> UInt16:
    """Decode stored depth into depth along the optical axis.

    Args:
        code: how it is stored.
        depth: (height, width) uint16 as it is stored, 0 = none.
        camera: its intrinsics, for distances along the ray.

    Returns:
        (height, width) uint16, 0 = none, in the recording's unit; of float16 in steps of 1 / FLOAT_SCALE m.
    """
    if code == "rotated":
        return unrotated(depth)
    if code == "float16":
        return quantised(float16_m(depth))
    if code == "ray_distance" and depth.shape == (camera.height, camera.width):
        return np.rint(depth / ray_lengths(camera)).astype(np.uint16)
    return depth


def float16_m(depth: UInt16) -> NDArray[np.float32]:
    """Metres of depth that is the bits of a float16, as CO3D stores it; any shape; 0 = none."""
    metres = depth.view(np.float16).astype(np.float32)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0))


def ray_lengths(camera: Camera) -> NDArray[np.float64]:
    """Ratio of ray length to axial depth at each pixel: (height, width), at least 1."""
    return np.asarray(np.linalg.norm(camera.rays(), axis=-1))


class Pattern(NamedTuple):
    """The expected pattern of rotated depth.

    Attributes:
        possible: nearly all values are multiples of eight; where a layout has such bits, it has them here.
        found: the values are those of rotated depth; depth in steps of 8 mm has them, too.
        likely: and as they stand they would be farther than a room is deep.
    """

    possible: bool
    found: bool
    likely: bool


def unrotated(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Depth in mm of rotated depth: any shape, uint16 both; 0 stays 0."""
    return np.asarray((depth >> np.uint16(BITS)) | (depth << np.uint16(16 - BITS)), np.uint16)


def find_pattern(images: Iterable[NDArray[np.uint16]]) -> Pattern:
    """Whether these depth images (height, width) uint16, 0 = none, are rotated.

    At least 95 % of the values are multiples of eight, one of them an odd multiple; all others have 1 in
    their low bits (8.2 to 16.4 m); and they are too many, and reach too high, for a picture with 8 bits.
    Depth in steps of 8 mm looks the same: the median decides between them, which as it stands is beyond
    4.24 m where bits are rotated.
    """
    values = _sampled(images)
    if not len(values):
        return Pattern(False, False, False)
    low = values & np.uint16((1 << BITS) - 1)
    near = values[low == 0]
    possible = len(near) >= NEAR_SHARE * len(values)
    patterns = (
        possible
        and bool(np.isin(low, (0, FARTHER_BITS)).all())
        and bool((near & np.uint16(1 << BITS)).any())
        and int(near.max()) > BRIGHTEST
        and len(np.unique(near)) >= LEAST_LEVELS
    )
    return Pattern(possible, patterns, patterns and float(np.median(near)) > EVEN_MEDIAN_MM)


def _sampled(images: Iterable[NDArray[np.uint16]]) -> NDArray[np.uint16]:
    """The measured values of every third pixel of every third row of those images that are whole."""
    samples = [np.zeros(0, np.uint16)]
    with suppress(RecordingError):
        for image in images:
            sample = image[::SAMPLED_EVERY_PX, ::SAMPLED_EVERY_PX]
            samples.append(sample[sample > 0])
    return np.concatenate(samples)
