"""ROS 1 bags: whole, cut off, without an index, and with every kind of image."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import (
    CAMERA,
    HEIGHT,
    START_NS,
    STEP_NS,
    WIDTH,
    BagWriter,
    color_image,
    depth_image,
    every_frame,
    jpeg,
    png,
    quaternion,
    translation,
    write_bag,
    write_tum,
)
from raising import raises
from read_pictures import decoded_picture

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import format_of, open_recording
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

NATIVE = CameraSettings(depth_scale=5000.0)
DEPTH, INFO, COLOR = "/camera/depth/image_raw", "/camera/depth/camera_info", "/camera/rgb/image_color"


def raw_frames(recording: Recording) -> list[RawFrame]:
    frames = list(every_frame(recording))
    assert not [frame for frame in frames if isinstance(frame, DamagedImageError)]
    return [frame for frame in frames if isinstance(frame, RawFrame)]


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_a_bag_and_a_folder_of_the_same_frames_are_the_same_sequence(
    tmp_path: Path, compression: str | None
) -> None:
    # The suffix is not what tells a bag.
    bag = write_bag(tmp_path / "recording.bag.active", compression=compression)
    recording = open_recording(bag, NATIVE)
    assert (recording.format, recording.warnings, len(recording)) == ("rosbag1", (), 5)
    write_sequence(recording, tmp_path / "a")
    write_sequence(open_recording(write_tum(tmp_path / "folder")), tmp_path / "b")
    a, b = read_sequence(tmp_path / "a"), read_sequence(tmp_path / "b")
    assert (a.camera, a.depth_scale, a.color_registered) == (b.camera, b.depth_scale, b.color_registered)
    np.testing.assert_array_equal(a.stamps_ns, b.stamps_ns)
    for i in range(5):
        np.testing.assert_array_equal(a.frames.depth_native(i), b.frames.depth_native(i))
        assert a.frames.color_encoded(i) == b.frames.color_encoded(i)
    for name in ("frames.json", "given_trajectory.txt"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_cut_in_half(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "r.bag", frames=40)
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    recording = open_recording(bag, NATIVE)
    assert 15 <= len(recording) <= 20
    assert "is cut off or has no index" in recording.warnings[0]
    assert "messages of " in recording.warnings[0]
    for i, frame in enumerate(raw_frames(recording)):
        np.testing.assert_array_equal(frame.depth, depth_image(i))


def test_without_an_index(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "r.bag")
    data = bytearray(bag.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    (index_at,) = struct.unpack_from("<Q", data, at)
    data[at : at + 8] = bytes(8)
    bag.write_bytes(data[:index_at])
    recording = open_recording(bag, NATIVE)
    assert len(raw_frames(recording)) == 5
    assert "is cut off or has no index" in recording.warnings[0]


@pytest.mark.parametrize("size", [13, 40, 4200])
def test_nothing_left_to_save(tmp_path: Path, size: int) -> None:
    bag = write_bag(tmp_path / "r.bag")
    bag.write_bytes(bag.read_bytes()[:size])
    with raises(RecordingError, "recording.malformed", match=r"r\.bag"):
        open_recording(bag)


def test_a_chunk_with_flipped_bits(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "r.bag", frames=40, compression="BZ2")
    data = bytearray(bag.read_bytes())
    middle = data.index(b"compression=bz2", len(data) // 2) + 2000
    data[middle] ^= 0x55
    bag.write_bytes(data)
    recording = open_recording(bag, NATIVE)
    assert len(recording) < 40
    assert "(1 chunks are damaged)" in recording.warnings[0]


def one_topic(path: Path, *, encoding: str, padding: int = 0, big_endian: bool = False) -> Path:
    """Three raw depth images with padded rows, and one raw colour image each."""
    with BagWriter(path) as bag:
        bag.info(INFO, START_NS, CAMERA)
        for i in range(3):
            depth = depth_image(i, 1000.0)
            pixels = depth if encoding != "32FC1" else (depth / np.float32(1000)).astype(np.float32)
            stamp_ns = START_NS + i * STEP_NS
            bag.image(DEPTH, stamp_ns, pixels, encoding, padding=padding, big_endian=big_endian)
            bag.image(COLOR, stamp_ns, color_image(i), "bgr8", padding=padding)
    return path


@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("big_endian", [False, True])
def test_raw_integer_depth(tmp_path: Path, encoding: str, padding: int, big_endian: bool) -> None:
    bag = one_topic(tmp_path / "r.bag", encoding=encoding, padding=padding, big_endian=big_endian)
    recording = open_recording(bag)
    assert recording.depth_scale == 1000.0
    for i, frame in enumerate(raw_frames(recording)):
        np.testing.assert_array_equal(frame.depth, depth_image(i, 1000.0))
        assert frame.color is not None
        decoded = decoded_picture(frame.color[1])
        np.testing.assert_array_equal(decoded, color_image(i))


@pytest.mark.parametrize("big_endian", [False, True])
def test_float_depth_in_metres(tmp_path: Path, big_endian: bool) -> None:
    bag = one_topic(tmp_path / "r.bag", encoding="32FC1", padding=4, big_endian=big_endian)
    recording = open_recording(bag)
    assert recording.depth_scale == 5000.0
    np.testing.assert_array_equal(raw_frames(recording)[1].depth, depth_image(1, 1000.0) * 5)


def test_float_depth_that_is_no_depth_and_other_units(tmp_path: Path) -> None:
    depth = np.full((HEIGHT, WIDTH), 1500.0, np.float32)
    depth[0, :5] = [np.nan, np.inf, -np.inf, -1.0, 20_000.0]
    with BagWriter(tmp_path / "r.bag") as bag:
        bag.info(INFO, START_NS, CAMERA)
        for i in range(3):
            bag.image(DEPTH, START_NS + i, depth, "32FC1")
    recording = open_recording(tmp_path / "r.bag", CameraSettings(depth_scale=1000.0))
    frame = raw_frames(recording)[0]
    assert recording.depth_scale == 5000.0
    assert frame.depth[0, :6].tolist() == [0, 0, 0, 0, 0, 7500]


@pytest.mark.parametrize(
    ("encoding", "order"), [("rgb8", [2, 1, 0]), ("rgba8", [2, 1, 0, 0]), ("mono8", [1])]
)
def test_raw_colour(tmp_path: Path, encoding: str, order: list[int]) -> None:
    with BagWriter(tmp_path / "r.bag") as bag:
        bag.info(INFO, START_NS, CAMERA)
        bag.image(DEPTH, START_NS, depth_image(0), "16UC1")
        bag.image(COLOR, START_NS, np.ascontiguousarray(color_image(0)[..., order]), encoding, padding=3)
    frame = raw_frames(open_recording(tmp_path / "r.bag"))[0]
    assert frame.color is not None
    assert frame.color[0] == ".png"
    decoded = decoded_picture(frame.color[1])
    expected = color_image(0) if encoding != "mono8" else np.repeat(color_image(0)[..., 1:2], 3, axis=2)
    np.testing.assert_array_equal(decoded, expected)


def compressed_bag(path: Path, topic: str, text: str, data: bytes) -> Path:
    with BagWriter(path) as bag:
        bag.info(INFO, START_NS, CAMERA)
        for i in range(3):
            bag.compressed(topic, START_NS + i, data, text)
    return path


def test_compressed_depth(tmp_path: Path) -> None:
    encoded = png(depth_image(0))
    plain = compressed_bag(tmp_path / "a.bag", DEPTH + "/compressed", "16UC1; png compressed ", encoded)
    frame = raw_frames(open_recording(plain))[0]
    np.testing.assert_array_equal(frame.depth, depth_image(0))
    text = "16UC1; compressedDepth png"
    wrapped = compressed_bag(tmp_path / "b.bag", DEPTH + "/compressedDepth", text, bytes(12) + encoded)
    np.testing.assert_array_equal(raw_frames(open_recording(wrapped))[0].depth, depth_image(0))


def test_compressed_float_depth(tmp_path: Path) -> None:
    a, b = 2000.0, -0.5
    inverse = np.rint(a / (depth_image(0, 1000.0) / 1000 + 1e-12) + b)
    native = np.where(depth_image(0) > 0, inverse, 0).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + png(native)
    bag = compressed_bag(tmp_path / "r.bag", DEPTH + "/compressedDepth", "32FC1; compressedDepth", data)
    frame = raw_frames(open_recording(bag))[0]
    np.testing.assert_array_equal(frame.depth == 0, depth_image(0) == 0)
    # One step of inverse depth is d^2 / A = 1 mm at 1.4 m.
    np.testing.assert_allclose(frame.depth / 5000, depth_image(0, 1000.0) / 1000, atol=0.0015)


def test_the_topics_that_are_chosen(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "r.bag") as bag:
        bag.info("/camera/depth_registered/camera_info", START_NS, CAMERA)
        bag.info("/camera/ir/camera_info", START_NS, {**CAMERA, "fx": 1.0}, frame_id="ir")
        for i in range(3):
            stamp_ns = START_NS + i
            bag.image("/camera/ir/image_raw", stamp_ns, depth_image(9), "mono16", "ir")
            bag.image("/camera/depth/image_raw", stamp_ns, depth_image(8), "16UC1", "depth")
            bag.image("/camera/depth_registered/image_raw", stamp_ns, depth_image(i), "16UC1", "rgb")
            bag.image("/camera/ir/picture", stamp_ns, color_image(9)[..., 0], "mono8", "ir")
            bag.image("/camera/rgb/image_color", stamp_ns, color_image(i), "bgr8", "rgb")
    recording = open_recording(tmp_path / "r.bag")
    frame = raw_frames(recording)[1]
    assert recording.camera.fx == CAMERA["fx"]
    assert recording.color_registered
    np.testing.assert_array_equal(frame.depth, depth_image(1))
    assert frame.color == (".png", png_of_level(color_image(1)))
    assert "not from /camera/depth/image_raw" in recording.warnings[0]


def png_of_level(image: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1])


def test_no_depth_and_no_intrinsics(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image("/camera/depth/image", START_NS, color_image(0)[..., 0], "mono8")
    with raises(RecordingError, "recording.no-depth", match=r"depth.*/camera/depth/image \(mono8\)"):
        open_recording(tmp_path / "a.bag")
    with BagWriter(tmp_path / "b.bag") as bag:
        bag.info("/camera/rgb/camera_info", START_NS, CAMERA, frame_id="rgb")
        bag.image(DEPTH, START_NS, depth_image(0), "16UC1", "depth")
    with raises(RecordingError, "recording.no-intrinsics"):
        open_recording(tmp_path / "b.bag")
    with BagWriter(tmp_path / "c.bag") as bag:
        bag.info(INFO, START_NS, {**CAMERA, "width": 640})
        bag.image(DEPTH, START_NS, depth_image(0), "16UC1")
    with raises(RecordingError, "recording.bad-intrinsics", match=r"640x48.*64x48"):
        open_recording(tmp_path / "c.bag")


def test_several_topics_of_poses_and_bad_poses(tmp_path: Path) -> None:
    for name, turn in (("a", [0.0, 0, 0, 1]), ("b", [0.0, 0, 0, 0]), ("c", [0.0, 0, np.nan, 1])):
        with BagWriter(tmp_path / f"{name}.bag") as bag:
            bag.info(INFO, START_NS, CAMERA)
            bag.image(DEPTH, START_NS, depth_image(0), "16UC1")
            bag.pose("/p", START_NS, translation(0), quaternion(0))
            bag.pose("/q" if name == "a" else "/p", START_NS + 1, translation(0), turn)
    recording = open_recording(tmp_path / "a.bag")
    assert recording.given_trajectory is None
    assert "/p, /q all hold poses; none of them is used" in recording.warnings[-1]
    for name, said in (("b", "the quaternion has length zero"), ("c", "the pose holds NaN")):
        broken = open_recording(tmp_path / f"{name}.bag")
        assert broken.given_trajectory is None
        assert f"/p, message 1: {said}" in broken.trajectory_error


def test_damaged_messages_become_damaged_frames(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "r.bag") as bag:
        bag.info(INFO, START_NS, CAMERA)
        for i in range(3):
            bag.image(DEPTH, START_NS + i, depth_image(0), "16UC1")
        header = struct.pack("<III", 0, START_NS // 10**9, START_NS % 10**9 + 7)
        bag.raw(DEPTH, "sensor_msgs/msg/Image", START_NS + 7, header + bytes(7))
        short = (HEIGHT, WIDTH, "16UC1", 0, WIDTH * 2, np.zeros(WIDTH * 2 * HEIGHT - 1, np.uint8))
        bag.write(DEPTH, "sensor_msgs/msg/Image", START_NS + 9, "camera", short)
    frames = list(every_frame(open_recording(tmp_path / "r.bag")))
    assert [isinstance(frame, DamagedImageError) for frame in frames] == [False] * 3 + [True] * 2
    assert isinstance(frames[3], DamagedImageError)
    assert f"{DEPTH}, message 3: cannot be decoded" in str(frames[3])
    assert isinstance(frames[4], DamagedImageError)
    assert "6143 bytes are too few for 64x48 pixels" in str(frames[4])


def distorted_bag(path: Path, topic: str, model: str = "plumb_bob") -> Path:
    """A wall whose depth is 1000 + u of the *pinhole* pixel, seen through a lens."""
    K = np.array([[CAMERA["fx"], 0, CAMERA["cx"]], [0, CAMERA["fy"], CAMERA["cy"]], [0, 0, 1]])
    D = np.array([-0.25, 0.05, 0.001, -0.001, 0.0])
    u, v = np.meshgrid(np.arange(float(WIDTH)), np.arange(float(HEIGHT)))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    straight = cv2.undistortPoints(pixels, K, D, P=K).reshape(HEIGHT, WIDTH, 2)
    depth = np.rint(1000 + 10 * straight[..., 0]).astype(np.uint16)
    with BagWriter(path) as bag:
        bag.info(topic.rsplit("/", 1)[0] + "/camera_info", START_NS, CAMERA, D.tolist(), model=model)
        for i in range(3):
            bag.image(topic, START_NS + i, depth, "16UC1")
            bag.compressed(COLOR, START_NS + i, jpeg(np.dstack([depth // 8] * 3).astype(np.uint8)), "jpeg")
    return path


def test_distortion_is_removed(tmp_path: Path) -> None:
    recording = open_recording(distorted_bag(tmp_path / "r.bag", DEPTH))
    frame = raw_frames(recording)[0]
    expected = np.broadcast_to(1000 + 10 * np.arange(WIDTH), (HEIGHT, WIDTH))
    inside = frame.depth > 0
    assert inside.mean() > 0.95
    # The nearest pixel is at most half a pixel off in each direction.
    assert np.abs(frame.depth.astype(int) - expected)[inside].max() <= 10
    assert frame.color is not None
    assert frame.color[0] == ".png"
    color = decoded_picture(frame.color[1], cv2.IMREAD_GRAYSCALE).astype(int)
    assert np.abs(color - (expected // 8).astype(np.uint8))[8:-8, 8:-8].max() <= 6


def test_rectified_images_are_left_alone_and_other_lenses_refused(tmp_path: Path) -> None:
    recording = open_recording(distorted_bag(tmp_path / "a.bag", "/camera/depth/image_rect_raw"))
    assert raw_frames(recording)[0].color == raw_frames(recording)[2].color
    assert raw_frames(recording)[0].depth.min() > 0
    with raises(RecordingError, "recording.lens"):
        open_recording(distorted_bag(tmp_path / "b.bag", DEPTH, "equidistant"))


def test_what_only_looks_like_a_bag(tmp_path: Path) -> None:
    (tmp_path / "r.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    assert format_of(tmp_path / "r.bag") is None
