"""RealSense bags: depth unit, extrinsics and cameras of every version; round trips are with the writers'."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ingest_writers import (
    CAMERA,
    CX,
    CY,
    FX,
    FY,
    HEIGHT,
    START_NS,
    STEP_NS,
    WIDTH,
    BagWriter,
    color_image,
    depth_image,
)
from raising import raises
from rosbags.typesys import Stores, get_typestore

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.bags.message_decoding import known_types
from kinectbench.stages.ingest.readers import format_of, open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

DEPTH = "/device_0/sensor_0/Depth_0"
COLOR = "/device_0/sensor_1/Color_0"


def write(
    path: Path, *, compression: str | None = None, extra: Any = None, step_ns: int = 33_000_000
) -> Path:
    with BagWriter(path, compression) as bag:
        for stream in (DEPTH, COLOR):
            bag.info(f"{stream}/info/camera_info", START_NS, CAMERA, frame_id="", model="Brown Conrady")
        if extra is not None:
            extra(bag)
        for i in range(3):
            stamp_ns = i * step_ns
            bag.image(f"{DEPTH}/image/data", stamp_ns, depth_image(i, 4000.0), "mono16", "0")
            bag.image(f"{COLOR}/image/data", stamp_ns, color_image(i)[..., ::-1], "rgb8", "0")
            bag.image("/device_0/sensor_0/Infrared_1/image/data", stamp_ns, depth_image(9), "mono16")
    return path


def units(bag: BagWriter) -> None:
    bag.raw(
        "/device_0/sensor_0/option/Depth Units/value",
        "std_msgs/msg/Float32",
        1,
        np.float32(0.00025).tobytes(),
    )


def property_of_version_2(bag: BagWriter) -> None:
    def text(value: str) -> bytes:
        return len(value).to_bytes(4, "little") + value.encode()

    for key, value in (("Exposure", "33.0"), ("Depth Units", "0.000250000011874363")):
        bag.raw("/device_0/sensor_0/property", "diagnostic_msgs/msg/KeyValue", 1, text(key) + text(value))


def motion(topic: str, x_m: float) -> tuple[str, str, int, bytes]:
    return topic, "geometry_msgs/msg/Transform", 1, np.array([x_m, 0, 0, 0, 0, 0, 1.0]).tobytes()


@pytest.mark.parametrize("extra", [units, property_of_version_2])
@pytest.mark.parametrize("compression", [None, "LZ4"])
def test_the_depth_unit_and_a_time_that_starts_at_zero(
    tmp_path: Path, extra: Any, compression: str | None
) -> None:
    path = write(tmp_path / "r.bag", extra=extra, compression=compression)
    recording = open_recording(path)
    assert (recording.format, recording.depth_scale, len(recording)) == ("realsense", 4000.0, 3)
    # One frame_id for all streams does not make colour registered.
    assert not recording.color_registered
    assert recording.color_calibration is None
    np.testing.assert_array_equal(recording.frame(1).depth, depth_image(1, 4000.0))
    assert recording.stamps_ns.tolist() == [0, 33_000_000, 66_000_000]


def test_without_a_unit_depth_is_in_millimetres(tmp_path: Path) -> None:
    assert open_recording(write(tmp_path / "r.bag")).depth_scale == 1000.0


@pytest.mark.parametrize("reference", ["0", "1"])
def test_extrinsics_of_one_reference(tmp_path: Path, reference: str) -> None:
    def both(bag: BagWriter) -> None:
        bag.raw(*motion(f"{DEPTH}/tf/0", 0.25))
        bag.raw(*motion(f"{COLOR}/tf/{reference}", 0.3))

    calibration = open_recording(write(tmp_path / "r.bag", extra=both)).color_calibration
    assert (calibration is not None) == (reference == "0")
    if calibration is not None:
        # Both map the reference to the stream.
        np.testing.assert_allclose(calibration.T_color_depth[:3, 3], [0.05, 0, 0], atol=1e-12)


def test_another_bag_is_not_taken_for_one(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "r.bag") as bag:
        bag.image("/camera/depth/image_raw", START_NS, depth_image(0), "16UC1")
    assert format_of(tmp_path / "r.bag") == "rosbag1"


ACCEL = "/device_0/sensor_2/Accel_0"


def imu(acceleration: tuple[float, float, float], frame_id: str = "imu") -> bytes:
    """A message of sensor_msgs/Imu but for its stamp, as ROS 1 serialises it."""
    name = len(frame_id).to_bytes(4, "little") + frame_id.encode()
    orientation, turning = [0, 0, 0, 1.0, *[0] * 9], [0.0] * (3 + 9)
    return name + np.array([*orientation, *turning, *acceleration, *[0] * 9], "<f8").tobytes()


def accelerometer(bag: BagWriter, topic: str, acceleration: tuple[float, float, float]) -> None:
    for stamp_ns in range(0, 200_000_000, 5_000_000):
        seconds, nanoseconds = divmod(stamp_ns, 10**9)
        head = np.array([0, seconds, nanoseconds], "<u4").tobytes()
        bag.raw(topic, "sensor_msgs/msg/Imu", stamp_ns, head + imu(acceleration))


@pytest.mark.parametrize(
    ("acceleration", "reference", "up"),
    [
        # The sensor lies on its side: its x axis is the camera's -y, which is up.
        ((9.75, 0, 0), "0", (0, -1, 0)),
        # A hand that shakes it, a gyroscope without any acceleration, a place that is not known.
        ((13.0, 0, 0), "0", None),
        ((0, 0, 0), "0", None),
        ((9.75, 0, 0), "1", None),
    ],
)
def test_up_by_the_accelerometer(tmp_path: Path, acceleration: Any, reference: str, up: Any) -> None:
    def both(bag: BagWriter) -> None:
        bag.raw(*motion(f"{DEPTH}/tf/0", 0.25))
        # T_stream_reference: a quarter turn about z, x y z w.
        turn = np.array([0.0, 0, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5)]).tobytes()
        bag.raw(f"{ACCEL}/tf/{reference}", "geometry_msgs/msg/Transform", 1, turn)
        accelerometer(bag, f"{ACCEL}/imu/data", acceleration)

    recording = open_recording(write(tmp_path / "r.bag", extra=both))
    found = [sample.up_camera for sample in recording.up_cameras]
    if up is None:
        assert found == []
    else:
        assert [sample.stamp_ns for sample in recording.up_cameras] == recording.stamps_ns.tolist()
        np.testing.assert_allclose(found, [up] * 3, atol=1e-6)
        write_sequence(recording, tmp_path / "sequence")
        assert read_sequence(tmp_path / "sequence").up_cameras == recording.up_cameras


STREAM_INFO = """string stream_type
uint32 fps
string encoding
sensor_msgs/CameraInfo camera_info
realsense_msgs/stream_extrinsics stream_extrinsics
================================================================================
MSG: realsense_msgs/stream_extrinsics
uint64 reference_point_id
realsense_msgs/extrinsics extrinsics
================================================================================
MSG: realsense_msgs/extrinsics
float32[9] rotation
float32[3] translation
"""


def old(path: Path, definition: str, data: bytes) -> Path:
    """A bag of version 1, whose stream_info has this definition and content."""
    with BagWriter(path) as bag:
        name, kind = "/camera/rs_stream_info/0", "realsense_msgs/msg/stream_info"
        place = bag._writer.add_connection(name, kind, msgdef=definition, md5sum="0" * 32)
        bag._writer.write(place, 1, data)
        for i in range(3):
            bag.image("/camera/DEPTH/image_raw/0", i * STEP_NS, depth_image(i, 1000.0), "mono16")
    return path


@pytest.mark.parametrize(
    ("definition", "size"), [("int8 a", 1), ("string stream_type\nint8 camera_info", 5), (STREAM_INFO, 9)]
)
def test_a_stream_info_of_other_fields_says_nothing(tmp_path: Path, definition: str, size: int) -> None:
    with raises(RecordingError, "recording.no-intrinsics"):
        open_recording(old(tmp_path / "r.bag", definition, bytes(size)))


def test_a_stream_info_holds_the_camera_of_version_1(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "realsense_msgs/msg/stream_info"
    store.register(known_types(kind, STREAM_INFO, store))
    types = store.types
    K = np.array([FX, 0, CX, 0, FY, CY, 0, 0, 1.0])
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](0, 0), "")
    region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    camera = types["sensor_msgs/msg/CameraInfo"](
        header, HEIGHT, WIDTH, "", np.zeros(5), K, np.eye(3).ravel(), np.zeros(12), 0, 0, region
    )
    turn = np.eye(3, dtype=np.float32).ravel()
    motion = types["realsense_msgs/msg/extrinsics"](turn, np.zeros(3, np.float32))
    place = types["realsense_msgs/msg/stream_extrinsics"](0, motion)
    data = bytes(store.serialize_ros1(types[kind]("DEPTH", 30, "mono16", camera, place), kind))
    recording = open_recording(old(tmp_path / "r.bag", STREAM_INFO, data))
    assert (recording.format, recording.camera.fx, recording.camera.cy) == ("realsense", FX, CY)
