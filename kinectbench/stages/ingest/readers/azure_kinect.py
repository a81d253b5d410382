"""Recordings of Azure Kinect and Orbbec's Femto: Matroska files by k4arecorder, tracks DEPTH and COLOR.

Layout by the sensor's SDK (its record and transformation folders, MIT): depth is 16-bit big-endian mm; colour
is MJPG, NV12, YUY2 or BGRA; `calibration.json` is attached. Its intrinsics are shares of the whole sensor
with (0, 0) at the sensor's corner. A depth mode bins and crops the sensor's pixels; colour is cropped to the
height of its mode. Distortion is Brown's with six radial terms, undefined beyond MetricRadius.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import HEAD_BYTES, UNPACKED_BYTES, RecordingError, is_too_large, open_plain, size_of
from kinectbench.core.trajectory.stamps import LIMIT_NS, NS_PER_S, first_by_stamp
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError, encode_png
from kinectbench.stages.ingest.json_values import object_of
from kinectbench.stages.ingest.pairing import pair_by_time
from kinectbench.stages.ingest.readers.azure_calibration import (
    CALIBRATION_FILE,
    COLOR_LOCATION,
    AzureCalibration,
)
from kinectbench.stages.ingest.recording import COLOR_DELAY, RawFrame, Recording
from kinectbench.stages.ingest.sources import check_count
from kinectbench.stages.ingest.undistortion import Undistortion

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream

DEPTH_SCALE = 1000.0
EBML_MAGIC = b"\x1a\x45\xdf\xa3"
SUFFIX = ".mkv"
MARKS = (b"K4A_", b"b16g")
TRACKS = ("DEPTH", "COLOR", "IR")
# The id of Matroska's segment. Its size is written when the file is closed; before, it consists of ones.
SEGMENT = b"\x18\x53\x80\x67"
UNKNOWN_SIZE = (1 << 56) - 1
# Largest number of bytes between the start of a block and its image (Matroska: id, size, track, time).
BLOCK_HEAD_BYTES = 64
# OpenCV's conversions of the formats that are not JPEG.
RAW_COLOR = {"NV12": "COLOR_YUV2BGR_NV12", "YUY2": "COLOR_YUV2BGR_YUY2", "BGRA": "COLOR_BGRA2BGR"}
RAW_BYTES_A_PIXEL = {"NV12": 1.5, "YUY2": 2.0, "BGRA": 4.0}


class Place(NamedTuple):
    """An image in the file: its stamp, nanoseconds, and the position and length of its data, bytes."""

    stamp_ns: int
    start: int
    length: int


class AzureFrame(NamedTuple):
    """A frame: its stamp, nanoseconds, and the places of its depth image and its colour image (or None)."""

    stamp_ns: int
    depth: Place
    color: Place | None


@dataclass(frozen=True, kw_only=True)
class AzureKinectRecording(Recording):
    """A .mkv by k4arecorder; needs kinectbench[azure].

    Attributes:
        calibration: calibration of its cameras.
        color_mode: format of colour, such as MJPG; "" without colour.
        undistortion: makes pinhole images from depth; None if not needed.
    """

    format: ClassVar[str] = "azure_kinect"
    uses: ClassVar[frozenset[str]] = COLOR_DELAY
    looks_for: ClassVar[str] = "a .mkv of Azure Kinect or Femto with a depth track (needs kinectbench[azure])"
    suffixes: ClassVar[tuple[str, ...]] = (SUFFIX,)

    places: tuple[AzureFrame, ...]
    calibration: AzureCalibration = field(compare=False)
    color_mode: str
    undistortion: Undistortion | None = field(default=None, compare=False)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the path is a Matroska file named .mkv, or with the tags or depth codec of Azure Kinect."""
        if not path.is_file():
            return False
        with open_plain(path) as file:
            # Read no more of other files: folders contain thousands of them.
            if file.read(len(EBML_MAGIC)) != EBML_MAGIC:
                return False
            if path.suffix.lower() in cls.suffixes:
                return True
            head = file.read(HEAD_BYTES)  # names the tracks; k4arecorder's head is far shorter
        return any(mark in head for mark in MARKS)

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Read tags and calibration, and find every image, without decoding any."""
        with _opened(path) as container:
            tracks = _tracks(container)
            depth_track, color_track = tracks.get("DEPTH"), tracks.get("COLOR")
            if depth_track is None:
                raise RecordingError(
                    f"{path}: has no depth track (DEPTH of k4arecorder), so there is colour only: record it "
                    "with a depth mode other than OFF and PASSIVE_IR",
                    what="no-depth",
                )
            calibration = AzureCalibration.of(_attached(container, path), path)
            depth_px = _size_px(depth_track, path)
            color_px = None if color_track is None else _size_px(color_track, path)
            mode = "" if color_track is None else _color_mode(color_track)
            indices = {track.index: name for name, track in tracks.items()}
            lists, trouble = _find_images(container, indices, path)
        trouble = trouble or _cut(path, len(lists["DEPTH"]))
        depth, warnings = _in_order(lists["DEPTH"], path)
        color, _ = _in_order(lists["COLOR"], path)
        if not depth:
            raise RecordingError(f"{path}: its depth track holds no whole image; copy the file again")
        stamps_ns = ([place.stamp_ns for place in places] for places in (depth, color))
        partners = pair_by_time(*stamps_ns, delay_s=settings.color_delay_s, where=str(path))
        frames = tuple(
            AzureFrame(place.stamp_ns, place, None if partner is None else color[partner])
            for place, partner in zip(depth, partners.of_depth, strict=True)
        )
        recorded, distortion = calibration.depth(depth_px, path)
        intrinsics = recorded.overridden_by(settings)
        camera = intrinsics.camera(depth_px, path)
        rig = None if color_px is None else calibration.color(color_px, path)
        if color and rig is None:
            warnings.append(
                f"{path}: its colour is left out: {CALIBRATION_FILE} has no camera at {COLOR_LOCATION}, "
                "which is colour's"
            )
        registered = rig is not None and rig.lies_on(camera)
        return cls(
            path=path,
            places=frames,
            calibration=calibration,
            color_mode=mode,
            camera=camera,
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=registered,
            color_calibration=None if registered else rig,
            recorded=(tuple(p.stamp_ns for p in lists["DEPTH"]), tuple(p.stamp_ns for p in lists["COLOR"])),
            warnings=(*trouble, *warnings, *partners.warnings),
            undistortion=Undistortion(camera, distortion) if any(distortion) else None,
        )

    def frame(self, index: int) -> RawFrame:
        """Read and decode a frame."""
        place = self.places[index]
        name = f"{self.path}: the frame at byte {place.depth.start}"
        shape = self.camera.height, self.camera.width
        data = self._bytes(place.depth)
        if len(data) != 2 * shape[0] * shape[1]:
            raise DamagedImageError(f"{name}: its depth has {len(data)} bytes, not 2 a pixel: it is damaged")
        stored = np.frombuffer(data, ">u2").reshape(shape).astype(np.uint16)
        if self.undistortion is not None:
            stored = self.undistortion.depth(stored)
            stored[self.calibration.beyond_radius(self.camera)] = 0
        return RawFrame(name, place.stamp_ns, stored, self._color(place.color))

    def _bytes(self, place: Place) -> bytes:
        if place.length > UNPACKED_BYTES:
            raise DamagedImageError(f"{self.path}: an image of {place.length} bytes at byte {place.start}")
        with open_plain(self.path) as file:
            file.seek(place.start)
            return file.read(place.length)

    def _color(self, place: Place | None) -> tuple[str, bytes] | None:
        """Return colour as encoded, or raw colour as PNG; None if missing, uncalibrated or incomplete."""
        if place is None or not (self.color_calibration or self.color_registered):
            return None
        data = self._bytes(place)
        if self.color_mode not in RAW_COLOR:
            return ".jpg", data
        camera = self.camera if self.color_calibration is None else self.color_calibration.camera
        bgr = _raw_bgr(data, self.color_mode, (camera.width, camera.height))
        return None if bgr is None else (".png", encode_png(bgr))


@contextmanager
def _opened(path: Path) -> Iterator["InputContainer"]:
    """Open the container, and close it after the block; errors of PyAV become a RecordingError."""
    try:
        import av
    except ModuleNotFoundError as error:
        raise RecordingError(
            f"{path}: reading a .mkv of Azure Kinect needs PyAV: pip install 'kinectbench[azure]'",
            what="no-package",
        ) from error
    try:
        # A file object, because other readers of FFmpeg might take a name for a list of files. And nothing
        # may be decoded to find out about a track, whatever size the track claims.
        with (
            open_plain(path) as file,
            av.open(file, "r", format="matroska", container_options={"codec_whitelist": "none"}) as container,
        ):
            yield container
    except (av.FFmpegError, OSError, ValueError) as error:
        raise RecordingError(
            f"{path}: is no Matroska file that can be read ({error}); copy it again"
        ) from error


def _tracks(container: "InputContainer") -> dict[str, "VideoStream"]:
    """Return the video tracks by k4arecorder's names DEPTH, COLOR and IR."""
    named = {str(track.metadata.get("title", "")).upper(): track for track in container.streams.video}
    numbered = {str(track.id): track for track in container.streams.video}
    by_tag = {name: numbered.get(container.metadata.get(f"K4A_{name}_TRACK", "")) for name in TRACKS}
    tracks = {name: named.get(name) or by_tag[name] for name in TRACKS}
    return {name: track for name, track in tracks.items() if track is not None}


def _size_px(track: "VideoStream", path: Path) -> tuple[int, int]:
    """Return width and height of a track's images, pixels.

    Raises:
        RecordingError: the size is 0, or so large that the file must be damaged.
    """
    # A track with a codec that FFmpeg does not know has neither.
    width, height = (int(getattr(track, side, 0)) for side in ("width", "height"))
    if min(width, height) <= 0 or is_too_large(width, height):
        raise RecordingError(
            f"{path}: a track of {width}x{height} pixels is of no camera; the file is damaged, copy it again"
        )
    return width, height


def _color_mode(track: "VideoStream") -> str:
    """Return the format of colour, such as MJPG."""
    mode = str(track.metadata.get("K4A_COLOR_MODE", "")).partition("_")[0]
    return mode or {"nv12": "NV12", "yuyv422": "YUY2", "bgra": "BGRA"}.get(str(track.pix_fmt), "MJPG")


def _attached(container: "InputContainer", path: Path) -> dict[str, object]:
    """Read the calibration that is attached to the file, as a JSON object."""
    for attachment in container.streams.attachments:
        if attachment.name == CALIBRATION_FILE and attachment.data:
            return object_of(
                attachment.data.rstrip(b"\0"), f"{path}: {CALIBRATION_FILE}", "CalibrationInformation"
            )
    raise RecordingError(
        f"{path}: has no {CALIBRATION_FILE} attached; record it with k4arecorder, or convert it",
        what="no-intrinsics",
    )


def _find_images(
    container: "InputContainer", names: dict[int, str], path: Path
) -> tuple[dict[str, list[Place]], list[str]]:
    """Return {track ("DEPTH", "COLOR", "IR"): places of its images in file order}, and the file's faults.

    `names` is {index of track: name}. The list of "IR" stays empty. Images of impossible times are left out.
    """
    import av

    places: dict[str, list[Place]] = {"DEPTH": [], "COLOR": [], "IR": []}
    trouble = list[str]()
    with open_plain(path) as file:
        try:
            packets = container.demux(video=tuple(range(len(container.streams.video))))
            for count, packet in enumerate(packets):
                check_count(path, max(len(places["DEPTH"]), len(places["COLOR"]), count // len(TRACKS)))
                name = names.get(packet.stream.index, "IR")
                if name == "IR" or packet.pts is None or not packet.size or packet.pos is None:
                    continue
                stamp_ns = round(packet.pts * packet.time_base * NS_PER_S)
                if abs(stamp_ns) >= LIMIT_NS:
                    trouble = [f"{path}: images of impossible times, such as {stamp_ns} ns, are left out"]
                    continue
                places[name].append(
                    Place(stamp_ns, _start(file, packet.pos, bytes(packet), path), packet.size)
                )
        except (av.FFmpegError, OSError) as error:
            trouble.append(f"{path}: is cut off or damaged ({error}): {len(places['DEPTH'])} frames are read")
    return places, trouble


def _cut(path: Path, frames: int) -> list[str]:
    """Return a warning if the file is truncated, with the number of frames that are read."""
    with open_plain(path) as file:
        head, file_bytes = file.read(HEAD_BYTES), size_of(file)
    start = head.find(SEGMENT) + len(SEGMENT)
    size = head[start : start + 8]
    # Recorders reserve eight bytes for the size, and fill it in at the end.
    if len(size) < 8 or size[0] != 1:
        return []
    length = int.from_bytes(size[1:], "big")
    if length == UNKNOWN_SIZE or start + 8 + length <= file_bytes:
        return []
    return [f"{path}: is cut off: {frames} frames are whole and are read; copy it again"]


def _start(file: BinaryIO, position: int, data: bytes, path: Path) -> int:
    """Find where an image's bytes, `data`, start in the file; its block starts at `position`.

    Raises:
        RecordingError: the image's bytes are not in the file unchanged.
    """
    file.seek(position)
    region = file.read(len(data) + BLOCK_HEAD_BYTES)
    for skipped in range(BLOCK_HEAD_BYTES + 1):
        if region.startswith(data, skipped):
            return position + skipped
    raise RecordingError(
        f"{path}: its images are packed by Matroska's own compression; unpack them with `mkvmerge -o NEW.mkv "
        f"--compression -1:none {path.name}`",
        what="unsupported",
    )


def _in_order(places: list[Place], path: Path) -> tuple[list[Place], list[str]]:
    """Sort images by stamp, and drop images that repeat a stamp; return the images, and warnings."""
    order, warnings = first_by_stamp([place.stamp_ns for place in places], str(path), "images")
    return [places[i] for i in order], warnings


def _raw_bgr(data: bytes, mode: str, size_px: tuple[int, int]) -> NDArray[np.uint8] | None:
    """Convert raw colour to BGR (height, width, 3); None if the length or an odd side contradicts `mode`."""
    import cv2

    width, height = size_px
    odd = mode != "BGRA" and (width % 2 or (mode == "NV12" and height % 2))
    if odd or len(data) != width * height * RAW_BYTES_A_PIXEL[mode]:
        return None
    pixels = np.frombuffer(data, np.uint8)
    shape = {"NV12": (height * 3 // 2, width), "YUY2": (height, width, 2), "BGRA": (height, width, 4)}[mode]
    return np.asarray(cv2.cvtColor(pixels.reshape(shape), getattr(cv2, RAW_COLOR[mode])), np.uint8)
