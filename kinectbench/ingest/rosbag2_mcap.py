"""The messages of an mcap file, found by walking its records; a file that was cut off gives what is whole.

Layout: https://mcap.dev/spec. The summary at the end is not needed.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from kinectbench.errors import RecordingError
from kinectbench.ingest.ros_messages import (
    ChunkCache,
    Encoding,
    MessagePlace,
    RosBag,
    header_stamp_ns,
    joined_topics,
    short_type,
)
from kinectbench.ingest.zstd_message import ZSTD_MAGIC, unpacked_message

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 2, 3, 4, 5, 6
RECORD = struct.Struct("<BQ")
# channel, sequence, log time, publish time
MESSAGE_HEAD = struct.Struct("<HIQQ")
# first and last log time, unpacked size, checksum
CHUNK_HEAD = struct.Struct("<QQQI")
PEEK = 16
# No image shrinks more than this; a chunk that says so is damaged.
MAX_RATIO = 2000
ENCODINGS: dict[str, Encoding] = {"cdr": "cdr", "ros1": "ros1"}


class _DamagedError(Exception):
    """A record that is not whole or does not make sense."""


def walk(path: Path, types: frozenset[str]) -> RosBag:
    """Find the messages of the wanted types.

    Raises:
        RecordingError: the topics are serialised in a way that cannot be read.
    """
    reader = _Reader(path)
    found = _Found(types, reader.keep)
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        try:
            complete = found.take_all(file, len(MAGIC), size, chunk=-1)
        except _DamagedError:
            complete = False
    if found.unknown and not found.messages:
        raise RecordingError(
            f"{path}: its messages are encoded as {', '.join(sorted(found.unknown))}; only cdr (ROS 2) and "
            "ros1 can be read"
        )
    topics, backwards = joined_topics(found.topics())
    count = sum(len(topic.messages) for topic in topics)
    trouble = ""
    if not complete or found.damaged_chunks:
        trouble = (
            f"{path}: is {'damaged' if complete else 'cut off'}: {count} messages were saved "
            f"({found.damaged_chunks} chunks are damaged); copy it again, or run `mcap recover`"
        )
    return RosBag(topics, reader, trouble, backwards)


class _Reader:
    """Reads single messages."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._chunk = ChunkCache(self._unpacked)
        self.keep = self._chunk.keep

    def __call__(self, place: MessagePlace) -> bytes:
        if place.chunk >= 0:
            return self._chunk(place.chunk)[place.offset : place.offset + place.size]
        with self._path.open("rb") as file:
            file.seek(place.offset)
            return file.read(place.size)

    def _unpacked(self, position: int) -> bytes:
        with self._path.open("rb") as file:
            file.seek(position)
            _, size = RECORD.unpack(file.read(RECORD.size))
            return _unpack_chunk(file, _chunk_parts(file, file.tell() + size))


@dataclass
class _Found:
    """What has been met so far."""

    types: frozenset[str]
    keep: Callable[[int, bytes], None]
    schemas: dict[int, str] = field(default_factory=dict)
    channels: dict[int, tuple[str, str, Encoding]] = field(default_factory=dict)
    messages: dict[int, list[MessagePlace]] = field(default_factory=dict)
    unknown: set[str] = field(default_factory=set)
    damaged_chunks: int = 0

    def topics(self) -> Iterator[tuple[str, str, Encoding, str, list[MessagePlace]]]:
        """Name, type, encoding, definition and messages of each channel that has some."""
        for channel, places in self.messages.items():
            name, type_, encoding = self.channels[channel]
            yield name, type_, encoding, "", places

    def take_all(
        self, file: BinaryIO, start: int, end: int, chunk: int = -1, *, nested: bool = False
    ) -> bool:
        """Take the records from start to end; whether a footer was among them.

        Args:
            file: the file, or the unpacked chunk.
            start: where the first record lies in it.
            end: where the last ends.
            chunk: position of the unpacked chunk's record; -1: `file` is the file.
            nested: they are the records of a chunk.
        """
        position = start
        while position + RECORD.size <= end:
            file.seek(position)
            kind, size = RECORD.unpack(file.read(RECORD.size))
            body = position + RECORD.size
            if body + size > end:
                if kind == CHUNK:
                    self.damaged_chunks += 1
                raise _DamagedError
            if kind == FOOTER:
                return True
            if kind == MESSAGE:
                self._take_message(file, body, size, chunk)
            elif kind == CHUNK and not nested:
                self._take_chunk(file, body, size)
            elif kind in (SCHEMA, CHANNEL):
                self._take_definition(kind, file.read(size))
            position = body + size
        return False

    def _take_definition(self, kind: int, data: bytes) -> None:
        try:
            (number,) = struct.unpack_from("<H", data)
            if kind == SCHEMA:
                self.schemas[number] = _string(data, 2)[0]
                return
            (schema,) = struct.unpack_from("<H", data, 2)
            topic, position = _string(data, 4)
            encoding, _ = _string(data, position)
        except (struct.error, UnicodeDecodeError) as error:
            raise _DamagedError from error
        type_ = short_type(self.schemas.get(schema, ""))
        if encoding not in ENCODINGS:
            self.unknown.add(encoding)
        elif type_ in self.types:
            self.channels[number] = (topic, type_, ENCODINGS[encoding])

    def _take_message(self, file: BinaryIO, body: int, size: int, chunk: int) -> None:
        if size < MESSAGE_HEAD.size:
            raise _DamagedError
        channel, _, log_ns, _ = MESSAGE_HEAD.unpack(file.read(MESSAGE_HEAD.size))
        if channel not in self.channels:
            return
        _, type_, encoding = self.channels[channel]
        length = size - MESSAGE_HEAD.size
        start = file.read(min(PEEK, length))
        if start.startswith(ZSTD_MAGIC):
            start = unpacked_message(start + file.read(length - len(start)))[:PEEK]
        stamp_ns = header_stamp_ns(start, type_, encoding) or log_ns
        place = MessagePlace(stamp_ns, chunk, body + MESSAGE_HEAD.size, length)
        self.messages.setdefault(channel, []).append(place)

    def _take_chunk(self, file: BinaryIO, body: int, size: int) -> None:
        try:
            parts = _chunk_parts(file, body + size)
            if not parts.compression:
                self.take_all(file, parts.start, parts.start + parts.length, nested=True)
                return
            data = _unpack_chunk(file, parts)
            self.take_all(BytesIO(data), 0, len(data), chunk=body - RECORD.size, nested=True)
            self.keep(body - RECORD.size, data)
        except _DamagedError:
            self.damaged_chunks += 1


class _ChunkParts(NamedTuple):
    """Compression, unpacked size, and position and size of the records of a chunk, bytes."""

    compression: str
    unpacked_size: int
    start: int
    length: int


def _string(data: bytes, position: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", data, position)
    end = position + 4 + size
    if end > len(data):
        raise _DamagedError
    return data[position + 4 : end].decode(), end


def _chunk_parts(file: BinaryIO, end: int) -> _ChunkParts:
    """The parts of the chunk whose body begins here and ends at `end`."""
    start = file.tell()
    data = file.read(min(end - start, CHUNK_HEAD.size + 64))
    try:
        _, _, unpacked_size, _ = CHUNK_HEAD.unpack_from(data)
        compression, position = _string(data, CHUNK_HEAD.size)
        (length,) = struct.unpack_from("<Q", data, position)
    except (UnicodeDecodeError, struct.error) as error:
        raise _DamagedError from error
    if start + position + 8 + length > end:
        raise _DamagedError
    return _ChunkParts(compression, unpacked_size, start + position + 8, length)


def _unpack_chunk(file: BinaryIO, parts: _ChunkParts) -> bytes:
    if parts.unpacked_size > MAX_RATIO * max(parts.length, 1):
        raise _DamagedError
    file.seek(parts.start)
    packed = file.read(parts.length)
    try:
        if parts.compression == "zstd":
            import zstandard

            # A stream also reads frames that do not say their size.
            return zstandard.ZstdDecompressor().stream_reader(packed).read(parts.unpacked_size)
        if parts.compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

            return bytes(LZ4FrameDecompressor().decompress(packed, max_length=max(parts.unpacked_size, 1)))
    except (zstandard_error(), RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise _DamagedError from error
    raise _DamagedError


def zstandard_error() -> type[Exception]:
    """What zstandard raises for damaged data."""
    from zstandard import ZstdError

    return ZstdError
