"""Up in the depth camera's axes, by an accelerometer, at frames where the camera was still.

At rest an accelerometer measures the reaction to gravity, which points up (ROS REP 145; librealsense, too).
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from kinectbench.core.sequence import UpSample
from kinectbench.core.types import Float64, Int64
from kinectbench.stages.ingest.images import DamagedImageError

# Standard gravity (3rd CGPM, 1901).
GRAVITY_MPS2 = 9.80665
# The mean over a fifth of a second is of a camera that is still, or moves evenly, if it differs from gravity
# by no more: a sensor's bias and scale are off by up to 2 %. What is left of the hand's own
# acceleration is as often to one side as to the other.
REACH_NS, STILL_MPS2 = 100_000_000, 0.5
# Most frames, and most and least measurements at each: enough for the mean of them.
FRAMES, SAMPLES, LEAST_SAMPLES = 100, 20, 3


def up_at_rest(
    times_ns: Int64,
    measured: Callable[[int], tuple[float, float, float]],
    stamps_ns: Sequence[int],
    R_depth_imu: Float64,
) -> Iterator[UpSample]:
    """Up at the frames, of at most 100, at which an accelerometer measures nothing but gravity.

    Args:
        times_ns: of the measurements, ascending.
        measured: reads one, m/s^2, in the accelerometer's axes; DamagedImageError: it is damaged.
        stamps_ns: of the depth frames, ascending.
        R_depth_imu: (3, 3), accelerometer to depth camera.
    """
    chosen = np.unique(np.linspace(0, len(stamps_ns) - 1, min(FRAMES, len(stamps_ns))).astype(int))
    for stamp_ns in (stamps_ns[index] for index in chosen):
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
        if abs(length - GRAVITY_MPS2) <= STILL_MPS2:  # which NaN is not
            x, y, z = (round(float(value), 6) for value in R_depth_imu @ mean / length)
            yield UpSample(int(stamp_ns), (x, y, z))
