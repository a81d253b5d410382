"""Deterministic npz files, and readers that report faults in one line.

Bit-packed grids have a faster writer, because they are mostly long runs of equal bytes.
"""

import io
import os
import struct
import zipfile
import zlib
from collections.abc import Collection, Mapping
from functools import cache, lru_cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import IO

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import StorageError, open_plain, printable
from kinectbench.core.types import Arrays
from kinectbench.core.voxels.npy import MAGIC, NpyError, read_npy
from kinectbench.core.zip_files import DAMAGED_ZIP, open_zip

# Exceptions that are raised for files that are damaged, lack an array, or cannot be read.
UNREADABLE = (*DAMAGED_ZIP, OSError, KeyError, MemoryError)
# No npz of ours holds more than twenty arrays.
MOST_ARRAYS = 64
# Size limit of an npz of a build: the largest is the TSDF of a scene, 12 bytes a voxel.
BUILD_BYTES = 8 << 30
NPY = ".npy"
# Size limit of an entry that is inflated at once: twice the largest grid of a pair.
AT_ONCE_BYTES = 4 << 20
# A pair's grids are 14.7 MB.
REUSED_BYTES = 16 << 20
# Where an entry's head has the lengths of what follows it, a name and an extra field: APPNOTE, 4.3.7.
_LENGTHS_AT = 26


def npz_bytes(arrays: Mapping[str, NDArray[np.generic]], level: int = 6) -> bytes:
    """Serialise named arrays as a compressed npz with fixed time stamps (np.savez writes the time of day).

    Args:
        arrays: name -> array, written in this order.
        level: level of the deflate compression, 1 (fast) to 9.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=level) as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            payload = io.BytesIO()
            np.lib.format.write_array(payload, np.asarray(array, order="C"), allow_pickle=False)
            # An entry written by its ZipInfo does not take the archive's level.
            archive.writestr(entry, payload.getvalue(), compresslevel=level)
    return buffer.getvalue()


def open_npz(file: IO[bytes], most_bytes: int, most_arrays: int = MOST_ARRAYS) -> zipfile.ZipFile:
    """Open an untrusted npz; all entries are checked before unpacking.

    Entries must be plain `<name>.npy`, stored or deflated, not encrypted, and none twice. To read one, pass
    its stream and its `file_size` to `read_npy`.

    Args:
        file: open to read; it stays open.
        most_bytes: limit in bytes of its arrays together, unpacked.
        most_arrays: the largest number of arrays that it may hold.

    Raises:
        NpyError: an entry breaks one of these rules; the message says which.
        zipfile.BadZipFile: it is not an npz, or damaged.
    """
    if file.read(len(MAGIC)) == MAGIC:
        raise NpyError("a single array, not an npz")
    try:
        archive = open_zip(file, most_arrays, most_bytes)
    except ValueError as error:
        raise NpyError(str(error)) from error
    names = set[str]()
    for entry in archive.infolist():
        name = entry.filename
        if not name.endswith(NPY) or any(sign in name for sign in "/\\:") or not name.isprintable():
            raise NpyError(f"its entry '{printable(name)}' is not an array")
        if name in names:
            raise NpyError(f"its entry '{printable(name)}' is there twice")
        names.add(name)
        if entry.flag_bits & 1:
            raise NpyError("encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise NpyError("an uncommon compression")
    return archive


def load_arrays(path: Path, most_bytes: int = BUILD_BYTES) -> Arrays:
    """Read all arrays of an npz; no pickles.

    Args:
        path: the file.
        most_bytes: limit in bytes of its arrays together, unpacked.

    Raises:
        UNREADABLE: one of these exceptions, if the file is missing, damaged, no npz, or claims to unpack to
            more.
    """
    with open_plain(path) as file:
        return arrays_of(file, most_bytes)


def arrays_of(
    file: IO[bytes],
    most_bytes: int,
    names: Collection[str] | None = None,
    absent: Mapping[str, NDArray[np.generic]] | None = None,
) -> Arrays:
    """Read the named arrays of an open npz, by default all, in C order; no pickles.

    Args:
        file: open to read; it stays open.
        most_bytes: limit in bytes of its arrays together, unpacked.
        names: names of the arrays to read; the others are not unpacked.
        absent: default, by name, of arrays that the file does not hold.

    Raises:
        UNREADABLE: one of these exceptions, if it is damaged, no npz, or lacks one of the arrays.
    """
    _reuse_memory()
    with open_npz(file, most_bytes) as archive:
        entries = {entry.filename.removesuffix(NPY): entry for entry in archive.infolist()}
        instead = absent or {}
        if missing := [name for name in names or () if name not in entries and name not in instead]:
            raise NpyError(f"it holds no '{missing[0]}'")
        arrays = {}
        for name in names or entries:
            is_present = name in entries
            array = _read(file, archive, entries[name]) if is_present else instead[name]
            arrays[name] = np.asarray(array, order="C")
        return arrays


@cache
def _reuse_memory() -> None:
    """Let the C library keep up to twice `REUSED_BYTES` of freed memory for reuse.

    Fresh pages take longer than inflating: all grids of a pair are read in 5 ms, and in 10 ms without this.
    glibc goes by the largest block that was freed so far (mallopt(3), M_MMAP_THRESHOLD); others ignore it.
    """
    np.empty(REUSED_BYTES, np.uint8)


def _read(file: IO[bytes], archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[np.generic]:
    """Return the array of an entry that `open_npz` accepted; `file` is the archive's file."""
    large = max(entry.file_size, entry.compress_size) > AT_ONCE_BYTES
    if large or entry.compress_type != zipfile.ZIP_DEFLATED:
        with archive.open(entry) as stream:
            return read_npy(stream, entry.file_size)
    return read_npy(_inflated(file, archive, entry), entry.file_size)  # the array is a view of it


def _inflated(file: IO[bytes], archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> io.BytesIO:
    """Return the content of a small deflated entry, inflated in one call by zlib-ng.

    zipfile takes 2.5 times as long for the three grids that training reads (median of real pairs: 12 ms, and
    5 ms), nearly all of it in zlib.
    """
    archive.open(entry).close()  # looks at the entry's head
    file.seek(entry.header_offset + _LENGTHS_AT)
    file.seek(sum(struct.unpack("<2H", file.read(4))), os.SEEK_CUR)
    inflater = _zlib().decompressobj(-zlib.MAX_WBITS)
    try:
        content = inflater.decompress(file.read(entry.compress_size), entry.file_size + 1)
    except _zlib().error as error:
        raise zipfile.BadZipFile(str(error)) from error
    if not inflater.eof or len(content) != entry.file_size or _zlib().crc32(content) != entry.CRC:
        raise zipfile.BadZipFile(f"Bad CRC-32 for file '{printable(entry.filename)}'")
    return io.BytesIO(content)


def read_npz(path: Path) -> Arrays:
    """Read all arrays of an npz of a build.

    Raises:
        StorageError: missing or damaged.
    """
    try:
        return load_arrays(path)
    except UNREADABLE as error:
        raise StorageError(
            f"{path}: cannot be read ({error}); `kinectbench build --force` makes it again"
        ) from error


# The version that reads it, flags, deflate, and midnight of 1 January 1980.
_KIND = struct.pack("<5H", 20, 0, 8, 0, 1 << 5 | 1)
# Written on Unix, as a file that all may read.
_MADE_BY, _ATTRIBUTES = struct.pack("<H", 3 << 8 | 20), struct.pack("<3HI", 0, 0, 0, 0o644 << 16)


def packed_npz_bytes(arrays: Mapping[str, NDArray[np.generic]]) -> bytes:
    """Serialise packed grids as `npz_bytes` does, faster: deflate codes only runs of equal bytes (Z_RLE).

    On packed solids it takes two thirds of the time of deflate's level 3 for the same size. The layout is of
    PKWARE's APPNOTE, sections 4.3.7 (local header), 4.3.12 (directory) and 4.3.16 (its end).

    Args:
        arrays: name -> array, written in this order; below 4 GiB in all.
    """
    parts, directory, offset = list[bytes](), list[bytes](), 0
    for name, array in arrays.items():
        sizes, data = _entry(np.asarray(array, order="C"))
        filename = f"{name}.npy".encode()
        facts = _KIND + sizes + struct.pack("<2H", len(filename), 0)
        local = b"PK\3\4" + facts + filename
        directory += [b"PK\1\2", _MADE_BY, facts, _ATTRIBUTES, struct.pack("<I", offset), filename]
        parts += [local, data]
        offset += len(local) + len(data)
    listing = b"".join(directory)
    end = struct.pack("<4H2IH", 0, 0, len(arrays), len(arrays), len(listing), offset, 0)
    return b"".join([*parts, listing, b"PK\5\6", end])


def _entry(array: NDArray[np.generic]) -> tuple[bytes, bytes]:
    """Return an array's checksum and sizes as bytes of a zip's header, and its compressed npy file."""
    if array.dtype == np.uint8 and array.size:
        values = array.reshape(-1)
        some = values[::1021]  # they tell most grids apart at once
        if (some == values[0]).all() and (values == values[0]).all():
            return _constant_entry(array.shape, int(values[0]))
    return _deflated(array)


@lru_cache(maxsize=8)
def _constant_entry(shape: tuple[int, ...], value: int) -> tuple[bytes, bytes]:
    """Return `_entry` of an array of one value, cached: `known` has one value in most synthetic pairs."""
    return _deflated(np.full(shape, value, np.uint8))


def _deflated(array: NDArray[np.generic]) -> tuple[bytes, bytes]:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, np.lib.format.header_data_from_array_1_0(array))
    head, body = header.getvalue(), array.reshape(-1).view(np.uint8).data
    squeezer = _zlib().compressobj(1, zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)
    data = squeezer.compress(head) + squeezer.compress(body) + squeezer.flush()
    checksum = _zlib().crc32(body, _zlib().crc32(head))
    return struct.pack("<3I", checksum, len(data), len(head) + len(body)), data


@cache
def _zlib() -> ModuleType:
    """Return zlib-ng if installed (three times as fast), else zlib. With Z_RLE, both give the same bytes."""
    try:
        return import_module("zlib_ng.zlib_ng")
    except ImportError:
        return zlib
