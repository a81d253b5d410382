"""The code of depth images: exact for every image, smaller than PNG, and never a crash on damage."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ingest_writers import depth_image
from numpy.typing import NDArray

from kinectbench.stages.ingest.depth_code import DIFFERENCES, HEAD, PLAIN, decode_depth, encode_depth

images = st.tuples(
    st.integers(0, 9),
    st.integers(1, 9),
    st.integers(0, 2**32 - 1),
    st.floats(0, 1),
    st.sampled_from([9, 65536]),
).map(
    lambda t: (
        np.random.default_rng(t[2]).integers(0, t[4], t[:2])
        * (np.random.default_rng(t[2] + 1).random(t[:2]) < t[3])
    ).astype(np.uint16)
)


@settings(deadline=None)
@given(images)
def test_every_image_comes_back_bit_by_bit(depth: NDArray[np.uint16]) -> None:
    np.testing.assert_array_equal(decode_depth(encode_depth(depth)), depth)


def test_the_layout_that_the_page_describes() -> None:
    import zstandard

    depth = np.array([[0, 1000], [1001, 998]], np.uint16)
    data = encode_depth(depth)
    assert HEAD.unpack_from(data) == (b"KBD1", 2, 2, DIFFERENCES)
    codes = [0, 1 + 2 * 1000, 1 + 2 * 1001, 1 + 2 * 2 - 1]
    expected = bytes(c & 255 for c in codes) + bytes(c >> 8 for c in codes)
    assert zstandard.ZstdDecompressor().decompress(data[HEAD.size :]) == expected


def test_the_difference_that_has_no_code() -> None:
    depth = np.array([[1], [32769]], np.uint16)
    assert HEAD.unpack_from(encode_depth(depth))[3] == PLAIN
    np.testing.assert_array_equal(decode_depth(encode_depth(depth)), depth)


def test_it_is_no_larger_than_png() -> None:
    smooth = np.kron(depth_image(0), np.ones((4, 4), np.uint16)).astype(np.uint16)
    assert len(encode_depth(smooth)) <= len(cv2.imencode(".png", smooth)[1])


@settings(deadline=None)
@given(st.data())
def test_damage_is_said(data: st.DataObject) -> None:
    code = bytearray(encode_depth(depth_image(0)))
    at = data.draw(st.integers(0, HEAD.size + 12))
    code[at] ^= data.draw(st.integers(1, 255))
    del code[data.draw(st.integers(at, len(code))) :]
    try:
        found = decode_depth(bytes(code))
    except ValueError as error:
        assert "\n" not in str(error)
        return
    assert found.size <= 65535**2


@pytest.mark.parametrize("length", [0, 5, HEAD.size, 40])
def test_a_cut_image(length: int) -> None:
    with pytest.raises(ValueError, match=r"is cut off|is damaged"):
        decode_depth(encode_depth(depth_image(0))[:length])
