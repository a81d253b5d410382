"""Up in the depth camera's axes, by the accelerometer of a bag, at frames where the camera was still.

At rest an accelerometer measures the reaction to gravity, which points up (ROS REP 145; librealsense alike).
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from kinectbench.core.sequence import UpSample
from kinectbench.core.types import Float64
from kinectbench.stages.ingest.bags.ros_messages import BagTopic, RosBag
from kinectbench.stages.ingest.bags.ros_topics import IMU
from kinectbench.stages.ingest.images import DamagedImageError

GRAVITY_MPS2 = 9.80665
# The mean over a fifth of a second is of a camera that is still, or moves evenly, if it differs from gravity
# by no more: a sensor's bias and scale are off by up to 2 %. What is left of the hand's own
# acceleration is as often to one side as to the other.
REACH_NS, STILL_MPS2 = 100_000_000, 0.5
FRAMES, SAMPLES, LEAST_SAMPLES = 100, 20, 3

# `T_depth_imu` (4, 4) of a topic and its messages' frame_id, where the bag says it.
PlaceOfImu = Callable[[BagTopic, str], Float64 | None]


def measured_up(bag: RosBag, stamps_ns: Sequence[int], place: PlaceOfImu) -> tuple[UpSample, ...]:
    """Up at some frames, by the first accelerometer whose place is known; () if none measures gravity.

    Args:
        bag: that was walked through.
        stamps_ns: of the depth frames, ascending.
        place: tells where an accelerometer is.
    """
    for topic in bag.topics:
        first = bag.first(topic) if topic.type == IMU else None
        # By the message's definition -1 says that there is no such measurement.
        if first is None or first.linear_acceleration_covariance[0] == -1:
            continue
        T_depth_imu = place(topic, first.header.frame_id.lstrip("/"))
        samples = () if T_depth_imu is None else tuple(_samples(bag, topic, stamps_ns, T_depth_imu))
        if samples:
            return samples
    return ()


def _samples(
    bag: RosBag, topic: BagTopic, stamps_ns: Sequence[int], T_depth_imu: Float64
) -> Iterator[UpSample]:
    """Up at the frames, of at most 100, at which an accelerometer measures nothing but gravity."""
    times_ns = np.array([message.stamp_ns for message in topic.messages], np.int64)
    chosen = np.unique(np.linspace(0, len(stamps_ns) - 1, min(FRAMES, len(stamps_ns))).astype(int))
    for stamp_ns in (stamps_ns[index] for index in chosen):
        start, end = np.searchsorted(times_ns, [stamp_ns - REACH_NS, stamp_ns + REACH_NS]).tolist()
        if end - start < LEAST_SAMPLES:
            continue
        some = np.unique(np.linspace(start, end - 1, min(SAMPLES, end - start)).astype(int))
        measured = []
        for index in some.tolist():
            with suppress(DamagedImageError):
                said = bag.decode(topic, index).linear_acceleration
                measured.append((said.x, said.y, said.z))
        mean = np.mean(measured, axis=0) if len(measured) >= LEAST_SAMPLES else np.full(3, np.nan)
        length = float(np.linalg.norm(mean))
        if abs(length - GRAVITY_MPS2) <= STILL_MPS2:  # which NaN is not
            x, y, z = (round(float(value), 6) for value in T_depth_imu[:3, :3] @ mean / length)
            yield UpSample(int(stamp_ns), (x, y, z))
