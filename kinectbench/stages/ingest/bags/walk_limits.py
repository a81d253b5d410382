"""Limits on the cost of walking through a bag and reading its messages."""

from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from kinectbench.core import UNPACKED_BYTES, RecordingError, open_plain, unpacked_bound
from kinectbench.stages.ingest.bags.message_decoding import DamagedRecordError, MessagePlace

# Smallest size of a bag's file per record, bytes, however well compressed; and records that are always
# allowed.
LEAST_RECORD_BYTES, ALWAYS_RECORDS = 8, 100_000
# Limits in steps of SQLite's virtual machine: a message takes about ten steps, and more than ten bytes.
ALWAYS_STEPS, STEPS_A_BYTE, STEPS_AT_ONCE = 1_000_000, 2, 10_000
# Unpacked chunks are cached up to this many bytes, and at least one chunk.
CACHED_BYTES = 64 << 20
# How often all chunks may be unpacked again before as many messages were read.
PASSES = 2


class WalkBudget:
    """Limits records, SQLite steps and unpacked bytes of a walk through a bag by the size of its files.

    Without limits, a few bytes of compressed chunks could hold any number of records.
    """

    def __init__(self, bag_bytes: int) -> None:
        """Set the limits for a bag whose files have `bag_bytes` bytes in all."""
        self._records = ALWAYS_RECORDS + bag_bytes // LEAST_RECORD_BYTES
        self._steps = ALWAYS_STEPS + bag_bytes * STEPS_A_BYTE
        self.bytes_left = unpacked_bound(bag_bytes)

    def take_record(self) -> None:
        """Count a record.

        Raises:
            DamagedRecordError: there are too many records.
        """
        self._records -= 1
        if self._records < 0:
            raise DamagedRecordError

    def take_step(self) -> bool:
        """Count `STEPS_AT_ONCE` steps of SQLite's virtual machine; return whether any are left."""
        self._steps -= STEPS_AT_ONCE
        return self._steps >= 0

    def take_bytes(self, count: int) -> None:
        """Count the unpacked size of a chunk before unpacking it.

        Raises:
            DamagedRecordError: the size is too large, alone or in sum.
        """
        if count > min(UNPACKED_BYTES, self.bytes_left):
            raise DamagedRecordError
        self.bytes_left -= count


class BagReader:
    """Reads single messages from a bag's file, and caches recently unpacked chunks.

    Messages are read in the order of their stamps, which is mostly that of their chunks. In another order
    each message might need another chunk, so the bytes that may be unpacked are limited, in proportion to the
    messages read.
    """

    def __init__(self, path: Path, unpack: Callable[[BinaryIO, int], bytes]) -> None:
        """Prepare to read the file; `unpack` returns the unpacked bytes of the chunk at a position in it."""
        self._path = path
        self._unpack = unpack
        self._chunks: dict[int, bytes] = {}
        self._whole_bytes = 0
        self._bytes_a_read = 0.0
        self._bytes_left = 0.0

    def keep(self, position: int, data: bytes) -> None:
        """Cache an unpacked chunk while there is room, because the first chunks are read first."""
        self._whole_bytes += len(data)
        if self._kept_bytes + len(data) <= CACHED_BYTES:
            self._chunks[position] = data

    def start_reading(self, messages: int) -> None:
        """Limit unpacking to `PASSES` times all chunks, plus once more for every `messages` messages read."""
        self._bytes_left = PASSES * self._whole_bytes
        self._bytes_a_read = self._whole_bytes / max(messages, 1)

    def __call__(self, place: MessagePlace) -> bytes:
        """Read a serialised message, given where it is stored.

        Raises:
            RecordingError: the same chunks would have to be unpacked again and again.
        """
        self._bytes_left += self._bytes_a_read
        if place.chunk not in self._chunks:
            if self._bytes_left < 0:
                raise RecordingError(
                    f"{self._path}: messages of one time lie in chunks far apart, and each costs a chunk: "
                    "write the bag again in the order of time, in chunks of a megabyte"
                )
            with open_plain(self._path) as file:
                if place.chunk < 0:
                    file.seek(place.offset)
                    return file.read(place.size)
                if self._kept_bytes > CACHED_BYTES:  # drop a chunk before the next is unpacked
                    self._chunks.clear()
                data = self._unpack(file, place.chunk)
            self._bytes_left -= len(data)
            while self._chunks and self._kept_bytes + len(data) > CACHED_BYTES:
                del self._chunks[next(iter(self._chunks))]
            self._chunks[place.chunk] = data
        return self._chunks[place.chunk][place.offset : place.offset + place.size]

    @property
    def _kept_bytes(self) -> int:
        return sum(map(len, self._chunks.values()))
