"""Checkpoints in TensorFlow's format, written by the plainest means: one data file, one block of index."""

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kinectbench.core.types import Float32

MAGIC = bytes.fromhex("57fb808b247547db")
# Every so many keys one is written in full.
RESTART = 16


def crc32c(data: bytes) -> int:
    """Bit by bit, for short texts."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def masked(crc: int) -> int:
    return (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF


def varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


def field(number: int, value: int | bytes) -> bytes:
    """A varint or a text of a protocol buffer; zeros are left out."""
    if isinstance(value, bytes):
        return varint(number << 3 | 2) + varint(len(value)) + value
    return varint(number << 3) + varint(value) if value else b""


def entry(shape: tuple[int, ...], offset: int, size: int, crc: int, kind: int = 1) -> bytes:
    """A BundleEntryProto."""
    axes = b"".join(field(2, field(1, count)) for count in shape)
    fixed = varint(6 << 3 | 5) + struct.pack("<I", crc)
    return field(1, kind) + field(2, axes) + field(4, offset) + field(5, size) + fixed


def block(entries: Mapping[bytes, bytes], kind: int = 0) -> bytes:
    """A block of LevelDB's tables with its trailer; keys in order."""
    out, restarts, before = b"", list[int](), b""
    for index, (key, value) in enumerate(sorted(entries.items())):
        shared = 0
        if index % RESTART == 0:
            restarts.append(len(out))
        else:
            while shared < min(len(key), len(before)) and key[shared] == before[shared]:
                shared += 1
        out += varint(shared) + varint(len(key) - shared) + varint(len(value)) + key[shared:] + value
        before = key
    out += b"".join(struct.pack("<I", place) for place in restarts or [0])
    out += struct.pack("<I", len(restarts or [0])) + bytes([kind])
    return out + struct.pack("<I", masked(crc32c(out)))


def table(entries: Mapping[bytes, bytes], kind: int = 0) -> bytes:
    """A whole index file."""
    first = block(entries, kind)
    meta = block({})
    meta_at = len(first)
    root = block({b"zzz": varint(0) + varint(len(first) - 5)})
    root_at = meta_at + len(meta)
    handles = varint(meta_at) + varint(len(meta) - 5) + varint(root_at) + varint(len(root) - 5)
    return first + meta + root + handles.ljust(40, b"\0") + MAGIC


def write_bundle(folder: Path, tensors: Mapping[str, Float32], name: str = "model.cptk") -> Path:
    """Write `<name>.index` and its data file; returns the index."""
    from kinectbench.networks.tensor_bundle import masked_crc32c

    folder.mkdir(parents=True, exist_ok=True)
    entries = {b"": field(1, 1) + field(3, field(1, 1))}
    data = b""
    for key in sorted(tensors):
        content = np.asarray(tensors[key], "<f4").tobytes()
        entries[key.encode()] = entry(tensors[key].shape, len(data), len(content), masked_crc32c(content))
        data += content
    (folder / f"{name}.index").write_bytes(table(entries))
    (folder / f"{name}.data-00000-of-00001").write_bytes(data)
    return folder / f"{name}.index"
