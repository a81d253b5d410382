"""The interface of recordings: frames one by one, a camera, and optionally a trajectory."""

import errno
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import ClassVar, Literal, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import IMAGE_BYTES, RecordingError, printable, read_plain
from kinectbench.core.encoded_images import PNG_MAGIC
from kinectbench.core.geometry import Camera
from kinectbench.core.sequence import GivenTrajectory, UpSample
from kinectbench.core.types import Bools, DepthCode, Float64, Int64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.color_pictures import as_png
from kinectbench.stages.ingest.depth_codes import read_by_code
from kinectbench.stages.ingest.depth_files import decode_depth_file, depth_size_px, kind_of
from kinectbench.stages.ingest.images import (
    DamagedImageError,
    OddImageError,
    advised,
    decode_mask,
    image_header,
    quantised,
)
from kinectbench.stages.ingest.known_names import first_file, in_any_case, visible

# Largest number of damaged images or messages to try until an undamaged one: five minutes at 30 frames a
# second. An index may start long before the images that were kept.
MOST_TRIED = 10_000
# What a path is may keep a file from being read, for ever; any other reason is the machine's, and may pass.
NO_IMAGE_FILE = {errno.EINVAL, errno.EFBIG, errno.EISDIR, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG}
Item = TypeVar("Item")
Result = TypeVar("Result")
Pixel = TypeVar("Pixel", bound=np.generic)
# What a reader was tested on: a real recording, one with a licence to copy it, or files that a writer of this
# project made from the format's description.
Evidence = Literal["recording", "copy", "writer"]
# Folder of the user's masks beside the folders of a recording's images.
MASKS_FOLDER, MASK_KINDS = "masks", ("*.png", "*.jpg", "*.jpeg", "*.bmp", "*.npy", "*.tif", "*.tiff")

# Settings of a camera that only some formats have a use for; others warn of them.
OF_SOME_FORMATS = (
    "depth_topic",
    "color_topic",
    "pose_topic",
    "color_delay_s",
    "min_confidence",
    "mask_object",
    "sensor",
    "swap_red_blue",
)
COLOR_DELAY = frozenset({"color_delay_s"})


@dataclass(frozen=True)
class RawFrame:
    """One recorded frame.

    Attributes:
        name: source of the frame, for messages.
        stamp_ns: stamp of the depth image, nanoseconds.
        depth: (height, width) uint16 in native units, 0 = no measurement.
        color: (suffix of a JPEG or PNG, such as ".jpg", the encoded image); None if there is none.
        mask: (height, width) bool, the object's pixels by a given mask; None if there is none.
    """

    name: str
    stamp_ns: int
    depth: NDArray[np.uint16]
    color: tuple[str, bytes] | None
    mask: Bools | None = None


@dataclass(frozen=True)
class ColorCalibration:
    """The calibration for mapping unregistered colour onto depth pixels.

    Attributes:
        camera: intrinsics of the colour images, pixels.
        distortion: k1 k2 p1 p2 [k3 [k4 k5 k6]] of the colour images (Brown 1971); empty: no distortion.
        T_color_depth: (4, 4) float64, depth camera to colour camera, metres.
    """

    camera: Camera
    distortion: tuple[float, ...]
    T_color_depth: Float64

    def lies_on(self, depth: Camera) -> bool:
        """Whether both cameras coincide and colour is not distorted, so that it is already registered."""
        return (
            self.camera == depth
            and not self.distortion
            and np.allclose(self.T_color_depth, np.eye(4), atol=1e-7)
        )


class ListedFrame(Protocol):
    """An entry in a recording's list of frames; every reader has a class of its own for it."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the depth image, nanoseconds."""
        ...


@dataclass(frozen=True, kw_only=True)
class Recording(ABC):
    """An opened recording: its camera is known, and its frames are read on demand.

    Attributes:
        path: the folder or file.
        format: name of the format, as in FORMATS.
        looks_for: what a folder or file must contain to be recognised.
        suffixes: suffixes of such files; the id of a recording is its name without them.
        uses: names of the settings in `OF_SOME_FORMATS` that this reader applies; not all readers apply them.
        evidence: the best data that the reader was tested on: real data, licensed real data, or our own
            files.
        verified: a description of that data, such as files of other programs; "" if it is only our own files.
        up_world: (3,) unit: up in the frame of the given trajectory, if the format aligns it with gravity;
            None: unknown.
        places: list of frames, damaged ones included; stamps are strictly increasing.
        camera: intrinsics of the depth images, pixels.
        depth_scale: native depth units per metre.
        float_scale: units per metre in the files, if depth is float there; None: depth is in integers.
        color_registered: whether colour pixels lie on depth pixels.
        color_calibration: calibration of unregistered colour relative to depth, or None if unknown.
        given_trajectory: the trajectory that came with the recording; None if there is none.
        trajectory_error: why the trajectory that came with the recording cannot be used, or "".
        color_delay_s: delay, from the settings, that was subtracted from the stamps of colour, seconds.
        trajectory_delay_s: delay, from the settings, that was subtracted from the stamps of given poses,
            seconds.
        trajectory_read: whether the settings say how given poses are stored.
        warnings: lines for the user.
        recorded: stamps of depth and of colour in the order of recording, nanoseconds; None: as in `places`.
        up_cameras: the up direction in camera axes at some frames, measured by an accelerometer.
    """

    format: ClassVar[str]
    looks_for: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]] = ()
    uses: ClassVar[frozenset[str]] = frozenset()
    evidence: ClassVar[Evidence] = "writer"
    verified: ClassVar[str] = ""
    up_world: ClassVar[tuple[float, float, float] | None] = None
    path: Path
    places: tuple[ListedFrame, ...]
    camera: Camera
    depth_scale: float
    float_scale: float | None = None
    color_registered: bool
    color_calibration: ColorCalibration | None = None
    given_trajectory: GivenTrajectory | None = None
    trajectory_error: str = ""
    color_delay_s: float = 0.0
    trajectory_delay_s: float = 0.0
    trajectory_read: bool = False
    warnings: tuple[str, ...] = ()
    recorded: tuple[tuple[int, ...], tuple[int, ...]] | None = None
    up_cameras: tuple[UpSample, ...] = ()

    @classmethod
    @abstractmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder or file has this format's layout; reads only a few bytes."""

    @classmethod
    def files_beside(cls, path: Path) -> tuple[Path, ...]:
        """Return files of the recording outside its folder, such as intrinsics that sequences share."""
        return ()

    @classmethod
    @abstractmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Open the recording; the settings override its values.

        Raises:
            RecordingError: the recording is unusable; the message says what is wrong and where.
        """

    def __len__(self) -> int:
        """Return the number of listed frames, damaged ones included."""
        return len(self.places)

    @property
    def stamps_ns(self) -> Int64:
        """Stamp of each listed frame, nanoseconds, strictly increasing, without decoding any image."""
        return np.array([place.stamp_ns for place in self.places], np.int64)

    @property
    def recorded_stamps_ns(self) -> tuple[Int64, Int64]:
        """Stamps of every depth and every colour image, in the order of recording.

        They may repeat or decrease, and colour images may lack a partner. The stamps of colour are empty for
        a format without them.
        """
        depth_ns, color_ns = self.recorded or (self.stamps_ns, ())
        return np.array(depth_ns, np.int64), np.array(color_ns, np.int64)

    @abstractmethod
    def frame(self, index: int) -> RawFrame:
        """Read and decode a frame.

        Raises:
            DamagedImageError: an image of the frame is missing or damaged, or (OddImageError) of another kind
                than the recording's depth.
            RecordingError: a file cannot be read, for a reason other than its content.
        """


@dataclass(frozen=True)
class FrameFiles:
    """The files of a frame.

    Attributes:
        stamp_ns: stamp of the depth image, nanoseconds.
        depth: 16-bit PNG, or another depth file.
        color: JPEG or PNG; None if there is none.
        mask: image that marks the object (PNG: nonzero there; `FileRecording.mask` reads it); None if there
            is none.
    """

    stamp_ns: int
    depth: Path
    color: Path | None
    mask: Path | None = None


@dataclass(frozen=True, kw_only=True)
class FileRecording(Recording):
    """A recording with a file for each image; base of the formats in folders.

    Attributes:
        often_rotated: whether depth in this layout usually has rotated bits (`depth_codes`).
        depth_code: how to read the values (`core.types.DepthCode`).
        channels: channels of the high and the low byte, if depth has two 8-bit channels; None: one channel.
        kind: the type of all depth values ("floats" or "whole numbers"), and an example file for the message
            if another file differs; None: whole numbers.
    """

    often_rotated: ClassVar[bool] = False

    places: tuple[FrameFiles, ...]
    depth_code: DepthCode = "plain"
    channels: tuple[int, int] | None = None
    kind: tuple[str, Path] | None = None

    @property
    def folders(self) -> set[Path]:
        """The folders of its images."""
        images = (file for place in self.places for file in (place.depth, place.color, place.mask) if file)
        return {file.parent for file in images}

    def frame(self, index: int) -> RawFrame:
        """Read and decode the files of a frame."""
        files = self.places[index]
        stored = decode_depth_file(read_image_file(files.depth), str(files.depth), self.channels)
        kind = kind_of(stored)
        right, example = self.kind or ("whole numbers", f"depth of the format {self.format}")
        if kind != right:
            raise OddImageError(f"{files.depth}: holds {kind}, but {example} holds {right}: keep one kind")
        native = stored if self.float_scale is None else quantised(stored / np.float32(self.float_scale))
        cleaned = self.placed(self.clean_depth(np.asarray(native, np.uint16), index), index)
        depth = read_by_code(self.depth_code, cleaned, self.camera)
        mask = None if files.mask is None else self.mask(files.mask, depth)
        if mask is not None and mask.shape != native.shape:
            side = f"{native.shape[1]}x{native.shape[0]}"
            raise DamagedImageError(
                f"{files.mask}: its size is not that of the depth image",
                advice=f"masks lie on depth's pixels, {side}: draw or scale them so",
            )
        mask = None if mask is None else self.placed(mask, index)
        return RawFrame(str(files.depth), files.stamp_ns, depth, self.color(index), mask)

    def mask(self, file: Path, depth: NDArray[np.uint16]) -> Bools:
        """Read a mask on the pixels of its depth image (`depth`, native units): (height, width) bool."""
        return decode_mask(read_image_file(file), str(file))

    def color(self, index: int) -> tuple[str, bytes] | None:
        """Return the colour of a frame as encoded in its file: (suffix, bytes); None if it has no colour."""
        file = self.places[index].color
        if file is None:
            return None
        data = read_image_file(file)
        return ".png" if data.startswith(PNG_MAGIC) else file.suffix, data

    def clean_depth(self, depth: NDArray[np.uint16], index: int) -> NDArray[np.uint16]:
        """Correct a frame's depth after it is read; by default, change nothing.

        Readers override it to set invalid or unreliable pixels to 0, or to remove lens distortion.
        """
        return depth

    def placed(self, image: NDArray[Pixel], index: int) -> NDArray[Pixel]:
        """Map an image (height, width, ...) of a frame to the camera's pixels; by default, change nothing."""
        return image


def without_color(path: Path, files: Sequence[FrameFiles]) -> tuple[str, ...]:
    """Return a warning if some frames, but not all, have no colour image with their name; else ()."""
    alone = sum(frame.color is None for frame in files)
    line = f"{path}: {alone} of {len(files)} depth frames have no colour of their name"
    return (line,) if 0 < alone < len(files) else ()


def read_image_file(path: Path) -> bytes:
    """Read a whole image file; a BMP or PPM is turned into a PNG.

    Raises:
        DamagedImageError: the file is missing, too large, or no plain file; or a BMP or PPM is damaged.
        RecordingError: the machine cannot read it now; the next run may.
    """
    try:
        return as_png(read_plain(path, IMAGE_BYTES), str(path))
    except FileNotFoundError as error:
        raise DamagedImageError(f"{path}: the recording lists this image, but it is missing") from error
    except OSError as error:
        line = f"{path}: cannot be read ({error.strerror})"
        if error.errno in NO_IMAGE_FILE:
            raise DamagedImageError(line) from error
        raise RecordingError(f"{line}; check the file and the disk", what="unreadable") from error


def with_masks(files: Sequence[FrameFiles], recording: Path) -> tuple[FrameFiles, ...]:
    """Return the frames with the user's masks: NAME.png in masks/ beside the folder of depth's NAME.png."""
    # Beside the recording's own folder there is none of its masks.
    folders = {frame.depth.parent for frame in files} - {recording}
    masks = {folder: in_any_case(folder.parent, MASKS_FOLDER) for folder in folders}

    def mask_of(depth: Path) -> Path | None:
        return first_file([masks[depth.parent] / f"{depth.stem}.png"]) if depth.parent in masks else None

    return tuple(replace(frame, mask=mask_of(frame.depth)) for frame in files)


def unmatched_masks(path: Path, files: Sequence[FrameFiles]) -> tuple[str, ...]:
    """Return warnings on images in masks/ that are not read, and have no name of one that is; () without."""
    used, frames = {frame.mask.stem for frame in files if frame.mask}, {frame.depth.stem for frame in files}
    folder, lines = in_any_case(path, MASKS_FOLDER), list[str]()
    others = sorted(mask for mask in visible(folder, *MASK_KINDS) if mask.stem not in used)
    other_kind = [mask for mask in others if mask.stem in frames and mask.suffix.lower() != ".png"]
    of_none = sorted({*others} - {*other_kind})
    unnamed = (of_none, "of no frame", "name each as its depth image is named, as PNG")
    for masks, said, how in (unnamed, (other_kind, "no PNG", "write it as PNG")):
        if masks:
            count = "1 mask is" if len(masks) == 1 else f"{len(masks)} masks are"
            lines.append(f"{folder}: {count} {said}, such as {printable(masks[0].name)}: {how}")
    return tuple(lines)


def first_whole(read: Callable[[Item], Result], items: Iterable[Item]) -> Result:
    """Return `read(item)` for the first undamaged item; at most `MOST_TRIED` items are tried.

    Raises:
        DamagedImageError: all of them are damaged; the message is about the first.
    """
    complaint: DamagedImageError | None = None
    for item in islice(items, MOST_TRIED):
        try:
            return read(item)
        except DamagedImageError as error:
            complaint = complaint or error
    raise complaint or DamagedImageError("there is no image")


def tried(count: int) -> str:
    """Return how many of `count` images `first_whole` tries, as text: all, or "first" and the limit."""
    return str(count) if count <= MOST_TRIED else f"first {MOST_TRIED}"


def first_color_size(files: Sequence[FrameFiles]) -> tuple[int, int] | None:
    """Return width and height in pixels of the first undamaged colour image; None if there is none."""
    with suppress(DamagedImageError):
        colors = (frame.color for frame in files if frame.color is not None)
        return first_whole(lambda file: image_header(read_image_file(file), str(file))[1:], colors)
    return None


def first_depth_size(files: Sequence[FrameFiles]) -> tuple[int, int]:
    """Return width and height in pixels of the first undamaged depth image.

    Raises:
        RecordingError: all images are damaged; the message is about the first.
    """
    try:
        return first_whole(
            lambda file: depth_size_px(read_image_file(file), str(file)), (frame.depth for frame in files)
        )
    except DamagedImageError as error:
        raise RecordingError(
            advised(f"{error}; none of the {tried(len(files))} depth images is usable", error.advice),
            what="no-frame",
        ) from error
