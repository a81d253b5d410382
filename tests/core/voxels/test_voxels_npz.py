"""npz files of strangers: counted and bounded before they are unpacked, refused in a line otherwise."""

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bounds import within

from kinectbench.core.voxels.npy import NpyError, read_npy
from kinectbench.core.voxels.npz import UNREADABLE, arrays_of, npz_bytes, open_npz, packed_npz_bytes

GRID = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asarray(array))
    return buffer.getvalue()


def zipped(entries: list[tuple[str, bytes]], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, content in entries:
            archive.writestr(name, content)
    return buffer.getvalue()


def flagged(content: bytes, flags: int) -> bytes:
    """A zip whose entries have flag bits set, in their own headers and in the directory."""
    changed = bytearray(content)
    for signature, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        at = changed.find(signature)
        while at >= 0:
            struct.pack_into("<H", changed, at + offset, flags)
            at = changed.find(signature, at + 4)
    return bytes(changed)


def lying(count: int, entries: int) -> bytes:
    """A zip whose end says fewer files than its directory lists."""
    content = bytearray(zipped([(f"{i}.npy", b"") for i in range(entries)]))
    struct.pack_into("<2H", content, len(content) - 14, count, count)
    return bytes(content)


@pytest.mark.parametrize("writer", [npz_bytes, packed_npz_bytes])
def test_own_files_are_read_as_they_were(writer: Callable[..., bytes]) -> None:
    arrays = {
        "grid": GRID,
        "text": np.asarray("winding"),
        "scale": np.asarray(0.005),
        "none": np.zeros((0, 3)),
    }
    read = arrays_of(io.BytesIO(writer(arrays)), 1 << 20)
    assert list(read) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], array)
        assert read[name].dtype == array.dtype and read[name].flags.writeable
    assert list(arrays_of(io.BytesIO(writer(arrays)), 1 << 20, ["text"])) == ["text"]


def test_numpys_files_are_read() -> None:
    for save in (np.savez, np.savez_compressed):
        buffer = io.BytesIO()
        save(buffer, grid=np.asfortranarray(GRID), large=GRID.astype(">f4"))
        read = arrays_of(buffer, 1 << 20)
        np.testing.assert_array_equal(read["grid"], GRID)
        np.testing.assert_array_equal(read["large"], GRID)
        assert read["grid"].flags.c_contiguous


def claiming(shape: str, descr: str = "'|u1'") -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header


TWICE = zipped([("a.npy", npy(GRID)), ("b.npy", npy(GRID))]).replace(b"b.npy", b"a.npy")
BAD: dict[str, tuple[bytes | Callable[[], bytes], str]] = {
    "a single array": (npy(GRID), "a single array, not an npz"),
    "nothing": (b"", "not a zip file"),
    "a path": (zipped([("../a.npy", npy(GRID))]), "'../a.npy' is not an array"),
    "a folder": (zipped([("sub/a.npy", npy(GRID))]), "'sub/a.npy' is not an array"),
    "a backslash": (zipped([("a\\b.npy", npy(GRID))]), "is not an array"),
    "control characters": (zipped([("a\x1b[2J.npy", npy(GRID))]), r"'a\?\[2J.npy' is not an array"),
    "another file": (zipped([("a.txt", b"hello")]), "'a.txt' is not an array"),
    "an array twice": (TWICE, "'a.npy' is there twice"),
    "encrypted": (flagged(zipped([("a.npy", npy(GRID))]), 1), "encrypted"),
    "bz2": (zipped([("a.npy", npy(GRID))], zipfile.ZIP_BZIP2), "an uncommon compression"),
    "lzma": (zipped([("a.npy", npy(GRID))], zipfile.ZIP_LZMA), "an uncommon compression"),
    "too many": (zipped([(f"{i}.npy", b"") for i in range(65)]), "65 files in it; 64 is the most accepted"),
    "more than its end says": (lying(3, 60), "its end says 3 files, its directory 60"),
    "a large directory": (lambda: lying(3, 40000), "a directory of [0-9]+ bytes, too large for 64 files"),
    "10^15 cells": (zipped([("a.npy", claiming("(100000, 100000, 100000)"))]), "claims 10{13}88"),
    "texts of no length": (zipped([("a.npy", claiming("(10**15,)", "'<U0'"))]), "malformed|not accepted"),
    "no text": (zipped([("a.npy", claiming("(1000000000000,)", "'<U0'"))]), "dtype '<U0' is not accepted"),
    "objects": (zipped([("a.npy", claiming("(1,)", "'|O'"))]), "pickled Python objects"),
    "nested header": (zipped([("a.npy", claiming("(" * 4000))]), "malformed npy header"),
    "many signs": (zipped([("a.npy", claiming("-" * 9000 + "1"))]), "malformed npy header"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_refused(name: str) -> None:
    made, line = BAD[name]
    content = made() if callable(made) else made
    with within(10, 32), pytest.raises(UNREADABLE, match=line):
        arrays_of(io.BytesIO(content), 1 << 20)


def bomb(megabytes: int, claimed: int | None = None) -> bytes:
    """An array of many zeros, whose entry may claim to be small."""
    content = bytearray(zipped([("full.npy", npy(np.zeros(megabytes << 20, np.uint8)))]))
    if claimed is not None:
        struct.pack_into("<I", content, content.rindex(b"PK\1\2") + 24, claimed)
    return bytes(content)


def test_a_bomb_is_not_unpacked() -> None:
    content, little = bomb(40), bomb(40, claimed=1000)
    assert len(content) < 1 << 17
    with within(5, 16), pytest.raises(NpyError, match="claims to unpack to 41943168 bytes; 16777216 is"):
        arrays_of(io.BytesIO(content), 16 << 20)
    # What claims little is read no further than that.
    with within(5, 16), pytest.raises(zipfile.BadZipFile, match="Bad CRC"):
        arrays_of(io.BytesIO(little), 16 << 20)


def test_a_million_entries_are_counted_not_listed(tmp_path: Path) -> None:
    """The directory of a million entries, which zipfile would take seconds and half a gigabyte to list."""
    row = b"PK\1\2" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"a"
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 10**6 * len(row), 0, 0)
    with (tmp_path / "many.npz").open("w+b") as file:
        file.write(row * 10**6 + end)
        with within(2, 1), pytest.raises(NpyError, match="65535 files in it"):
            open_npz(file, 1 << 20)
        # The same with an end record for large files.
        file.seek(-len(end), 2)
        large = struct.pack("<4sQ2H2L4Q", b"PK\6\6", 44, 45, 45, 0, 0, 10**6, 10**6, 10**6 * len(row), 0)
        file.write(large + struct.pack("<4sLQL", b"PK\6\7", 0, 10**6 * len(row), 1) + end)
        with within(2, 1), pytest.raises(NpyError, match="1000000 files in it"):
            open_npz(file, 1 << 20)


@pytest.mark.parametrize("cut", [1, 10, 22, 60, 100])
def test_what_is_cut_short_is_refused(cut: int) -> None:
    with pytest.raises(UNREADABLE):
        arrays_of(io.BytesIO(npz_bytes({"grid": GRID})[:-cut]), 1 << 20)


def test_a_comment_at_the_end_is_no_harm() -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a.npy", npy(GRID))
        archive.comment = b"made by hand"
    np.testing.assert_array_equal(arrays_of(buffer, 1 << 20)["a"], GRID)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize(
    ("point", "is_text"), [(0x10FFFF, True), (0x110000, False), (0xD7FF, True), (0xDFFF, False)]
)
def test_texts_are_of_characters(order: str, point: int, is_text: bool) -> None:
    content = npy(np.asarray("ab").astype(f"{order}U2"))[:-4] + struct.pack(f"{order}I", point)
    file = io.BytesIO(zipped([("text.npy", content)]))
    if is_text:
        assert arrays_of(file, 1 << 20)["text"].item() == "a" + chr(point)
    else:
        with pytest.raises(NpyError, match="no characters"):
            arrays_of(file, 1 << 20)


def test_bytes_in_memory_are_read_where_they_lie_and_bytes_of_others_are_copied() -> None:
    mine = io.BytesIO(bytes(bytearray(npy(GRID))))
    array = read_npy(mine, len(npy(GRID)))
    with pytest.raises(BufferError):  # the array is a view of it
        mine.write(b"more of it" * 100)
    array[:] = 0  # nobody else has it
    held = npy(GRID)
    read_npy(io.BytesIO(held), len(held))[:] = 0
    assert held == npy(GRID)


def test_an_array_in_memory_is_aligned() -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }\n"
    content = b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + np.array([1.5, 2.5]).tobytes()
    array = read_npy(io.BytesIO(content), len(content))
    assert array.tolist() == [1.5, 2.5] and array.flags.aligned and array.flags.writeable


@pytest.mark.parametrize(("change", "line"), [(-1, "cut short"), (1, "longer than it claims")])
def test_a_wrong_length_in_memory(change: int, line: str) -> None:
    content = npy(GRID)
    size = len(content)
    changed = content[:change] if change < 0 else content + bytes(change)
    for said in (size, size + change):  # whatever the archive says
        with pytest.raises(NpyError, match=line):
            read_npy(io.BytesIO(changed), said)
