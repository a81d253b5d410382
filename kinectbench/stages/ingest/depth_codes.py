"""Decode 16-bit depth whose values are not distances along the optical axis.

Rotated depth stores the highest three bits of the depth as its lowest three. SUN3D's is in mm (`depthRead` of
its own tools): depth below 8.192 m is stored as eight times its mm. The Amazon Picking Challenge's is in
0.1 mm (`readDepth.m` of its toolbox): depth below 0.8192 m is stored as 80000 units per metre.
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
# Nearly all depth is below 2^13 units. In mm the rest is below 2^14, where the sensors' range ends: if this
# share of the values is farther, but fewer than between both limits, the unit is 0.1 mm. Measured in a scene
# of the Amazon Picking Challenge: 0.003 % farther, 0.26 % between.
NEAR_SHARE, FARTHER_BITS, FARTHER_SHARE = 0.95, 1, 0.00001
# Units per metre of rotated depth: mm and 0.1 mm.
ROTATED_SCALES = (1000.0, 10000.0)
# The largest value of an 8-bit picture of depth, multiplied by eight.
BRIGHTEST = 255 << BITS
# With fewer different values, multiples of eight may be a coincidence.
LEAST_LEVELS = 16
# In 0.1 mm, a median nearer than this is unlikely: the Kinect SDK adds a person's number to eight times the
# mm, and people stand at 2 to 3 m.
LEAST_MEDIAN_M = 0.3
# At this median depth both readings of a recording are equally likely: the logarithmic middle between a usual
# median depth of rooms and shelves and eight times that: 1.5 m * sqrt(8).
EVEN_MEDIAN_MM = 4243.0
# So are mm and 0.1 mm at this one: 1.5 m * sqrt(10).
EVEN_UNITS_MM = 4743.0
# Number of evenly spread images: enough to detect the pattern.
SAMPLED_IMAGES = 5


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
        units: units per metre, one of ROTATED_SCALES, if the bits are rotated: 10000 if some depth would
            otherwise be beyond the range of sensors.
        median: median of the values in these units, if the bits are rotated.
    """

    possible: bool
    found: bool
    likely: bool
    units: float
    median: float

    @property
    def likelier_units(self) -> float:
        """`units`, or 10000 if the median would be unlikely far in mm."""
        return ROTATED_SCALES[1] if self.median > EVEN_UNITS_MM else self.units


def unrotated(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Undo the rotation of bits: return depth in mm, uint16, of the same shape; 0 stays 0."""
    return np.asarray((depth >> np.uint16(BITS)) | (depth << np.uint16(16 - BITS)), np.uint16)


def find_pattern(images: Iterable[NDArray[np.uint16]]) -> Pattern:
    """Check whether depth images (height, width) uint16, 0 = none, have rotated bits.

    In rotated depth, at least 95 % of the values are multiples of eight, some of them odd multiples. The low
    three bits of the others are 001 in mm (8.2 to 16.4 m), and any in 0.1 mm (0.8 to 6.6 m). The values are
    larger and more varied than in an 8-bit picture. Plain depth in steps of 8 mm has these properties, too,
    so the median decides: if the bits are rotated, the median, read as plain depth, is beyond 4.24 m.
    """
    counts = _counts(images)
    total = int(counts.sum())
    if not total:
        return Pattern(False, False, False, ROTATED_SCALES[0], 0.0)
    by_bits = counts.reshape(-1, 1 << BITS).sum(axis=0)
    near = np.flatnonzero(counts[:: 1 << BITS]) << BITS
    possible = by_bits[0] >= NEAR_SHARE * total
    patterns = bool(
        possible and (near & 1 << BITS).any() and near.max() > BRIGHTEST and len(near) >= LEAST_LEVELS
    )
    median = float(np.searchsorted(np.cumsum(counts[:: 1 << BITS]), by_bits[0] / 2))
    farther = by_bits[FARTHER_BITS + 1 :].sum()
    tenths = (
        FARTHER_SHARE * total < farther < by_bits[FARTHER_BITS]
        and median >= LEAST_MEDIAN_M * ROTATED_SCALES[1]
    )
    likely = patterns and median * (1 << BITS) > EVEN_MEDIAN_MM
    return Pattern(bool(possible), patterns, likely, ROTATED_SCALES[int(tenths)], median)


def _counts(images: Iterable[NDArray[np.uint16]]) -> NDArray[np.int64]:
    """Return how often each measured value (65536,) occurs, in the images before an error."""
    counts = np.zeros(1 << 16, np.int64)
    with suppress(RecordingError):
        for image in images:
            counts += np.bincount(image.ravel(), minlength=len(counts))
    counts[[0, -1]] = 0  # both are codes for no measurement
    return counts
