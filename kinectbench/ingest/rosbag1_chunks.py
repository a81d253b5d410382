"""The records of a ROS 1 bag (format 2.0), found by walking its chunks.

The walk needs no index, so it also reads what is whole of a bag that was cut off or never closed, and it
gives random access to single messages. Layout: http://wiki.ros.org/Bags/Format/2.0.
"""

import bz2
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from kinectbench.errors import RecordingError

MAGIC = b"#ROSBAG V2.0\n"
OP_MESSAGE, OP_BAG, OP_CHUNK, OP_CONNECTION = 2, 3, 5, 7
CACHED_CHUNKS = 4


@dataclass(frozen=True)
class MessagePlace:
    """Where a message lies.

    Attributes:
        stamp_ns: stamp of its header, or the time it was recorded where the header has none.
        chunk: position of the chunk's record in the file.
        offset: of the message in the chunk, once that is decompressed.
        size: in bytes.
    """

    stamp_ns: int
    chunk: int
    offset: int
    size: int


@dataclass(frozen=True)
class BagTopic:
    """One topic: its type such as "sensor_msgs/Image", and its messages in the order of their stamps."""

    name: str
    type: str
    messages: tuple[MessagePlace, ...]


@dataclass(frozen=True)
class BagContents:
    """What a walk through a bag found.

    Attributes:
        topics: those of the wanted types that have messages, sorted by name.
        chunks: number of whole chunks.
        damaged_chunks: number of chunks that do not decompress.
        complete: the file ends as it should and has an index.
    """

    topics: tuple[BagTopic, ...]
    chunks: int
    damaged_chunks: int
    complete: bool


class _CutOffError(Exception):
    """The file ends within a record, or does not go on with one."""


def scan_bag(path: Path, types: frozenset[str]) -> BagContents:
    """Walk through a bag and note where the messages of these types lie; all of them begin with a Header.

    Raises:
        RecordingError: not a bag of format 2.0, or encrypted.
    """
    walk = _Walk(types)
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"{path}: not a ROS 1 bag of format 2.0")
        try:
            fields, data_size = _read_header(file)
            if fields.get(b"encryptor"):
                raise RecordingError(f"{path}: the bag is encrypted; record or copy it without encryption")
            file.seek(data_size, 1)
            complete = 0 < _number(fields, b"index_pos", "<Q") < path.stat().st_size
            while file.peek(1):
                walk.take_record(file)
        except _CutOffError:
            complete = False
    return BagContents(walk.topics(), walk.chunks, walk.damaged_chunks, complete)


class ChunkReader:
    """Reads single messages; keeps the chunks that were read last."""

    def __init__(self, path: Path) -> None:
        """Read from this bag, which `scan_bag` has walked through."""
        self._path = path
        self._chunks: dict[int, bytes] = {}

    def message(self, place: MessagePlace) -> bytes:
        """The serialised message that lies there."""
        if place.chunk not in self._chunks:
            while len(self._chunks) >= CACHED_CHUNKS:
                del self._chunks[next(iter(self._chunks))]
            with self._path.open("rb") as file:
                file.seek(place.chunk)
                self._chunks[place.chunk] = _decompress(*_read_record(file))
        return self._chunks[place.chunk][place.offset : place.offset + place.size]


class _Walk:
    """What has been met so far."""

    def __init__(self, types: frozenset[str]) -> None:
        self.chunks = 0
        self.damaged_chunks = 0
        self._types = types
        self._connections: dict[int, tuple[str, str]] = {}
        self._messages: dict[int, list[MessagePlace]] = {}

    def take_record(self, file: BinaryIO) -> None:
        """Read the next record of the file, or pass over it."""
        position = file.tell()
        fields, data_size = _read_header(file)
        op = _number(fields, b"op", "<B")
        if op not in (OP_CHUNK, OP_CONNECTION):
            _read_exactly(file, data_size)
            return
        data = _read_exactly(file, data_size)
        if op == OP_CONNECTION:
            self._take_connection(fields, data)
            return
        self.chunks += 1
        try:
            self._take_chunk(position, _decompress(fields, data))
        except (_CutOffError, OSError, ValueError, EOFError, RuntimeError):
            self.damaged_chunks += 1

    def topics(self) -> tuple[BagTopic, ...]:
        """The topics of the wanted types; connections that share a topic are joined."""
        joined: dict[tuple[str, str], list[MessagePlace]] = {}
        for connection, messages in self._messages.items():
            name_and_type = self._connections.get(connection)
            if name_and_type is not None and name_and_type[1] in self._types:
                joined.setdefault(name_and_type, []).extend(messages)
        return tuple(
            BagTopic(name, type_, tuple(sorted(messages, key=lambda place: place.stamp_ns)))
            for (name, type_), messages in sorted(joined.items())
        )

    def _take_connection(self, fields: dict[bytes, bytes], data: bytes) -> None:
        more = _parse_fields(data)
        topic, type_ = (fields.get(b"topic", b""), more.get(b"type", b""))
        names = (topic.decode(errors="replace"), type_.decode(errors="replace"))
        self._connections[_number(fields, b"conn", "<I")] = names

    def _take_chunk(self, position: int, chunk: bytes) -> None:
        for fields, offset, size in _records_of(chunk):
            op = _number(fields, b"op", "<B")
            if op == OP_CONNECTION:
                self._take_connection(fields, chunk[offset : offset + size])
            elif op == OP_MESSAGE:
                connection = _number(fields, b"conn", "<I")
                known = self._connections.get(connection)
                # The connection of a message can be in a chunk that is lost, and again at the end.
                if size >= 12 and (known is None or known[1] in self._types):
                    _, seconds, nanoseconds = struct.unpack_from("<III", chunk, offset)
                    stamp_ns = seconds * 10**9 + nanoseconds or _time_ns(fields)
                    place = MessagePlace(stamp_ns, position, offset, size)
                    self._messages.setdefault(connection, []).append(place)


def _records_of(chunk: bytes) -> Iterator[tuple[dict[bytes, bytes], int, int]]:
    """The records in a chunk: header fields, and offset and size of the data."""
    position = 0
    while position < len(chunk):
        try:
            (header_size,) = struct.unpack_from("<I", chunk, position)
            fields = _parse_fields(chunk[position + 4 : position + 4 + header_size])
            (size,) = struct.unpack_from("<I", chunk, position + 4 + header_size)
        except struct.error as error:
            raise _CutOffError from error
        offset = position + 8 + header_size
        if offset + size > len(chunk):
            raise _CutOffError
        yield fields, offset, size
        position = offset + size


def _decompress(fields: dict[bytes, bytes], data: bytes) -> bytes:
    def lz4(packed: bytes) -> bytes:
        from lz4.frame import decompress  # type: ignore[import-untyped]

        return bytes(decompress(packed))

    known: dict[bytes, Callable[[bytes], bytes]] = {b"none": bytes, b"bz2": bz2.decompress, b"lz4": lz4}
    unpack = known.get(fields.get(b"compression", b""))
    if unpack is None:
        raise _CutOffError
    return unpack(data)


def _read_record(file: BinaryIO) -> tuple[dict[bytes, bytes], bytes]:
    fields, size = _read_header(file)
    return fields, _read_exactly(file, size)


def _read_header(file: BinaryIO) -> tuple[dict[bytes, bytes], int]:
    """Header fields of the next record, and the size of the data that follow."""
    (header_size,) = struct.unpack("<I", _read_exactly(file, 4))
    fields = _parse_fields(_read_exactly(file, header_size))
    (data_size,) = struct.unpack("<I", _read_exactly(file, 4))
    return fields, data_size


def _read_exactly(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) != size:
        raise _CutOffError
    return data


def _parse_fields(data: bytes) -> dict[bytes, bytes]:
    fields, position = {}, 0
    while position < len(data):
        if position + 4 > len(data):
            raise _CutOffError
        (size,) = struct.unpack_from("<I", data, position)
        name, separator, value = data[position + 4 : position + 4 + size].partition(b"=")
        if not separator or position + 4 + size > len(data):
            raise _CutOffError
        fields[name] = value
        position += 4 + size
    return fields


def _number(fields: dict[bytes, bytes], name: bytes, layout: str) -> int:
    try:
        return int(struct.unpack(layout, fields[name])[0])
    except (KeyError, struct.error) as error:
        raise _CutOffError from error


def _time_ns(fields: dict[bytes, bytes]) -> int:
    try:
        seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
    except (KeyError, struct.error) as error:
        raise _CutOffError from error
    return int(seconds) * 10**9 + int(nanoseconds)
