"""ROS 1 bags (format 2.0): raw and compressed images, lz4 and bz2 chunks, complete or truncated files.

Messages are found by walking through the file's chunks. The walk needs no index, so it also reads the intact
part of a bag that was truncated or never closed. In chunks without compression the walk reads only the
headers of records. Afterwards messages can be read in any order. The package rosbags reads no bag without an
index. Layout: http://wiki.ros.org/Bags/Format/2.0.
"""

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, ClassVar

from kinectbench.core import UNPACKED_BYTES, RecordingError, open_plain, read_head, size_of
from kinectbench.stages.ingest.bags.message_decoding import (
    DEFINITION_BYTES,
    LONGEST_NAME,
    BagTopic,
    DamagedRecordError,
    FoundMessages,
    RosBag,
    unpacked_chunk,
)
from kinectbench.stages.ingest.bags.ros_recording import RosRecording
from kinectbench.stages.ingest.bags.walk_limits import BagReader, WalkBudget

MAGIC = b"#ROSBAG V2.0\n"
# Numbers of records in version 2.0 of the format.
OP_MESSAGE, OP_CHUNK, OP_CONNECTION = 2, 5, 7


class Rosbag1Recording(RosRecording):
    """A ROS 1 bag; integer depth is in millimetres, float depth in metres."""

    format: ClassVar[str] = "rosbag1"
    looks_for: ClassVar[str] = "a file that begins with '#ROSBAG V2.0'"
    suffixes: ClassVar[tuple[str, ...]] = (".bag", ".bag.active")
    verified: ClassVar[str] = "files written by rosbags; a bag with tf by ROS"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the file starts like a bag, whatever its suffix."""
        if not path.is_file():
            return False
        return read_head(path, len(MAGIC)) == MAGIC

    @classmethod
    def walk(cls, path: Path) -> RosBag:
        """Walk through the bag's records and chunks, and note where the messages are."""
        reader = BagReader(path, _chunk_at)
        with open_plain(path) as file:
            found, budget = FoundMessages(cls.wanted), WalkBudget(size_of(file))
            walk = _Walk(found, cls.own_types, reader.keep, budget)
            complete = walk.take_all(file, path)
        topics = found.topics()
        count = sum(len(topic.messages) for topic in topics)
        reader.start_reading(count)
        if complete and not walk.damaged_chunks:
            return RosBag(path, topics, reader)
        what = "is damaged" if complete else "is cut off or has no index"
        if not count:
            raise RecordingError(f"{path}: {what}, and nothing in it can be saved; copy it again")
        trouble = (
            f"{path}: {what}: {count} messages of {walk.chunks - walk.damaged_chunks} whole chunks were "
            f"saved ({walk.damaged_chunks} chunks are damaged); copy it again, or run `rosbag reindex`"
        )
        return RosBag(path, topics, reader, trouble)


@dataclass
class _Walk:
    """The state of a walk through a bag: the messages found, and the number of damaged chunks.

    Attributes:
        found: the messages.
        own_types: types whose definitions are taken from the bag, not from the standard.
        keep: called with the position and the bytes of each unpacked chunk.
        budget: limits of the walk.
        chunks: number of complete chunks.
        damaged_chunks: number of these chunks with a damaged part.
    """

    found: FoundMessages
    own_types: frozenset[str]
    keep: Callable[[int, bytes], None]
    budget: WalkBudget
    chunks: int = 0
    damaged_chunks: int = 0

    def take_all(self, file: BinaryIO, path: Path) -> bool:
        """Walk through the file; return whether every record is whole and the file has an index.

        The walk ends at the first damaged record that is not in a complete chunk.

        Raises:
            RecordingError: the bag is encrypted.
        """
        size = size_of(file)
        file.seek(len(MAGIC))
        try:
            fields, data_size = _read_header(file, size)
            if fields.get(b"encryptor"):
                raise RecordingError(
                    f"{path}: the bag is encrypted; record or copy it without encryption", what="unsupported"
                )
            file.seek(data_size, os.SEEK_CUR)
            while file.tell() < size:
                self.take_record(file, size)
            return 0 < _number(fields, b"index_pos", "<Q") < size
        except DamagedRecordError:
            return False

    def take_record(self, file: BinaryIO, end: int) -> None:
        """Read the next record (chunk, connection or message), which must end before `end`, or skip it."""
        position = file.tell()
        fields, size = _read_header(file, end)
        op = _number(fields, b"op", "<B")
        start = file.tell()
        if op == OP_CHUNK:
            self._take_chunk(file, position, fields, size, end)
            return
        if start + size > end:
            raise DamagedRecordError
        # A bag that was never closed may contain the records of its last chunk outside a chunk.
        self._take(fields, file, start, size, chunk=-1)
        file.seek(start + size)

    def _take_chunk(
        self, file: BinaryIO, position: int, fields: dict[bytes, bytes], size: int, end: int
    ) -> None:
        start = file.tell()
        if fields.get(b"compression") == b"none":
            # Take the complete messages of a truncated chunk.
            try:
                for inner, offset, length in _records_of(file, min(start + size, end)):
                    self._take(inner, file, offset, length, chunk=-1)
            except DamagedRecordError:
                self.damaged_chunks += start + size <= end
            if start + size > end:
                raise DamagedRecordError
            self.chunks += 1
            file.seek(start + size)
            return
        data = _read_exactly(file, size, end)
        self.chunks += 1
        try:
            self.budget.take_bytes(_number(fields, b"size", "<I"))
            chunk = _decompress(fields, data)
            self.keep(position, chunk)
            unpacked = BytesIO(chunk)
            for inner, offset, length in _records_of(unpacked, len(chunk)):
                self._take(inner, unpacked, offset, length, chunk=position)
        except DamagedRecordError:
            self.damaged_chunks += 1

    def _take(self, fields: dict[bytes, bytes], file: BinaryIO, offset: int, size: int, chunk: int) -> None:
        self.budget.take_record()
        op = _number(fields, b"op", "<B")
        if op == OP_CONNECTION:
            if size > DEFINITION_BYTES:
                raise DamagedRecordError
            file.seek(offset)
            self._take_connection(fields, file.read(size))
        elif op == OP_MESSAGE:
            file.seek(offset)
            connection = _number(fields, b"conn", "<I")
            seconds, nanoseconds = _values(fields, b"time", "<II")
            recorded_ns = seconds * 10**9 + nanoseconds
            self.found.take(connection, file, recorded_ns, (chunk, offset, size))

    def _take_connection(self, fields: dict[bytes, bytes], data: bytes) -> None:
        more = _parse_fields(data)
        values = (fields.get(b"topic", b""), more.get(b"type", b""), more.get(b"message_definition", b""))
        topic, type_, definition = (value.decode(errors="replace") for value in values)
        if max(len(topic), len(type_)) > LONGEST_NAME:
            raise DamagedRecordError
        own = definition if type_ in self.own_types else ""
        self.found.connections[_number(fields, b"conn", "<I")] = BagTopic(topic, type_, "ros1", own)


def _records_of(file: BinaryIO, end: int) -> Iterator[tuple[dict[bytes, bytes], int, int]]:
    """Yield the records up to `end`: header fields, position of the data, and size of the data."""
    position = file.tell()
    while position < end:
        file.seek(position)
        fields, size = _read_header(file, end)
        offset = file.tell()
        if offset + size > end:
            raise DamagedRecordError
        yield fields, offset, size
        position = offset + size


def _decompress(fields: dict[bytes, bytes], data: bytes) -> bytes:
    """Unpack the bytes of a chunk, by the compression in its header fields."""
    kind = fields.get(b"compression", b"").decode(errors="replace")
    return data if kind == "none" else unpacked_chunk(kind, data, _number(fields, b"size", "<I"))


def _chunk_at(file: BinaryIO, position: int) -> bytes:
    """Unpack the chunk whose record starts at `position`."""
    end = file.seek(0, os.SEEK_END)
    file.seek(position)
    fields, size = _read_header(file, end)
    return _decompress(fields, _read_exactly(file, size, end))


def _read_header(file: BinaryIO, end: int) -> tuple[dict[bytes, bytes], int]:
    """Read the header fields of the next record, and the size of its data."""
    (header_size,) = struct.unpack("<I", _read_exactly(file, 4, end))
    if header_size > DEFINITION_BYTES:
        raise DamagedRecordError
    fields = _parse_fields(_read_exactly(file, header_size, end))
    (data_size,) = struct.unpack("<I", _read_exactly(file, 4, end))
    return fields, data_size


def _read_exactly(file: BinaryIO, size: int, end: int) -> bytes:
    """Read `size` bytes, up to `end` at most; a damaged size is refused before memory is allocated."""
    if file.tell() + size > end or size > UNPACKED_BYTES:
        raise DamagedRecordError
    return file.read(size)


def _parse_fields(data: bytes) -> dict[bytes, bytes]:
    fields, position = {}, 0
    while position < len(data):
        if position + 4 > len(data):
            raise DamagedRecordError
        (size,) = struct.unpack_from("<I", data, position)
        name, separator, value = data[position + 4 : position + 4 + size].partition(b"=")
        if not separator or position + 4 + size > len(data):
            raise DamagedRecordError
        fields[name] = value
        position += 4 + size
    return fields


def _values(fields: dict[bytes, bytes], name: bytes, layout: str) -> tuple[int, ...]:
    """Unpack the numbers in the header field `name`; `layout` is a format of `struct`."""
    try:
        return struct.unpack(layout, fields[name])
    except (KeyError, struct.error) as error:
        raise DamagedRecordError from error


def _number(fields: dict[bytes, bytes], name: bytes, layout: str) -> int:
    return _values(fields, name, layout)[0]
