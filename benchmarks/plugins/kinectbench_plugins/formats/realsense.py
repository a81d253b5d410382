"""RealSense bags in the layouts of librealsense: version 3, and version 1 of its predecessor."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.lab.simulate.writers.bags import IMAGE, INFO, MessageMaker, Messages, log_messages
from kinectbench.lab.simulate.writers.frame import DEPTH_SCALE, RecordedFrame, Rig

SENSORS = {"Depth": "/device_0/sensor_0/Depth_0", "Color": "/device_0/sensor_1/Color_0"}
# librealsense writes this whatever the stream.
FRAME_ID = "0"
TRANSFORM, FLOAT, VERSION = "geometry_msgs/msg/Transform", "std_msgs/msg/Float32", "std_msgs/msg/UInt32"
STREAM_INFO = "realsense_msgs/msg/stream_info"
EXTRINSICS = "realsense_msgs/msg/stream_extrinsics"
DEFINITIONS = {
    STREAM_INFO: "string stream_type\nuint32 fps\nsensor_msgs/CameraInfo camera_info\n"
    "realsense_msgs/stream_extrinsics stream_extrinsics\nuint32 width\nuint32 height\nstring encoding\n",
    EXTRINSICS: "realsense_msgs/extrinsics extrinsics\nuint64 reference_point_id\n",
    "realsense_msgs/msg/extrinsics": "float32[9] rotation\nfloat32[3] translation\n",
}
# Facts of the device stand at the beginning of time.
STATIC_NS = 1


def write_realsense(path: Path, rig: Rig, frames: Iterable[RecordedFrame], *, old: bool) -> None:
    """Write a recording to a bag that does not exist yet, in the layout of file version 3, or else of 1.

    Depth is mono16 in mm with its Depth Units, colour rgb8, both without compression; extrinsics lie under
    tf/0 with depth as the reference. The layout has no place for poses, or to say that colour is registered:
    where it is, the extrinsics are none.
    """
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    for name, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))
    maker = MessageMaker(store.types, rig, "raw", ros2=False)
    depth_topic = "/camera/DEPTH/image_raw/0" if old else f"{SENSORS['Depth']}/image/data"
    color_topic = "/camera/COLOR/image_raw/0" if old else f"{SENSORS['Color']}/image/data"

    def messages() -> Messages:
        """All messages of the recording, what does not change first."""
        yield from (_old_facts if old else _facts)(maker, store.types, rig)
        for index, frame in enumerate(frames):
            header = maker.header(index, frame.stamp_ns, FRAME_ID)
            yield depth_topic, IMAGE, frame.stamp_ns, maker.image(header, frame.depth_native(), "mono16")
            for color in frame.colors:
                header = maker.header(index, color.stamp_ns, FRAME_ID)
                yield color_topic, IMAGE, color.stamp_ns, maker.image(header, color.rgb, "rgb8")

    with Writer(path) as writer:
        log_messages(writer, store, messages())


def _facts(maker: MessageMaker, types: Any, rig: Rig) -> Messages:
    """Version, depth unit, and intrinsics and extrinsics of both streams."""
    yield "/file_version", VERSION, STATIC_NS, types[VERSION](3)
    yield "/device_0/sensor_0/option/Depth Units/value", FLOAT, STATIC_NS, types[FLOAT](1 / DEPTH_SCALE)
    header = maker.header(0, 0, "")
    places = {"Depth": np.eye(4), "Color": rig.T_color_depth}
    for name, camera in (("Depth", rig.depth), ("Color", rig.color)):
        yield f"{SENSORS[name]}/info/camera_info", INFO, STATIC_NS, maker.camera_info(header, camera)
        yield f"{SENSORS[name]}/tf/0", TRANSFORM, STATIC_NS, maker.transform(places[name])


def _old_facts(maker: MessageMaker, types: Any, rig: Rig) -> Messages:
    """Version, and a stream_info for each stream: intrinsics, and extrinsics column by column."""
    yield "/FILE_VERSION", VERSION, STATIC_NS, types[VERSION](1)
    streams = (("DEPTH", rig.depth, np.eye(4), "mono16"), ("COLOR", rig.color, rig.T_color_depth, "rgb8"))
    for name, camera, T, encoding in streams:
        matrix = types["realsense_msgs/msg/extrinsics"](
            T[:3, :3].T.ravel().astype(np.float32), T[:3, 3].astype(np.float32)
        )
        info = types[STREAM_INFO](
            stream_type=name,
            fps=30,
            camera_info=maker.camera_info(maker.header(0, 0, ""), camera),
            stream_extrinsics=types[EXTRINSICS](matrix, 0),
            width=camera.width,
            height=camera.height,
            encoding=encoding,
        )
        yield "/camera/rs_stream_info/0", STREAM_INFO, STATIC_NS, info
