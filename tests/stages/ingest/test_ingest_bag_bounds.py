"""What it costs to walk through all files of a bag, and to read their messages, is bounded by their size."""

import sqlite3
import tempfile
import tracemalloc
from contextlib import closing
from pathlib import Path
from typing import IO

import pytest
import zstandard
from raising import raises
from test_ingest_untrusted_bags import A_TOPIC, MESSAGES, TOPICS, database
from typed import noted

from kinectbench.core import untrusted
from kinectbench.core.errors import RecordingError
from kinectbench.core.untrusted import copy_bounded
from kinectbench.stages.ingest.bags import rosbag2, rosbag2_mcap, rosbag2_sqlite, walk_limits
from kinectbench.stages.ingest.bags.message_decoding import (
    BagTopic,
    DamagedRecordError,
    FoundMessages,
    MessagePlace,
)
from kinectbench.stages.ingest.readers import open_recording


def test_rows_that_share_their_pages_are_not_read_each(tmp_path: Path) -> None:
    """A file that was cut off is read whole, message by message: rows may all have the pages of one."""
    rows = tuple(f"INSERT INTO messages VALUES ({i}, 1, {i}, zeroblob({20_000 + i}))" for i in range(200))
    file = database(tmp_path / "r.db3", (TOPICS, A_TOPIC, MESSAGES, *rows))
    data = bytearray(file.read_bytes())
    found = FoundMessages(frozenset({"sensor_msgs/Image"}))
    found.connections[1] = BagTopic("/depth", "sensor_msgs/Image", "cdr")
    with closing(sqlite3.connect(file)) as made:
        # As if the file had but a fifth of the bytes that its rows speak of.
        with pytest.raises(DamagedRecordError, match="all of them together"):
            rosbag2_sqlite._take_messages(made, found, len(data) // 5, all_of_them=True)
        with pytest.raises(DamagedRecordError, match="all of them together"):
            rosbag2_sqlite._take_messages(made, found, len(data) // 2, all_of_them=False)
        rosbag2_sqlite._take_messages(made, found, len(data), all_of_them=False)


def test_a_folder_of_bombs_has_the_budget_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(untrusted, "ALWAYS_BYTES", 2 << 20)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "t"))
    (tmp_path / "t").mkdir()
    bomb = zstandard.ZstdCompressor(level=9).compress(rosbag2_mcap.MAGIC + bytes((1 << 20) - 100))
    (tmp_path / "r").mkdir()
    for number in range(24):
        (tmp_path / f"r/a_{number}.mcap.zstd").write_bytes(bomb)
    written: list[int] = []

    def measured(source: IO[bytes], target: IO[bytes], most: int) -> None:
        copy_bounded(source, target, most)
        written.append(target.tell())

    monkeypatch.setattr(rosbag2, "copy_bounded", measured)
    with raises(RecordingError, "recording.malformed", match=r"bag of its size|can be saved"):
        open_recording(tmp_path / "r")
    assert sum(written) <= (2 << 20) + 100 * 24 * len(bomb) and written
    assert not any((tmp_path / "t").iterdir())


def test_a_bag_has_a_thousand_files_at_most(tmp_path: Path) -> None:
    for number in range(rosbag2.MOST_FILES + 1):
        (tmp_path / f"a_{number}.mcap").write_bytes(rosbag2_mcap.MAGIC)
    with raises(RecordingError, "recording.too-large", match="1000"):
        open_recording(tmp_path)


def test_chunks_are_not_unpacked_for_each_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two chunks, each larger than what is kept, whose messages take turns."""
    monkeypatch.setattr(walk_limits, "CACHED_BYTES", 1000)
    unpacked: list[object] = []
    path = tmp_path / "r.bag"
    path.write_bytes(b"")
    reader = walk_limits.BagReader(path, noted(lambda file, at: bytes(900), unpacked))
    for chunk in (1, 2):
        reader.keep(chunk, bytes(900))
    reader.start_reading(100)
    in_order = [MessagePlace(i, 1 + i // 50, i, 1) for i in range(100)]
    for _ in range(5):  # to read all again and again is no such thing
        assert all(reader(place) == b"\0" for place in in_order)
    assert len(unpacked) <= 10
    unpacked.clear()
    with raises(RecordingError, "recording.malformed", match="messages"):
        for _ in range(5):
            for place in (in_order[index // 2 + 50 * (index % 2)] for index in range(100)):
                reader(place)
    assert len(unpacked) < 30


def test_a_large_chunk_makes_room_before_the_next_is_unpacked(tmp_path: Path) -> None:
    """Messages of two large chunks in turns: never both of them in memory."""
    (tmp_path / "a.bag").write_bytes(b"")
    size = walk_limits.CACHED_BYTES + (1 << 20)
    read = walk_limits.BagReader(tmp_path / "a.bag", lambda file, position: bytes(size))
    for chunk in (0, 1):
        read.keep(chunk, bytes(size))
    read.start_reading(4)
    tracemalloc.start()
    for chunk in (0, 1, 0, 1):
        assert read(MessagePlace(0, chunk, 5, 10)) == bytes(10)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < size + (1 << 20)
