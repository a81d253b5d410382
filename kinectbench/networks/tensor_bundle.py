"""Read a TensorFlow checkpoint without TensorFlow: `<name>.index` (a table) and `<name>.data-…` (raw values).

Source of the formats: TensorFlow's tensor_bundle.proto and LevelDB's table_format.md. Only uncompressed index
blocks are supported, as TensorFlow writes them, and only little-endian float32 values.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinectbench.core import StorageError, open_plain, printable, read_plain, size_of
from kinectbench.core.types import Float32

MAGIC = bytes.fromhex("57fb808b247547db")
FOOTER_BYTES, TRAILER_BYTES = 48, 5
# Limits: the released network's index has 4 KB, its longest key 16 bytes and its longest value 30 bytes.
MOST_INDEX_BYTES, MOST_KEY_BYTES, MOST_VALUE_BYTES = 2 << 20, 4096, 4096
# Limits over all blocks, including the block that lists the others.
MOST_ENTRIES, MOST_AXES = 10_000, 8
FLOAT32 = 1
VALUE_BYTES = 4
# Wire types of a protocol buffer's fields.
VARINT, FIXED64, TEXT, FIXED32 = 0, 1, 2, 5
# Castagnoli's polynomial with its bits reversed (RFC 3720, appendix B.4); and the constant that TensorFlow
# adds to a rotated checksum (tensorflow/core/lib/hash/crc32c.h).
POLYNOMIAL = 0x82F63B78
MASK = 0xA282EAD8


@dataclass(frozen=True)
class StoredTensor:
    """Where a tensor's values are stored.

    Attributes:
        kind: TensorFlow's number of the dtype; 1 for float32.
        shape: the tensor's shape.
        shard: number of the data file.
        offset: position of the first byte in the data file.
        size: number of bytes.
        crc: masked CRC-32C of the bytes.
    """

    kind: int
    shape: tuple[int, ...]
    shard: int
    offset: int
    size: int
    crc: int


@dataclass(frozen=True)
class TensorBundle:
    """An opened checkpoint.

    Attributes:
        index: path of the checkpoint's index.
        tensors: {name of a tensor: where its values are}, in the order of the index.
        shards: number of data files.
    """

    index: Path
    tensors: Mapping[str, StoredTensor]
    shards: int

    def data_path(self, shard: int = 0) -> Path:
        """Return the path of a data file, which may not exist."""
        return self.index.with_name(f"{self.index.stem}.data-{shard:05d}-of-{self.shards:05d}")

    def read(self, name: str) -> Float32:
        """Read the values of a tensor.

        Raises:
            StorageError: the data file is missing or too short, or the values are not float32 or have a wrong
                checksum.
        """
        tensor, path = self.tensors[name], self.data_path(self.tensors[name].shard)
        if tensor.kind != FLOAT32 or tensor.size != VALUE_BYTES * math.prod(tensor.shape):
            raise StorageError(f"{self.index}: '{printable(name)}' is not float32; only that is read")
        try:
            with open_plain(path) as file:
                if tensor.offset + tensor.size > size_of(file):
                    raise StorageError(f"{path}: too short for '{printable(name)}'; get the file again")
                file.seek(tensor.offset)
                content = file.read(tensor.size)
        except OSError as error:
            problem = "missing" if isinstance(error, FileNotFoundError) else f"cannot be read ({error})"
            raise StorageError(
                f"{path}: {problem}; it holds the weights and belongs beside the index"
            ) from error
        if masked_crc32c(content) != tensor.crc:
            raise StorageError(f"{path}: the checksum of '{printable(name)}' is wrong; get the file again")
        return np.frombuffer(content, "<f4").reshape(tensor.shape)


def open_bundle(index: Path) -> TensorBundle:
    """Read the index of a checkpoint.

    Raises:
        StorageError: the index is missing, damaged, or of another kind.
    """
    try:
        return _opened(index, read_plain(index, MOST_INDEX_BYTES))
    except OSError as error:
        raise StorageError(f"{index}: cannot be read ({error.strerror or error})") from error
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise StorageError(f"{index}: no index of a TensorFlow checkpoint ({error})") from error


def _opened(index: Path, content: bytes) -> TensorBundle:
    if len(content) < FOOTER_BYTES or content[-len(MAGIC) :] != MAGIC:
        raise ValueError("its last bytes are others")
    footer = content[-FOOTER_BYTES:]
    _, place = _handle(footer, 0)
    root, _ = _handle(footer, place)
    reader = _Reader(content)
    entries: dict[bytes, bytes] = {}
    for handle in [value for _, value in reader.entries(root)]:
        for key, value in reader.entries(_handle(handle, 0)[0]):
            if key in entries:
                raise ValueError("a key that is there twice")
            entries[key] = value
    header = _fields(entries.pop(b"")) if b"" in entries else None
    tensors = {key.decode(): _tensor(value) for key, value in entries.items()}
    if header is None:
        raise ValueError("it has no header")
    if _number(header, 2):
        raise ValueError("its values have their high bytes first; only the other order is read")
    shards = _number(header, 1)
    if not tensors or not all(0 <= tensor.shard < shards for tensor in tensors.values()):
        raise ValueError("it names no tensors, or data files that there are not")
    return TensorBundle(index, tensors, shards)


class _Reader:
    """Reads the blocks of an index; refuses to read more bytes in total than the file has."""

    def __init__(self, content: bytes) -> None:
        self._content, self._bytes_left, self._entries_left = content, len(content), MOST_ENTRIES

    def entries(self, block: tuple[int, int]) -> Iterator[tuple[bytes, bytes]]:
        """Yield the keys and values of the block at (offset, size).

        A stored key lacks the prefix that it shares with the previous key; the yielded key has it.
        """
        whole, end = self._plain(*block)
        place, key = 0, b""
        while place < end:
            shared, place = _varint(whole, place)
            more, place = _varint(whole, place)
            length, place = _varint(whole, place)
            if shared > len(key) or place + more + length > end:
                raise ValueError("a block's entries do not add up")
            if shared + more > MOST_KEY_BYTES or length > MOST_VALUE_BYTES:
                raise ValueError("a key or a value that is too long")
            self._entries_left -= 1
            if self._entries_left < 0:
                raise ValueError(f"more than {MOST_ENTRIES} entries")
            key = key[:shared] + whole[place : place + more]
            yield key, whole[place + more : place + more + length]
            place += more + length

    def _plain(self, offset: int, size: int) -> tuple[bytes, int]:
        """Check the checksum of a block; return the block, and the position where its entries end."""
        whole = self._content[offset : offset + size + TRAILER_BYTES]
        if size < 4 or len(whole) != size + TRAILER_BYTES:
            raise ValueError("a block is cut off")
        self._bytes_left -= len(whole)
        if self._bytes_left < 0:
            raise ValueError("it names the same block twice")
        if whole[size]:
            raise ValueError("its blocks are compressed; only plain ones are read")
        if masked_crc32c(whole[: size + 1]) != int.from_bytes(whole[size + 1 :], "little"):
            raise ValueError("the checksum of a block is wrong")
        return whole, size - 4 - 4 * int.from_bytes(whole[size - 4 : size], "little")


def _handle(content: bytes, place: int) -> tuple[tuple[int, int], int]:
    """Read (offset, size) of a block at a position of `content`; return them and the position after them."""
    offset, place = _varint(content, place)
    size, place = _varint(content, place)
    return (offset, size), place


def _varint(content: bytes, place: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 64, 7):
        byte = content[place]
        value |= (byte & 127) << shift
        place += 1
        if byte < 128:
            return value, place
    raise ValueError("a number without end")


def _fields(content: bytes) -> dict[int, list[int | bytes]]:
    """Return {field number: its values} of a protocol buffer."""
    fields: dict[int, list[int | bytes]] = {}
    place = 0
    while place < len(content):
        tag, place = _varint(content, place)
        kind = tag & 7
        value: int | bytes
        if kind == VARINT:
            value, place = _varint(content, place)
        elif kind in (FIXED32, FIXED64):
            width = 4 if kind == FIXED32 else 8
            value, place = int.from_bytes(content[place : place + width], "little"), place + width
        elif kind == TEXT:
            length, place = _varint(content, place)
            value, place = content[place : place + length], place + length
        else:
            raise ValueError("a field of an unknown kind")
        if place > len(content):
            raise ValueError("a field is cut off")
        fields.setdefault(tag >> 3, []).append(value)
    return fields


def _number(fields: Mapping[int, list[int | bytes]], field: int) -> int:
    """Return a number field's last value; 0 if the field is missing, as protocol buffers omit zeros."""
    value = fields.get(field, [0])[-1]
    if not isinstance(value, int):
        raise ValueError("a field of another kind")
    return value


def _tensor(content: bytes) -> StoredTensor:
    """Parse a BundleEntryProto."""
    fields = _fields(content)
    if 7 in fields:
        raise ValueError("a tensor in slices; only whole ones are read")
    (shape,) = fields.get(2, [b""])[-1:]
    axes = _fields(shape).get(2, []) if isinstance(shape, bytes) else []
    sizes = [_number(_fields(axis), 1) for axis in axes if isinstance(axis, bytes)]
    if len(sizes) > MOST_AXES:
        raise ValueError("a tensor of too many axes")
    numbers = (_number(fields, field) for field in (3, 4, 5, 6))
    return StoredTensor(_number(fields, 1), tuple(sizes), *numbers)


@cache
def _table() -> NDArray[np.uint32]:
    """Return the CRC remainder of each byte value: (256,)."""
    values = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        values = np.where(values & 1, (values >> 1) ^ np.uint32(POLYNOMIAL), values >> 1).astype(np.uint32)
    return values


@njit(cache=True, nogil=True)
def _remainder(data: NDArray[np.uint8], table: NDArray[np.uint32]) -> np.uint32:
    """Return the plain CRC of some bytes (n,)."""
    crc = np.uint32(0xFFFFFFFF)
    for byte in data:
        crc = table[(crc ^ byte) & np.uint32(0xFF)] ^ (crc >> np.uint32(8))
    return crc ^ np.uint32(0xFFFFFFFF)


def masked_crc32c(data: bytes | NDArray[np.uint8]) -> int:
    """Return the CRC-32C as TensorFlow stores it: rotated by 15 bits, plus a constant.

    Source: TensorFlow's lib/hash/crc32c.h.
    """
    values = np.frombuffer(data, np.uint8)
    crc = int(_remainder(values, _table()))
    return (((crc >> 15) | (crc << 17)) + MASK) & 0xFFFFFFFF
