"""Convert ROS image messages, raw or compressed, to depth and colour."""

import struct
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import MOST_PIXELS, MOST_SIDE_PX, is_too_large
from kinectbench.core.encoded_images import JPEG_MAGIC, PNG_MAGIC
from kinectbench.stages.ingest.bags.message_decoding import Message
from kinectbench.stages.ingest.images import (
    DamagedImageError,
    decode_depth_png,
    encode_png,
    image_header,
    is_depth_png,
    quantised,
)

INTEGER_DEPTH = frozenset({"16UC1", "mono16"})
FLOAT_DEPTH = "32FC1"
DEPTH_ENCODINGS = INTEGER_DEPTH | {FLOAT_DEPTH}
# encoding -> indices of the blue, green and red channels (mono has one channel)
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
_Value = TypeVar("_Value", bound=np.generic)
# Bayer encoding -> OpenCV's conversion to blue, green, red; OpenCV names a pattern by its second row.
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
# Native units per metre of integer depth.
INTEGER_SCALE = 1000.0
COMPRESSED_DEPTH = "compressedDepth"
# Bytes of compressed_depth_image_transport's ConfigHeader: the format, int32, and two float32 of
# quantisation.
COMPRESSED_DEPTH_HEADER = 12


def is_compressed(message: Message) -> bool:
    """Whether a message is a CompressedImage, which has the field `format`, rather than an Image."""
    return hasattr(message, "format")


def depth_encoding(message: Message) -> str | None:
    """Return the encoding of depth in an image message, such as "16UC1"; None if the image is not depth."""
    if not is_compressed(message):
        return message.encoding if message.encoding in DEPTH_ENCODINGS else None
    first = message.format.split(";")[0].strip()
    if COMPRESSED_DEPTH in message.format:
        return first if first in DEPTH_ENCODINGS else "16UC1"
    return "16UC1" if is_depth_png(bytes(message.data[:32])) else None


def color_encoding(message: Message) -> str | None:
    """Return the encoding of colour in an image message, "compressed" for PNG and JPEG; else None."""
    if not is_compressed(message):
        known = message.encoding in COLOR_CHANNELS or message.encoding.lower() in CONVERSIONS
        return message.encoding if known else None
    data = bytes(message.data[:32])
    if COMPRESSED_DEPTH in message.format or is_depth_png(data):
        return None
    return "compressed" if data.startswith((PNG_MAGIC, JPEG_MAGIC)) else None


def depth_of(message: Message, name: str, float_units_per_m: float = 1.0) -> NDArray[np.uint16]:
    """Decode the depth of an Image or CompressedImage message.

    `float_units_per_m` are the units per metre of a 32FC1 image; `name` is topic and message number, for
    errors.

    Returns:
        (height, width) uint16, 0 = none: integers unchanged, floats in 1 / FLOAT_SCALE m (NaN, infinity and
            values out of range become 0).

    Raises:
        DamagedImageError: the image is damaged, or its encoding is not that of depth.
        OddImageError: the image is an intact PNG, but not 16-bit grey.
    """
    if not is_compressed(message):
        if message.encoding in INTEGER_DEPTH:
            return _pixels(message, name, np.dtype(np.uint16), 1)[..., 0].astype(np.uint16)
        if message.encoding == FLOAT_DEPTH:
            metres = _pixels(message, name, np.dtype(np.float32), 1)[..., 0] / float_units_per_m
            return quantised(metres)
        raise DamagedImageError(
            f"{name}: encoding '{message.encoding}' is not depth, unlike the first message's"
        )
    data = bytes(message.data)
    if COMPRESSED_DEPTH not in message.format:
        return decode_depth_png(data, name)
    body = data[COMPRESSED_DEPTH_HEADER:]
    if len(data) < COMPRESSED_DEPTH_HEADER:
        raise DamagedImageError(f"{name}: the compressedDepth image is cut off after {len(data)} bytes")
    if "rvl" in message.format.lower():
        # Imported here, because numba takes longer to import than checking that a recording is up to date.
        from kinectbench.stages.ingest.bags.rvl import decode_rvl

        native = decode_rvl(body, name)
    else:
        native = decode_depth_png(body, name)
    if not message.format.startswith(FLOAT_DEPTH):
        return native
    # Stored as inverse depth: z = A / (v - B), with the header `int32 format, float32 A, float32 B`.
    a, b = struct.unpack_from("<ff", data, 4)
    valid = native > 0
    metres = np.divide(a, native - np.float64(b), out=np.zeros(native.shape), where=valid & (native > b))
    return quantised(metres / float_units_per_m)


def color_of(message: Message, name: str) -> tuple[str, bytes]:
    """Return encoded colour of an Image or CompressedImage: (suffix, bytes); raw pixels become PNG.

    Raises:
        DamagedImageError: the image is damaged, or its encoding is not that of colour.
    """
    if is_compressed(message):
        data = bytes(message.data)
        return image_header(data, name)[0], data
    conversion = CONVERSIONS.get(message.encoding.lower())
    if conversion is not None:
        import cv2

        channels, code = conversion
        pixels = _pixels(message, name, np.dtype(np.uint8), channels)
        try:
            return ".png", encode_png(np.asarray(cv2.cvtColor(pixels, getattr(cv2, code)), np.uint8))
        except cv2.error as error:  # such as an odd width, where two pixels share their colour
            size = f"{message.width}x{message.height}"
            raise DamagedImageError(f"{name}: {size} pixels cannot be '{message.encoding}'") from error
    order = COLOR_CHANNELS.get(message.encoding)
    if order is None:
        raise DamagedImageError(f"{name}: encoding '{message.encoding}' is not the first message's")
    stored = 1 if order == (0,) else 3 + int(message.encoding.endswith(("a8", "C4")))
    pixels = _pixels(message, name, np.dtype(np.uint8), stored)
    return ".png", encode_png(np.ascontiguousarray(pixels[..., order]).astype(np.uint8))


def _pixels(message: Message, name: str, dtype: np.dtype[_Value], channels: int) -> NDArray[_Value]:
    """Return pixels (height, width, channels) of a raw image: `dtype` in its byte order, no row padding."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    if is_too_large(width, height):
        raise DamagedImageError(
            f"{name}: more than {MOST_SIDE_PX} pixels a side, or {MOST_PIXELS} in all ({width}x{height})"
        )
    row_bytes = width * channels * dtype.itemsize
    if not height or not width or step < row_bytes or len(message.data) < height * step:
        raise DamagedImageError(
            f"{name}: {len(message.data)} bytes are too few for {width}x{height} pixels "
            f"('{message.encoding}', {step} bytes a row)"
        )
    rows = np.asarray(message.data[: height * step], np.uint8).reshape(height, step)[:, :row_bytes]
    order = dtype.newbyteorder(">" if message.is_bigendian else "<")
    return np.ascontiguousarray(rows).view(order).reshape(height, width, channels)
