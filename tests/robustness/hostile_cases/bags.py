"""Bags: databases that compute, files and chunks that swell, definitions of messages that are programs."""

import bz2
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from hostile_cases.case import Case, on

YAML = "name: a\nrecordings: [{{id: r, path: {}, category: chair}}]\n"
READ = "inspect {0}\ningest --jobs 1"
ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
TOPICS = "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
A_TOPIC = "INSERT INTO topics VALUES (1, '/depth', 'sensor_msgs/msg/Image', 'cdr')"
MESSAGES = "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)"
ROW = "INSERT INTO messages VALUES (1, 1, 1, x'00')"


def cases() -> Iterator[Case]:
    for name, statements in DATABASES.items():
        yield from _cases("H2", name, "a.db3", _database(statements))
        packed = _settled("a.db3.zstd", _packed_database(statements))
        yield Case("H2", f"{name}, packed", "ingest --jobs 1", packed, statuses=(0, 1, 3))
    for name, (file, make) in BOMBS.items():
        yield from _cases("H3" if file.endswith("zstd") else "M2", name, file, make)
        yield Case("H3", name, "init --force .", _settled(file, make), statuses=(0, 1))
    for name, definition in DEFINITIONS.items():
        for whole in ("realsense", "realsense_old"):
            yield from on(
                "inspect r\ningest --jobs 1",
                Case("H6", f"{whole}: {name}", "", _defined(definition), whole, (0, 1, 3)),
            )
        for defined, file in ((_ros1_definition, "a.bag"), (_mcap_definition, "a.mcap")):
            yield from _cases("H6", f"{file}: {name}", file, defined(definition))
    yield from _cases("H1", "metadata.yaml that is a billion laughs", "bag", _metadata)
    for name, blocks in (("blocks", _blocks), ("clusters", _clusters)):
        yield from on(
            "inspect r\ningest --jobs 1",
            Case("M6", f"a .mkv of 2,000,000 {name}", "", _mkv(blocks), "azure_kinect", (0, 1, 3)),
        )
    yield from _cases("H5", "metadata.yaml that names files elsewhere", "bag", _metadata_out)


def _cases(
    group: str, name: str, file: str, make: Callable[[], bytes] | Callable[[Path], object]
) -> list[Case]:
    return on(READ.format(file), Case(group, name, "", _settled(file, make), statuses=(0, 1, 3)))


def _settled(file: str, make: Callable[..., Any]) -> Callable[[Path], None]:
    """The input in a folder, with its benchmark.yaml."""

    def write(folder: Path) -> None:
        (folder / "benchmark.yaml").write_text(YAML.format(file), encoding="utf-8")
        path = folder / file
        if make.__code__.co_argcount:
            make(path)
        else:
            path.write_bytes(make())

    return write


DATABASES: dict[str, tuple[str, ...]] = {
    "a view of topics": (
        f"CREATE VIEW topics AS {ENDLESS} SELECT x id, x name, x type, 'cdr' serialization_format FROM c",
    ),
    "a view of messages": (
        TOPICS,
        A_TOPIC,
        f"CREATE VIEW messages AS {ENDLESS} SELECT x id, 1 topic_id, 1 timestamp, "
        "randomblob(900000000) data FROM c",
    ),
    "views in capitals": (f"CREATE VIEW Topics AS {ENDLESS} SELECT x id FROM c", MESSAGES),
    "a computed column": (
        TOPICS,
        A_TOPIC,
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data AS (zeroblob(900000000)))",
        "INSERT INTO messages VALUES (1, 1, 1)",
    ),
    "a stored computed column": (
        TOPICS,
        A_TOPIC,
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, "
        "data AS (zeroblob(1000)) STORED)",
        "INSERT INTO messages VALUES (1, 1, 1)",
    ),
    "a virtual table": (TOPICS, "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)"),
    "no row numbers": (
        TOPICS,
        A_TOPIC,
        "CREATE TABLE messages (id PRIMARY KEY, topic_id, timestamp, data) WITHOUT ROWID",
        ROW,
    ),
    "a view beside tables": (
        TOPICS,
        A_TOPIC,
        MESSAGES,
        ROW,
        f"CREATE VIEW schema AS {ENDLESS} SELECT x FROM c",
    ),
    "an index by an expression": (
        TOPICS,
        A_TOPIC,
        MESSAGES,
        ROW,
        "CREATE INDEX i ON messages (abs(length(zeroblob(900000000)) - timestamp))",
    ),
    "200,000 topics": (
        TOPICS,
        "INSERT INTO topics WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c WHERE x < 200000) "
        "SELECT x, '/t' || x, 'sensor_msgs/msg/Image', 'cdr' FROM c",
        MESSAGES,
    ),
    "500,000 messages of nothing": (
        TOPICS,
        A_TOPIC,
        MESSAGES,
        "INSERT INTO messages WITH RECURSIVE c(x) AS "
        "(SELECT 1 UNION ALL SELECT x + 1 FROM c WHERE x < 500000) "
        "SELECT x, 1, x, x'00' FROM c",
    ),
    "values of other kinds": (
        TOPICS,
        "INSERT INTO topics VALUES (1, x'1b5b324a', 3.5, NULL)",
        MESSAGES,
        "INSERT INTO messages VALUES (1, 'a', 1e300, 'text')",
    ),
    "topics that steer a terminal": (
        TOPICS,
        "INSERT INTO topics VALUES (1, '/\x1b[2J\nerror: x', 'sensor_msgs/msg/Image', 'cdr')",
        MESSAGES,
        ROW,
    ),
}


def _database(statements: tuple[str, ...]) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        with closing(sqlite3.connect(path)) as made, made:
            for statement in statements:
                made.execute(statement)

    return make


def _packed_database(statements: tuple[str, ...]) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        import zstandard

        plain = path.with_name("plain")
        _database(statements)(plain)
        path.write_bytes(zstandard.compress(plain.read_bytes()))
        plain.unlink()

    return make


def _zeros(gigabytes: float, head: bytes = b"") -> bytes:
    import zstandard

    packer = zstandard.ZstdCompressor().compressobj()
    parts = [packer.compress(head)] + [packer.compress(bytes(1 << 24)) for _ in range(int(64 * gigabytes))]
    return b"".join(parts) + packer.flush()


def _mcap(chunks: bytes) -> bytes:
    return b"\x89MCAP0\r\n" + chunks


def _mcap_chunk(compression: bytes, size: int, data: bytes) -> bytes:
    body = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(compression)) + compression
    body += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


def _ros1_record(fields: dict[str, bytes], data: bytes) -> bytes:
    head = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in fields.items())
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def _ros1(chunks: bytes) -> bytes:
    return b"#ROSBAG V2.0\n" + _ros1_record({"op": b"\x03", "index_pos": bytes(8)}, b"") + chunks


def _ros1_chunk(compression: bytes, size: int, data: bytes) -> bytes:
    return _ros1_record({"op": b"\x05", "compression": compression, "size": struct.pack("<I", size)}, data)


def _lz4(megabytes: int) -> bytes:
    from lz4.frame import compress  # type: ignore[import-untyped]

    return bytes(compress(bytes(megabytes << 20)))


def _bz2(megabytes: int) -> bytes:
    packer = bz2.BZ2Compressor()
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(megabytes)) + packer.flush()


SQLITE, MCAP = b"SQLite format 3\0", b"\x89MCAP0\r\n"
BOMBS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "a database of 3 GB": ("a.db3.zstd", lambda: _zeros(3, SQLITE)),
    "an mcap of 3 GB": ("a.mcap.zstd", lambda: _zeros(3, MCAP)),
    "many frames of zstd": ("a.db3.zstd", lambda: _zeros(0.1, SQLITE) + _zeros(0.5) * 6),
    "zeros that are no bag": ("a.db3.zstd", lambda: _zeros(3)),
    "a chunk of zstd of 3 GB": ("a.mcap", lambda: _mcap(_mcap_chunk(b"zstd", 3 << 30, _zeros(3)))),
    "chunks of zstd that say little": ("a.mcap", lambda: _mcap(_mcap_chunk(b"zstd", 4096, _zeros(1)) * 20)),
    "chunks of lz4 in mcap": ("a.mcap", lambda: _mcap(_mcap_chunk(b"lz4", 255 << 20, _lz4(128)) * 20)),
    "a chunk of bz2 of 2 GB": ("a.bag", lambda: _ros1(_ros1_chunk(b"bz2", 2 << 30, _bz2(2048)))),
    "a chunk of lz4 of 2 GB": ("a.bag", lambda: _ros1(_ros1_chunk(b"lz4", 2 << 30, _lz4(512)))),
    "2,000 chunks of bz2": ("a.bag", lambda: _ros1(_ros1_chunk(b"bz2", 255 << 20, _bz2(16)) * 2000)),
    "20 chunks of lz4 of 128 MB": ("a.bag", lambda: _ros1(_ros1_chunk(b"lz4", 255 << 20, _lz4(128)) * 20)),
    "an unknown compression": ("a.bag", lambda: _ros1(_ros1_chunk(b"\x1b[2J", 1 << 20, b"x"))),
}

LINE = "=" * 80
BIG = "".join(f"a/m{i + 1}[60] x\n{LINE}\nMSG: a/m{i + 1}\n" for i in range(5)) + "int8 a\n"
DEFINITIONS = {
    "an array of 30,000": "string[30000] a",
    "an array of a billion": "float32[1000000000] a",
    "arrays of arrays": BIG,
    "itself": "stream_info a",
    "each other": f"a/b x\n{LINE}\nMSG: a/b\na/c x\n{LINE}\nMSG: a/c\na/b x\n",
    "3,000 fields": "".join(f"int8 a{i}\n" for i in range(3000)),
    "names that are code": "int8 __import__('os').system('id')\nint8 X=__import__('os').system('id')",
    "100,000 brackets": "int8" + "[" * 100_000,
    "a text of 2 MB": "# " + "x" * (2 << 20) + "\nint8 a",
}


def _defined(definition: str) -> Callable[[Path], None]:
    """A RealSense bag whose messages of streams are said to be something else."""

    def make(folder: Path) -> None:
        path = next(folder.glob("recording*"))
        content = path.read_bytes()
        key = b"message_definition="
        start = content.index(key, max(0, content.find(b"type=realsense_msgs/stream_info")))
        path.write_bytes(_with_definition(content, start + len(key), definition.encode()))

    return make


def _with_definition(content: bytes, at: int, definition: bytes) -> bytes:
    """Replace a field of a connection, in a chunk or not: the lengths around it follow."""
    length_at = at - len(b"message_definition=") - 4
    (length,) = struct.unpack_from("<I", content, length_at)
    end = length_at + 4 + length
    more = len(definition) - (end - at)
    changed = bytearray(content[:at] + definition + content[end:])
    struct.pack_into("<I", changed, length_at, length + more)
    for start in _lengths_around(content, length_at):
        (before,) = struct.unpack_from("<I", content, start)
        struct.pack_into("<I", changed, start, before + more)
    return bytes(changed)


def _lengths_around(content: bytes, place: int) -> list[int]:
    """Where the lengths stand that count a place in a bag: of records, and of chunks and their sizes."""
    found, at, end = list[int](), len(b"#ROSBAG V2.0\n"), len(content)
    while at < end:
        (head,) = struct.unpack_from("<I", content, at)
        data_at = at + 4 + head
        (data,) = struct.unpack_from("<I", content, data_at)
        if data_at + 4 <= place < data_at + 4 + data:
            found.append(data_at)
            if b"op=\x05" in content[at:data_at]:
                size_at = content.index(b"size=", at) + len(b"size=")
                found.append(size_at)
                at, end = data_at + 4, data_at + 4 + data
                continue
            return found
        at = data_at + 4 + data
    return found


def _ros1_definition(definition: str) -> Callable[[], bytes]:
    def make() -> bytes:
        said = {"type": b"sensor_msgs/Image", "md5sum": b"0" * 32, "message_definition": definition.encode()}
        fields = b"".join(
            struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in said.items()
        )
        connection = _ros1_record({"op": b"\x07", "conn": bytes(4), "topic": b"/depth"}, fields)
        message = _ros1_record({"op": b"\x02", "conn": bytes(4), "time": bytes(8)}, bytes(16))
        chunk = connection + message * 20
        return _ros1(_ros1_chunk(b"none", len(chunk), chunk))

    return make


def _text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def _mcap_definition(definition: str) -> Callable[[], bytes]:
    def make() -> bytes:
        schema = (
            struct.pack("<H", 1)
            + _text(b"sensor_msgs/msg/Image")
            + _text(b"ros2msg")
            + _text(definition.encode())
        )
        channel = struct.pack("<HH", 0, 1) + _text(b"/depth") + _text(b"cdr") + _text(b"")
        message = struct.pack("<HIQQ", 0, 0, 0, 0) + bytes(16)
        records = [(1, _text(b"") * 2), (3, schema), (4, channel), *[(5, message)] * 20]
        return _mcap(b"".join(struct.pack("<BQ", op, len(body)) + body for op, body in records))

    return make


def _metadata(folder: Path) -> None:
    from hostile_cases.releases import bomb_yaml

    folder.mkdir()
    _database((TOPICS, A_TOPIC, MESSAGES, ROW))(folder / "a_0.db3")
    (folder / "metadata.yaml").write_text(bomb_yaml("rosbag2_bagfile_information"), encoding="utf-8")


def _metadata_out(folder: Path) -> None:
    folder.mkdir()
    _database((TOPICS, A_TOPIC, MESSAGES, ROW))(folder.with_name("secret.db3"))
    text = "rosbag2_bagfile_information:\n  relative_file_paths: [../secret.db3, /etc/passwd]\n"
    (folder / "metadata.yaml").write_text(text, encoding="utf-8")


# Matroska (RFC 9559): a segment; a cluster with its time, and blocks of one byte of the first track.
SEGMENT, UNKNOWN_SIZE = b"\x18\x53\x80\x67", b"\x01" + b"\xff" * 7
CLUSTER, CLUSTER_TIME, BLOCK = b"\x1f\x43\xb6\x75", b"\xe7\x81\x00", b"\xa3\x85\x81\x00\x00\x80x"
MANY_BLOCKS = 2_000_000


def _cluster(blocks: bytes) -> bytes:
    content = CLUSTER_TIME + blocks
    return CLUSTER + (1 << 56 | len(content)).to_bytes(8, "big") + content


def _blocks() -> bytes:
    return _cluster(BLOCK * MANY_BLOCKS)


def _clusters() -> bytes:
    return _cluster(BLOCK) * MANY_BLOCKS


def _mkv(more: Callable[[], bytes]) -> Callable[[Path], object]:
    """A recording, and behind it clusters, as a segment of unknown size may have them."""

    def make(folder: Path) -> None:
        (path,) = folder.glob("*.mkv")
        content = path.read_bytes()
        size_at = content.index(SEGMENT) + len(SEGMENT)
        path.write_bytes(content[:size_at] + UNKNOWN_SIZE + content[size_at + 8 :] + more())

    return make
