"""A ROS 1 bag as an OpenNI driver records it: registered depth in mm, JPEG colour, poses; bz2 chunks."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.geometry import Camera, quaternion_xyzw_from_rotation
from kinectbench.simulate.writers.frame import RecordedFrame

DEPTH_SCALE = 1000.0
FRAME_ID = "camera_rgb_optical_frame"
TOPICS = {
    "info": ("/camera/depth_registered/camera_info", "sensor_msgs/msg/CameraInfo"),
    "depth": ("/camera/depth_registered/image_raw", "sensor_msgs/msg/Image"),
    "color": ("/camera/rgb/image_color/compressed", "sensor_msgs/msg/CompressedImage"),
    "pose": ("/camera/pose", "geometry_msgs/msg/PoseStamped"),
}


def write_rosbag1(path: Path, camera: Camera, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording to a bag that does not exist yet. Same frames, same bytes.

    Depth is 16UC1 in millimetres; the common frame id and `depth_registered` say that colour lies on depth.
    PoseStamped holds the camera in frame `world`, optical axes.
    """
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.BZ2)
    with writer:
        connections = {
            key: writer.add_connection(topic, kind, typestore=store) for key, (topic, kind) in TOPICS.items()
        }
        for index, frame in enumerate(frames):
            for key, message in _messages(store, camera, frame, index).items():
                data = store.serialize_ros1(message, TOPICS[key][1])
                writer.write(connections[key], frame.stamp_ns, data)


def _messages(store: Any, camera: Camera, frame: RecordedFrame, index: int) -> dict[str, Any]:
    """The messages of one frame by key of TOPICS."""
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](frame.stamp_ns // 10**9, frame.stamp_ns % 10**9)

    def header(frame_id: str) -> Any:
        return types["std_msgs/msg/Header"](seq=index, stamp=stamp, frame_id=frame_id)

    depth = frame.depth_native(DEPTH_SCALE)
    height, width = depth.shape
    position = types["geometry_msgs/msg/Point"](*frame.T_world_camera[:3, 3].tolist())
    quaternion_xyzw = quaternion_xyzw_from_rotation(frame.T_world_camera[:3, :3])
    orientation = types["geometry_msgs/msg/Quaternion"](*quaternion_xyzw.tolist())
    return {
        "info": _camera_info(types, header(FRAME_ID), camera),
        "depth": types["sensor_msgs/msg/Image"](
            header=header(FRAME_ID),
            height=height,
            width=width,
            encoding="16UC1",
            is_bigendian=0,
            step=2 * width,
            data=np.frombuffer(depth.astype("<u2").tobytes(), np.uint8),
        ),
        "color": types["sensor_msgs/msg/CompressedImage"](
            header=header(FRAME_ID), format="jpeg", data=np.frombuffer(frame.color_jpeg(), np.uint8)
        ),
        "pose": types["geometry_msgs/msg/PoseStamped"](
            header=header("world"), pose=types["geometry_msgs/msg/Pose"](position, orientation)
        ),
    }


def _camera_info(types: Any, header: Any, camera: Camera) -> Any:
    """The CameraInfo of an undistorted camera."""
    projection = np.column_stack([camera.K, np.zeros(3)])
    return types["sensor_msgs/msg/CameraInfo"](
        header=header,
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        D=np.zeros(5),
        K=camera.K.ravel(),
        R=np.eye(3).ravel(),
        P=projection.ravel(),
        binning_x=0,
        binning_y=0,
        roi=types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
    )
