"""Frames of a ROS bag: where their names, or librealsense's extrinsics, tell the place of colour; and tf."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ingest_writers import FX, HEIGHT, START_NS, STEP_NS, WIDTH, depth_image
from numpy.typing import NDArray
from raising import raises
from test_ingest_rosbag2 import (
    RGB,
    RIG,
    STORE,
    T_BASE_CAMERA,
    TYPES,
    messages,
    pose,
    stamped,
    tf,
    write_bag,
    write_mcap,
)

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera, rigid, rotation_from_quaternion_xyzw
from kinectbench.lab.simulate.writers.bags import MessageMaker
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.bags import ros_poses
from kinectbench.stages.ingest.bags.ros_images import color_of
from kinectbench.stages.ingest.readers import open_recording


def of_frame(frame_id: str, streams: tuple[str, str], color: Camera) -> list[tuple[str, str, int, bytes]]:
    """Depth and colour whose messages all have one frame_id, each stream with its own camera."""
    maker = MessageMaker(TYPES, RIG, "raw", ros2=True)
    image, info, found = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", []
    for i in range(3):
        header = maker.header(0, START_NS + i * STEP_NS, frame_id)
        rgb = np.zeros((color.height, color.width, 3), np.uint8)
        for stream, message, camera in (
            (streams[0], maker.image(header, depth_image(i, 1000.0), "16UC1"), RIG.depth),
            (streams[1], maker.image(header, rgb, "rgb8"), color),
        ):
            data = bytes(STORE.serialize_cdr(message, image))
            found.append((f"{stream}/image/data", image, START_NS + i * STEP_NS, data))
            said = bytes(STORE.serialize_cdr(maker.camera_info(header, camera), info))
            found.append((f"{stream}/image/camera_info", info, START_NS + i * STEP_NS, said))
    return found


STREAMS = "/device_0/sensor_0/Depth_0", "/device_0/sensor_1/Color_0"


@pytest.mark.parametrize(
    ("frame_id", "streams"),
    [("", ("/cam/depth", "/cam/rgb")), ("/", ("/cam/depth", "/cam/rgb")), ("0", STREAMS)],
)
@pytest.mark.parametrize("times", [1, 2])
def test_without_a_frame_the_place_of_colour_is_unknown(
    tmp_path: Path, frame_id: str, streams: tuple[str, str], times: int
) -> None:
    """librealsense's ROS 1 bags, converted, have "0" in every stream."""
    color = Camera(WIDTH * times, HEIGHT * times, 1.6 * FX, 1.6 * FX, WIDTH / 2, HEIGHT / 2)
    found = of_frame(frame_id, streams, color)
    found.append(tf(START_NS, stamped(START_NS, "", "base", np.eye(4)), static=True))
    recording = open_recording(write_mcap(tmp_path / "r.mcap", found))
    assert not recording.color_registered
    assert recording.color_calibration is None


@pytest.mark.parametrize("kind", ["std_msgs/msg/String", "geometry_msgs/msg/Transform"])
@pytest.mark.parametrize("reference", ["0", "1"])
def test_extrinsics_of_librealsense(tmp_path: Path, kind: str, reference: str) -> None:
    """As text in its own .db3, as a transform in a ROS 1 bag that was converted."""
    color = Camera(WIDTH, HEIGHT, 1.6 * FX, 1.6 * FX, WIDTH / 2, HEIGHT / 2)
    found = of_frame("0", STREAMS, color)
    turn = rotation_from_quaternion_xyzw([0.0, 0.0, np.sin(0.1), np.cos(0.1)])
    T_color_reference = rigid(turn, [0.3, 0.02, 0.0])
    for stream, T, to in ((STREAMS[0], np.eye(4), "0"), (STREAMS[1], T_color_reference, reference)):
        columns, moved = (",".join(f"{x:.6f}" for x in part) for part in (T[:3, :3].T.ravel(), T[:3, 3]))
        text = TYPES["std_msgs/msg/String"](data=f"rotation={columns};translation={moved}")
        message = text if "String" in kind else MessageMaker(TYPES, RIG, "raw", ros2=True).transform(T)
        found.append((f"{stream}/tf/{to}", kind, START_NS, bytes(STORE.serialize_cdr(message, kind))))
    calibration = open_recording(write_bag(tmp_path / "r", found)).color_calibration
    assert (calibration is not None) == (reference == "0")
    if calibration is not None:
        np.testing.assert_allclose(calibration.T_color_depth, T_color_reference, atol=1e-5)


@pytest.mark.parametrize("times", [1, 2, 7])
def test_a_fixed_link_that_is_published_again_hides_no_trajectory(
    tmp_path: Path, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As robot_state_publisher does; and the matrices of a frame's transforms are made at once."""
    calls = []

    def counted(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        calls.append(len(rows))
        return rotation_from_quaternion_xyzw(rows)

    monkeypatch.setattr(ros_poses, "rotation_from_quaternion_xyzw", counted)
    found = [m for m in messages() if m[1] != "geometry_msgs/msg/PoseStamped"]
    for i in range(5):
        stamp_ns = START_NS + i * STEP_NS
        found.append(tf(stamp_ns, stamped(stamp_ns, "odom", "base", pose(i))))
        for k in range(times):
            again_ns = stamp_ns + STEP_NS // 2 + k
            found.append(tf(again_ns, stamped(again_ns, "base", RGB, T_BASE_CAMERA)))
    recording = open_recording(write_mcap(tmp_path / "r.mcap", found), CameraSettings(pose_topic="tf"))
    assert sorted(calls) == [5, 5 * times]
    given = recording.given_trajectory
    assert given is not None and len(given.stamps_ns) == 5
    for i in range(5):
        np.testing.assert_allclose(given.T_world_camera[i], pose(i) @ T_BASE_CAMERA, atol=1e-9)


@pytest.mark.parametrize("encoding", ["yuv422", "yuv422_yuy2", "uyvy", "yuyv"])
def test_colour_of_an_odd_width_whose_pixels_share_it_is_named(encoding: str) -> None:
    message = SimpleNamespace(
        encoding=encoding, width=5, height=4, step=10, data=np.zeros(40, np.uint8), is_bigendian=0
    )
    with raises(RecordingError, "recording.damaged-image", match=f"5x4 pixels cannot be '{encoding}'"):
        color_of(message, "/rgb")
