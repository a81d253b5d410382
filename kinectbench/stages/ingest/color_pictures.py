"""Tell colour images by their heads; turn BMP and PPM (netpbm.sourceforge.net) into PNG for later stages."""

import re
import struct

import numpy as np

from kinectbench.core import is_too_large
from kinectbench.core.encoded_images import JPEG_MAGIC, PNG_MAGIC
from kinectbench.stages.ingest.images import DamagedImageError, decode_unchanged, encode_png
from kinectbench.stages.ingest.netpbm import BETWEEN, HEAD_BYTES

# Signatures of a BMP (Microsoft's BITMAPFILEHEADER, bfType) and of a binary PPM (netpbm.sourceforge.net).
BMP_MAGIC, PPM_MAGIC = b"BM", b"P6"
PPM_HEAD = re.compile(
    PPM_MAGIC + BETWEEN + rb"(\d{1,6})" + BETWEEN + rb"(\d{1,6})" + BETWEEN + rb"(\d{1,5})\s"
)
# Where a BMP begins its second header, whose first number is its length; of the oldest kind it is 12, and the
# sides are then of 16 bits (Microsoft's BITMAPCOREHEADER and BITMAPINFOHEADER).
BMP_INFO, BMP_CORE_BYTES = 14, 12
# The frame header of a JPEG with one channel of 8 bits (ITU-T T.81, B.2.2).
GREY_JPEG = re.compile(rb"\xff[\xc0-\xcf]\x00\x0b\x08.{4}\x01", re.DOTALL)
# Types of a PNG in colour, without and with alpha (W3C, PNG, 11.2.1), and bits of a pixel of such a BMP.
COLOR_PNG, COLOR_BMP = (2, 6), (24, 32)
# Largest value of a channel of 8 bits, and the largest that a PPM may state (netpbm.sourceforge.net).
WHITE, MOST_WHITE = 255, 65535


def is_in_color(head: bytes) -> bool:
    """Whether an image is a PNG, JPEG, BMP or PPM in colour; a PNG with 8 bits per channel.

    Args:
        head: the first bytes of the file. If they end before a JPEG states its channels, it counts as colour.
    """
    if head.startswith(PNG_MAGIC):
        return len(head) > 25 and head[24] == 8 and head[25] in COLOR_PNG
    if head.startswith(BMP_MAGIC):
        at = BMP_INFO + (10 if head[BMP_INFO : BMP_INFO + 1] == bytes([BMP_CORE_BYTES]) else 14)
        return int.from_bytes(head[at : at + 2], "little") in COLOR_BMP
    return head.startswith(PPM_MAGIC) or (head.startswith(JPEG_MAGIC) and not GREY_JPEG.search(head))


def as_png(data: bytes, name: str) -> bytes:
    """Return a BMP or PPM as a PNG of 8 bits per channel; any other data as they are.

    Raises:
        DamagedImageError: the BMP or PPM is damaged or too large.
    """
    if not data.startswith((BMP_MAGIC, PPM_MAGIC)):
        return data
    width, height, white = _head(data)
    if not width * height or not 0 < white <= MOST_WHITE:
        raise DamagedImageError(f"{name}: the head of the image is damaged")
    if is_too_large(width, height):
        raise DamagedImageError(f"{name}: {width}x{height} are more pixels than an image may have")
    pixels = decode_unchanged(data, name)
    if pixels.shape[1::-1] != (width, height):
        raise DamagedImageError(f"{name}: the image is damaged")
    if white != WHITE:
        pixels = np.minimum((pixels.astype(np.uint32) * WHITE + white // 2) // white, WHITE)
    return encode_png(np.asarray(pixels[..., :3] if pixels.ndim == 3 else pixels, np.uint8), fast=True)


def _head(data: bytes) -> tuple[int, int, int]:
    """Return width and height that the head of a BMP or PPM states, pixels, and the largest value, or 0s."""
    if data.startswith(PPM_MAGIC):
        match = PPM_HEAD.match(data[:HEAD_BYTES])
        return (int(match[1]), int(match[2]), int(match[3])) if match else (0, 0, 0)
    try:
        (length,) = struct.unpack_from("<I", data, BMP_INFO)
        width, height = struct.unpack_from("<HH" if length == BMP_CORE_BYTES else "<ii", data, BMP_INFO + 4)
    except struct.error:
        return 0, 0, 0
    return max(width, 0), abs(height), WHITE
