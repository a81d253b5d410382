"""Images that cost more to decode than they weigh are refused by their heads, in every room."""

import struct
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest
from bounds import within
from raising import raises

from kinectbench.core.encoded_images import decoded_image, image_head
from kinectbench.core.errors import ReleaseError, StorageError
from kinectbench.core.images import read_color, read_gray
from kinectbench.core.sequence import Sequence, stored_bgr
from kinectbench.release.view_images import depth_mm
from kinectbench.stages.ingest.images import decode_color_bgr
from kinectbench.stages.track.frame_maps import gray_frame


def progressive_jpeg(side: int, scans: int) -> bytes:
    """A grey progressive JPEG whose last scan is repeated: each costs a pass over the image."""
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    data = cv2.imencode(".jpg", np.full((side, side), 128, np.uint8), options)[1].tobytes()
    last = data.rfind(b"\xff\xda")
    return data[:-2] + data[last:-2] * scans + data[-2:]


def test_scans_of_a_jpeg_are_counted_before_it_is_decoded(tmp_path: Path) -> None:
    data, path = progressive_jpeg(1024, 5000), tmp_path / "000.color.jpg"
    path.write_bytes(data)
    with within(1, 50):
        with pytest.raises(ValueError, match=r"1024x1024 pixels in .* scans cost too much to read"):
            image_head(data)
        for read in (read_color, read_gray):
            with raises(StorageError, "storage.damaged", match="not a readable image of its kind"):
                read(path)


@pytest.mark.parametrize(
    "data", [progressive_jpeg(64, 0), progressive_jpeg(64, 5000), b"", b"\x89PNG\r\n\x1a\n"]
)
def test_depth_of_a_release_is_a_png_of_16_bits_or_nothing_is_decoded(data: bytes) -> None:
    with within(1, 50), raises(ReleaseError, "release.damaged", match="16-bit"):
        depth_mm(data, "000.depth.png")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_what_a_head_says(dtype: type[np.uint8 | np.uint16]) -> None:
    image = np.zeros((3, 5), dtype)
    data = cv2.imencode(".png", image)[1].tobytes()
    head = image_head(data)
    assert (head.suffix, head.width, head.height, head.is_gray16) == (".png", 5, 3, dtype is np.uint16)
    assert decoded_image(data, cv2.IMREAD_UNCHANGED).dtype == dtype
    jpeg = image_head(cv2.imencode(".jpg", image.astype(np.uint8))[1].tobytes())
    assert (jpeg.suffix, jpeg.width, jpeg.height, jpeg.is_gray16) == (".jpg", 5, 3, False)


def test_what_is_damaged_behind_its_head() -> None:
    with pytest.raises(ValueError, match="cannot be decoded"):
        decoded_image(b"\x89PNG\r\n\x1a\n" + bytes(100), cv2.IMREAD_UNCHANGED)


def with_orientation(jpeg: bytes, orientation: int) -> bytes:
    """The JPEG with EXIF that states an orientation: its tag is 0x0112, a SHORT."""
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", 8 + len(tiff)) + b"Exif\0\0" + tiff + jpeg[2:]


@pytest.mark.parametrize("orientation", [3, 6])
def test_colour_stays_on_its_depth_whatever_orientation_exif_states(orientation: int, tmp_path: Path) -> None:
    stored = np.zeros((48, 64, 3), np.uint8)
    stored[:16, :16] = 255
    plain = cv2.imencode(".jpg", stored)[1].tobytes()
    data = with_orientation(plain, orientation)
    turned = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert turned is not None and turned[0, 0, 0] < 50  # OpenCV by itself turns it
    sequence = SimpleNamespace(frames=SimpleNamespace(color_encoded=lambda _: (".jpg", data)))
    (tmp_path / "r.jpg").write_bytes(data)
    for mode in (cv2.IMREAD_COLOR, cv2.IMREAD_GRAYSCALE, cv2.IMREAD_REDUCED_GRAYSCALE_2):
        right = decoded_image(plain, mode)
        np.testing.assert_array_equal(decoded_image(data, mode), right)
        np.testing.assert_array_equal(gray_frame(cast(Sequence, sequence), 0, mode), right)
    for bgr in (decode_color_bgr(data, ""), stored_bgr(data, 0), read_color(tmp_path / "r.jpg")):
        assert bgr.shape == stored.shape and np.abs(bgr.astype(int) - stored).max() < 20
