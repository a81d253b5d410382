"""Up in the depth camera's axes, by the accelerometer of a bag."""

from collections.abc import Callable, Sequence

import numpy as np

from kinectbench.core.sequence import UpSample
from kinectbench.core.types import Float64
from kinectbench.stages.ingest.bags.ros_messages import BagTopic, RosBag
from kinectbench.stages.ingest.bags.ros_topics import IMU
from kinectbench.stages.ingest.gravity import up_at_rest

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
        if T_depth_imu is None:
            continue
        times_ns = np.array([message.stamp_ns for message in topic.messages], np.int64)
        read = _reader(bag, topic)
        samples = tuple(up_at_rest(times_ns, read, stamps_ns, T_depth_imu[:3, :3]))
        if samples:
            return samples
    return ()


def _reader(bag: RosBag, topic: BagTopic) -> Callable[[int], tuple[float, float, float]]:
    """Reads what a message of the topic measured, by its index."""

    def read(index: int) -> tuple[float, float, float]:
        said = bag.decode(topic, index).linear_acceleration
        return said.x, said.y, said.z

    return read
