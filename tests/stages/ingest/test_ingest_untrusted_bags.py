"""Bags of strangers: databases that compute, bombs, and definitions that are programs end with one line."""

import bz2
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bounds import within
from ingest_writers import BagWriter, every_frame
from raising import raises
from rosbags.typesys import Stores, get_typestore
from test_ingest_realsense import STREAM_INFO
from test_ingest_realsense import write as write_realsense
from test_ingest_rosbag2 import check, messages, write_bag
from typed import noted

from kinectbench.core.errors import RecordingError
from kinectbench.core.untrusted import UNPACKED_BYTES
from kinectbench.stages.ingest.bags import message_decoding, rosbag1, rosbag2_mcap
from kinectbench.stages.ingest.bags.message_decoding import (
    DamagedRecordError,
    known_types,
    unpacked_chunk,
)
from kinectbench.stages.ingest.readers import open_recording

ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
TOPICS = "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
A_TOPIC = "INSERT INTO topics VALUES (1, '/depth', 'sensor_msgs/msg/Image', 'cdr')"
MESSAGES = "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)"
DATABASES = {
    "view topics": (
        f"CREATE VIEW topics AS {ENDLESS} SELECT x id, x name, x type, 'cdr' serialization_format FROM c",
    ),
    "View in capitals": (f"CREATE VIEW TOPICS AS {ENDLESS} SELECT x id FROM c", MESSAGES),
    "view messages": (
        TOPICS,
        A_TOPIC,
        f"CREATE VIEW messages AS {ENDLESS} SELECT x id, 1 topic_id, 1 timestamp, "
        "randomblob(900000000) data FROM c",
    ),
    "computed column": (
        TOPICS,
        A_TOPIC,
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data AS (zeroblob(900000000)))",
        "INSERT INTO messages VALUES (1, 1, 1)",
    ),
    "virtual table": (TOPICS, "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)"),
    "no rowid": (
        TOPICS,
        A_TOPIC,
        "CREATE TABLE messages (id PRIMARY KEY, topic_id, timestamp, data) WITHOUT ROWID",
    ),
}


def database(path: Path, statements: tuple[str, ...]) -> Path:
    with closing(sqlite3.connect(path)) as made, made:
        for statement in statements:
            made.execute(statement)
    return path


@pytest.mark.parametrize("name", DATABASES)
def test_a_database_that_computes_is_refused(tmp_path: Path, name: str) -> None:
    path = database(tmp_path / "r.db3", DATABASES[name])
    refusal = r"cannot be read as a ROS 2 bag|nothing in it"
    with within(5), raises(RecordingError, "recording.malformed", match=refusal) as error:
        open_recording(path)
    assert "\n" not in str(error.value)


def test_rows_without_end_are_bounded(tmp_path: Path) -> None:
    """An inner page of the tree that names one leaf again and again, as no page of a tree may."""
    rows = tuple(f"INSERT INTO messages VALUES ({i}, 1, {i}, x'00')" for i in range(2000))
    path = database(tmp_path / "r.db3", (TOPICS, A_TOPIC, MESSAGES, *rows))
    with closing(sqlite3.connect(path)) as made:
        (page_bytes,), (root,) = (
            made.execute("PRAGMA page_size").fetchone(),
            made.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone(),
        )
    data = bytearray(path.read_bytes())
    start = (root - 1) * page_bytes
    assert data[start] == 5  # an inner page
    leaf = data[start + 8 : start + 12]
    # All its cells are one, and there are as many as fit.
    cell = page_bytes - 8
    data[start + cell : start + cell + 5] = leaf + b"\x01"
    count = (page_bytes - 32) // 2
    data[start + 3 : start + 7] = struct.pack(">HH", count, cell)
    data[start + 12 : start + 12 + 2 * count] = struct.pack(">H", cell) * count
    path.write_bytes(data)
    with within(5), pytest.raises(RecordingError):
        open_recording(path)


def test_of_messages_that_do_not_decode_a_thousand_are_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = ENDLESS.replace("FROM c)", "FROM c WHERE x < 30000)")
    rows = f"INSERT INTO messages {endless} SELECT x, 1, x, x'00' FROM c"
    path = database(tmp_path / "r.db3", (TOPICS, A_TOPIC, MESSAGES, rows))
    tried: list[tuple[object, str, int]] = []
    monkeypatch.setattr(message_decoding.RosBag, "decode", noted(message_decoding.RosBag.decode, tried))
    with raises(RecordingError, "recording.no-depth"):
        open_recording(path)
    assert max(at for _, _, at in tried) == 999


def test_a_message_larger_than_the_file_is_not_read(tmp_path: Path) -> None:
    """Its pages go round: SQLite would copy them as often as its size asks for."""
    size = 100_000
    row = f"INSERT INTO messages VALUES (1, 1, 1, zeroblob({size}))"
    file = database(tmp_path / "r.db3", (TOPICS, A_TOPIC, MESSAGES, row))

    def varint(value: int) -> bytes:
        parts = [value & 127]
        while value := value >> 7:
            parts.append(value & 127 | 128)
        return bytes(reversed(parts))

    data = file.read_bytes()
    said, huge = varint(12 + 2 * size), varint(12 + 2 * ((1 << 20) - 8))
    assert said in data and len(said) == len(huge)
    # The head of a row has 7 bytes here, and all of the row but the blob is in it.
    data = data.replace(said, huge, 1).replace(varint(size + 7), varint((1 << 20) - 8 + 7), 1)
    file.write_bytes(data)
    with raises(RecordingError, "recording.malformed", match=r"damaged \(a"):
        open_recording(file)


def test_a_file_is_never_opened_to_write_its_schema(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check(write_bag(tmp_path / "bag", messages()))
    statements: list[str] = []
    usual = sqlite3.connect

    def watched(*args: Any, **options: Any) -> sqlite3.Connection:
        made: sqlite3.Connection = usual(*args, **options)
        made.set_trace_callback(statements.append)
        assert "mode=ro&immutable=1" in str(args[0])
        return made

    monkeypatch.setattr(sqlite3, "connect", watched)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "t"))
    (tmp_path / "t").mkdir()
    whole = (tmp_path / "bag/bag.db3").read_bytes()
    for end in (len(whole), len(whole) - 5000):
        (tmp_path / "r.db3").write_bytes(whole[:end])
        recording = open_recording(tmp_path / "r.db3")
        assert len(list(every_frame(recording))) >= 3
        del recording
    assert any("trusted_schema = OFF" in each for each in statements)
    assert not any("writable_schema" in each for each in statements)
    assert list((tmp_path / "t").iterdir()) == []  # the copy of what was cut off is gone
    assert (tmp_path / "r.db3").read_bytes() == whole[:-5000]


def zeros(gigabytes: int) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj()
    return b"".join(packer.compress(bytes(1 << 24)) for _ in range(64 * gigabytes)) + packer.flush()


@pytest.mark.parametrize("suffix", [".db3.zstd", ".mcap.zstd"])
@pytest.mark.parametrize("nested", [False, True])
def test_a_bomb_does_not_fill_the_disk(
    tmp_path: Path, suffix: str, nested: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "t").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "t"))
    head = zstandard.ZstdCompressor().compress(b"SQLite format 3\0" + bytes(100))
    bomb = head + zeros(1)
    path = tmp_path / f"r{suffix}"
    path.write_bytes(zstandard.ZstdCompressor().compress(bomb) if nested else bomb)
    largest: list[int] = []
    usual = shutil.rmtree

    def measured(folder: str, *rest: Any, **more: Any) -> None:
        largest.extend(file.stat().st_size for file in Path(folder).iterdir())
        usual(folder, *rest, **more)

    monkeypatch.setattr(shutil, "rmtree", measured)
    with raises(RecordingError, "recording.malformed", match="unpacks to more|no ROS 2 bag"):
        open_recording(path)
    assert list((tmp_path / "t").iterdir()) == []
    assert max(largest, default=0) < 128 << 20


def mcap(chunks: bytes) -> bytes:
    return rosbag2_mcap.MAGIC + chunks


def mcap_chunk(compression: str, size: int, data: bytes) -> bytes:
    name = compression.encode()
    body = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(name)) + name
    body += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


def ros1_record(fields: dict[str, bytes], data: bytes) -> bytes:
    head = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in fields.items())
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def ros1(chunks: bytes) -> bytes:
    start = ros1_record({"op": b"\x03", "index_pos": bytes(8)}, b"")
    return rosbag1.MAGIC + start + chunks


def ros1_chunk(compression: str, size: int, data: bytes) -> bytes:
    return ros1_record(
        {"op": b"\x05", "compression": compression.encode(), "size": struct.pack("<I", size)}, data
    )


def lz4(data: bytes) -> bytes:
    from lz4.frame import compress  # type: ignore[import-untyped]

    return bytes(compress(data))


ZEROS = bytes(128 << 20)
SMALL = struct.pack("<BQ", 4, 22) + bytes(22)  # messages of a channel that is not there
BOMBS: dict[str, Callable[[], tuple[str, bytes]]] = {
    "mcap zstd that says 3 GB": lambda: ("r.mcap", mcap(mcap_chunk("zstd", 3 << 30, zeros(1)))),
    "mcap zstd that says less": lambda: ("r.mcap", mcap(mcap_chunk("zstd", 4096, zeros(1)) * 20)),
    "mcap lz4": lambda: ("r.mcap", mcap(mcap_chunk("lz4", 255 << 20, lz4(ZEROS)) * 20)),
    "mcap with records of nothing": lambda: (
        "r.mcap",
        mcap(mcap_chunk("lz4", len(SMALL) << 20, lz4(SMALL * (1 << 20))) * 50),
    ),
    "bag bz2": lambda: ("r.bag", ros1(ros1_chunk("bz2", 255 << 20, bz2.compress(ZEROS[: 16 << 20])) * 2000)),
    "bag lz4": lambda: ("r.bag", ros1(ros1_chunk("lz4", 255 << 20, lz4(ZEROS)) * 20)),
    "bag that says 4 GB": lambda: ("r.bag", ros1(ros1_chunk("lz4", (1 << 32) - 1, lz4(ZEROS)))),
    "bag with records of nothing": lambda: (
        "r.bag",
        ros1(ros1_chunk("lz4", 15 << 20, lz4(ros1_record({"op": b"\x04"}, b"") * (1 << 20))) * 50),
    ),
}
READ = """
import re, sys, time
from pathlib import Path
import cv2, rosbags.typesys, zstandard
from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.readers import open_recording
for path in sorted(Path(sys.argv[1]).iterdir()):
    started = time.process_time()
    try:
        recording = open_recording(path)
        said = [type(recording).__name__]
    except RecordingError as error:
        said = str(error).splitlines()
    status = Path("/proc/self/status").read_text()  # getrusage counts what the process was made of, too
    used = int(re.search(r"VmHWM:\\s+(\\d+)", status)[1]) >> 10
    print(len(said), round(time.process_time() - started, 2), used, path.name, said[0], flush=True)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is told by Linux's /proc")
def test_bombs_take_neither_time_nor_memory(tmp_path: Path) -> None:
    """10 s of a processor and 500 MB for each of them, with Python and its libraries."""
    (tmp_path / "all").mkdir()
    for number, make in enumerate(BOMBS.values()):
        name, data = make()
        (tmp_path / f"all/{number}{name}").write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-c", READ, str(tmp_path / "all")], capture_output=True, text=True, timeout=200
    )
    rows = [row.split(maxsplit=4) for row in done.stdout.splitlines()]
    assert len(rows) == len(BOMBS) and done.stderr == ""
    for lines, seconds, megabytes, _, said in rows:
        assert (lines, said.startswith(str(tmp_path))) == ("1", True)
        assert float(seconds) < 10 and int(megabytes) < 500, (seconds, megabytes, said)


@pytest.mark.parametrize("compression", ["bz2", "lz4", "zstd"])
def test_chunks_are_unpacked_as_far_as_they_say(compression: str) -> None:
    packed = {"bz2": bz2.compress, "lz4": lz4, "zstd": zstandard.ZstdCompressor().compress}[compression]
    data = np.random.default_rng(0).integers(0, 4, 5 << 20, np.uint8).tobytes()
    assert unpacked_chunk(compression, packed(data), len(data)) == data
    assert unpacked_chunk(compression, packed(data), 1000) == data[:1000]
    with pytest.raises(DamagedRecordError):
        unpacked_chunk(compression, packed(data), UNPACKED_BYTES + 1)


BIG = "".join(f"a/m{i + 1}[60] x\n{'=' * 80}\nMSG: a/m{i + 1}\n" for i in range(5)) + "int8 a\n"
DEFINITIONS = {
    "a long array": "string[30000] a",
    "an array of arrays": BIG,
    "itself": "stream_info a",
    "each other": f"a/b x\n{'=' * 80}\nMSG: a/b\na/c x\n{'=' * 80}\nMSG: a/c\na/b x\n",
    "a list of nothing": f"a/b[] x\n{'=' * 80}\nMSG: a/b\nuint8 X=1\n",
    "many fields": "".join(f"int8 a{i}\n" for i in range(3000)),
    "a long text": "# " + "x" * 100_000 + "\nint8 a",
    "no definition": "%&/()=" * 100,
    "an unknown type": "a/b x",
    "brackets": "int8" + "[" * 5000,
}


def test_the_definition_of_librealsense_is_known() -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    types = known_types("realsense_msgs/msg/stream_info", STREAM_INFO, store)
    assert set(types) == {
        f"realsense_msgs/msg/{name}" for name in ("stream_info", "stream_extrinsics", "extrinsics")
    }
    store.register(types)


@pytest.mark.parametrize("name", DEFINITIONS)
def test_a_definition_that_is_a_program_is_not_compiled(tmp_path: Path, name: str) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    started = time.process_time()
    with pytest.raises(ValueError, match=r"\w"):
        known_types("realsense_msgs/msg/stream_info", DEFINITIONS[name], store)
    assert time.process_time() - started < 5


def test_messages_of_such_a_type_do_not_decode(tmp_path: Path) -> None:
    decode = message_decoding._ros1_decoder((("realsense_msgs/stream_info", DEFINITIONS["a long array"]),))
    with pytest.raises(KeyError):
        decode(bytes(16), "realsense_msgs/msg/stream_info")

    def extra(bag: BagWriter) -> None:
        bag.raw("/camera/rs_stream_info/1", "std_msgs/msg/Float32", 1, bytes(4))

    assert len(open_recording(write_realsense(tmp_path / "r.bag", extra=extra))) == 3
