"""The up direction in the depth camera's axes, from an accelerometer, at frames where the camera was still.

At rest an accelerometer measures the reaction to gravity, which points up (as in ROS REP 145 and
librealsense).
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from kinectbench.core.even_choice import evenly
from kinectbench.core.sequence import UpSample
from kinectbench.core.types import Float64, Int64
from kinectbench.stages.ingest.images import DamagedImageError

# Standard gravity (3rd CGPM, 1901).
GRAVITY_MPS2 = 9.80665
# If the mean over a fifth of a second differs from gravity by no more than this, the camera is still or moves
# evenly: a sensor's bias and scale are off by up to 2 %. The remaining acceleration of the hand has no
# preferred direction.
REACH_NS, STILL_MPS2 = 100_000_000, 0.5
# Largest number of frames, and largest and smallest number of measurements at each: enough for a mean.
FRAMES, SAMPLES, LEAST_SAMPLES = 100, 20, 3


def up_at_rest(
    times_ns: Int64,
    measured: Callable[[int], tuple[float, float, float]],
    stamps_ns: Sequence[int],
    R_depth_imu: Float64,
) -> Iterator[UpSample]:
    """Yield the up direction in the depth camera's axes, at up to 100 frames where the camera is still.

    Args:
        times_ns: times of the measurements, ascending, nanoseconds.
        measured: returns the measurement of an index, m/s^2, in the accelerometer's axes; raises
            DamagedImageError if it is damaged.
        stamps_ns: stamps of the depth frames, ascending, nanoseconds.
        R_depth_imu: (3, 3), from accelerometer to depth camera.
    """
    for stamp_ns in (stamps_ns[index] for index in evenly(len(stamps_ns), FRAMES)):
        start, end = np.searchsorted(times_ns, [stamp_ns - REACH_NS, stamp_ns + REACH_NS]).tolist()
        if end - start < LEAST_SAMPLES:
            continue
        some = np.unique(np.linspace(start, end - 1, min(SAMPLES, end - start)).astype(int))
        found = []
        for index in some.tolist():
            with suppress(DamagedImageError):
                found.append(measured(index))
        with np.errstate(over="ignore", invalid="ignore"):  # an untrusted file may hold any number
            mean = np.mean(found, axis=0) if len(found) >= LEAST_SAMPLES else np.full(3, np.nan)
            length = float(np.linalg.norm(mean))
        if abs(length - GRAVITY_MPS2) <= STILL_MPS2:  # false for NaN
            x, y, z = (round(float(value), 6) for value in R_depth_imu @ mean / length)
            yield UpSample(int(stamp_ns), (x, y, z))
