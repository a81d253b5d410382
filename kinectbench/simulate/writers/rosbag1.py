"""ROS 1 bags as an OpenNI driver records them: depth in mm, JPEG colour, CameraInfo of both, poses."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from kinectbench.simulate.writers.frame import RecordedFrame, Rig
from kinectbench.simulate.writers.ros_messages import DepthCode, MessageMaker


def write_rosbag1(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording to a bag that does not exist yet, with raw 16UC1 depth in bz2 chunks.

    Messages are those of `MessageMaker`, in the order of the frames, logged at the stamps of their headers.
    Same frames, same bytes.
    """
    _write(path, rig, frames, "raw")


def write_rosbag1_compressed(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording as `write_rosbag1` does, but with depth as compressedDepth PNG and plain chunks."""
    _write(path, rig, frames, "png")


def _write(path: Path, rig: Rig, frames: Iterable[RecordedFrame], depth_code: DepthCode) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if depth_code == "raw":  # PNG and JPEG would not shrink
        writer.set_compression(Writer.CompressionFormat.BZ2)
    maker = MessageMaker(store.types, rig, depth_code, ros2=False)
    connections: dict[str, Any] = {}
    with writer:
        for index, frame in enumerate(frames):
            for topic, kind, message in maker.messages(frame, index):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                stamp = message.header.stamp
                data = store.serialize_ros1(message, kind)
                writer.write(connections[topic], stamp.sec * 10**9 + stamp.nanosec, data)
