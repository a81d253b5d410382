"""Submitted files are untrusted: each bad one gets one clear line, and nothing it claims is allocated."""

import io
import os
import pickle
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from raising import raises

from kinectbench.core.errors import PredictionError
from kinectbench.scoring.prediction_file import load_prediction

RNG = np.random.default_rng(2)
GOOD = RNG.random((6, 6, 6)).astype(np.float32)


def npy_bytes(array: NDArray[Any], **options: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, **options)
    return buffer.getvalue()


def header_bytes(descr: str, shape: str, data: bytes = b"", order: str = "False") -> bytes:
    """An npy file with any header at all."""
    text = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def zip_bytes(entries: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def changed(value: float, dtype: type[np.generic] = np.float32) -> NDArray[Any]:
    array = GOOD.astype(dtype)
    array[1, 2, 3] = value
    return array


def structured() -> NDArray[Any]:
    return np.zeros((2, 2, 2), [("a", "<f4"), ("b", "<f4")])


def objects() -> NDArray[Any]:
    return np.full((2, 2, 2), None, object)


def lying_size(claimed: int) -> bytes:
    """An npz whose directory and local header claim another unpacked size than they hold."""
    content = bytearray(zip_bytes({"a.npy": npy_bytes(GOOD)}))
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        start = content.index(signature) + offset
        content[start : start + 4] = struct.pack("<I", claimed)
    return bytes(content)


BOMB = npy_bytes(np.zeros((2,), np.float16)) + bytes(64 << 20)

HOSTILE: dict[str, tuple[str, bytes, str]] = {
    "pickle": ("npy", pickle.dumps([1.0]), "it is a pickle, which is never loaded"),
    "pickle in npz": ("npz", zip_bytes({"a.npy": pickle.dumps([1.0])}), "it is a pickle"),
    "objects": ("npy", npy_bytes(objects(), allow_pickle=True), "pickled Python objects"),
    "objects in npz": ("npz", zip_bytes({"a.npy": npy_bytes(objects())}), "pickled Python objects"),
    "structured": ("npy", npy_bytes(structured()), "a structured array"),
    "terabytes": ("npy", header_bytes("'<f4'", "(8192, 8192, 8192)"), r"shape \(8192, 8192, 8192\)"),
    "endless shape": ("npy", header_bytes("'<f4'", f"({'9' * 4000}, 1, 1)"), "shape"),
    "claims more": ("npy", header_bytes("'<f4'", "(512, 512, 512)", b"1234"), "cut short: .* claims 53687"),
    "negative shape": ("npy", header_bytes("'<f4'", "(-1, -1, -1)"), "malformed npy header"),
    "text shape": ("npy", header_bytes("'<f4'", "'abc'"), "malformed npy header"),
    "code in header": ("npy", header_bytes("__import__('os')", "(1, 1, 1)"), "malformed npy header"),
    "nested header": ("npy", header_bytes("(" * 4000, "(1, 1, 1)"), "malformed npy header"),
    "long header": ("npy", b"\x93NUMPY\x02\x00" + struct.pack("<I", 1 << 30), "header of 1073741824 bytes"),
    "header cut": ("npy", npy_bytes(GOOD)[:40], "cut short in its header"),
    "magic only": ("npy", b"\x93NUMPY", "unknown version"),
    "future version": ("npy", b"\x93NUMPY\x09\x00\x00\x00", "unknown version"),
    "unknown dtype": ("npy", header_bytes("'<q99'", "(1, 1, 1)"), "dtype '<q99' is not accepted"),
    "odd float": ("npy", header_bytes("'<f3'", "(1, 1, 1)"), "dtype '<f3' is not known"),
    "empty file": ("npy", b"", "the file is empty"),
    "empty npz": ("npz", b"", "the file is empty"),
    "not npy": ("npy", b"PLY and so on", "not an npy array"),
    "not zip": ("npz", b"PLY and so on", "damaged npz"),
    "truncated": ("npy", npy_bytes(GOOD)[:-1], "cut short"),
    "trailing": ("npy", npy_bytes(GOOD) + b"x", "longer than it claims"),
    "truncated npz": ("npz", zip_bytes({"a.npy": npy_bytes(GOOD)})[:-30], "damaged npz"),
    "no array": ("npz", zip_bytes({}), r"holds 0 arrays \(none\)"),
    "two arrays": ("npz", zip_bytes({"a.npy": npy_bytes(GOOD), "b.npy": b""}), r"holds 2 arrays \(a, b\)"),
    "not an array": ("npz", zip_bytes({"a.txt": b"hello"}), "its entry 'a.txt' is not an array"),
    "a path in it": ("npz", zip_bytes({"../../out.npy": npy_bytes(GOOD)}), "'../../out.npy' is not an array"),
    "other compression": (
        "npz",
        zip_bytes({"a.npy": b""}, zipfile.ZIP_LZMA),
        "uncommon compression",
    ),
    "zip bomb": ("npz", zip_bytes({"a.npy": BOMB}), "shape"),
    "zip claims much": ("npz", lying_size(0xF0000000), "claims to unpack to 4026531840 bytes"),
    "zip claims little": ("npz", lying_size(200), "damaged npz"),
    "NaN": ("npy", npy_bytes(changed(np.nan)), r"nan at \(1, 2, 3\): every value must be in \[0, 1\]"),
    "half NaN": ("npy", npy_bytes(changed(np.nan, np.float16)), r"nan at \(1, 2, 3\)"),
    "infinity": ("npy", npy_bytes(changed(np.inf)), r"inf at \(1, 2, 3\)"),
    "half infinity": ("npz", zip_bytes({"a.npy": npy_bytes(changed(-np.inf, np.float16))}), "-inf at"),
    "negative": ("npy", npy_bytes(changed(-0.25)), r"-0.25 at \(1, 2, 3\)"),
    "half negative": ("npy", npy_bytes(changed(-0.25, np.float16)), r"-0.25 at \(1, 2, 3\)"),
    "above one": ("npy", npy_bytes(changed(1.5)), r"1.5 at \(1, 2, 3\)"),
    "half above one": ("npy", npy_bytes(changed(1.5, np.float16)), r"1.5 at \(1, 2, 3\)"),
    "uint8 of 2": (
        "npy",
        npy_bytes(changed(2, np.uint8)),
        r"2 at \(1, 2, 3\): uint8 is .* only as 0 and 1",
    ),
    "bool of 2": (
        "npy",
        header_bytes("'|b1'", "(1, 1, 1)", b"\x02"),
        r"2 at \(0, 0, 0\): a bool is accepted only",
    ),
    "float64": ("npy", npy_bytes(GOOD.astype(np.float64)), "dtype float64 is not accepted: save float16"),
    "int64": ("npy", npy_bytes(np.ones((2, 2, 2), np.int64)), "dtype int64 is not accepted"),
    "complex": ("npy", npy_bytes(GOOD.astype(np.complex64)), "dtype complex64 is not accepted"),
    "not a cube": (
        "npy",
        npy_bytes(np.zeros((2, 2, 3), np.float32)),
        r"shape \(2, 2, 3\): it must be",
    ),
    "a channel": ("npy", npy_bytes(np.zeros((2, 2, 2, 1), np.float32)), r"shape \(2, 2, 2, 1\)"),
    "too large": ("npy", npy_bytes(np.zeros((513,) * 3, bool)[:1]), "shape"),
    "nothing": ("npy", npy_bytes(np.zeros((0, 0, 0), np.float32)), "shape"),
}


@pytest.mark.parametrize("name", list(HOSTILE))
def test_hostile_files(name: str, tmp_path: Path) -> None:
    suffix, content, message = HOSTILE[name]
    path = tmp_path / f"000.{suffix}"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(PredictionError, match=message) as caught:
            load_prediction(path, "chair_01/000")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(caught.value).startswith("chair_01/000: ")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 250
    assert peak < 16 << 20


def test_flipped_bits_never_give_a_traceback(tmp_path: Path) -> None:
    path = tmp_path / "000.npz"
    for content in (zip_bytes({"a.npy": npy_bytes(GOOD)}), npy_bytes(GOOD)):
        for suffix in ("npz", "npy"):
            path = tmp_path / f"000.{suffix}"
            for _ in range(400):
                damaged = bytearray(content)
                for position in RNG.integers(len(damaged), size=3):
                    damaged[position] ^= 1 << int(RNG.integers(8))
                path.write_bytes(
                    damaged[: int(RNG.integers(1, len(damaged) + 1))] if RNG.random() < 0.2 else damaged
                )
                try:
                    array = load_prediction(path)
                except PredictionError:
                    continue
                assert array.min() >= 0 and array.max() <= 1


def test_not_files(tmp_path: Path) -> None:
    (tmp_path / "000.npy").mkdir()
    os.mkfifo(tmp_path / "001.npy")  # reading it would wait for ever
    for name, message in (
        ("000.npy", "not a plain file but a folder"),
        ("001.npy", "not a plain file"),
        ("002.npy", "No such"),
    ):
        with raises(PredictionError, "prediction.unreadable", match=message):
            load_prediction(tmp_path / name)


@pytest.mark.parametrize("suffix", ["npy", "npz"])
@pytest.mark.parametrize("dtype", ["<f2", ">f2", "<f4", ">f4", "|b1", "|u1"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_accepted_files(suffix: str, dtype: str, order: str, tmp_path: Path) -> None:
    values = np.round(GOOD) if dtype in ("|b1", "|u1") else GOOD
    array = np.asarray(values.astype(dtype), order=order)  # type: ignore[call-overload]
    path = tmp_path / f"000.{suffix}"
    path.write_bytes(npy_bytes(array) if suffix == "npy" else zip_bytes({"out.npy": npy_bytes(array)}))
    loaded = load_prediction(path)
    assert loaded.flags.c_contiguous and loaded.dtype.isnative
    assert loaded.dtype == (np.bool_ if dtype == "|u1" else np.dtype(dtype).newbyteorder("="))
    np.testing.assert_array_equal(loaded, array)
    assert sorted(tmp_path.iterdir()) == [path]


def test_numpys_own_savers(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "000.npz", GOOD)
    np.savez(tmp_path / "001.npz", prediction=-np.zeros((2, 2, 2), np.float16))
    np.testing.assert_array_equal(load_prediction(tmp_path / "000.npz"), GOOD)
    np.testing.assert_array_equal(load_prediction(tmp_path / "001.npz"), 0)
