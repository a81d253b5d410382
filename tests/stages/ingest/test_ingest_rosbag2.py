"""ROS 2 bags by rosbags and by mcap's own writer: every storage, compression and way to cut them."""

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ingest_writers import (
    CAMERA,
    FX,
    HEIGHT,
    START_NS,
    STEP_NS,
    WIDTH,
    color_image,
    depth_image,
    every_frame,
    jpeg,
)
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from raising import raises
from read_pictures import decoded_picture
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera, rigid, rotation_from_quaternion_xyzw
from kinectbench.lab.simulate.writers.bags import MessageMaker
from kinectbench.lab.simulate.writers.frame import RecordedFrame, Rig
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import format_of, open_recording
from kinectbench.stages.ingest.recording import RawFrame

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
RIG = Rig(Camera(**CAMERA), Camera(**CAMERA), True, np.eye(4))
DELAY_NS = 4_000_000
PLUGINS = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]


class JpegFrame(RecordedFrame):
    """A frame whose colour is the test images' JPEG."""

    def color_jpeg(self) -> bytes:
        return jpeg(self.color_rgb[..., ::-1])


def frames(count: int) -> Iterator[JpegFrame]:
    for i in range(count):
        stamp_ns = START_NS + i * STEP_NS
        depth_m = (depth_image(i, 1000.0) / np.float32(1000)).astype(np.float32)
        bgr = color_image(i)
        yield JpegFrame(stamp_ns, depth_m, stamp_ns + DELAY_NS, np.ascontiguousarray(bgr[..., ::-1]), pose(i))


def pose(index: int) -> NDArray[np.float64]:
    return rigid(rotation_from_quaternion_xyzw([0.1, 0.02 * index, -0.3, 0.9]), [0.1 * index, 1.25, -0.3])


def messages(count: int = 5, code: Any = "raw") -> list[tuple[str, str, int, bytes]]:
    """Topic, type, stamp and data of every message."""
    maker = MessageMaker(TYPES, RIG, code, ros2=True)
    found = []
    for index, frame in enumerate(frames(count)):
        for topic, kind, message in maker.messages(frame, index):
            found.append((topic, kind, frame.stamp_ns, bytes(STORE.serialize_cdr(message, kind))))
    return found


def write_bag(
    folder: Path,
    found: Sequence[tuple[str, str, int, bytes]],
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    writer = Writer(folder, version=8, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    with writer:
        for topic, kind, stamp_ns, data in found:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], stamp_ns, data)
    return folder


def write_mcap(
    path: Path,
    found: Sequence[tuple[str, str, int, bytes]],
    compression: CompressionType = CompressionType.NONE,
    encoding: str = "cdr",
    **options: Any,
) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression, **options)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for topic, kind, stamp_ns, data in found:
            if topic not in channels:
                schema = writer.register_schema(name=kind, encoding="ros2msg", data=b"")
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], stamp_ns, data, stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap says no types
    return path


def check(path: Path, count: int = 5) -> None:
    """It holds just the frames that were written."""
    recording = open_recording(path)
    assert (recording.format, recording.warnings, len(recording)) == ("rosbag2", (), count)
    assert (recording.camera, recording.depth_scale) == (RIG.depth, 1000.0)
    assert recording.color_registered
    for i in (count - 1, 0, 2):  # at random
        frame = recording.frame(i)
        assert frame.stamp_ns == START_NS + i * STEP_NS
        np.testing.assert_array_equal(frame.depth, depth_image(i, 1000.0))
        assert frame.color == (".jpg", jpeg(color_image(i)))
    assert recording.given_trajectory is not None
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera[3], pose(3), atol=1e-12)


def test_a_folder_of_a_bag_with_its_ending_in_capitals(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    write_mcap(tmp_path / "bag" / "RUN_0.MCAP", messages())
    check(tmp_path / "bag")


@pytest.mark.parametrize(("said", "scale"), [("0.000100", 10_000.0), ("0.001000", 1000.0), ("none", 1000.0)])
def test_depth_units_of_librealsense_are_the_scale(tmp_path: Path, said: str, scale: float) -> None:
    """Since 2.58 it writes ROS 2 bags, its options as texts; a text of any other bag says nothing."""
    text = bytes(STORE.serialize_cdr(TYPES["std_msgs/msg/String"](data=said), "std_msgs/msg/String"))
    option = ("/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/String", START_NS, text)
    assert open_recording(write_bag(tmp_path / "other", [option, *messages()])).depth_scale == 1000
    depth = next(topic for topic, kind, *_ in messages() if "depth" in topic and kind.endswith("/Image"))
    of_librealsense = {depth: "/device_0/sensor_0/Depth_0/image/data"}
    found = [(of_librealsense.get(topic, topic), kind, at, data) for topic, kind, at, data in messages()]
    bag = write_bag(tmp_path / "bag", [option, *found])
    assert open_recording(bag, CameraSettings(**CAMERA)).depth_scale == scale


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize("plugin", PLUGINS)
def test_every_storage_as_folder_and_as_bare_file(
    tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode
) -> None:
    folder = write_bag(tmp_path / "bag", messages(), plugin, mode)
    check(folder)
    (file,) = (f for f in folder.iterdir() if f.name != "metadata.yaml")
    check(Path(shutil.copy(file, tmp_path / file.name)))


def test_mcap_with_compressed_chunks_by_rosbags(tmp_path: Path) -> None:
    check(write_bag(tmp_path / "bag", messages(), StoragePlugin.MCAP, CompressionMode.STORAGE))


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_mcap_by_its_own_writer(tmp_path: Path, compression: CompressionType, chunked: bool) -> None:
    check(write_mcap(tmp_path / "r.any", messages(), compression, use_chunking=chunked, chunk_size=20_000))


@pytest.mark.parametrize("code", ["png", "rvl"])
def test_compressed_depth(tmp_path: Path, code: str) -> None:
    check(write_mcap(tmp_path / "r.mcap", messages(5, code)))


@pytest.mark.parametrize("plugin", PLUGINS)
def test_a_bag_that_was_split_is_one(tmp_path: Path, plugin: StoragePlugin) -> None:
    found, suffix = messages(12), {StoragePlugin.SQLITE3: ".db3", StoragePlugin.MCAP: ".mcap"}[plugin]
    (tmp_path / "all").mkdir()
    for number in range(12):  # _2 comes before _10
        part = write_bag(tmp_path / f"part{number}", found[5 * number : 5 * number + 5], plugin)
        shutil.move(part / f"part{number}{suffix}", tmp_path / "all" / f"bag_{number}{suffix}")
    check(tmp_path / "all", 12)


def test_other_encodings_and_files_are_refused(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / "r.mcap", messages(), encoding="protobuf")
    with raises(RecordingError, "recording.unsupported"):
        open_recording(bag)
    (tmp_path / "r.db3").write_bytes(b"SQLite format 3\0" + bytes(2000))
    with raises(RecordingError, "recording.malformed", match="ROS 2 bag"):
        open_recording(tmp_path / "r.db3")
    (tmp_path / "n.db3").write_bytes(b"no bag")
    assert format_of(tmp_path / "n.db3") is None


@pytest.mark.parametrize("storage", ["mcap", "mcap.zstd", "mcap lz4", "db3", "db3.zstd"])
@pytest.mark.parametrize("tenth", range(1, 10))
def test_cut_off_at_every_tenth(tmp_path: Path, storage: str, tenth: int) -> None:
    found = messages(40)
    if storage == "mcap lz4":
        file = write_mcap(tmp_path / "r.mcap", found, CompressionType.LZ4, chunk_size=20_000)
    else:
        mode = CompressionMode.FILE if storage.endswith("zstd") else CompressionMode.NONE
        plugin = StoragePlugin.MCAP if storage.startswith("mcap") else StoragePlugin.SQLITE3
        file = write_bag(tmp_path / "bag", found, plugin, mode) / f"bag.{storage}"
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * tenth // 10])
    try:
        recording = open_recording(file)
        usable = [frame for frame in every_frame(recording) if isinstance(frame, RawFrame)]
    except RecordingError as error:
        assert "\n" not in str(error)
        assert "cut off" in str(error) or "copy it again" in str(error) or "no topic" in str(error)
        return
    assert "cut off" in recording.warnings[0]
    assert 0 < len(usable) < 40
    for frame in usable:
        i = (frame.stamp_ns - START_NS) // STEP_NS
        np.testing.assert_array_equal(frame.depth, depth_image(i, 1000.0))
    if storage == "db3":
        assert len(usable) == len(recording)  # no frame is half of one
    if storage in ("mcap", "mcap lz4", "db3") and tenth > 1:
        assert len(usable) >= 4 * tenth - 6


@pytest.mark.parametrize("torn_bytes", [1, 700, 2048, 4095])
def test_a_torn_page_of_a_cut_off_database_gives_no_half_frame(tmp_path: Path, torn_bytes: int) -> None:
    """Whichever page is the last: frames that are read are equal to the bit, and few are lost."""
    file = write_bag(tmp_path / "bag", messages(20)) / "bag.db3"
    data = file.read_bytes()
    for page in range(30, 44):
        file.write_bytes(data[: page * 4096 + torn_bytes])
        frames = list(every_frame(open_recording(file)))
        assert len(frames) >= page / (len(data) / 4096) * 20 - 3
        for i, frame in enumerate(frames):
            assert isinstance(frame, RawFrame)
            np.testing.assert_array_equal(frame.depth, depth_image(i, 1000.0))
            assert frame.color is None or frame.color == (".jpg", jpeg(color_image(i)))


def test_named_topics(tmp_path: Path) -> None:
    found = messages()
    other = [(t.replace("/camera", "/other"), k, s, d) for t, k, s, d in messages(3)]
    bag = write_mcap(tmp_path / "r.mcap", [*found, *other])
    first = open_recording(bag)
    assert any("not from /other" in warning for warning in first.warnings)
    assert any("/camera/pose, /other/pose all hold poses" in warning for warning in first.warnings)
    named = CameraSettings(
        depth_topic="/other/depth_registered/image_raw",
        color_topic="/other/rgb/image_color/compressed",
        pose_topic="/other/pose",
    )
    recording = open_recording(bag, named)
    assert (len(recording), recording.warnings) == (3, ())
    assert recording.given_trajectory is not None
    for key in ("depth_topic", "color_topic", "pose_topic"):
        with pytest.raises(RecordingError, match=f"`{key}: /no`"):
            open_recording(bag, CameraSettings.model_validate({key: "/no"}))
    with raises(RecordingError, "recording.bad-topic"):
        open_recording(bag, CameraSettings(pose_topic="tf"))


def stamped(stamp_ns: int, parent: str, child: str, T: NDArray[np.float64]) -> Any:
    maker = MessageMaker(TYPES, RIG, "raw", ros2=True)
    header = maker.header(0, stamp_ns, parent)
    return TYPES["geometry_msgs/msg/TransformStamped"](header, child, maker.transform(T))


def tf(stamp_ns: int, *transforms: Any, static: bool = False) -> tuple[str, str, int, bytes]:
    kind = "tf2_msgs/msg/TFMessage"
    data = bytes(STORE.serialize_cdr(TYPES[kind](list(transforms)), kind))
    return ("/tf_static" if static else "/tf"), kind, stamp_ns, data


T_BASE_CAMERA = rigid(rotation_from_quaternion_xyzw([-0.5, 0.5, -0.5, 0.5]), [0.1, 0.0, 1.2])
RGB = "camera_rgb_optical_frame"


def test_a_trajectory_from_tf(tmp_path: Path) -> None:
    found = [m for m in messages() if m[1] != "geometry_msgs/msg/PoseStamped"]
    found.append(tf(START_NS, stamped(START_NS, "base", RGB, T_BASE_CAMERA), static=True))
    T_map_odom = [rigid(np.eye(3), [0.0, 2.0 * k, 0.0]) for k in range(2)]
    for k in range(2):  # slower than odometry, so it is interpolated
        stamp_ns = START_NS + k * 4 * STEP_NS
        found.append(tf(stamp_ns, stamped(stamp_ns, "map", "odom", T_map_odom[k])))
    for i in range(5):
        stamp_ns = START_NS + i * STEP_NS
        found.append(tf(stamp_ns, stamped(stamp_ns, "/odom", "base", pose(i))))
    recording = open_recording(write_mcap(tmp_path / "r.mcap", found))
    given = recording.given_trajectory
    assert given is not None
    assert given.stamps_ns.tolist() == [START_NS + i * STEP_NS for i in range(5)]
    for i in range(5):
        expected = rigid(np.eye(3), [0.0, 0.5 * i, 0.0]) @ pose(i) @ T_BASE_CAMERA
        np.testing.assert_allclose(given.T_world_camera[i], expected, atol=1e-9)


@pytest.mark.parametrize("known", [True, False])
def test_odometry_of_another_frame_is_moved_to_the_camera(tmp_path: Path, known: bool) -> None:
    found = [m for m in messages() if m[1] != "geometry_msgs/msg/PoseStamped"]
    maker, kind = MessageMaker(TYPES, RIG, "raw", ros2=True), "nav_msgs/msg/Odometry"
    zero = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = TYPES["geometry_msgs/msg/TwistWithCovariance"](
        TYPES["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)
    )
    for i in range(5):
        stamp_ns = START_NS + i * STEP_NS
        stamped_pose = maker._pose(maker.header(0, stamp_ns, "odom"), pose(i))
        with_covariance = TYPES["geometry_msgs/msg/PoseWithCovariance"](stamped_pose.pose, np.zeros(36))
        message = TYPES[kind](stamped_pose.header, "base", with_covariance, twist)
        found.append(("/odom", kind, stamp_ns, bytes(STORE.serialize_cdr(message, kind))))
    if known:
        found.append(tf(START_NS, stamped(START_NS, "base", RGB, T_BASE_CAMERA), static=True))
    recording = open_recording(write_mcap(tmp_path / "r.mcap", found))
    assert recording.given_trajectory is not None
    expected = pose(3) @ (T_BASE_CAMERA if known else np.eye(4))
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera[3], expected, atol=1e-9)
    assert ("does not say how the camera" in " ".join(recording.warnings)) == (not known)


def test_stamps_in_the_order_of_recording(tmp_path: Path) -> None:
    found = messages(4)
    swapped = found[:5] + found[10:15] + found[5:10] + found[15:]
    recording = open_recording(write_mcap(tmp_path / "r.mcap", swapped))
    depth_ns, color_ns = recording.recorded_stamps_ns
    assert ((depth_ns - START_NS) // STEP_NS).tolist() == [0, 2, 1, 3]
    assert ((color_ns - START_NS) // STEP_NS).tolist() == [0, 2, 1, 3]
    assert ((recording.stamps_ns - START_NS) // STEP_NS).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_colour(tmp_path: Path, pattern: str) -> None:
    levels = {"r": 200, "g": 100, "b": 30}
    mosaic = np.array([levels[c] for c in pattern], np.uint8).reshape(2, 2)
    pixels = np.tile(mosaic, (HEIGHT // 2, WIDTH // 2))
    maker = MessageMaker(TYPES, RIG, "raw", ros2=True)
    found = [m for m in messages(3) if "/rgb/" not in m[0]]
    kind = "sensor_msgs/msg/Image"
    for i in range(3):
        stamp_ns = START_NS + i * STEP_NS
        message = maker.image(maker.header(0, stamp_ns, RGB), pixels, f"bayer_{pattern}8")
        found.append(("/camera/rgb/image_raw", kind, stamp_ns, bytes(STORE.serialize_cdr(message, kind))))
    frame = open_recording(write_mcap(tmp_path / "r.mcap", found)).frame(0)
    assert frame.color is not None
    bgr = decoded_picture(frame.color[1])
    assert (bgr[4:-4, 4:-4] == [30, 100, 200]).all()
    assert FX > 0
