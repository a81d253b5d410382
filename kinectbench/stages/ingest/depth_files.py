"""Decode depth images of many kinds: PNG, .npy, .npz, TIFF, PGM, PFM, HDF5, two 8-bit channels."""

import io
import struct
from collections.abc import Iterable
from contextlib import suppress
from itertools import permutations
from math import prod
from pathlib import Path
from types import ModuleType
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import MOST_PIXELS, UNPACKED_BYTES, RecordingError, is_too_large, open_plain, printable
from kinectbench.core.encoded_images import PNG_MAGIC, image_head
from kinectbench.core.types import MM_PER_M, Bools, Float32
from kinectbench.core.voxels.npy import MAGIC, read_npy, read_npy_header
from kinectbench.core.voxels.npz import UNREADABLE, arrays_of, open_npz
from kinectbench.stages.ingest.images import (
    DamagedImageError,
    OddImageError,
    decode_depth_png,
    decode_unchanged,
    image_header,
)
from kinectbench.stages.ingest.netpbm import SUFFIXES as NETPBM_SUFFIXES
from kinectbench.stages.ingest.netpbm import decode_netpbm, is_netpbm, netpbm_head

if TYPE_CHECKING:
    from h5py import File

UInt16 = NDArray[np.uint16]
Channels = tuple[int, int]
ZIP_MAGIC, KEY = b"PK", "depth"
ARRAYS = frozenset({".npy", ".npz"})
# Arrays whose headers alone are read may state this much (our own bound: 1 TB is no recording).
MOST_ARRAY_BYTES = 1 << 40
TIFF_MAGICS = {b"II*\x00": "<", b"MM\x00*": ">"}
# Numbers of tags in TIFF 6.0, and how many tags to read at most: images have some thirty.
TIFF_WIDTH, TIFF_HEIGHT, MOST_TIFF_TAGS = 256, 257, 1000
SUFFIXES = frozenset({".png", ".tif", ".tiff"}) | ARRAYS | NETPBM_SUFFIXES
# Larger floats are not metres of a room, but millimetres.
FARTHEST_M = 50.0
# Between neighbours whose high bytes differ by one, depth in two channels mostly changes by less than
# SMALL_STEP, because surfaces are smooth. In a false-colour picture the channels are not related like this.
SMALL_STEP, SMALL_SHARE, LEAST_STEPS = 64, 0.8, 16
# Signature of OpenEXR (its file layout), and how its Python package reads a channel of a file {f}; OpenCV's
# packages are built without it.
EXR_MAGIC = b"v/1\x01"
READ_EXR = "OpenEXR.File({f}, separate_channels=True).channels().popitem()[1].pixels"
# Signature of HDF5 (its file format specification, III.A).
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
# Errors of h5py on damaged files: by its documentation only OSError, KeyError and ValueError; RuntimeError
# for unknown problems of the library.
DAMAGED = (OSError, KeyError, ValueError, RuntimeError, TypeError, OverflowError)


def decode_depth_file(data: bytes, name: str, channels: Channels | None = None) -> UInt16 | Float32:
    """Decode a depth image.

    Args:
        data: bytes of the file.
        name: source of the data, for messages.
        channels: for a PNG with 8-bit channels: indices (B, G, R) of the high and of the low byte.

    Returns:
        (height, width): uint16 in native units, or float32 as stored; `is_measured` finds the pixels with a
            depth, as floats may also be negative or not finite.

    Raises:
        DamagedImageError: the image is damaged.
        OddImageError: the image is intact, but not a depth image, or in EXR.
        RecordingError: the image is in HDF5, and h5py is not installed.
    """
    _refuse_exr(data, name)
    if _is_array(data, name):
        return _as_depth(_array(data, name), name)
    if data[:4] in TIFF_MAGICS:
        _tiff_size_px(data, name)
        return _as_depth(decode_unchanged(data, name), name)
    if is_netpbm(data, name):
        return _as_depth(decode_netpbm(data, name), name)
    if channels is not None and data.startswith(PNG_MAGIC):
        image_header(data, name)
        pixels = decode_unchanged(data, name)
        if pixels.ndim != 3 or pixels.dtype != np.uint8:
            raise OddImageError(
                f"{name}: is no PNG of 8-bit channels, as other depth here: keep one kind", advice=""
            )
        return joined_channels(pixels, channels)
    return decode_depth_png(data, name)


def depth_size_px(data: bytes, name: str) -> tuple[int, int]:
    """Return width and height of a depth image, pixels; raise errors as `decode_depth_file` does."""
    _refuse_exr(data, name)
    if _is_array(data, name):
        height, width = _array(data, name).shape
        return width, height
    if data[:4] in TIFF_MAGICS:
        return _tiff_size_px(data, name)
    if is_netpbm(data, name):
        return netpbm_head(data, name)[:2]
    return image_header(data, name)[1:]


def shapes_of_arrays(file: Path) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays in an .npz file, or of that in an .npy file under "", by their headers.

    There are none if the file is damaged, or of another kind.
    """
    with suppress(*UNREADABLE), open_plain(file) as opened:
        if opened.read(len(ZIP_MAGIC)) == ZIP_MAGIC:
            opened.seek(0)
            with open_npz(opened, MOST_ARRAY_BYTES) as archive:
                return {
                    entry.filename[:-4]: _shape(archive.open(entry), entry.file_size)
                    for entry in archive.infolist()
                }
        opened.seek(0)
        return {"": _shape(opened, file.stat().st_size)}
    return {}


def _shape(file: IO[bytes], size: int) -> tuple[int, ...]:
    """Return the shape by the header of a .npy of `size` bytes; () if it has other bytes of data."""
    header = read_npy_header(file)
    return header.shape if header.data_offset + header.data_bytes == size else ()


def _refuse_exr(data: bytes, name: str) -> None:
    if data.startswith(EXR_MAGIC):
        raise OddImageError(
            f"{name}: EXR images are not read: write each as .npy in metres; in Python "
            f"`{READ_EXR.format(f='path')}` reads one, after `pip install OpenEXR`",
            advice="",
        )


def _is_array(data: bytes, name: str) -> bool:
    return data.startswith((MAGIC, ZIP_MAGIC, HDF5_MAGIC)) or Path(name).suffix.lower() in ARRAYS


def kind_of(depth: UInt16 | Float32) -> str:
    """Return the type of a depth image's values, in words: "whole numbers" or "floats"."""
    return "whole numbers" if depth.dtype == np.uint16 else "floats"


def units_a_metre(depth: UInt16 | Float32) -> float | None:
    """Return the units per metre of a float image, judged by its median: 1 or 1000.

    An image without any measurement counts as one in metres. The result is None for an integer image.
    """
    if depth.dtype == np.uint16:
        return None
    measured = depth[is_measured(depth)]
    return MM_PER_M if len(measured) and float(np.median(measured)) > FARTHEST_M else 1.0


def is_measured(depth: UInt16 | Float32) -> Bools:
    """Return the mask of pixels whose depth is finite and above 0: (height, width) bool."""
    return np.asarray(np.isfinite(depth) & (depth > 0))


def packed_channels(data: bytes, name: str) -> Channels | None:
    """Find the two channels (of B, G, R) of a PNG that hold the high and low byte of depth; None if none do.

    Raises:
        DamagedImageError: a colour PNG with 8 bits is damaged.
    """
    if not data.startswith(PNG_MAGIC):
        return None
    try:
        head = image_head(data)
    except ValueError:
        return None
    if head.bits != 8 or head.color_type not in (2, 6):
        return None
    pixels = decode_unchanged(data, name)
    for channels in permutations(range(3), 2):
        depth = joined_channels(pixels, channels).astype(np.int64)
        sides = ((depth[:, :-1], depth[:, 1:]), (depth[:-1], depth[1:]))
        first, second = (np.concatenate([side[k].ravel() for side in sides]) for k in (0, 1))
        steps = (first > 0) & (second > 0) & (np.abs((first >> 8) - (second >> 8)) == 1)
        small = np.abs(first - second)[steps] < SMALL_STEP
        if small.size >= LEAST_STEPS and small.mean() > SMALL_SHARE:
            return channels
    return None


def joined_channels(pixels: NDArray[np.generic], channels: Channels) -> UInt16:
    """Join the high and the low byte of depth from two channels of an image (height, width, 3 or 4) uint8."""
    high, low = (pixels[..., channel].astype(np.uint16) for channel in channels)
    return np.asarray(high << np.uint16(8) | low, np.uint16)


def _as_depth(pixels: NDArray[np.generic], name: str) -> UInt16 | Float32:
    if pixels.ndim == 2 and pixels.dtype.kind == "f":
        with np.errstate(over="ignore"):
            return pixels.astype(np.float32)
    if pixels.ndim == 2 and pixels.dtype.kind in "ui" and pixels.dtype.itemsize == 1:
        raise OddImageError(
            f"{name}: depth is 8-bit ({pixels.dtype}): export the raw depth again, not a picture of it",
            advice="",
        )
    if pixels.ndim == 2 and pixels.dtype.kind in "ui":
        if pixels.size and (pixels.min() < 0 or pixels.max() > np.iinfo(np.uint16).max):
            raise OddImageError(
                f"{name}: its whole numbers do not fit into 16 bits: write metres as floats", advice=""
            )
        return pixels.astype(np.uint16)
    raise OddImageError(
        f"{name}: depth is {pixels.dtype} of shape {pixels.shape}, not one channel of floats or of 16-bit "
        "numbers"
    )


def _array(data: bytes, name: str) -> NDArray[np.generic]:
    """Read the image in a .npy, .npz or HDF5 file, (height, width), without unpickling."""
    kind = Path(name).suffix or "NumPy"
    try:
        array = _stored(data, name)
    except UNREADABLE as error:
        raise DamagedImageError(f"{name}: the {kind} file is damaged ({error})") from error
    sides = _sides(array)
    if array.dtype.kind not in "fui" or len(sides) != 2:
        raise OddImageError(f"{name}: depth is {array.dtype} of shape {array.shape}, not (height, width)")
    if is_too_large(*sides):
        raise DamagedImageError(f"{name}: {sides} are more pixels than an image may have")
    return array.reshape(sides)


def _stored(data: bytes, name: str) -> NDArray[np.generic]:
    """Read the array in a .npy, .npz or HDF5 file."""
    if data.startswith(HDF5_MAGIC):
        arrays = hdf5_arrays(data, name, (KEY,), MOST_PIXELS)
        if KEY not in arrays:
            raise OddImageError(f"{name}: holds no array '{KEY}'")
        return arrays[KEY]
    return _of_npz(data, name) if data.startswith(ZIP_MAGIC) else read_npy(io.BytesIO(data), len(data))


def _of_npz(data: bytes, name: str) -> NDArray[np.generic]:
    """Return the array `depth` of a .npz file, or else its only image."""
    file = io.BytesIO(data)
    with open_npz(file, UNPACKED_BYTES) as archive:
        keys = sorted(entry.filename.removesuffix(".npy") for entry in archive.infolist())
    file.seek(0)
    arrays = arrays_of(file, UNPACKED_BYTES, [KEY] if KEY in keys else None)
    images = [array for array in arrays.values() if len(_sides(array)) == 2]
    if len(images) != 1:
        shapes = ", ".join(f"'{key}' {array.shape}" for key, array in sorted(arrays.items()))
        raise OddImageError(
            f"{name}: holds {printable(shapes, 200) or 'no arrays'}: which one is depth? give it the key "
            f"'{KEY}', (height, width)",
            advice="",
        )
    return images[0]


def _sides(array: NDArray[np.generic]) -> tuple[int, ...]:
    return tuple(side for side in array.shape if side != 1)


def _tiff_size_px(data: bytes, name: str) -> tuple[int, int]:
    """Return width and height from the first directory of a TIFF, pixels."""
    order = TIFF_MAGICS[data[:4]]
    try:
        (place,) = struct.unpack_from(order + "I", data, 4)
        (count,) = struct.unpack_from(order + "H", data, place)
        sizes = {}
        for number in range(min(count, MOST_TIFF_TAGS)):
            tag, kind, _ = struct.unpack_from(order + "HHI", data, place + 2 + 12 * number)
            if tag in (TIFF_WIDTH, TIFF_HEIGHT):
                code = "H" if kind == 3 else "I"
                (sizes[tag],) = struct.unpack_from(order + code, data, place + 10 + 12 * number)
        width, height = int(sizes[TIFF_WIDTH]), int(sizes[TIFF_HEIGHT])
    except (struct.error, KeyError) as error:
        raise DamagedImageError(f"{name}: the TIFF is damaged or cut off") from error
    if is_too_large(width, height):
        raise DamagedImageError(f"{name}: {width}x{height} are more pixels than an image may have")
    return width, height


def hdf5_arrays(
    data: bytes, name: str, keys: Iterable[str], most_values: int
) -> dict[str, NDArray[np.generic]]:
    """Read the arrays under those `keys` that an HDF5 file has; return {key: array}.

    Keys are from the file's root; an array has at most `most_values`.

    Raises:
        DamagedImageError: the file is damaged, or an array is too large, not numeric, or stored in another
            file.
        RecordingError: h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise RecordingError(
            f"{name}: is an HDF5 file; install what reads it with `pip install 'kinectbench[ycb]'`",
            what="no-package",
        ) from error
    found: dict[str, NDArray[np.generic]] = {}
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            for key in keys:
                if file.get(key, getlink=True) is not None:
                    found[key] = _hdf5_array(h5py, file, key, most_values)
    except DAMAGED as error:
        said = str(error).strip().splitlines() or [type(error).__name__]
        raise DamagedImageError(f"{name}: the HDF5 file is damaged ({said[0]})") from error
    return found


def _hdf5_array(h5py: ModuleType, file: "File", key: str, most_values: int) -> NDArray[np.generic]:
    """Read the array `key` of an open HDF5 file, of at most `most_values` values.

    Raises:
        ValueError: it is a link, stored in another file, too large or not numeric.
    """
    if not isinstance(file.get(key, getlink=True), h5py.HardLink):
        raise ValueError(f"'{key}' is a link")
    entry = file[key]
    if not isinstance(entry, h5py.Dataset) or entry.is_virtual or entry.external:
        raise ValueError(f"'{key}' is no array of this file")
    if entry.dtype.kind not in "fui" or entry.shape is None or prod(entry.shape) > most_values:
        raise ValueError(f"'{key}' is {entry.dtype} of shape {entry.shape}")
    return np.asarray(entry[()])
