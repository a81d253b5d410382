"""RVL against a plain encoder made from the paper's description, and on damaged data."""

import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from raising import raises

from kinectbench.lab.simulate.writers.bags import encode_rvl
from kinectbench.stages.ingest.bags.rvl import decode_rvl
from kinectbench.stages.ingest.images import DamagedImageError


def plain_rvl(depth: NDArray[np.uint16]) -> bytes:
    """Runs of zeros and values in turn; numbers three bits a nibble; nibbles from the top of 32-bit words."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        digits = [value & 7]
        while value := value >> 3:
            digits.append(value & 7)
        nibbles.extend([*(d | 8 for d in digits[:-1]), digits[-1]])

    values, previous = depth.reshape(-1).tolist(), 0
    while values:
        zeros = next((i for i, v in enumerate(values) if v), len(values))
        rest = values[zeros:]
        others = next((i for i, v in enumerate(rest) if not v), len(rest))
        put(zeros)
        put(others)
        for value in rest[:others]:
            step, previous = value - previous, value
            put(2 * step if step >= 0 else -2 * step - 1)
        values = rest[others:]
    nibbles += [0] * (-len(nibbles) % 8)
    words = [int("".join(f"{n:x}" for n in nibbles[i : i + 8]), 16) for i in range(0, len(nibbles), 8)]
    return struct.pack("<II", depth.shape[1], depth.shape[0]) + struct.pack(f"<{len(words)}I", *words)


images = st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1), st.floats(0, 1)).map(
    lambda t: (
        np.random.default_rng(t[2]).integers(0, 65536, t[:2])
        * (np.random.default_rng(t[2] + 1).random(t[:2]) < t[3])
    ).astype(np.uint16)
)


@settings(deadline=None)
@given(images)
def test_it_is_what_the_paper_describes(depth: NDArray[np.uint16]) -> None:
    assert encode_rvl(depth) == plain_rvl(depth)
    np.testing.assert_array_equal(decode_rvl(plain_rvl(depth), "r"), depth)


@settings(deadline=None)
@given(images, st.data())
def test_what_is_damaged_is_said_or_has_the_right_size(
    depth: NDArray[np.uint16], data: st.DataObject
) -> None:
    code = bytearray(encode_rvl(depth))
    code[data.draw(st.integers(0, len(code) - 1))] ^= data.draw(st.integers(1, 255))
    del code[data.draw(st.integers(0, len(code))) :]
    try:
        found = decode_rvl(bytes(code), "r")
    except DamagedImageError as error:
        assert "\n" not in str(error)
        return
    assert found.shape == struct.unpack_from("<II", code)[::-1]


def test_an_impossible_size_allocates_nothing() -> None:
    with raises(DamagedImageError, "recording.damaged-image", match="4294967295x4294967295"):
        decode_rvl(b"\xff" * 8 + bytes(40), "r")
    with raises(DamagedImageError, "recording.damaged-image", match="after 3 bytes"):
        decode_rvl(b"abc", "r")
