"""The records of a ROS 1 bag (format 2.0), found by walking its chunks.

The walk needs no index, so it also reads what is whole of a bag that was cut off or never closed, and it
gives random access to single messages. Of chunks that are not compressed it reads no more than the records'
headers. Layout: http://wiki.ros.org/Bags/Format/2.0.
"""

import bz2
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from kinectbench.errors import RecordingError
from kinectbench.ingest.ros_messages import (
    BagTopic,
    ChunkCache,
    MessagePlace,
    header_stamp_ns,
    joined_topics,
)

MAGIC = b"#ROSBAG V2.0\n"
OP_MESSAGE, OP_BAG, OP_CHUNK, OP_CONNECTION = 2, 3, 5, 7
# A Header's sequence number and stamp.
PEEK = 16


@dataclass(frozen=True)
class BagContents:
    """What a walk through a bag found.

    Attributes:
        topics: those of the wanted types that have messages, sorted by name.
        chunks: number of whole chunks.
        damaged_chunks: number of chunks that do not decompress.
        complete: the file ends as it should and has an index.
        backwards: how often the stamps of a connection go back.
    """

    topics: tuple[BagTopic, ...]
    chunks: int
    damaged_chunks: int
    complete: bool
    backwards: int


class _CutOffError(Exception):
    """The file ends within a record, or does not go on with one."""


def scan_bag(
    path: Path,
    types: frozenset[str],
    own_types: frozenset[str] = frozenset(),
    keep: Callable[[int, bytes], None] | None = None,
) -> BagContents:
    """Walk through a bag and note where the messages of these types lie.

    Args:
        path: the bag.
        types: such as "sensor_msgs/Image".
        own_types: those of them whose definition is to be taken from the bag.
        keep: is given the position and the bytes of each chunk that had to be unpacked.

    Raises:
        RecordingError: not a bag of format 2.0, or encrypted.
    """
    walk = _Walk(types, keep)
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"{path}: not a ROS 1 bag of format 2.0")
        try:
            fields, data_size = _read_header(file, size)
            if fields.get(b"encryptor"):
                raise RecordingError(f"{path}: the bag is encrypted; record or copy it without encryption")
            file.seek(data_size, os.SEEK_CUR)
            complete = 0 < _number(fields, b"index_pos", "<Q") < size
            while file.tell() < size:
                walk.take_record(file, size)
        except _CutOffError:
            complete = False
    topics, backwards = walk.topics(own_types)
    return BagContents(topics, walk.chunks, walk.damaged_chunks, complete, backwards)


class BagFile:
    """Reads single messages of a bag."""

    def __init__(self, path: Path) -> None:
        """Read from this bag, which `scan_bag` has walked through."""
        self._path = path
        self._chunk = ChunkCache(self._unpacked)
        self.keep = self._chunk.keep

    def __call__(self, place: MessagePlace) -> bytes:
        """The serialised message that lies there."""
        if place.chunk < 0:
            with self._path.open("rb") as file:
                file.seek(place.offset)
                return file.read(place.size)
        return self._chunk(place.chunk)[place.offset : place.offset + place.size]

    def _unpacked(self, position: int) -> bytes:
        with self._path.open("rb") as file:
            end = file.seek(0, os.SEEK_END)
            file.seek(position)
            fields, size = _read_header(file, end)
            return _decompress(fields, _read_exactly(file, size, end))


class _Walk:
    """What has been met so far."""

    def __init__(self, types: frozenset[str], keep: Callable[[int, bytes], None] | None) -> None:
        self._keep = keep
        self.chunks = 0
        self.damaged_chunks = 0
        self._types = types
        self._connections: dict[int, tuple[str, str, str]] = {}
        self._messages: dict[int, list[MessagePlace]] = {}

    def take_record(self, file: BinaryIO, end: int) -> None:
        """Read the next record of the file, or pass over it."""
        position = file.tell()
        fields, size = _read_header(file, end)
        op = _number(fields, b"op", "<B")
        start = file.tell()
        if op == OP_CHUNK:
            self._take_chunk(file, position, fields, size, end)
            return
        if start + size > end:
            raise _CutOffError
        # A bag that was never closed can hold the records of its last chunk without the chunk.
        self._take(fields, file, start, size, chunk=-1)
        file.seek(start + size)

    def _take_chunk(
        self, file: BinaryIO, position: int, fields: dict[bytes, bytes], size: int, end: int
    ) -> None:
        start = file.tell()
        if fields.get(b"compression") == b"none":
            # Of a chunk that is cut off, what is whole is taken.
            for inner, offset, length in _records_of(file, min(start + size, end)):
                self._take(inner, file, offset, length, chunk=-1)
            if start + size > end:
                raise _CutOffError
            self.chunks += 1
            file.seek(start + size)
            return
        data = _read_exactly(file, size, end)
        self.chunks += 1
        try:
            chunk = _decompress(fields, data)
            unpacked = BytesIO(chunk)
            for inner, offset, length in _records_of(unpacked, len(chunk)):
                self._take(inner, unpacked, offset, length, chunk=position)
            if self._keep:
                self._keep(position, chunk)
        except (_CutOffError, OSError, ValueError, EOFError, RuntimeError, MemoryError):
            self.damaged_chunks += 1

    def topics(self, own_types: frozenset[str]) -> tuple[tuple[BagTopic, ...], int]:
        """The topics of the wanted types, and how often stamps go back."""
        known = ((self._connections.get(number), places) for number, places in self._messages.items())
        return joined_topics(
            (found[0], found[1], "ros1", found[2] if found[1] in own_types else "", places)
            for found, places in known
            if found is not None and found[1] in self._types
        )

    def _take(self, fields: dict[bytes, bytes], file: BinaryIO, offset: int, size: int, chunk: int) -> None:
        op = _number(fields, b"op", "<B")
        if op == OP_CONNECTION:
            file.seek(offset)
            self._take_connection(fields, file.read(size))
        elif op == OP_MESSAGE:
            connection = _number(fields, b"conn", "<I")
            known = self._connections.get(connection)
            # The connection of a message can be in a chunk that is lost, and again at the end.
            if known is None or known[1] in self._types:
                file.seek(offset)
                type_ = "" if known is None else known[1]
                stamp_ns = header_stamp_ns(file.read(min(PEEK, size)), type_, "ros1") or _time_ns(fields)
                self._messages.setdefault(connection, []).append(MessagePlace(stamp_ns, chunk, offset, size))

    def _take_connection(self, fields: dict[bytes, bytes], data: bytes) -> None:
        more = _parse_fields(data)
        values = (fields.get(b"topic", b""), more.get(b"type", b""), more.get(b"message_definition", b""))
        topic, type_, definition = (value.decode(errors="replace") for value in values)
        self._connections[_number(fields, b"conn", "<I")] = (topic, type_, definition)


def _records_of(file: BinaryIO, end: int) -> Iterator[tuple[dict[bytes, bytes], int, int]]:
    """The records from here to the end of a chunk: header fields, and position and size of the data."""
    position = file.tell()
    while position < end:
        file.seek(position)
        fields, size = _read_header(file, end)
        offset = file.tell()
        if offset + size > end:
            raise _CutOffError
        yield fields, offset, size
        position = offset + size


def _decompress(fields: dict[bytes, bytes], data: bytes) -> bytes:
    """The bytes of a chunk, no more of them than its header says."""
    size = _number(fields, b"size", "<I")
    kind = fields.get(b"compression")
    if kind == b"none":
        return data
    if kind == b"bz2":
        return bz2.BZ2Decompressor().decompress(data, max_length=max(size, 1))
    if kind == b"lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        return bytes(LZ4FrameDecompressor().decompress(data, max_length=max(size, 1)))
    raise _CutOffError


def _read_header(file: BinaryIO, end: int) -> tuple[dict[bytes, bytes], int]:
    """Header fields of the next record, and the size of the data that follow."""
    (header_size,) = struct.unpack("<I", _read_exactly(file, 4, end))
    fields = _parse_fields(_read_exactly(file, header_size, end))
    (data_size,) = struct.unpack("<I", _read_exactly(file, 4, end))
    return fields, data_size


def _read_exactly(file: BinaryIO, size: int, end: int) -> bytes:
    """Bytes of the file, once it is known to hold them: a damaged size allocates nothing."""
    if file.tell() + size > end:
        raise _CutOffError
    return file.read(size)


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
