"""Decoding and checking encoded images; damage and excess are found before OpenCV sees them."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import RecordingError
from kinectbench.core.types import Bools
from kinectbench.core.untrusted import IMAGE_BYTES, MOST_SIDE_PX

# Units per metre of depth that was float: it is kept in steps of 0.2 mm.
FLOAT_SCALE = 5000.0
PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8\xff"
JPEG_SCAN = 0xDA
# SOF0-SOF15 hold the size; C4, C8 and CC in that range are other segments.
JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Chunks of a PNG, segments of a JPEG: in parts of 8 KB the largest has 16,000 (own choice).
MOST_PARTS = 50_000
# Markers that no length follows: TEM, RST0-RST7.
JPEG_ALONE = frozenset({0x01, *range(0xD0, 0xD8)})
# Each scan of a progressive JPEG goes over the whole image once more; encoders make ten (own choice). All of
# its coefficients are kept meanwhile, which takes twice as much memory as its pixels.
MOST_SCANS, MOST_PIXELS_OF_SCANS = 32, MOST_SIDE_PX**2 // 4


class DamagedImageError(RecordingError):
    """One image is missing or damaged; a few of those among many frames can be left out."""


def image_header(data: bytes, name: str) -> tuple[str, int, int]:
    """Read the type and size of a PNG or JPEG and check that it is whole.

    Args:
        data: the encoded image.
        name: where it comes from, for messages.

    Returns:
        (".png" or ".jpg", width, height), pixels.

    Raises:
        DamagedImageError: it is neither, is cut off, is larger than an image can be, or (PNG) a checksum is
            wrong.
    """
    if len(data) > IMAGE_BYTES:
        raise DamagedImageError(f"{name}: {len(data)} bytes are more than an image may have ({IMAGE_BYTES})")
    if data.startswith(PNG_MAGIC):
        width, height, _, _ = _png_header(data, name)
        return ".png", width, height
    if data.startswith(JPEG_MAGIC):
        return ".jpg", *_jpeg_size(data, name)
    if not data:
        raise DamagedImageError(f"{name}: the file is empty")
    raise DamagedImageError(f"{name}: neither a PNG nor a JPEG image")


def is_depth_png(data: bytes) -> bool:
    """Whether the data begins like a grey PNG with 16 bits a pixel."""
    return len(data) > 25 and data.startswith(PNG_MAGIC) and data[24:26] == b"\x10\x00"


def decode_depth_png(data: bytes, name: str) -> NDArray[np.uint16]:
    """Decode a 16-bit grey PNG: (height, width) uint16.

    Raises:
        DamagedImageError: the image is damaged or not a PNG.
        RecordingError: it is whole, but not 16-bit grey.
    """
    if not data.startswith(PNG_MAGIC):
        kind = "is empty" if not data else "is not a PNG image"
        raise DamagedImageError(f"{name}: {kind}; depth must be a 16-bit grey PNG")
    _, _, bits, color_type = _png_header(data, name)
    if bits != 16 or color_type != 0:
        channels = "1 channel" if color_type in (0, 3) else "several channels"
        raise RecordingError(
            f"{name}: depth is {bits}-bit (uint{max(bits, 8)}) with {channels}, not 16-bit grey (uint16): "
            "export the raw depth again, not a picture of it"
        )
    return np.asarray(_decode(data, name, unchanged=True), dtype=np.uint16)


def quantised(metres: NDArray[np.floating]) -> NDArray[np.uint16]:
    """Depth in metres (height, width) in steps of 1 / FLOAT_SCALE m: uint16; what does not fit becomes 0."""
    native = np.rint(metres.astype(np.float64) * FLOAT_SCALE)
    fits = np.isfinite(native) & (native > 0) & (native <= np.iinfo(np.uint16).max)
    return np.where(fits, native, 0).astype(np.uint16)


def decode_color_bgr(data: bytes, name: str) -> NDArray[np.uint8]:
    """Decode a PNG or JPEG: (height, width, 3) uint8, channels blue, green, red.

    Raises:
        DamagedImageError: the image is damaged.
    """
    image_header(data, name)
    return _decode(data, name, unchanged=False).astype(np.uint8, copy=False)


def decode_mask(data: bytes, name: str) -> Bools:
    """Decode a PNG mask: (height, width) bool, True where any channel is not 0.

    Raises:
        DamagedImageError: the image is damaged.
    """
    return np.asarray(decode_color_bgr(data, name).any(axis=2))


def encode_png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Encode (height, width) or BGR (height, width, 3), 8 or 16 bits, as PNG: same pixels, same bytes."""
    import cv2

    done, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    assert done
    return bytes(encoded)


def _decode(data: bytes, name: str, *, unchanged: bool) -> NDArray[np.generic]:
    import cv2

    flag = cv2.IMREAD_UNCHANGED if unchanged else cv2.IMREAD_COLOR
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flag)
    except cv2.error as error:
        raise DamagedImageError(f"{name}: cannot be decoded ({error.err})") from error
    if image is None:
        raise DamagedImageError(f"{name}: cannot be decoded; the image is damaged")
    decoded: NDArray[np.generic] = image
    return decoded


def _png_header(data: bytes, name: str) -> tuple[int, int, int, int]:
    """Width, height, bits per sample and colour type of a PNG whose every chunk is whole."""
    position, view = len(PNG_MAGIC), memoryview(data)
    for _ in range(MOST_PARTS):
        if position + 12 > len(data):
            break
        (length,) = struct.unpack_from(">I", data, position)
        kind, end = data[position + 4 : position + 8], position + 12 + length
        if end > len(data):
            break
        if zlib.crc32(view[position + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            raise DamagedImageError(f"{name}: the PNG is damaged (checksum of a {kind!r} chunk is wrong)")
        if kind == b"acTL":
            raise DamagedImageError(f"{name}: is an animation, not an image")
        if kind == b"IEND":
            if data[12:16] != b"IHDR":
                raise DamagedImageError(f"{name}: the PNG is cut off or damaged")
            width, height, bits, color_type = struct.unpack_from(">IIBB", data, 16)
            _check_size(width, height, name)
            return width, height, bits, color_type
        position = end
    raise DamagedImageError(f"{name}: the PNG is cut off after {len(data)} bytes, or in too many parts")


def _check_size(width: int, height: int, name: str) -> None:
    if max(width, height) > MOST_SIDE_PX:
        raise DamagedImageError(
            f"{name}: says that it has {width}x{height} pixels; more than {MOST_SIDE_PX} a side are not read"
        )


def _jpeg_size(data: bytes, name: str) -> tuple[int, int]:
    """Width and height of a JPEG that has its end marker, and whose decoding is bounded."""
    position, size, progressive = 2, None, False
    for _ in range(MOST_PARTS):
        if position + 4 > len(data) or data[position] != 0xFF:
            break
        marker = data[position + 1]
        if marker == 0xFF or marker in JPEG_ALONE:  # 0xFF fills up
            position += 1 if marker == 0xFF else 2
            continue
        if marker in JPEG_FRAMES and position + 9 <= len(data):
            height, width = struct.unpack_from(">HH", data, position + 5)
            _check_size(width, height, name)
            size, progressive = (width, height), marker not in (0xC0, 0xC1)
        if marker == JPEG_SCAN:
            break
        position += 2 + int(struct.unpack_from(">H", data, position + 2)[0])
    # Inside the scan 0xFF is stuffed, so the end marker cannot occur by chance, nor that of a scan.
    if size is None or data.find(b"\xff\xd9", position) < 0:
        raise DamagedImageError(f"{name}: the JPEG is cut off after {len(data)} bytes or damaged")
    scans = data.count(bytes((0xFF, JPEG_SCAN)), position)
    if scans > MOST_SCANS or ((progressive or scans > 1) and size[0] * size[1] > MOST_PIXELS_OF_SCANS):
        raise DamagedImageError(
            f"{name}: {size[0]}x{size[1]} pixels in {scans} scans cost too much to read; save it as a "
            "baseline JPEG"
        )
    return size
