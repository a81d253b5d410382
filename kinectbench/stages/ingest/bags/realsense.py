"""RealSense bags recorded by librealsense: file versions 2 and 3, and version 1 of its predecessor.

Layout: `ros_file_format.h` of librealsense and its description of the format. A stream's extrinsics map a
reference frame to the stream. Between two streams with the same reference frame the transform is known.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from kinectbench.core import HEAD_BYTES, RecordingError, open_plain, size_of
from kinectbench.core.geometry import closest_rotation, rigid
from kinectbench.core.trajectory.text_rows import parse_floats
from kinectbench.core.trajectory.trajectory_file import FARTHEST_M
from kinectbench.core.types import Float64
from kinectbench.stages.ingest.bags.message_decoding import BagTopic, Message, RosBag, long_type
from kinectbench.stages.ingest.bags.ros_poses import TransformTree, matrix_of
from kinectbench.stages.ingest.bags.ros_topics import CAMERA_INFO, WANTED, CameraInfo, ImageTopic
from kinectbench.stages.ingest.bags.rosbag1 import MAGIC, Rosbag1Recording

FLOAT, KEY_VALUE, TRANSFORM = "std_msgs/Float32", "diagnostic_msgs/KeyValue", "geometry_msgs/Transform"
# Since 2.58 librealsense writes ROS 2 bags (.db3) with options and extrinsics as text.
STRING = "std_msgs/String"
STREAM_INFO = "realsense_msgs/stream_info"
# /device_0/sensor_0/Depth_0/image/data, /camera/DEPTH/image_raw/0
STREAM = re.compile(r"(/device_\d+/sensor_\d+)/(\w+)_\d+/image/data(?:/compressedDepth)?")
OLD_STREAM = re.compile(r"/camera/([A-Z]+)\d*/image_raw/(\d+)")
ANY_STREAM = re.compile(r"/device_\d+/sensor_\d+/\w+_\d+/")
# "rotation=" with nine numbers by columns, and "translation=" with three, metres (its ros2_writer.cpp).
EXTRINSICS = re.compile(r"rotation=([^;]{17,400});translation=([^;]{5,200})")
UNITS = re.compile(r"depth[ _]units", re.IGNORECASE)
# Version 3 has a topic for each option, version 2 one topic for all options.
OPTION = re.compile(r"/option/depth[ _]units/value$|/property$", re.IGNORECASE)
TELL_TALES = (b"topic=/device_0/sensor_", b"topic=/camera/rs_stream_info/")


class RealsenseRecording(Rosbag1Recording):
    """A bag by librealsense: depth in its Depth Units, colour registered by the stored extrinsics."""

    format: ClassVar[str] = "realsense"
    looks_for: ClassVar[str] = "a bag with topics such as /device_0/sensor_0/Depth_0/image/data"
    verified: ClassVar[str] = ""
    wanted: ClassVar[frozenset[str]] = WANTED | {FLOAT, KEY_VALUE, TRANSFORM, STREAM_INFO}
    own_types: ClassVar[frozenset[str]] = frozenset({STREAM_INFO})

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the path is a ROS 1 bag whose first bytes or index contain librealsense's topics."""
        if not super().recognises(path):
            return False
        with open_plain(path) as file:
            start = file.read(HEAD_BYTES)
            # The index at the end repeats every connection.
            index = re.search(rb"index_pos=(.{8})", start[: len(MAGIC) + 4096], re.DOTALL)
            (position,) = struct.unpack("<Q", index[1]) if index else (0,)
            file.seek(min(position, size_of(file)))
            end = file.read(HEAD_BYTES)
        return any(word in part for word in TELL_TALES for part in (start, end))

    @classmethod
    def frame_ids_tell(cls, depth: ImageTopic) -> bool:
        """Return False, because librealsense gives every stream the frame_id "0", registered or not."""
        return False

    @classmethod
    def integer_scale(cls, bag: RosBag, depth: ImageTopic) -> float | None:
        """Return depth units per metre: 1 / Depth Units (metres, a sensor option); None if not stated."""
        return depth_units_scale(bag, depth)

    @classmethod
    def between(cls, bag: RosBag, tree: TransformTree, to: ImageTopic, of: ImageTopic) -> Float64 | None:
        """Return `T_to_of` (4, 4) between two streams; None if their reference frames differ."""
        return between_streams(bag, to.name, of.name)

    @classmethod
    def camera_infos(cls, bag: RosBag) -> list[tuple[str, CameraInfo]]:
        """Return pairs (topic's name, CameraInfo message); in version 1 also from stream_info messages."""
        return super().camera_infos(bag) + [
            (
                f"/camera/{message.stream_type}/camera_info/{topic.name.rpartition('/')[2]}",
                message.camera_info,
            )
            for topic, message in _old_stream_infos(bag)
        ]


def depth_units_scale(bag: RosBag, depth: ImageTopic) -> float | None:
    """Return native units per metre from the depth sensor's option Depth Units; None if the bag lacks it."""
    found = STREAM.fullmatch(depth.name)
    prefix = found[1] if found else "/"
    for topic in bag.topics:
        if topic.name.startswith(prefix) and OPTION.search(topic.name):
            units_m = _depth_units_m(bag, topic)
            if units_m is not None:
                # Stored as float32: 0.001 becomes 0.0010000000474.
                return float(np.round(1 / units_m, 3))
    return None


def _depth_units_m(bag: RosBag, topic: BagTopic) -> float | None:
    """Return Depth Units, metres, from a topic of options (file versions 3, 4) or of properties (version 2).

    The result is None if no message states a positive value.
    """
    for message in bag.whole(topic):
        if topic.type == FLOAT and message.data > 0:
            return float(message.data)
        if topic.type == STRING:
            return _positive(message.data)
        if topic.type == KEY_VALUE and UNITS.fullmatch(message.key):
            return _positive(message.value)
    return None


def _positive(text: str) -> float | None:
    """Parse a number above 0; return None if the text is anything else."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if number > 0 else None  # false for NaN


def between_streams(bag: RosBag, to: str, of: str) -> Float64 | None:
    """Return `T_to_of` (4, 4), from stream `of` to stream `to` (names of topics); None if unknown."""
    T_to, T_of = _place_of_stream(bag, to), _place_of_stream(bag, of)
    if T_to is None or T_of is None or T_to[0] != T_of[0]:
        return None
    return np.asarray(T_to[1] @ np.linalg.inv(T_of[1]))


def _place_of_stream(bag: RosBag, name: str) -> tuple[str, Float64] | None:
    """Return the name of a stream's reference frame, and `T_stream_reference` (4, 4); None if unknown."""
    stream = ANY_STREAM.match(name)
    places = f"{stream[0]}tf/" if stream else "/"
    for topic in bag.topics if stream else ():
        if topic.type in (TRANSFORM, STRING) and topic.name.startswith(places):
            message = bag.first(topic)
            read = matrix_of if topic.type == TRANSFORM else _matrix_of_text
            matrix = None if message is None else read(message)
            return None if matrix is None else (topic.name.removeprefix(places), matrix)
    info = _old_stream_info(bag, name)
    if info is None:
        return None
    extrinsics = info.stream_extrinsics
    matrix = _rigid_by_columns(extrinsics.extrinsics.rotation, extrinsics.extrinsics.translation)
    return None if matrix is None else (str(extrinsics.reference_point_id), matrix)


def _matrix_of_text(message: Message) -> Float64 | None:
    """Parse extrinsics stored as text into a rigid transform (4, 4); return None if the text has none."""
    said = EXTRINSICS.fullmatch(message.data)
    try:
        rotation, translation_m = (
            [parse_floats(part.split(","), "") for part in said.groups()] if said else ([], [])
        )
    except RecordingError:
        return None
    if (len(rotation), len(translation_m)) != (9, 3):
        return None
    return _rigid_by_columns(rotation, translation_m)


def _rigid_by_columns(rotation: ArrayLike, translation_m: ArrayLike) -> Float64 | None:
    """Make a rigid transform (4, 4) from a column-major rotation, as in librealsense; None if invalid."""
    R, t_m = np.asarray(rotation, np.float64).reshape(3, 3).T, np.asarray(translation_m, np.float64)
    if not np.abs(R).max() <= 2 or abs(np.linalg.det(R) - 1) > 0.01:  # true for NaN, too
        return None
    return rigid(closest_rotation(R), t_m) if np.abs(t_m).max() <= FARTHEST_M else None


def _old_stream_info(bag: RosBag, name: str) -> Message | None:
    """Return the stream_info message (version 1) of a stream such as /camera/DEPTH/image_raw/0.

    The result is None if the name has another form, or if there is no such message.
    """
    match = OLD_STREAM.fullmatch(name)
    if not match:
        return None
    infos = (m for topic, m in _old_stream_infos(bag) if topic.name.endswith(f"/{match[2]}"))
    return next((message for message in infos if message.stream_type == match[1]), None)


def _old_stream_infos(bag: RosBag) -> Iterator[tuple[BagTopic, Message]]:
    """Yield each stream_info message with its topic, unless the bag defines this type with other fields."""
    for topic in bag.topics:
        for message in bag.whole(topic) if topic.type == STREAM_INFO else ():
            camera, place = (getattr(message, key, None) for key in ("camera_info", "stream_extrinsics"))
            motion = getattr(place, "extrinsics", None)
            numbers = [np.asarray(getattr(motion, key, ())) for key in ("rotation", "translation")]
            if (
                getattr(camera, "__msgtype__", "") == long_type(CAMERA_INFO)
                and [(each.dtype.kind, each.shape) for each in numbers] == [("f", (9,)), ("f", (3,))]
                and hasattr(message, "stream_type")
                and hasattr(place, "reference_point_id")
            ):
                yield topic, message
