"""Write ROS bags like an OpenNI driver: depth in mm, JPEG colour, CameraInfo of both, poses.

Messages are made by `MessageMaker`, in the order of the frames. The same frames give the same bytes.
"""

import shutil
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Literal

import numba
import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from kinectbench.core.geometry import Camera, quaternion_xyzw_from_rotation
from kinectbench.lab.simulate.writers.frame import RecordedFrame, Rig, png_bytes
from kinectbench.stages.ingest.bags.message_decoding import Message

DepthCode = Literal["raw", "png", "rvl"]

COLOR_FRAME_ID = "camera_rgb_optical_frame"
DEPTH_FRAME_ID = "camera_depth_optical_frame"
INFO = "sensor_msgs/msg/CameraInfo"
IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
POSE, TF = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
_TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms"
# image_transport's ConfigHeader: an int32 format, and two float32 that only 32FC1 uses.
COMPRESSED_DEPTH_HEADER = struct.pack("<iff", 0, 0.0, 0.0)


class MessageMaker:
    """Makes the ROS messages of a recording, one frame at a time.

    If colour is registered, depth has topics below /camera/depth_registered and the frame_id of colour; else
    it has topics below /camera/depth and its own frame_id. Colour and its CameraInfo have the stamp of
    colour, poses have the pose's stamp (`given_ns`), and all other messages have the stamp of depth.
    PoseStamped is the depth camera's pose in frame `world`, optical axes; a frame without a pose has no such
    message.
    """

    def __init__(
        self, types: Mapping[str, Callable[..., Message]], rig: Rig, depth_code: DepthCode, *, ros2: bool
    ) -> None:
        """Prepare to make messages from the message classes `types` of a rosbags type store."""
        self._types, self._rig, self._code, self._ros2 = types, rig, depth_code, ros2
        self._depth_folder = "/camera/depth_registered" if rig.color_registered else "/camera/depth"
        self._depth_frame_id = COLOR_FRAME_ID if rig.color_registered else DEPTH_FRAME_ID

    def messages(self, frame: RecordedFrame, index: int) -> list[tuple[str, str, Message]]:
        """Return all messages of a frame as (topic, message type, message)."""
        depth_header = self.header(index, frame.stamp_ns, self._depth_frame_id)
        logged = [
            (f"{self._depth_folder}/camera_info", INFO, self.camera_info(depth_header, self._rig.depth)),
            self._depth(depth_header, frame.depth_native()),
        ]
        for stamp_ns, jpeg in frame.color_jpegs():
            header = self.header(index, stamp_ns, COLOR_FRAME_ID)
            image = self._types[COMPRESSED_IMAGE](
                header=header, format="jpeg", data=np.frombuffer(jpeg, np.uint8)
            )
            logged += [
                ("/camera/rgb/camera_info", INFO, self.camera_info(header, self._rig.color)),
                ("/camera/rgb/image_color/compressed", COMPRESSED_IMAGE, image),
            ]
        if frame.T_world_camera is not None:
            pose = self._pose(self.header(index, frame.given_ns, "world"), frame.T_world_camera)
            logged.append(("/camera/pose", POSE, pose))
        return logged

    def header(self, index: int, stamp_ns: int, frame_id: str) -> Message:
        """Return a std_msgs/Header; `index` is its sequence number, which ROS 2 lacks."""
        stamp = self._types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        number = {} if self._ros2 else {"seq": index}
        return self._types["std_msgs/msg/Header"](**number, stamp=stamp, frame_id=frame_id)

    def image(self, header: Message, pixels: NDArray[np.generic], encoding: str) -> Message:
        """Return a sensor_msgs/Image of (height, width) or (height, width, channels), little-endian."""
        height, width = pixels.shape[:2]
        data = np.frombuffer(pixels.astype(pixels.dtype.newbyteorder("<")).tobytes(), np.uint8)
        return self._types[IMAGE](
            header=header,
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=data.size // height,
            data=data,
        )

    def camera_info(self, header: Message, camera: Camera) -> Message:
        """Return the CameraInfo of an undistorted camera."""
        matrices = {
            "D": np.zeros(5),
            "K": camera.K.ravel(),
            "R": np.eye(3).ravel(),
            "P": np.column_stack([camera.K, np.zeros(3)]).ravel(),
        }
        named = {name.lower(): value for name, value in matrices.items()} if self._ros2 else matrices
        return self._types[INFO](
            header=header,
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            **named,
            binning_x=0,
            binning_y=0,
            roi=self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
        )

    def transform(self, T_parent_child: NDArray[np.float64]) -> Message:
        """Return a transform (4, 4) as a geometry_msgs/Transform."""
        quaternion_xyzw = quaternion_xyzw_from_rotation(T_parent_child[:3, :3])
        return self._types["geometry_msgs/msg/Transform"](
            self._types["geometry_msgs/msg/Vector3"](*T_parent_child[:3, 3].tolist()),
            self._types["geometry_msgs/msg/Quaternion"](*quaternion_xyzw.tolist()),
        )

    def static_transforms(self, stamp_ns: int) -> list[tuple[str, str, Message]]:
        """Return /tf_static: the depth camera's pose in the colour camera's frame; [] if registered."""
        if self._rig.color_registered:
            return []
        header = self.header(0, stamp_ns, COLOR_FRAME_ID)
        stamped = self._types["geometry_msgs/msg/TransformStamped"](
            header, DEPTH_FRAME_ID, self.transform(self._rig.T_color_depth)
        )
        return [("/tf_static", TF, self._types[TF]([stamped]))]

    def _depth(self, header: Message, depth: NDArray[np.uint16]) -> tuple[str, str, Message]:
        topic = f"{self._depth_folder}/image_raw"
        if self._code == "raw":
            return topic, IMAGE, self.image(header, depth, "16UC1")
        code = png_bytes(depth) if self._code == "png" else encode_rvl(depth)
        data = np.frombuffer(COMPRESSED_DEPTH_HEADER + code, np.uint8)
        message = self._types[COMPRESSED_IMAGE](header, f"16UC1; compressedDepth {self._code}", data)
        return f"{topic}/compressedDepth", COMPRESSED_IMAGE, message

    def _pose(self, header: Message, T_world_camera: NDArray[np.float64]) -> Message:
        quaternion_xyzw = quaternion_xyzw_from_rotation(T_world_camera[:3, :3])
        position = self._types["geometry_msgs/msg/Point"](*T_world_camera[:3, 3].tolist())
        orientation = self._types["geometry_msgs/msg/Quaternion"](*quaternion_xyzw.tolist())
        return self._types[POSE](header, self._types["geometry_msgs/msg/Pose"](position, orientation))


NAME = "recording"

# Topic, type, logging time in nanoseconds, and message.
Messages = Iterator[tuple[str, str, int, Message]]


def log_messages(
    writer: Writer1 | Writer2, store: Typestore, messages: Messages, *, ros2: bool = False
) -> None:
    """Write (topic, type, stamp in ns, message) to an open bag; open each topic at its first message."""
    serialize = store.serialize_cdr if ros2 else store.serialize_ros1
    connections: dict[str, Connection] = {}
    for topic, kind, stamp_ns, message in messages:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=store)
        writer.write(connections[topic], stamp_ns, serialize(message, kind))


def write_rosbag1(path: Path, rig: Rig, frames: Iterable[RecordedFrame], *, depth_code: DepthCode) -> None:
    """Write a ROS 1 bag; messages are logged at the stamps of their headers.

    If colour is not registered, /tf_static has the transform between the cameras.

    Args:
        path: the bag's path, which does not exist yet.
        rig: the cameras.
        frames: the recorded frames.
        depth_code: encoding of depth; raw 16UC1 is written in bz2 chunks, others in uncompressed chunks.
    """
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_TF_DEFINITION, TF))  # the library's own lack it
    writer = Writer1(path)
    if depth_code == "raw":  # PNG and JPEG would not shrink
        writer.set_compression(Writer1.CompressionFormat.BZ2)
    maker = MessageMaker(store.types, rig, depth_code, ros2=False)

    def messages() -> Messages:
        for index, frame in enumerate(frames):
            static = maker.static_transforms(frame.stamp_ns) if index == 0 else []
            for topic, kind, message in maker.messages(frame, index) + static:
                stamp = (message.transforms[0] if kind == TF else message).header.stamp
                yield topic, kind, stamp.sec * 10**9 + stamp.nanosec, message

    with writer:
        log_messages(writer, store, messages())


def write_rosbag2(
    folder: Path, rig: Rig, frames: Iterable[RecordedFrame], *, depth_code: DepthCode, mcap: bool
) -> None:
    """Write a ROS 2 bag into an empty folder: metadata.yaml, and recording.mcap or recording.db3.

    Colour and its CameraInfo are logged at colour's stamp, all other messages at depth's. If colour is not
    registered, /tf_static has the transform between the cameras.

    Args:
        folder: an empty folder.
        rig: the cameras.
        frames: the recorded frames.
        depth_code: encoding of depth.
        mcap: whether the file is MCAP instead of SQLite.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    maker = MessageMaker(store.types, rig, depth_code, ros2=True)

    def messages() -> Messages:
        """Yield (topic, type, stamp in ns, message) of all messages, frame by frame."""
        for index, frame in enumerate(frames):
            static = maker.static_transforms(frame.stamp_ns) if index == 0 else []
            for topic, kind, message in maker.messages(frame, index) + static:
                logged = message.header.stamp if "/rgb/" in topic else None
                logged_ns = logged.sec * 10**9 + logged.nanosec if logged else frame.stamp_ns
                yield topic, kind, logged_ns, message

    with Writer2(folder / NAME, version=8, storage_plugin=plugin) as writer:
        log_messages(writer, store, messages(), ros2=True)
    # The library makes its own subfolder; its files are moved to the given folder.
    for file in (folder / NAME).iterdir():
        shutil.move(file, folder / file.name)
    (folder / NAME).rmdir()


def encode_rvl(depth: NDArray[np.uint16]) -> bytes:
    """Encode depth (rows, columns) uint16 as RVL with its header."""
    flat = np.ascontiguousarray(depth).reshape(-1)
    nibbles = np.empty(8 * flat.size + 64, np.uint8)
    count = _encode(flat, nibbles)
    nibbles[count:] = 0
    packed = nibbles[: -(-count // 8) * 8].reshape(-1, 8).astype(np.uint32)
    words = np.zeros(len(packed), np.uint32)
    for place in range(8):
        np.bitwise_or(words, packed[:, place] << np.uint32(28 - 4 * place), out=words)
    return struct.pack("<II", depth.shape[1], depth.shape[0]) + words.astype("<u4").tobytes()


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _put(nibbles: NDArray[np.uint8], count: int, value: int) -> int:
    while True:
        bits = value & 7
        value >>= 3
        nibbles[count] = bits | 8 if value else bits
        count += 1
        if not value:
            return count


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _encode(depth: NDArray[np.uint16], nibbles: NDArray[np.uint8]) -> int:
    position, count, previous = 0, 0, 0
    while position < len(depth):
        start = position
        while position < len(depth) and depth[position] == 0:
            position += 1
        count = _put(nibbles, count, position - start)
        end = position
        while end < len(depth) and depth[end] != 0:
            end += 1
        count = _put(nibbles, count, end - position)
        for index in range(position, end):
            difference = int(depth[index]) - previous
            count = _put(nibbles, count, (difference << 1) ^ (difference >> 63))
            previous = int(depth[index])
        position = end
    return count
