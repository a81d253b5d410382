"""ROS 2 bags: depth in mm, raw in sqlite3 or as RVL in mcap, JPEG colour, CameraInfo of both, poses, tf."""

import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from kinectbench.simulate.writers.frame import RecordedFrame, Rig
from kinectbench.simulate.writers.ros_messages import DepthCode, MessageMaker

NAME = "recording"


def write_rosbag2_sqlite(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording into an empty folder: metadata.yaml and recording.db3, with raw 16UC1 depth.

    Messages are those of `MessageMaker`, in the order of the frames. Where colour is not registered,
    /tf_static says how its camera lies.
    """
    _write(folder, rig, frames, "raw", mcap=False)


def write_rosbag2_mcap(folder: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording as `write_rosbag2_sqlite` does, but to recording.mcap with compressedDepth RVL."""
    _write(folder, rig, frames, "rvl", mcap=True)


def _write(
    folder: Path, rig: Rig, frames: Iterable[RecordedFrame], depth_code: DepthCode, *, mcap: bool
) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    maker = MessageMaker(store.types, rig, depth_code, ros2=True)
    connections: dict[str, Any] = {}
    with Writer(folder / NAME, version=8, storage_plugin=plugin) as writer:
        for index, frame in enumerate(frames):
            messages = maker.messages(frame, index)
            if index == 0:
                messages += maker.static_transforms(frame.stamp_ns)
            for topic, kind, message in messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                stamp_ns = frame.color_stamp_ns if "/rgb/" in topic else frame.stamp_ns
                writer.write(connections[topic], stamp_ns, store.serialize_cdr(message, kind))
    # The library makes a folder of its own; its files belong into the given one.
    for file in (folder / NAME).iterdir():
        shutil.move(file, folder / file.name)
    (folder / NAME).rmdir()
