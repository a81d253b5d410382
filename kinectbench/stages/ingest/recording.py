"""The interface of recordings: frames one by one, a camera, an optional trajectory."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path
from typing import ClassVar, Literal, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.core.sequence import GivenTrajectory, UpSample
from kinectbench.core.types import Bools, DepthCode, Float64, Int64
from kinectbench.core.untrusted import IMAGE_BYTES, listed_paths, printable, read_plain
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_codes import read_by_code
from kinectbench.stages.ingest.depth_files import decode_depth_file, depth_size_px, kind_of
from kinectbench.stages.ingest.images import (
    DamagedImageError,
    OddImageError,
    decode_mask,
    image_header,
    quantised,
)

# Damaged images or messages that are tried in search of one that is whole: five minutes at 30 frames a
# second; an index may begin long before the images that were kept of it.
MOST_TRIED = 10_000
Item = TypeVar("Item")
Result = TypeVar("Result")
# On what a reader was tried: a real recording, one whose licence lets it be copied, or files that a writer
# made here by the format's own description.
Evidence = Literal["recording", "copy", "writer"]


@dataclass(frozen=True)
class RawFrame:
    """One recorded frame.

    Attributes:
        name: where it comes from, for messages.
        stamp_ns: stamp of the depth image, nanoseconds.
        depth: (height, width) uint16 in native units, 0 = no measurement.
        color: (".jpg" or ".png", the encoded image), or None.
        mask: (height, width) bool, the pixels that a given mask says are the object, or None.
    """

    name: str
    stamp_ns: int
    depth: NDArray[np.uint16]
    color: tuple[str, bytes] | None
    mask: Bools | None = None


@dataclass(frozen=True)
class ColorCalibration:
    """The calibration that maps unregistered colour onto depth pixels.

    Attributes:
        camera: intrinsics of the colour images, pixels.
        distortion: k1 k2 p1 p2 [k3 [k4 k5 k6]] of the colour images (Brown 1971); empty: none.
        T_color_depth: (4, 4) float64, depth camera to colour camera, metres.
    """

    camera: Camera
    distortion: tuple[float, ...]
    T_color_depth: Float64

    def lies_on(self, depth: Camera) -> bool:
        """Whether colour has the depth camera's pixels, so that it is already registered."""
        return (
            self.camera == depth
            and not self.distortion
            and np.allclose(self.T_color_depth, np.eye(4), atol=1e-7)
        )


class ListedFrame(Protocol):
    """An entry of the frame list, in a form private to the reader."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the depth image, nanoseconds."""
        ...


@dataclass(frozen=True, kw_only=True)
class Recording(ABC):
    """A recording that was opened: its camera is known, its frames are read when asked for.

    Attributes:
        path: the folder or file.
        format: name of the format, as in the registry.
        looks_for: what a folder or file must hold to be taken for this format.
        suffixes: how names of such files end; what an id of a recording does without.
        evidence: the best kind of thing that the reader was tried on.
        verified: what that was, files of other programs too; "" if it was only files that were written here.
        up_world: (3,) unit: up in the frame of the given trajectory, where the format's is aligned with
            gravity; None: gravity is unknown.
        places: where each frame lies, damaged ones included; stamps are strictly increasing.
        camera: intrinsics of the depth images, pixels.
        depth_scale: native depth units per metre.
        color_registered: colour pixels lie on depth pixels.
        color_calibration: how colour can be registered, where it is not and that is known; or None.
        given_trajectory: the trajectory that came with it, or None.
        trajectory_error: why the trajectory that came with it cannot be used, or "".
        color_delay_s: taken off the stamps of colour, as the settings say, seconds.
        trajectory_delay_s: taken off the stamps of given poses, as the settings say, seconds.
        warnings: what its user should know, one line each.
        recorded: stamps of depth and of colour in the order of recording, where that is known.
        up_cameras: up in some frames' own axes, by an accelerometer.
    """

    format: ClassVar[str]
    looks_for: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]] = ()
    evidence: ClassVar[Evidence] = "writer"
    verified: ClassVar[str] = ""
    up_world: ClassVar[tuple[float, float, float] | None] = None
    path: Path
    places: tuple[ListedFrame, ...]
    camera: Camera
    depth_scale: float
    color_registered: bool
    color_calibration: ColorCalibration | None = None
    given_trajectory: GivenTrajectory | None = None
    trajectory_error: str = ""
    color_delay_s: float = 0.0
    trajectory_delay_s: float = 0.0
    warnings: tuple[str, ...] = ()
    recorded: tuple[tuple[int, ...], tuple[int, ...]] | None = None
    up_cameras: tuple[UpSample, ...] = ()

    @classmethod
    @abstractmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder or file has this format's layout; reads a few bytes at most."""

    @classmethod
    def files_beside(cls, path: Path) -> tuple[Path, ...]:
        """Files outside the folder that belong to the recording, such as intrinsics of several sequences."""
        return ()

    @classmethod
    @abstractmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Open the recording; settings override its own values.

        Raises:
            RecordingError: it cannot be used; the message says what is wrong and where.
        """

    def __len__(self) -> int:
        """Number of frames listed, damaged ones included."""
        return len(self.places)

    @property
    def stamps_ns(self) -> Int64:
        """Stamp of each frame listed, nanoseconds, strictly increasing; nothing is decoded for it."""
        return np.array([place.stamp_ns for place in self.places], np.int64)

    @property
    def recorded_stamps_ns(self) -> tuple[Int64, Int64]:
        """Stamps of every depth and every colour image, in recorded order.

        They can repeat or go back, and colour need not have a partner; a format without stamps of its own for
        colour gives none.
        """
        depth_ns, color_ns = self.recorded or (self.stamps_ns, ())
        return np.array(depth_ns, np.int64), np.array(color_ns, np.int64)

    @abstractmethod
    def frame(self, index: int) -> RawFrame:
        """Read any frame.

        Raises:
            DamagedImageError: its depth is damaged.
        """


@dataclass(frozen=True)
class FrameFiles:
    """The files of one frame.

    Attributes:
        stamp_ns: stamp of the depth image, nanoseconds.
        depth: 16-bit PNG.
        color: JPEG or PNG, or None.
        mask: PNG, not 0 where the object is, or None.
    """

    stamp_ns: int
    depth: Path
    color: Path | None
    mask: Path | None = None


@dataclass(frozen=True, kw_only=True)
class FileRecording(Recording):
    """A recording whose every image is a file; the folder formats derive from it.

    Attributes:
        often_rotated: depth in this layout usually has rotated bits.
        depth_code: how its values are to be read (`core.types.DepthCode`).
        float_scale: units a metre of the files, where depth is float; None: its values are those stored.
        channels: of depth in two 8-bit channels: those of the high and of the low byte; None: it is in one.
        kind: "floats" or "whole numbers", and a file that holds such; None: files are not compared.
    """

    often_rotated: ClassVar[bool] = False

    places: tuple[FrameFiles, ...]
    depth_code: DepthCode = "plain"
    float_scale: float | None = None
    channels: tuple[int, int] | None = None
    kind: tuple[str, Path] | None = None

    def frame(self, index: int) -> RawFrame:
        """Read the files of a frame."""
        files = self.places[index]
        stored = decode_depth_file(read_image_file(files.depth), str(files.depth), self.channels)
        kind = kind_of(stored)
        if self.kind is not None and kind != self.kind[0]:
            raise OddImageError(
                f"{files.depth}: holds {kind}, but {self.kind[1]} holds {self.kind[0]}: keep one kind"
            )
        native = (
            stored if stored.dtype == np.uint16 else quantised(stored / np.float32(self.float_scale or 1.0))
        )
        depth = read_by_code(
            self.depth_code, self.clean_depth(np.asarray(native, np.uint16), index), self.camera
        )
        mask = None if files.mask is None else self.mask(files.mask, depth)
        if mask is not None and mask.shape != depth.shape:
            raise DamagedImageError(f"{files.mask}: its size is not that of the depth image")
        return RawFrame(str(files.depth), files.stamp_ns, depth, self.color(index), mask)

    def mask(self, file: Path, depth: NDArray[np.uint16]) -> Bools:
        """The mask in a file, on the pixels of its depth image (height, width) in native units."""
        return decode_mask(read_image_file(file), str(file))

    def color(self, index: int) -> tuple[str, bytes] | None:
        """Colour of a frame as it was encoded: (suffix, bytes), or None."""
        file = self.places[index].color
        return None if file is None else (file.suffix, read_image_file(file))

    def clean_depth(self, depth: NDArray[np.uint16], index: int) -> NDArray[np.uint16]:
        """Give invalid pixels of a frame the value 0."""
        return depth


def without_color(path: Path, files: Sequence[FrameFiles]) -> tuple[str, ...]:
    """A warning if only some frames have a colour image of their name."""
    alone = sum(frame.color is None for frame in files)
    line = f"{path}: {alone} of {len(files)} depth frames have no colour of their name"
    return (line,) if 0 < alone < len(files) else ()


def read_image_file(path: Path) -> bytes:
    """Read a file whole.

    Raises:
        DamagedImageError: it is missing or cannot be read.
    """
    try:
        return read_plain(path, IMAGE_BYTES)
    except FileNotFoundError as error:
        raise DamagedImageError(f"{path}: the recording lists this image, but it is missing") from error
    except OSError as error:
        raise DamagedImageError(f"{path}: cannot be read ({error.strerror})") from error


def mask_beside(depth: Path, recording: Path) -> Path | None:
    """A person's mask of a depth image: of its name in a folder masks/ beside the image's; or None.

    Args:
        depth: the image.
        recording: the recording's folder; a mask outside of it does not belong to it.
    """
    if depth.parent == recording:
        return None
    return first_file([depth.parent.parent / "masks" / f"{depth.stem}.png"])


def unmatched_masks(path: Path, files: Sequence[FrameFiles]) -> tuple[str, ...]:
    """A line with the number of masks in a recording's masks/ that match no frame, if any."""
    used = {frame.mask for frame in files}
    others = sorted(mask for mask in visible(path / "masks", "*.png") if mask not in used)
    if not others:
        return ()
    count = "1 mask is" if len(others) == 1 else f"{len(others)} masks are"
    such = f"{count} of no frame, such as {printable(others[0].name)}"
    return (f"{path / 'masks'}: {such}: name each as its depth image is named",)


def visible(folder: Path, pattern: str) -> list[Path]:
    """The files of a folder whose names match; hidden ones are no part of a recording."""

    def matches(name: str) -> bool:
        return fnmatchcase(name, pattern) and not name.startswith(".")

    return list(listed_paths(folder, wanted=matches)) if folder.is_dir() else []


def first_file(candidates: Iterable[Path]) -> Path | None:
    """The first existing file of several paths, or None."""
    return next((file for file in candidates if file.is_file()), None)


def first_whole(read: Callable[[Item], Result], items: Iterable[Item]) -> Result:
    """The result of `read` for the first undamaged image or message; tries only the first of very many.

    Raises:
        DamagedImageError: all are damaged; the message is about the first.
    """
    complaint: DamagedImageError | None = None
    for item in islice(items, MOST_TRIED):
        try:
            return read(item)
        except DamagedImageError as error:
            complaint = complaint or error
    raise complaint or DamagedImageError("there is no image")


def tried(count: int) -> str:
    """The number of images that `first_whole` tried, as text."""
    return str(count) if count <= MOST_TRIED else f"first {MOST_TRIED}"


def first_color_size(files: Sequence[FrameFiles]) -> tuple[int, int] | None:
    """Width and height in pixels of the first colour image that is whole, or None."""
    with suppress(DamagedImageError):
        colors = (frame.color for frame in files if frame.color is not None)
        return first_whole(lambda file: image_header(read_image_file(file), str(file))[1:], colors)
    return None


def first_depth_size(files: Sequence[FrameFiles]) -> tuple[int, int]:
    """Width and height in pixels of the first depth image that is whole.

    Raises:
        RecordingError: none of them is; the message is about the first.
    """
    try:
        return first_whole(
            lambda file: depth_size_px(read_image_file(file), str(file)), (frame.depth for frame in files)
        )
    except DamagedImageError as error:
        raise RecordingError(
            f"{error}; none of the {tried(len(files))} depth images is usable", what="no-frame"
        ) from error
