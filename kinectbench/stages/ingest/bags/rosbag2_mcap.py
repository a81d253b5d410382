"""Find the messages of an mcap file by walking through its records; a truncated file gives its intact part.

Layout: https://mcap.dev/spec. Of the summary at the end only the channels are read, because the chunks that
define them may be damaged. The package mcap is not used: it unpacks lz4 chunks of any size, and does not say
where a message is stored.
"""

import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from kinectbench.core import UNPACKED_BYTES, RecordingError, open_plain, size_of
from kinectbench.stages.ingest.bags.message_decoding import (
    DEFINITION_BYTES,
    LONGEST_NAME,
    BagTopic,
    DamagedRecordError,
    Encoding,
    FoundMessages,
    RosBag,
    short_type,
    unpacked_chunk,
)
from kinectbench.stages.ingest.bags.walk_limits import BagReader, WalkBudget

MAGIC = b"\x89MCAP0\r\n"
# Numbers of records in the MCAP specification.
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 2, 3, 4, 5, 6
RECORD = struct.Struct("<BQ")
# channel, sequence, log time, publish time
MESSAGE_HEAD = struct.Struct("<HIQQ")
# first and last log time, unpacked size, checksum
CHUNK_HEAD = struct.Struct("<QQQI")
# Largest ratio of unpacked to packed size: no image shrinks more; a chunk that states more is damaged.
MAX_RATIO = 2000
ENCODINGS: dict[str, Encoding] = {"cdr": "cdr", "ros1": "ros1"}


def walk_mcap(path: Path, types: frozenset[str], budget: WalkBudget) -> RosBag:
    """Find the messages of the wanted types (ROS 1's spelling) in an mcap file, within `budget`.

    Raises:
        RecordingError: the topics are serialised in an unreadable way.
    """
    reader = BagReader(path, _chunk_at)
    walked = _Walk(types, reader.keep, budget)
    with open_plain(path) as file:
        size = size_of(file)
        file.seek(len(MAGIC))
        try:
            complete = walked.take_all(file, len(MAGIC), size, chunk=-1)
        except DamagedRecordError:
            complete = False
    topics = walked.found.topics()
    count = sum(len(topic.messages) for topic in topics)
    reader.start_reading(count)
    if walked.unknown and not topics:
        raise RecordingError(
            f"{path}: its messages are encoded as {', '.join(sorted(walked.unknown))}; only cdr (ROS 2) and "
            "ros1 can be read",
            what="unsupported",
        )
    trouble = ""
    if not complete or walked.damaged_chunks:
        trouble = (
            f"{path}: is {'damaged' if complete else 'cut off'}: {count} messages were saved "
            f"({walked.damaged_chunks} chunks are damaged); copy it again, or run `mcap recover`"
        )
    return RosBag(path, topics, reader, trouble)


class _Walk:
    """A walk through an mcap file; `found`: its messages, `unknown`: encodings of topics it cannot read."""

    def __init__(self, types: frozenset[str], keep: Callable[[int, bytes], None], budget: WalkBudget) -> None:
        self.budget = budget
        self.found = FoundMessages(types)
        self.unknown: set[str] = set()
        self.damaged_chunks = 0
        self._schemas: dict[int, str] = {}
        self._keep = keep

    def take_all(
        self, file: BinaryIO, start: int, end: int, chunk: int = -1, *, nested: bool = False
    ) -> bool:
        """Take the records from `start` to `end`; return whether there was a footer.

        `chunk` is the position of the unpacked chunk's record; -1: `file` is the file itself.
        """
        position = start
        while position + RECORD.size <= end:
            file.seek(position)
            self.budget.take_record()
            kind, size = RECORD.unpack(file.read(RECORD.size))
            body = position + RECORD.size
            if body + size > end or not kind:  # no record is of kind 0
                if kind == CHUNK:
                    self.damaged_chunks += 1
                raise DamagedRecordError
            if kind == FOOTER:
                return True
            if kind == MESSAGE:
                self._take_message(file, body, size, chunk)
            elif kind == CHUNK and not nested:
                self._take_chunk(file, body, size)
            elif kind in (SCHEMA, CHANNEL):
                self._take_definition(kind, file.read(min(size, DEFINITION_BYTES + 1)))
            position = body + size
        return False

    def _take_definition(self, kind: int, data: bytes) -> None:
        if len(data) > DEFINITION_BYTES:
            raise DamagedRecordError
        try:
            (number,) = struct.unpack_from("<H", data)
            if kind == SCHEMA:
                self._schemas[number] = _name(data, 2)[0]
                return
            (schema,) = struct.unpack_from("<H", data, 2)
            topic, position = _name(data, 4)
            encoding, _ = _name(data, position)
        except (struct.error, UnicodeDecodeError) as error:
            raise DamagedRecordError from error
        type_ = short_type(self._schemas.get(schema, ""))
        if encoding not in ENCODINGS:
            self.unknown.add(encoding)
            type_ = ""
        self.found.connections[number] = BagTopic(topic, type_, ENCODINGS.get(encoding, "cdr"))

    def _take_message(self, file: BinaryIO, body: int, size: int, chunk: int) -> None:
        if size < MESSAGE_HEAD.size:
            raise DamagedRecordError
        channel, _, log_ns, _ = MESSAGE_HEAD.unpack(file.read(MESSAGE_HEAD.size))
        # The chunk with its channel may be damaged; then the summary repeats the channel.
        self.found.take(channel, file, log_ns, (chunk, body + MESSAGE_HEAD.size, size - MESSAGE_HEAD.size))

    def _take_chunk(self, file: BinaryIO, body: int, size: int) -> None:
        try:
            parts = _chunk_parts(file, body + size)
            if not parts.compression:
                self.take_all(file, parts.start, parts.start + parts.length, nested=True)
                return
            self.budget.take_bytes(parts.unpacked_size)
            data = _unpack_chunk(file, parts)
            self._keep(body - RECORD.size, data)
            self.take_all(BytesIO(data), 0, len(data), chunk=body - RECORD.size, nested=True)
        except DamagedRecordError:
            self.damaged_chunks += 1


class _ChunkParts(NamedTuple):
    """Parts of a chunk: compression, unpacked size, and position and size of its records, bytes."""

    compression: str
    unpacked_size: int
    start: int
    length: int


def _string(data: bytes, position: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", data, position)
    end = position + 4 + size
    if end > len(data):
        raise DamagedRecordError
    return data[position + 4 : end].decode(), end


def _name(data: bytes, position: int) -> tuple[str, int]:
    """Read a string at a byte position: (string, its end). A long one is refused, to limit memory."""
    name, end = _string(data, position)
    if len(name) > LONGEST_NAME:
        raise DamagedRecordError
    return name, end


def _chunk_parts(file: BinaryIO, end: int) -> _ChunkParts:
    """Return the parts of the chunk whose body starts at the file's position and ends at `end`."""
    start = file.tell()
    data = file.read(min(end - start, CHUNK_HEAD.size + 64))
    try:
        _, _, unpacked_size, _ = CHUNK_HEAD.unpack_from(data)
        compression, position = _string(data, CHUNK_HEAD.size)
        (length,) = struct.unpack_from("<Q", data, position)
    except (UnicodeDecodeError, struct.error) as error:
        raise DamagedRecordError from error
    if start + position + 8 + length > end:
        raise DamagedRecordError
    return _ChunkParts(compression, unpacked_size, start + position + 8, length)


def _unpack_chunk(file: BinaryIO, parts: _ChunkParts) -> bytes:
    if parts.unpacked_size > MAX_RATIO * max(parts.length, 1) or parts.length > UNPACKED_BYTES:
        raise DamagedRecordError
    file.seek(parts.start)
    return unpacked_chunk(parts.compression, file.read(parts.length), parts.unpacked_size)


def _chunk_at(file: BinaryIO, position: int) -> bytes:
    """Unpack the chunk whose record starts at `position`."""
    file.seek(position)
    _, size = RECORD.unpack(file.read(RECORD.size))
    return _unpack_chunk(file, _chunk_parts(file, file.tell() + size))
