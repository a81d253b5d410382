"""Images that cost more to decode than they weigh are refused by their heads, in every room."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from bounds import within
from raising import raises

from kinectbench.core.encoded_images import decoded_image, image_head
from kinectbench.core.errors import ReleaseError, StorageError
from kinectbench.core.images import read_color, read_gray
from kinectbench.release.view_images import depth_mm


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
