"""Decode encoded images, after checks that find damage and excessive size before OpenCV reads them."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError
from kinectbench.core.encoded_images import PNG_MAGIC, ImageHead, decoded_image, decoded_mask, image_head
from kinectbench.core.types import Bools

# Units per metre for depth that was float: steps of 0.2 mm.
FLOAT_SCALE = 5000.0


class DamagedImageError(RecordingError):
    """One image is missing or damaged; if only a few are, their frames are left out.

    Attributes:
        advice: what to do if many are; "" if the message says it.
    """

    what = "damaged-image"
    advice = "copy or export them again"

    def __init__(self, *lines: object, advice: str | None = None) -> None:
        """Keep the class's advice unless `advice` is given."""
        super().__init__(*lines)
        if advice is not None:
            self.advice = advice


class OddImageError(DamagedImageError):
    """One image is intact, but of another kind or size than the recording's depth."""

    what = "other-image"
    advice = "export the depth again, raw, in one kind"


def advice_on(error: RecordingError) -> str:
    """What to do about an image that cannot be used; "" if the error's message says it."""
    return error.advice if isinstance(error, DamagedImageError) else ""


def advised(line: str, advice: str) -> str:
    """Return a message with advice (of `advice_on`) at its end."""
    return f"{line}; {advice}" if advice else line


def image_header(data: bytes, name: str) -> tuple[str, int, int]:
    """Read the type and size of a PNG or JPEG; check that it is complete and cheap to decode.

    Returns:
        (".png" or ".jpg", width, height), sizes in pixels.

    Raises:
        DamagedImageError: the image is damaged, truncated or too large.
    """
    head = _head(data, name)
    return head.suffix, head.width, head.height


def is_depth_png(data: bytes) -> bool:
    """Whether the data starts like a grey PNG with 16 bits per pixel."""
    return len(data) > 25 and data.startswith(PNG_MAGIC) and data[24:26] == b"\x10\x00"


def decode_depth_png(data: bytes, name: str) -> NDArray[np.uint16]:
    """Decode a 16-bit grey PNG: (height, width) uint16.

    Raises:
        DamagedImageError: the image is damaged or not a PNG.
        OddImageError: the image is intact, but not 16-bit grey.
    """
    if not data.startswith(PNG_MAGIC):
        kind = "is empty" if not data else "is not a PNG image"
        raise DamagedImageError(f"{name}: {kind}; depth must be a 16-bit grey PNG")
    head = _head(data, name)
    if not head.is_gray16:
        channels = "1 channel" if head.color_type in (0, 3) else "several channels"
        packed = head.bits == 8 and head.color_type in (2, 6)
        joined = "; or, if its channels are bytes of depth, join them by the data set's own tool"
        raise OddImageError(
            f"{name}: depth is {head.bits}-bit (uint{max(head.bits, 8)}) with {channels}, not 16-bit grey "
            f"(uint16): export the raw depth again, not a picture of it{joined if packed else ''}",
            advice="",
        )
    return np.asarray(decode_unchanged(data, name), dtype=np.uint16)


def quantised(metres: NDArray[np.floating]) -> NDArray[np.uint16]:
    """Convert depth in metres to uint16 in 1 / FLOAT_SCALE m, any shape; NaN, <= 0 and > 13.1 m become 0."""
    native = np.rint(metres.astype(np.float64) * FLOAT_SCALE)
    fits = np.isfinite(native) & (native > 0) & (native <= np.iinfo(np.uint16).max)
    return np.where(fits, native, 0).astype(np.uint16)


def decode_color_bgr(data: bytes, name: str) -> NDArray[np.uint8]:
    """Decode a PNG or JPEG: (height, width, 3) uint8, channels blue, green, red.

    Raises:
        DamagedImageError: the image is damaged.
    """
    import cv2

    image_header(data, name)
    return _decode(data, name, cv2.IMREAD_COLOR).astype(np.uint8, copy=False)


def decode_mask(data: bytes, name: str) -> Bools:
    """Decode a PNG mask: (height, width) bool, True where any channel but alpha is not 0.

    Raises:
        DamagedImageError: the image is damaged.
    """
    image_header(data, name)
    try:
        return decoded_mask(data)
    except ValueError as error:
        raise DamagedImageError(f"{name}: {error}") from error


def encode_png(image: NDArray[np.uint8] | NDArray[np.uint16], *, fast: bool = False) -> bytes:
    """Encode (height, width) or BGR (height, width, 3), 8 or 16 bits, as PNG; equal pixels give equal bytes.

    Args:
        image: the pixels.
        fast: whether to compress less: it takes 7 ms (depth) and 14 ms (colour) of CPU time for 640x480
            pixels, instead of 14 and 27.
    """
    import cv2

    settings = [cv2.IMWRITE_PNG_COMPRESSION, 1 if fast else 3]
    if fast:
        settings += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    done, encoded = cv2.imencode(".png", image, settings)
    assert done
    return bytes(encoded)


def _head(data: bytes, name: str) -> ImageHead:
    try:
        return image_head(data)
    except ValueError as error:
        raise DamagedImageError(f"{name}: {error}") from error


def decode_unchanged(data: bytes, name: str) -> NDArray[np.generic]:
    """Decode an image whose header was checked: pixels as stored, (height, width) or with a channel axis.

    Raises:
        DamagedImageError: the image is damaged.
    """
    import cv2

    return _decode(data, name, cv2.IMREAD_UNCHANGED)


def _decode(data: bytes, name: str, mode: int) -> NDArray[np.generic]:
    try:
        return decoded_image(data, mode)
    except ValueError as error:
        raise DamagedImageError(f"{name}: {error}") from error
