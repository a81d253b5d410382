"""ROS image messages to depth and colour: raw with any row padding and byte order, and compressed."""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.ingest.images import (
    PNG_MAGIC,
    DamagedImageError,
    decode_depth_png,
    encode_png,
    image_header,
    is_depth_png,
)
from kinectbench.ingest.rvl import decode_rvl

INTEGER_DEPTH = frozenset({"16UC1", "mono16"})
FLOAT_DEPTH = "32FC1"
DEPTH_ENCODINGS = INTEGER_DEPTH | {FLOAT_DEPTH}
# encoding -> which channels make blue, green, red (mono has one)
COLOR_CHANNELS: dict[str, tuple[int, ...]] = {
    "rgb8": (2, 1, 0),
    "bgr8": (0, 1, 2),
    "rgba8": (2, 1, 0),
    "bgra8": (0, 1, 2),
    "8UC3": (0, 1, 2),
    "8UC4": (0, 1, 2),
    "mono8": (0,),
    "8UC1": (0,),
}
# encoding -> OpenCV's conversion to blue, green, red; its names count the pattern from the second row.
CONVERSIONS = {
    "bayer_rggb8": (1, "COLOR_BayerBG2BGR"),
    "bayer_bggr8": (1, "COLOR_BayerRG2BGR"),
    "bayer_gbrg8": (1, "COLOR_BayerGR2BGR"),
    "bayer_grbg8": (1, "COLOR_BayerGB2BGR"),
    "yuv422": (2, "COLOR_YUV2BGR_UYVY"),
    "uyvy": (2, "COLOR_YUV2BGR_UYVY"),
    "yuv422_yuy2": (2, "COLOR_YUV2BGR_YUYV"),
    "yuyv": (2, "COLOR_YUV2BGR_YUYV"),
}
# Native units per metre: integers are millimetres, floats metres that are stored in units of 0.2 mm.
INTEGER_SCALE = 1000.0
FLOAT_SCALE = 5000.0
COMPRESSED_DEPTH = "compressedDepth"
COMPRESSED_DEPTH_HEADER = 12


def depth_encoding(message: Any, *, compressed: bool) -> str | None:
    """The encoding of the depth in an image message, such as "16UC1"; None if it holds no depth."""
    if not compressed:
        return message.encoding if message.encoding in DEPTH_ENCODINGS else None
    first = message.format.split(";")[0].strip()
    if COMPRESSED_DEPTH in message.format:
        return first if first in DEPTH_ENCODINGS else "16UC1"
    return "16UC1" if is_depth_png(bytes(message.data[:32])) else None


def color_encoding(message: Any, *, compressed: bool) -> str | None:
    """The encoding of the colour in an image message; None if it holds none that can be read."""
    if not compressed:
        known = message.encoding in COLOR_CHANNELS or message.encoding.lower() in CONVERSIONS
        return message.encoding if known else None
    data = bytes(message.data[:32])
    if COMPRESSED_DEPTH in message.format or is_depth_png(data):
        return None
    return "compressed" if data.startswith((PNG_MAGIC, b"\xff\xd8\xff")) else None


def depth_of(
    message: Any, name: str, *, compressed: bool, float_units_per_m: float = 1.0
) -> tuple[NDArray[np.uint16], bytes | None]:
    """Depth of an Image or CompressedImage message.

    Args:
        message: with the fields of sensor_msgs.
        name: topic and message number, for errors.
        compressed: it is a CompressedImage.
        float_units_per_m: what 1 m is in a 32FC1 image.

    Returns:
        (height, width) uint16, 0 = none: integers as they are, floats in 1 / FLOAT_SCALE m (NaN, infinity and
        what does not fit become 0); and the PNG that decodes to just that, or None.

    Raises:
        DamagedImageError: the image is damaged.
        RecordingError: it is whole, but not 16-bit grey.
    """
    if not compressed:
        if message.encoding in INTEGER_DEPTH:
            return _pixels(message, name, np.dtype(np.uint16), 1)[..., 0].astype(np.uint16), None
        if message.encoding == FLOAT_DEPTH:
            metres = _pixels(message, name, np.dtype(np.float32), 1)[..., 0] / float_units_per_m
            return _quantised(metres), None
        raise DamagedImageError(
            f"{name}: encoding '{message.encoding}' is not depth, unlike the first message's"
        )
    data = bytes(message.data)
    if COMPRESSED_DEPTH not in message.format:
        return decode_depth_png(data, name), data
    body = data[COMPRESSED_DEPTH_HEADER:]
    if len(data) < COMPRESSED_DEPTH_HEADER:
        raise DamagedImageError(f"{name}: the compressedDepth image is cut off after {len(data)} bytes")
    is_rvl = "rvl" in message.format.lower()
    native = decode_rvl(body, name) if is_rvl else decode_depth_png(body, name)
    if not message.format.startswith(FLOAT_DEPTH):
        return native, None if is_rvl else body
    # Inverse depth: z = A / (v - B), from the header `int32 format, float32 A, float32 B`.
    a, b = struct.unpack_from("<ff", data, 4)
    valid = native > 0
    metres = np.divide(a, native - np.float64(b), out=np.zeros(native.shape), where=valid & (native > b))
    return _quantised(metres / float_units_per_m), None


def color_of(message: Any, name: str, *, compressed: bool) -> tuple[str, bytes]:
    """Colour of an Image or CompressedImage message: (suffix, encoded); raw pixels become PNG.

    Raises:
        DamagedImageError: the image is damaged.
    """
    if compressed:
        data = bytes(message.data)
        return image_header(data, name)[0], data
    conversion = CONVERSIONS.get(message.encoding.lower())
    if conversion is not None:
        return ".png", encode_png(
            _converted(_pixels(message, name, np.dtype(np.uint8), conversion[0]), conversion[1])
        )
    channels = COLOR_CHANNELS.get(message.encoding)
    if channels is None:
        raise DamagedImageError(f"{name}: encoding '{message.encoding}' is not the first message's")
    stored = 1 if channels == (0,) else 3 + int(message.encoding.endswith(("a8", "C4")))
    pixels = _pixels(message, name, np.dtype(np.uint8), stored)
    return ".png", encode_png(np.ascontiguousarray(pixels[..., channels]).astype(np.uint8))


def _converted(pixels: NDArray[np.uint8], conversion: str) -> NDArray[np.uint8]:
    """Blue, green, red (height, width, 3) of a Bayer or YUV 4:2:2 image."""
    import cv2

    return np.asarray(cv2.cvtColor(pixels, getattr(cv2, conversion)), np.uint8)


def _pixels(message: Any, name: str, dtype: np.dtype[Any], channels: int) -> NDArray[Any]:
    """The pixels (height, width, channels) of a raw image, without row padding, in any byte order."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row_bytes = width * channels * dtype.itemsize
    if not height or not width or step < row_bytes or len(message.data) < height * step:
        raise DamagedImageError(
            f"{name}: {len(message.data)} bytes are too few for {width}x{height} pixels "
            f"('{message.encoding}', {step} bytes a row)"
        )
    rows = np.asarray(message.data[: height * step], np.uint8).reshape(height, step)[:, :row_bytes]
    order = dtype.newbyteorder(">" if message.is_bigendian else "<")
    return np.ascontiguousarray(rows).view(order).reshape(height, width, channels)


def _quantised(metres: NDArray[np.floating]) -> NDArray[np.uint16]:
    native = np.rint(metres.astype(np.float64) * FLOAT_SCALE)
    fits = np.isfinite(native) & (native > 0) & (native <= np.iinfo(np.uint16).max)
    return np.where(fits, native, 0).astype(np.uint16)
