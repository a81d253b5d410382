"""Bags cut at every tenth: what is whole is read. Fuzzed bags: one line, and no memory is asked for."""

import shutil
import sqlite3
import tracemalloc
from contextlib import closing
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ingest_writers import CAMERA, START_NS, STEP_NS, BagWriter, depth_image, every_frame, write_bag
from mcap.writer import CompressionType
from test_ingest_realsense import property_of_version_2, units
from test_ingest_realsense import write as write_realsense
from test_ingest_rosbag2 import RIG, STORE, TYPES, messages, write_mcap
from test_ingest_rosbag2 import write_bag as write_bag2

from kinectbench.core.errors import RecordingError
from kinectbench.lab.simulate.writers.bags import MessageMaker
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.bags.message_decoding import ZSTD_MAGIC, Encoding, header_stamp_ns
from kinectbench.stages.ingest.readers import format_of, open_recording
from kinectbench.stages.ingest.recording import RawFrame

NATIVE = CameraSettings(depth_scale=5000.0)


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
@pytest.mark.parametrize("tenth", range(1, 10))
def test_a_bag_cut_off_at_every_tenth(tmp_path: Path, compression: str | None, tenth: int) -> None:
    bag = write_bag(tmp_path / "r.bag", 40, compression=compression)
    data = bag.read_bytes()
    bag.write_bytes(data[: len(data) * tenth // 10])
    try:
        recording = open_recording(bag, NATIVE)
    except RecordingError as error:
        # Nothing but the first chunk is lost.
        assert tenth == 1
        assert "nothing in it can be saved" in str(error)
        return
    frames = list(every_frame(recording))
    assert all(isinstance(frame, RawFrame) for frame in frames)
    assert "is cut off or has no index" in recording.warnings[0]
    # The index takes some of the file, and a compressed chunk of 32 KB holds a few frames.
    assert 4 * tenth - 7 <= len(frames) <= 40
    for frame in frames:
        assert isinstance(frame, RawFrame)
        np.testing.assert_array_equal(frame.depth, depth_image((frame.stamp_ns - START_NS) // STEP_NS))


def test_a_damaged_record_ends_only_its_own_chunk(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "r.bag", 40)
    data = bytearray(bag.read_bytes())
    at = data.index(b"op=\x02", data.index(b"compression=none", len(data) // 4))
    data[at - 4 : at] = b"\xff" * 4
    bag.write_bytes(data)
    recording = open_recording(bag, NATIVE)
    assert len(recording) >= 34 and "(1 chunks are damaged)" in recording.warnings[0]
    last = list(every_frame(recording))[-1]
    assert isinstance(last, RawFrame) and last.stamp_ns == START_NS + 39 * STEP_NS


def test_channels_of_a_damaged_chunk_are_those_of_the_summary(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "r.mcap", messages(40), CompressionType.ZSTD, chunk_size=20_000)
    data = bytearray(file.read_bytes())
    at = data.index(ZSTD_MAGIC) + 30
    data[at : at + 100] = b"\xff" * 100
    file.write_bytes(data)
    recording = open_recording(file)
    assert len(recording) >= 30 and "(1 chunks are damaged)" in recording.warnings[0]
    frame = recording.frame(len(recording) - 1)
    np.testing.assert_array_equal(frame.depth, depth_image(39, 1000.0))
    assert frame.stamp_ns == START_NS + 39 * STEP_NS


def test_a_damaged_pose_leaves_the_others(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "r.bag") as bag:
        bag.info("/camera/depth/camera_info", START_NS, CAMERA)
        for i in range(5):
            bag.image("/camera/depth/image_raw", START_NS + i * STEP_NS, depth_image(i), "16UC1")
            bag.pose("/pose", START_NS + i * STEP_NS, (0.1 * i, 0, 0), (0, 0, 0, 1))
        bag.raw("/pose", "geometry_msgs/msg/PoseStamped", START_NS + 5 * STEP_NS, bytes(20))
    recording = open_recording(tmp_path / "r.bag", NATIVE)
    assert recording.trajectory_error == "" and "1 of 6 poses are left out" in recording.warnings[-1]
    assert recording.given_trajectory is not None and len(recording.given_trajectory.stamps_ns) == 5


def test_a_text_has_no_stamp() -> None:
    text = b"rotation=1,0,0"
    for encoding, start in (("ros1", b""), ("cdr", b"\0\1\0\0")):
        data = start + len(text).to_bytes(4, "little") + text
        assert header_stamp_ns(data, "std_msgs/String", cast(Encoding, encoding)) == 0


def test_a_log_of_writes_that_is_not_read_is_named(tmp_path: Path) -> None:
    """As rosbag2's preset `resilient` leaves it where the recorder was killed."""
    file = write_bag2(tmp_path / "bag", messages(40)) / "bag.db3"
    found = tmp_path / "found.db3"
    with closing(sqlite3.connect(file)) as database:
        columns = "topic_id, timestamp, data"
        rows = database.execute(f"SELECT {columns} FROM messages ORDER BY id").fetchall()
        database.execute("DELETE FROM messages WHERE id > 100")
        database.commit()
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        database.executemany(f"INSERT INTO messages({columns}) VALUES (?, ?, ?)", rows[100:])
        database.commit()
        for end in ("", "-wal"):
            shutil.copy(f"{file}{end}", f"{found}{end}")
    recording = open_recording(found)
    assert len(recording) == 20
    assert "found.db3-wal beside it may hold further messages" in recording.warnings[0]
    with closing(sqlite3.connect(found)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    recording = open_recording(found)
    assert (len(recording), recording.warnings) == (40, ())


def test_a_time_beyond_64_bits_is_damage(tmp_path: Path) -> None:
    maker, image = MessageMaker(TYPES, RIG, "raw", ros2=True), "sensor_msgs/msg/Image"
    found = messages(4)
    message = maker.image(maker.header(0, 0, "d"), depth_image(0, 1000.0), "16UC1")
    late = ("/camera/depth_registered/image_raw", image, 2**63, bytes(STORE.serialize_cdr(message, image)))
    recording = open_recording(write_mcap(tmp_path / "r.mcap", [*found, late], use_chunking=False))
    assert len(recording) == 4 and "20 messages were saved" in recording.warnings[0]


def originals(tmp_path: Path) -> dict[str, bytes]:
    found = messages(3)
    made = {
        "bag": write_bag(tmp_path / "a.bag", 3),
        "bag bz2": write_bag(tmp_path / "b.bag", 3, compression="BZ2"),
        "bag lz4": write_bag(tmp_path / "c.bag", 3, compression="LZ4"),
        "realsense": write_realsense(tmp_path / "r.bag", extra=units, compression="LZ4"),
        "realsense plain": write_realsense(tmp_path / "p.bag", extra=property_of_version_2),
        "mcap": write_mcap(tmp_path / "a.mcap", found),
        "mcap zstd": write_mcap(tmp_path / "b.mcap", found, CompressionType.ZSTD),
        "mcap lz4": write_mcap(tmp_path / "c.mcap", found, CompressionType.LZ4),
        "mcap plain": write_mcap(tmp_path / "d.mcap", found, use_chunking=False),
        "db3": write_bag2(tmp_path / "bag", found) / "bag.db3",
    }
    return {name: path.read_bytes() for name, path in made.items()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return originals(tmp_path_factory.mktemp("whole"))


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_fuzzed_bags_neither_crash_nor_allocate(
    tmp_path: Path, whole: dict[str, bytes], data: st.DataObject
) -> None:
    name = data.draw(st.sampled_from(sorted(whole)))
    content = bytearray(whole[name])
    for _ in range(data.draw(st.integers(1, 5))):
        # Headers are at the start, and the index at the end.
        at = data.draw(st.one_of(st.integers(13, 4400), st.integers(0, len(content) - 1)))
        patch = data.draw(st.one_of(st.binary(min_size=1, max_size=4), st.just(b"\xff" * 8)))
        content[at : at + len(patch)] = patch
    path = tmp_path / "fuzzed"
    path.write_bytes(content)
    if format_of(path) is None:
        return
    tracemalloc.start()
    try:
        recording = open_recording(path, CameraSettings(**CAMERA))
        for frame in every_frame(recording):
            assert not isinstance(frame, RawFrame) or frame.depth.dtype == np.uint16
    except RecordingError as error:
        assert "\n" not in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    # The file has 60 KB; the types of ROS take some when they are met first.
    assert peak < 24 << 20
