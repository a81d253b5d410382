"""Recordings of analytic frames in every format, read back by the readers and by others' libraries."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from raising import raises
from read_pictures import read_picture
from written_frames import (
    BAGS,
    COLOR,
    DELAY_NS,
    DEPTH,
    FOLDERS,
    SCALE,
    SETTINGS,
    START_NS,
    STEP_NS,
    T_COLOR_DEPTH,
    color_rgb,
    digests,
    frame,
    pose,
    read,
    rig,
    write,
)

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.lab.simulate.writers import RecordedFrame, Rig, formats
from kinectbench.lab.simulate.writers.image_folders import seconds
from kinectbench.stages.ingest.readers import FORMATS, open_recording

READER = {
    "tum": "tum", "7scenes": "7scenes", "folder": "folder", "redwood": "folder",
    "bag": "rosbag1", "bag_compressed": "rosbag1",
    "ros2_sqlite": "rosbag2", "ros2_mcap": "rosbag2",
    "realsense": "realsense", "realsense_old": "realsense", "klg": "klg", "sens": "sens",
    "stray": "stray", "scanner_app": "scanner_app", "bop": "bop",
    "wildrgbd": "wildrgbd", "nerfstudio": "nerfstudio", "polycam": "polycam",
    "redwood_zip": "redwood_zip", "record3d": "record3d", "scannet": "scannet", "sun3d": "sun3d",
    "azure_kinect": "azure_kinect", "ycb": "ycb",
}  # fmt: skip
# Without stamps, or where they repeat, frames are counted.
NUMBERED = {
    "7scenes",
    "folder",
    "redwood",
    "redwood_zip",
    "bop",
    "scanner_app",
    "wildrgbd",
    "nerfstudio",
    "record3d",
    "scannet",
    "ycb",
}
# Their layout has no place for poses; nor for saying that colour is registered.
WITHOUT_POSES = {"realsense", "realsense_old", "klg", "redwood_zip", "azure_kinect"}
UNREGISTERED = {"7scenes"}
# It says where the colour camera is.
CALIBRATED = {"tum", "folder", "redwood", "ros2_sqlite", "ros2_mcap", "realsense", "realsense_old", "sens"}
CALIBRATED |= {"scannet", "azure_kinect", "ycb", *BAGS}
# Numbers are float32, or text with nine decimals.
POSE_TOLERANCE = {"sens": 2e-7, "tum": 3e-9, "stray": 3e-9}
# One camera takes both: colour of another is left out.
ONE_CAMERA = {"klg", "stray", "scanner_app", "bop", "wildrgbd", "nerfstudio", "polycam", "record3d"}
ONE_CAMERA |= {"sun3d"}
# Its library refuses stamps that go back.
IN_ORDER = {"azure_kinect"}


def test_every_format_that_is_read_has_a_writer() -> None:
    assert set(READER) == set(formats())
    assert set(READER.values()) == set(FORMATS)


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("registered", [True, False])
@pytest.mark.parametrize("name", formats())
def test_round_trip(tmp_path: Path, name: str, registered: bool, given: bool) -> None:
    if name == "stray" and not given:
        return  # its layout asks for a pose of every frame
    made = [frame(i, registered, given) for i in range(5)]
    recording = open_recording(write(tmp_path / "r", name, iter(made), registered), SETTINGS.get(name))
    assert recording.format == READER[name]
    assert asdict(recording.camera) == pytest.approx(asdict(DEPTH), rel=1e-12)
    assert recording.depth_scale == SCALE[name]
    has_color = registered or name not in ONE_CAMERA
    assert recording.color_registered == (name == "klg" or (registered and name not in UNREGISTERED))
    calibration = recording.color_calibration
    assert (calibration is not None) == (name in CALIBRATED and not recording.color_registered)
    if calibration is not None:
        assert calibration.camera == rig(registered).color
        np.testing.assert_allclose(calibration.T_color_depth, rig(registered).T_color_depth, atol=1e-7)
    if (name != "stray" or registered) and (name != "ycb" or given):  # without a video, or poses, it warns
        assert recording.warnings == ()
    stamps_ns = [formats()[name].stamp_as_read(i, f.stamp_ns) for i, f in enumerate(made)]
    found = read(recording)
    assert [f.stamp_ns for f in found] == stamps_ns
    for raw, one in zip(found, made, strict=True):
        np.testing.assert_array_equal(raw.depth, one.depth_native(SCALE[name]))
        assert (raw.depth > 0).mean() > 0.9
        # Neighbouring frames differ by 30 in blue, the channels by more.
        assert not has_color or np.abs(color_rgb(raw) - one.color_rgb).mean() < 3
    if not given or name in WITHOUT_POSES:
        assert recording.given_trajectory is None
        return
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.stamps_ns.tolist() == stamps_ns
    expected = np.stack([pose(i) for i in range(5)])
    tolerance = POSE_TOLERANCE.get(name, 1e-14)
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera, expected, rtol=0, atol=tolerance)


def test_stamps_as_read() -> None:
    stamp_ns = 1_400_000_000_123_456_789
    expected = dict.fromkeys(formats(), stamp_ns)
    expected |= dict.fromkeys(("tum", "klg", "sens", "stray", "polycam"), 1_400_000_000_123_456_000)
    expected |= {"7scenes": 3 * 10**9, "folder": 3 * 10**9, "redwood": 123_456_000}
    expected |= {"scannet": 3 * 10**9, "sun3d": 123_456_000, "azure_kinect": 1_400_000_000_123_000_000}
    expected |= {"redwood_zip": 123_456_000, "record3d": 1_400_000_000_123_456_768}
    expected |= {
        "bop": 3 * 10**9,
        "ycb": 9 * 10**9,
        "wildrgbd": 3 * 10**9,
        "nerfstudio": 3 * 10**9,
        "scanner_app": 1_400_000_000_123_456_768,
    }
    assert {name: one.stamp_as_read(3, stamp_ns) for name, one in formats().items()} == expected
    assert seconds(stamp_ns) == "1400000000.123456"
    assert [seconds(-1), seconds(-1_500_000)] == ["-0.000001", "-0.001500"]


@pytest.mark.parametrize("name", formats())
def test_depth_in_native_units(tmp_path: Path, name: str) -> None:
    # Rounded to the nearest unit; 14 m does not fit 16 bits at 5000 units per metre.
    depth_m = np.full((48, 64), 2.0, np.float32)
    depth_m[0, :5] = [1.23457, 14.0, 0.0, 65.6, 1.0004]
    stamps_ns = [START_NS + 1000 * i for i in range(3)]
    made = [RecordedFrame(stamp, depth_m, stamp, frame(0).color_rgb, np.eye(4)) for stamp in stamps_ns]
    found = read(open_recording(write(tmp_path / "r", name, made), SETTINGS.get(name)))
    tum, millimetres = [6173, 0, 0, 0, 5002, 10000], [1235, 14000, 0, 0, 1000, 2000]
    tenths = [12346, 0, 0, 0, 10004, 20000]
    wanted = {5000.0: tum, 1000.0: millimetres, 10_000.0: tenths}[SCALE[name]]
    assert found[0].depth[0, :6].tolist() == wanted


@pytest.mark.parametrize("name", formats())
def test_frames_without_a_pose_are_left_out_of_the_trajectory(tmp_path: Path, name: str) -> None:
    made = [frame(i, given=i not in (1, 4)) for i in range(5)]
    recording = open_recording(write(tmp_path / "r", name, made), SETTINGS.get(name))
    assert len(read(recording)) == (3 if name == "stray" else 5)
    if name in WITHOUT_POSES:
        return
    assert recording.given_trajectory is not None
    expected = [formats()[name].stamp_as_read(i, made[i].stamp_ns) for i in (0, 2, 3)]
    assert recording.given_trajectory.stamps_ns.tolist() == expected
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera[1], pose(2), rtol=0, atol=2e-7)


@pytest.mark.parametrize("name", formats())
def test_stamps_that_repeat_or_go_back(tmp_path: Path, name: str) -> None:
    stamps_ns = [START_NS + step * STEP_NS for step in (0, 2, 1, 2, 2)]
    made = [frame(i, stamp_ns=stamp_ns) for i, stamp_ns in enumerate(stamps_ns)]
    if name in IN_ORDER:
        with raises(RecordingError, "recording.malformed", match="cannot hold"):
            write(tmp_path / "r", name, made)
        return
    out = write(tmp_path / "r", name, made)
    # Readers that have stamps sort, and keep the first of equal ones; others count.
    expected = [made[i] for i in ((0, 1, 2, 3, 4) if name in NUMBERED else (0, 2, 1))]
    found = read(open_recording(out, SETTINGS.get(name)))
    assert len(found) == len(expected)
    for raw, one in zip(found, expected, strict=True):
        np.testing.assert_array_equal(raw.depth, one.depth_native(SCALE[name]))
        assert np.abs(color_rgb(raw) - one.color_rgb).mean() < 3
    if name in FOLDERS:  # nothing was overwritten
        digests = {hashlib.sha256(file.read_bytes()).digest() for file in out.rglob("*.png")}
        assert len(digests) == (10 if name == "7scenes" else 5)
        assert len(list(out.rglob("*.jpg"))) == (0 if name == "7scenes" else 5)


def test_tum_lists_are_in_the_order_of_the_frames_and_colour_has_its_own_stamps(tmp_path: Path) -> None:
    stamps_ns = [START_NS, START_NS + 2 * STEP_NS, START_NS + STEP_NS, START_NS]
    made = [frame(i, stamp_ns=stamp_ns) for i, stamp_ns in enumerate(stamps_ns)]
    out = write(tmp_path / "r", "tum", made)
    rows = {name: (out / f"{name}.txt").read_text().splitlines()[1:] for name in ("rgb", "depth")}
    assert rows["depth"] == [
        "1400000000.123456 depth/1400000000.123456.png",
        "1400000000.190122 depth/1400000000.190122.png",
        "1400000000.156789 depth/1400000000.156789.png",
        "1400000000.123456 depth/1400000000.123456_2.png",
    ]
    assert [row.split()[0] for row in rows["rgb"]] == [seconds(f.color_stamp_ns) for f in made]
    assert rows["rgb"][3] == "1400000000.130457 rgb/1400000000.130457_2.jpg"
    last = read_picture(out / "depth/1400000000.123456_2.png", cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(last, made[3].depth_native(5000))


@pytest.mark.parametrize(("name", "file"), [("tum", "camera.json"), ("folder", "camera_intrinsic.json")])
def test_json_says_where_an_unregistered_colour_camera_is(tmp_path: Path, name: str, file: str) -> None:
    out = write(tmp_path / "r", name, [frame(i, registered=False) for i in range(3)], registered=False)
    said = json.loads((out / file).read_text())
    assert said["color_registered"] is False
    assert Camera(**said["color_camera"]) == COLOR
    np.testing.assert_array_equal(said["T_color_depth"], T_COLOR_DEPTH)
    # Colour of the same size is not taken for registered either.
    same = Rig(DEPTH, DEPTH, False, T_COLOR_DEPTH)
    (tmp_path / "same").mkdir()
    formats()[name].write(tmp_path / "same", same, [frame(i) for i in range(3)])
    assert not open_recording(tmp_path / "same").color_registered


def test_open3d_reads_the_plain_folder_alike(tmp_path: Path) -> None:
    import open3d as o3d

    out = write(tmp_path / "r", "folder", [frame(i, registered=False) for i in range(3)], registered=False)
    intrinsic = o3d.io.read_pinhole_camera_intrinsic(out / "camera_intrinsic.json")
    assert (intrinsic.width, intrinsic.height) == (64, 48)
    np.testing.assert_array_equal(intrinsic.intrinsic_matrix, DEPTH.K)
    log = o3d.io.read_pinhole_camera_trajectory(out / "trajectory.log")
    for i, parameters in enumerate(log.parameters):
        # Open3D's extrinsic is world to camera.
        np.testing.assert_allclose(parameters.extrinsic @ pose(i), np.eye(4), atol=1e-12)
    assert len(log.parameters) == 3


def test_seven_scenes_marks_no_measurement_as_the_data_set_does(tmp_path: Path) -> None:
    out = write(tmp_path / "r", "7scenes", [frame(0)])
    depth = read_picture(out / "frame-000000.depth.png", cv2.IMREAD_UNCHANGED)
    assert (depth[:4, :6] == 65535).all()
    np.testing.assert_array_equal(np.loadtxt(out / "frame-000000.pose.txt"), pose(0))
    color = read_picture(out / "frame-000000.color.png")
    np.testing.assert_array_equal(color[..., ::-1], frame(0).color_rgb)


@pytest.mark.parametrize("delay_ns", [DELAY_NS, -DELAY_NS, 0])
@pytest.mark.parametrize("registered", [True, False])
@pytest.mark.parametrize("name", BAGS)
def test_the_messages_of_a_bag(tmp_path: Path, name: str, registered: bool, delay_ns: int) -> None:
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    made = [frame(i, registered, delay_ns=delay_ns) for i in range(3)]
    out = write(tmp_path / "r.bag", name, made, registered)
    store = get_typestore(Stores.ROS1_NOETIC)
    of_tf = get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    store.register(of_tf)
    messages: dict[str, list[tuple[int, Any]]] = {}
    with Reader(out) as bag:
        for connection, stamp_ns, data in bag.messages():
            message = store.deserialize_ros1(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append((stamp_ns, message))
    folder = "/camera/depth_registered" if registered else "/camera/depth"
    image = f"{folder}/image_raw" + ("/compressedDepth" if name == "bag_compressed" else "")
    color = "/camera/rgb/image_color/compressed"
    depth_topics = [f"{folder}/camera_info", image, "/camera/pose"]
    static = messages.pop("/tf_static", [])
    assert [(stamp_ns, len(message.transforms)) for stamp_ns, message in static] == (
        [] if registered else [(made[0].stamp_ns, 1)]
    )
    assert set(messages) == {*depth_topics, "/camera/rgb/camera_info", color}
    for topic, found in messages.items():
        own = [f.stamp_ns if topic in depth_topics else f.color_stamp_ns for f in made]
        assert [stamp_ns for stamp_ns, _ in found] == own
        assert [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in found] == own
    first = {topic: found[0][1] for topic, found in messages.items()}
    frame_ids = {first[topic].header.frame_id for topic in (f"{folder}/camera_info", image)}
    rgb = "camera_rgb_optical_frame"
    assert frame_ids == {rgb if registered else "camera_depth_optical_frame"}
    assert first[color].header.frame_id == first["/camera/rgb/camera_info"].header.frame_id == rgb
    info = first["/camera/rgb/camera_info"]
    expected = DEPTH if registered else COLOR
    assert (info.width, info.height, *info.K[[0, 4, 2, 5]], *info.P[[0, 5, 2, 6]], *info.D) == (
        *(expected.width, expected.height),
        *[expected.fx, expected.fy, expected.cx, expected.cy] * 2,
        *[0.0] * 5,
    )
    if name == "bag_compressed":
        assert first[image].format == "16UC1; compressedDepth png"
        assert bytes(first[image].data[:20]) == bytes(12) + b"\x89PNG\r\n\x1a\n"
    else:
        assert (first[image].encoding, first[image].step, first[image].is_bigendian) == ("16UC1", 128, 0)
        assert len(first[image].data) == 128 * 48


@pytest.mark.parametrize("name", formats())
def test_the_same_frames_give_the_same_bytes(tmp_path: Path, name: str) -> None:
    first = digests(write(tmp_path / "a", name, [frame(i) for i in range(4)]))
    assert digests(write(tmp_path / "b", name, [frame(i) for i in range(4)])) == first
    other = digests(write(tmp_path / "c", name, [frame(i + 1) for i in range(4)]))
    assert other != first
