"""ElasticFusion's logs (.klg), read frame by frame; a truncated log is read to its end.

Layout, little-endian (ElasticFusion's RawLogReader): `int32 frames`; then per frame `int64 stamp in
microseconds, int32 depth bytes, int32 colour bytes`, depth, colour. Depth is uint16 mm, raw or by zlib;
colour is raw, a JPEG, or missing. The file contains neither image size nor intrinsics.
"""

import struct
import zlib
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple, Self

import numpy as np

from kinectbench.core import UNPACKED_BYTES, RecordingError, open_plain, size_of
from kinectbench.core.encoded_images import JPEG_MAGIC
from kinectbench.core.trajectory.stamps import counted_ns, first_by_stamp, no_times
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError, decode_color_bgr, encode_png
from kinectbench.stages.ingest.intrinsics import Intrinsics
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.sources import check_count

COUNT, HEAD = struct.Struct("<i"), struct.Struct("<qii")
DEPTH_SCALE = 1000.0
# ElasticFusion's default size.
SIZE_PX = (640, 480)
CAMERA = Intrinsics(640, 480, 528.0, 528.0, 320.0, 240.0)
NS_PER_US = 1000
ZLIB_STARTS = (b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda")


class PackedFrame(NamedTuple):
    """A frame in the file: stamp in nanoseconds, position and sizes of its images' data in bytes."""

    stamp_ns: int
    position: int
    depth_bytes: int
    color_bytes: int


@dataclass(frozen=True, kw_only=True)
class PackedRecording(Recording):
    """A file of consecutive frames, with depth stored raw or compressed by zlib."""

    # Whether colour precedes depth within a frame.
    color_first: ClassVar[bool] = False

    places: tuple[PackedFrame, ...]

    def frame(self, index: int) -> RawFrame:
        """Read and decode a frame."""
        place = self.places[index]
        name = f"{self.path}: the frame at byte {place.position}"
        if place.depth_bytes + place.color_bytes > UNPACKED_BYTES:
            raise DamagedImageError(f"{name}: says that it has more than {UNPACKED_BYTES} bytes")
        with open_plain(self.path) as file:
            file.seek(place.position)
            data = file.read(place.depth_bytes + place.color_bytes)
        depth, color = data[: place.depth_bytes], data[place.depth_bytes :]
        if self.color_first:
            color, depth = data[: place.color_bytes], data[place.color_bytes :]
        shape = self.camera.height, self.camera.width
        size = 2 * shape[0] * shape[1]
        unpacked = depth if self.is_raw(depth, size) else inflated(depth, size, name)
        pixels = np.frombuffer(unpacked, "<u2").reshape(shape).astype(np.uint16)
        return RawFrame(name, place.stamp_ns, pixels, self.color(color, name))

    def is_raw(self, depth: bytes, size: int) -> bool:
        """Whether stored depth is raw, not compressed; `size` is its size when unpacked, bytes."""
        return len(depth) == size

    @abstractmethod
    def color(self, data: bytes, name: str) -> tuple[str, bytes] | None:
        """Convert a frame's stored colour to (suffix, encoded image); None if there is no colour."""


@dataclass(frozen=True, kw_only=True)
class KlgRecording(PackedRecording):
    """An ElasticFusion log; colour is registered to depth, as ElasticFusion requires.

    Attributes:
        swap_red_blue: whether colour is stored with red and blue exchanged.
    """

    format: ClassVar[str] = "klg"
    uses: ClassVar[frozenset[str]] = frozenset({"swap_red_blue"})
    looks_for: ClassVar[str] = "a .klg file of ElasticFusion"
    suffixes: ClassVar[tuple[str, ...]] = (".klg",)

    swap_red_blue: bool

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the path is named .klg; the format has no signature."""
        return path.suffix.lower() in cls.suffixes and path.is_file()

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Find the frames; size and intrinsics are from the settings, or else ElasticFusion's defaults."""
        recorded, warnings = Intrinsics(), []
        if settings.fx is None:
            recorded = CAMERA
            warnings.append(
                f"{path}: a .klg has no intrinsics; ElasticFusion's are taken (528, 528, 320, 240)"
            )
        size_px = (settings.width or SIZE_PX[0], settings.height or SIZE_PX[1])
        found, trouble = _find_frames(path, size_px)
        frames, order, faults = timed(found, path)
        intrinsics = recorded.overridden_by(settings)
        return cls(
            path=path,
            places=tuple(frames[i] for i in order),
            recorded=(tuple(frame.stamp_ns for frame in frames), ()),
            swap_red_blue=settings.swap_red_blue,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=True,
            warnings=(*trouble, *warnings, *faults),
        )

    def color(self, data: bytes, name: str) -> tuple[str, bytes] | None:
        """Return a frame's colour: (suffix, image with red and blue in order); None if it has no colour."""
        if not data:
            return None
        shape = self.camera.height, self.camera.width, 3
        if len(data) == np.prod(shape):
            rgb = np.frombuffer(data, np.uint8).reshape(shape)
            return ".png", encode_png(np.ascontiguousarray(rgb if self.swap_red_blue else rgb[..., ::-1]))
        if not self.swap_red_blue:
            return ".jpg", data
        bgr = decode_color_bgr(data, f"colour of {name}")
        return ".png", encode_png(np.ascontiguousarray(bgr[..., ::-1]))


def timed(frames: list[PackedFrame], path: Path) -> tuple[list[PackedFrame], list[int], list[str]]:
    """Replace implausible stamps, and find the order of frames by stamp without repeated stamps.

    Returns:
        The frames in file order, stamped 0 s, 1 s, 2 s, ... if their own stamps cannot be times (`no_times`);
        the indices of the frames to keep, by ascending stamp; and warnings.
    """
    counted, why = [], no_times([frame.stamp_ns for frame in frames])
    if why:
        frames = [f._replace(stamp_ns=ns) for f, ns in zip(frames, counted_ns(len(frames)), strict=True)]
        counted.append(f"{path}: its stamps are no times ({why}); its frames are counted instead")
    order, warnings = first_by_stamp([frame.stamp_ns for frame in frames], str(path), "frames")
    return frames, order, [*counted, *warnings]


def inflated(data: bytes, size: int, name: str) -> bytes:
    """Unpack zlib data to exactly `size` bytes, without allocating more.

    Raises:
        DamagedImageError: the data is damaged, or has another size.
    """
    try:
        unpacker = zlib.decompressobj()
        unpacked = unpacker.decompress(data, size)
        more = unpacker.decompress(unpacker.unconsumed_tail, 1)
    except zlib.error as error:
        raise DamagedImageError(f"{name}: its depth cannot be unpacked ({error})") from error
    if len(unpacked) != size or more:
        kind = "more than" if more else f"{len(unpacked)} bytes, not"
        raise DamagedImageError(f"{name}: its depth unpacks to {kind} the {size} bytes of its images")
    return unpacked


def _find_frames(path: Path, size_px: tuple[int, int]) -> tuple[list[PackedFrame], list[str]]:
    """Return the complete frames up to the first damaged one, in file order, and the file's faults.

    Raises:
        RecordingError: no frame is complete, the first is of another size, or there are too many.
    """
    frames: list[PackedFrame] = []
    with open_plain(path) as file:
        size = size_of(file)
        if size < COUNT.size:
            raise RecordingError(f"{path}: the file is empty or cut off; copy it again")
        (declared,) = COUNT.unpack(file.read(COUNT.size))
        position = COUNT.size
        while position + HEAD.size <= size:
            file.seek(position)
            stamp_us, depth_bytes, color_bytes = HEAD.unpack(file.read(HEAD.size))
            start = position + HEAD.size
            sizes_are_none = depth_bytes <= 0 or color_bytes < 0 or depth_bytes + color_bytes > UNPACKED_BYTES
            if sizes_are_none or abs(stamp_us) > 2**62 // NS_PER_US:
                return frames, [_damaged(path, frames, declared, f"is damaged at byte {position}")]
            if start + depth_bytes + color_bytes > size:
                break
            if not frames:
                _check_first(path, file.read(depth_bytes), file.read(color_bytes), size_px)
            check_count(path, len(frames) + 1)
            frames.append(PackedFrame(stamp_us * NS_PER_US, start, depth_bytes, color_bytes))
            position = start + depth_bytes + color_bytes
    if position != size or (declared > 0 and declared != len(frames)):
        return frames, [_damaged(path, frames, declared, "is cut off")]
    if not frames:
        raise RecordingError(f"{path}: holds no frame", what="no-frame")
    return frames, []


def _damaged(path: Path, frames: list[PackedFrame], declared: int, what: str) -> str:
    if not frames:
        raise RecordingError(f"{path}: {what}, and no frame in it is whole; copy it again", what="no-frame")
    of = f" of {declared}" if declared > 0 else ""
    return f"{path}: {what}: {len(frames)}{of} frames are whole and are read; copy it again"


def _check_first(path: Path, depth: bytes, color: bytes, size_px: tuple[int, int]) -> None:
    """Refuse a file whose first frame does not have this image size."""
    pixels = size_px[0] * size_px[1]
    says = (
        f"{size_px[0]}x{size_px[1]}; if they are of another size, give `camera: {{width: ..., height: ...}}`"
    )
    if len(depth) != 2 * pixels:
        if not depth.startswith(ZLIB_STARTS):
            raise RecordingError(f"{path}: the first depth image is neither by zlib nor raw at {says}")
        try:
            inflated(depth, 2 * pixels, "first frame")
        except DamagedImageError as error:
            raise RecordingError(f"{path}: {error}; they are taken for {says}") from error
    if color and len(color) != 3 * pixels and not color.startswith(JPEG_MAGIC):
        raise RecordingError(f"{path}: the first colour image is neither a JPEG nor raw at {says}")
