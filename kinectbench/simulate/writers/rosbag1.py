"""ROS 1 bags as an OpenNI driver records them: depth in mm, JPEG colour, CameraInfo of both, poses."""

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, quaternion_xyzw_from_rotation
from kinectbench.simulate.writers.frame import RecordedFrame, Rig, png_bytes

DEPTH_SCALE = 1000.0
COLOR_FRAME_ID = "camera_rgb_optical_frame"
DEPTH_FRAME_ID = "camera_depth_optical_frame"
INFO = "sensor_msgs/msg/CameraInfo"
IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
POSE = "geometry_msgs/msg/PoseStamped"
# image_transport's ConfigHeader: int32 format, two float32 that only 32FC1 uses.
COMPRESSED_DEPTH_HEADER = struct.pack("<iff", 0, 0.0, 0.0)


def write_rosbag1(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording to a bag that does not exist yet, with raw 16UC1 depth in bz2 chunks.

    Depth that colour is registered to lies under /camera/depth_registered in the frame of colour, other
    depth under /camera/depth in its own frame. Messages are in the order of the frames; header and log have
    the stamp of depth, or of colour for colour and its CameraInfo. PoseStamped holds the depth camera in
    frame `world`, optical axes; a frame without a pose has none. Same frames, same bytes.
    """
    _write(path, rig, frames, compressed=False)


def write_rosbag1_compressed(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording as `write_rosbag1` does, but with depth as compressedDepth PNG and plain chunks."""
    _write(path, rig, frames, compressed=True)


def _write(path: Path, rig: Rig, frames: Iterable[RecordedFrame], *, compressed: bool) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if not compressed:  # PNG and JPEG would not shrink
        writer.set_compression(Writer.CompressionFormat.BZ2)
    maker = _MessageMaker(store.types, rig, compressed)
    connections: dict[str, Any] = {}
    with writer:
        for index, frame in enumerate(frames):
            for topic, kind, message in maker.messages(frame, index):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                stamp = message.header.stamp
                data = store.serialize_ros1(message, kind)
                writer.write(connections[topic], stamp.sec * 10**9 + stamp.nanosec, data)


class _MessageMaker:
    """Makes the messages of one frame after another."""

    def __init__(self, types: Any, rig: Rig, compressed: bool) -> None:
        self._types, self._rig, self._compressed = types, rig, compressed
        self._depth_folder = "/camera/depth_registered" if rig.color_registered else "/camera/depth"
        self._depth_frame_id = COLOR_FRAME_ID if rig.color_registered else DEPTH_FRAME_ID

    def messages(self, frame: RecordedFrame, index: int) -> list[tuple[str, str, Any]]:
        """Topic, type and message of everything that belongs to a frame."""
        depth_header = self._header(index, frame.stamp_ns, self._depth_frame_id)
        color_header = self._header(index, frame.color_stamp_ns, COLOR_FRAME_ID)
        color = self._types[COMPRESSED_IMAGE](
            header=color_header, format="jpeg", data=np.frombuffer(frame.color_jpeg(), np.uint8)
        )
        found = [
            (f"{self._depth_folder}/camera_info", INFO, self._camera_info(depth_header, self._rig.depth)),
            self._depth(depth_header, frame.depth_native(DEPTH_SCALE)),
            ("/camera/rgb/camera_info", INFO, self._camera_info(color_header, self._rig.color)),
            ("/camera/rgb/image_color/compressed", COMPRESSED_IMAGE, color),
        ]
        if frame.T_world_camera is not None:
            pose = self._pose(self._header(index, frame.given_ns, "world"), frame.T_world_camera)
            found.append(("/camera/pose", POSE, pose))
        return found

    def _header(self, index: int, stamp_ns: int, frame_id: str) -> Any:
        stamp = self._types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        return self._types["std_msgs/msg/Header"](seq=index, stamp=stamp, frame_id=frame_id)

    def _depth(self, header: Any, depth: NDArray[np.uint16]) -> tuple[str, str, Any]:
        topic = f"{self._depth_folder}/image_raw"
        if self._compressed:
            data = np.frombuffer(COMPRESSED_DEPTH_HEADER + png_bytes(depth), np.uint8)
            message = self._types[COMPRESSED_IMAGE](header, "16UC1; compressedDepth png", data)
            return f"{topic}/compressedDepth", COMPRESSED_IMAGE, message
        height, width = depth.shape
        message = self._types[IMAGE](
            header=header,
            height=height,
            width=width,
            encoding="16UC1",
            is_bigendian=0,
            step=2 * width,
            data=np.frombuffer(depth.astype("<u2").tobytes(), np.uint8),
        )
        return topic, IMAGE, message

    def _camera_info(self, header: Any, camera: Camera) -> Any:
        """The CameraInfo of an undistorted camera."""
        return self._types[INFO](
            header=header,
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            D=np.zeros(5),
            K=camera.K.ravel(),
            R=np.eye(3).ravel(),
            P=np.column_stack([camera.K, np.zeros(3)]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
        )

    def _pose(self, header: Any, T_world_camera: NDArray[np.float64]) -> Any:
        quaternion_xyzw = quaternion_xyzw_from_rotation(T_world_camera[:3, :3])
        position = self._types["geometry_msgs/msg/Point"](*T_world_camera[:3, 3].tolist())
        orientation = self._types["geometry_msgs/msg/Quaternion"](*quaternion_xyzw.tolist())
        return self._types[POSE](header, self._types["geometry_msgs/msg/Pose"](position, orientation))
