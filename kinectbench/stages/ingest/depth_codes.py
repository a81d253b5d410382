"""Decode 16-bit depth whose values are not distances along the optical axis.

Rotated depth, in SUN3D and the Amazon Picking Challenge, stores the highest three bits of the depth in mm as
its lowest three (`depthRead` of SUN3D's own tools): depth below 8.192 m is stored as eight times its mm.
"""

from collections.abc import Iterable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.core.types import DepthCode
from kinectbench.stages.ingest.images import quantised

UInt16 = NDArray[np.uint16]
# SUN3D rotates the 16 bits of its depth by three to the left.
BITS = 3
# Nearly all depth is below 2^13 mm, and the rest below 2^14, where the sensors' range ends.
NEAR_SHARE, FARTHER_BITS = 0.95, 1
# The largest value of an 8-bit picture of depth, multiplied by eight.
BRIGHTEST = 255 << BITS
# With fewer different values, multiples of eight may be a coincidence.
LEAST_LEVELS = 16
# At this median depth both readings of a recording are equally likely: the logarithmic middle between a usual
# median depth of rooms and shelves and eight times that: 1.5 m * sqrt(8).
EVEN_MEDIAN_MM = 4243.0
# Number of evenly spread images, and stride along rows and columns: enough to detect the pattern.
SAMPLED_IMAGES, SAMPLED_EVERY_PX = 5, 3


def read_by_code(code: DepthCode, depth: UInt16, camera: Camera) -> UInt16:
    """Decode stored depth into depth along the optical axis.

    Args:
        code: how the stored values encode depth.
        depth: (height, width) uint16 as stored, 0 = none.
        camera: intrinsics, to convert distances along the ray.

    Returns:
        (height, width) uint16, 0 = none, in the recording's unit; for "float16" in units of 1 / FLOAT_SCALE
            m. Distances along the ray in an image of another size than the camera's stay as they are.
    """
    if code == "rotated":
        return unrotated(depth)
    if code == "float16":
        return quantised(float16_m(depth))
    if code == "ray_distance" and depth.shape == (camera.height, camera.width):
        return np.rint(depth / ray_lengths(camera)).astype(np.uint16)
    return depth


def float16_m(depth: UInt16) -> NDArray[np.float32]:
    """Return depth in metres, 0 = none, from uint16 with the bits of float16 (as in CO3D), any shape."""
    metres = depth.view(np.float16).astype(np.float32)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0))


def ray_lengths(camera: Camera) -> NDArray[np.float64]:
    """Return the ratio of the ray's length to the axial depth at each pixel: (height, width), at least 1."""
    return np.asarray(np.linalg.norm(camera.rays(), axis=-1))


class Pattern(NamedTuple):
    """Whether the values of depth images appear to have rotated bits.

    Attributes:
        possible: nearly all values are multiples of eight. This suffices as evidence in a layout that usually
            has rotated bits.
        found: the values have all properties of rotated depth. Plain depth in steps of 8 mm has them, too.
        likely: `found`, and the values, read as plain depth, would be farther than a room is deep.
    """

    possible: bool
    found: bool
    likely: bool


def unrotated(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Undo the rotation of bits: return depth in mm, uint16, of the same shape; 0 stays 0."""
    return np.asarray((depth >> np.uint16(BITS)) | (depth << np.uint16(16 - BITS)), np.uint16)


def find_pattern(images: Iterable[NDArray[np.uint16]]) -> Pattern:
    """Check whether depth images (height, width) uint16, 0 = none, have rotated bits.

    In rotated depth, at least 95 % of the values are multiples of eight, some of them odd multiples. In all
    other values the low three bits are 001 (8.2 to 16.4 m). The values are larger and more varied than in an
    8-bit picture. Plain depth in steps of 8 mm has these properties, too, so the median decides: if the bits
    are rotated, the median, read as plain depth, is beyond 4.24 m.
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
    """Return the measured values at every third pixel of every third row, from the images before an error."""
    samples = [np.zeros(0, np.uint16)]
    with suppress(RecordingError):
        for image in images:
            sample = image[::SAMPLED_EVERY_PX, ::SAMPLED_EVERY_PX]
            samples.append(sample[sample > 0])
    return np.concatenate(samples)
