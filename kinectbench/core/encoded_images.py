"""Read and check the headers of untrusted PNG and JPEG images, so that decoding them has bounded cost.

OpenCV decodes anything: a PNG of a few kilobytes may claim a billion pixels, and each scan of a progressive
JPEG goes over the whole image again. So the whole package reads the header here first.
"""

import struct
import zlib
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools
from kinectbench.core.untrusted import IMAGE_BYTES, MOST_PIXELS, MOST_SIDE_PX, is_too_large

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8\xff"
JPEG_SCAN = 0xDA
# SOF0-SOF15 hold the size; C4, C8 and CC in that range are other segments.
JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Chunks of a PNG or segments of a JPEG: the largest image, in parts of 8 KB, has 16,000.
MOST_PARTS = 50_000
# Markers of a JPEG that no length follows: TEM, RST0-RST7.
JPEG_ALONE = frozenset({0x01, *range(0xD0, 0xD8)})
# Each scan of a progressive JPEG goes over the whole image again; encoders make ten scans.
MOST_SCANS = 32


class ImageHead(NamedTuple):
    """The header of an encoded image.

    Attributes:
        suffix: the file suffix of its format.
        width: pixels.
        height: pixels.
        bits: bits per channel.
        color_type: as in a PNG: 0 is grey, 3 a palette, 2 colour; every JPEG has 2.
    """

    suffix: Literal[".png", ".jpg"]
    width: int
    height: int
    bits: int
    color_type: int

    @property
    def is_gray16(self) -> bool:
        """Whether the image is a PNG of one channel with 16 bits, as depth is stored."""
        return self.suffix == ".png" and self.bits == 16 and self.color_type == 0


def image_head(data: bytes) -> ImageHead:
    """Read the header of a PNG or JPEG; check that the file is complete and its decoding bounded.

    Raises:
        ValueError: the data is neither PNG nor JPEG, is cut off, is too large, has too many scans, or a PNG's
            checksum is wrong; the message says which.
    """
    if len(data) > IMAGE_BYTES:
        raise ValueError(f"{len(data)} bytes are more than an image may have ({IMAGE_BYTES})")
    if data.startswith(PNG_MAGIC):
        return _png_head(data)
    if data.startswith(JPEG_MAGIC):
        return _jpeg_head(data)
    raise ValueError("neither a PNG nor a JPEG image" if data else "the file is empty")


def decoded_image(data: bytes, mode: int) -> NDArray[np.generic]:
    """Decode an image whose header the caller has checked; `mode` is a flag of `cv2.imdecode`.

    The pixels stay as they are stored, whatever orientation EXIF states, because depth has no EXIF.

    Raises:
        ValueError: the image is damaged.
    """
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), mode | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise ValueError(f"cannot be decoded ({error.err})") from error
    if image is None:
        raise ValueError("cannot be decoded; the image is damaged")
    pixels: NDArray[np.generic] = image
    return pixels


def decoded_mask(data: bytes) -> Bools:
    """Decode a mask of any bit depth: (height, width) bool, True where a channel other than alpha is not 0.

    The caller has checked the image's header.

    Raises:
        ValueError: the image is damaged.
    """
    import cv2

    # Any other mode keeps the high byte of 16 bits, or rounds faint colours: a label of 1 would be 0.
    pixels = decoded_image(data, cv2.IMREAD_UNCHANGED)
    return np.asarray(pixels != 0 if pixels.ndim == 2 else pixels[..., :3].any(axis=2))


def _png_head(data: bytes) -> ImageHead:
    """Read the header of a PNG; check that the file is complete and each checksum is right."""
    position, view = len(PNG_MAGIC), memoryview(data)
    for _ in range(MOST_PARTS):
        if position + 12 > len(data):
            break
        (length,) = struct.unpack_from(">I", data, position)
        kind, end = data[position + 4 : position + 8], position + 12 + length
        if end > len(data):
            break
        if zlib.crc32(view[position + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            raise ValueError(f"the PNG is damaged (checksum of a {kind!r} chunk is wrong)")
        if kind == b"acTL":
            raise ValueError("is an animation, not an image")
        if kind == b"IEND":
            if data[12:16] != b"IHDR":
                raise ValueError("the PNG is cut off or damaged")
            width, height, bits, color_type = struct.unpack_from(">IIBB", data, 16)
            _check_size(width, height)
            return ImageHead(".png", width, height, bits, color_type)
        position = end
    raise ValueError(f"the PNG is cut off after {len(data)} bytes, or in too many parts")


def _check_size(width: int, height: int) -> None:
    if is_too_large(width, height):
        raise ValueError(
            f"says that it has {width}x{height} pixels; more than {MOST_SIDE_PX} a side, or {MOST_PIXELS} in "
            "all, are not read"
        )


def _jpeg_head(data: bytes) -> ImageHead:
    """Read the header of a JPEG; check the end marker and the number of scans."""
    position, size = 2, None
    for _ in range(MOST_PARTS):
        if position + 4 > len(data) or data[position] != 0xFF:
            break
        marker = data[position + 1]
        if marker == 0xFF or marker in JPEG_ALONE:  # 0xFF fills up
            position += 1 if marker == 0xFF else 2
            continue
        if marker in JPEG_FRAMES and position + 9 <= len(data):
            height, width = struct.unpack_from(">HH", data, position + 5)
            _check_size(width, height)
            size = (width, height)
        if marker == JPEG_SCAN:
            break
        position += 2 + int(struct.unpack_from(">H", data, position + 2)[0])
    # In the data of a scan 0xFF is escaped, so no marker occurs there by chance.
    if size is None or data.find(b"\xff\xd9", position) < 0:
        raise ValueError(f"the JPEG is cut off after {len(data)} bytes or damaged")
    scans = data.count(bytes((0xFF, JPEG_SCAN)), position)
    if scans > MOST_SCANS:
        raise ValueError(
            f"{size[0]}x{size[1]} pixels in {scans} scans cost too much to read; save it as a baseline JPEG"
        )
    return ImageHead(".jpg", *size, 8, 2)
