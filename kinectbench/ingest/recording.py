"""What every reader of recordings offers: frames one after another, a camera, maybe a trajectory."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import CameraSettings
from kinectbench.errors import RecordingError
from kinectbench.geometry import Camera
from kinectbench.ingest.images import DamagedImageError, decode_depth_png, image_header
from kinectbench.sequence import GivenTrajectory


@dataclass(frozen=True)
class RawFrame:
    """One frame as it was recorded.

    Attributes:
        name: where it comes from, for messages.
        stamp_ns: stamp of the depth image, nanoseconds.
        depth: (height, width) uint16 in native units, 0 = no measurement.
        depth_png: the original PNG file, where it decodes to `depth` as it stands; else None.
        color: (".jpg" or ".png", the encoded image), or None.
    """

    name: str
    stamp_ns: int
    depth: NDArray[np.uint16]
    depth_png: bytes | None
    color: tuple[str, bytes] | None


@dataclass(frozen=True)
class DamagedFrame:
    """A frame that is listed but cannot be read; `why` names the file and the damage."""

    why: str


class Recording(ABC):
    """A recording that was opened: its camera is known, its frames are read when asked for.

    Attributes:
        path: the folder or file.
        format: name of the format, as in the registry.
        looks_for: what a folder or file must hold to be taken for this format.
        camera: intrinsics of the depth images, pixels.
        depth_scale: native depth units per metre.
        color_registered: colour pixels lie on depth pixels.
        given_trajectory: the trajectory that came with it, or None.
        warnings: what its user should know, one line each.
    """

    format: ClassVar[str]
    looks_for: ClassVar[str]
    path: Path
    camera: Camera
    depth_scale: float
    color_registered: bool
    given_trajectory: GivenTrajectory | None
    warnings: tuple[str, ...]

    @classmethod
    @abstractmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder or file has this format's layout; reads a few bytes at most."""

    @classmethod
    @abstractmethod
    def open(cls, path: Path, settings: CameraSettings | None) -> Self:
        """Open the recording; what the settings give wins over what it says.

        Raises:
            RecordingError: it cannot be used; the message says what is wrong and where.
        """

    @abstractmethod
    def __len__(self) -> int:
        """Number of frames listed, damaged ones included."""

    @abstractmethod
    def frames(self) -> Iterator[RawFrame | DamagedFrame]:
        """Read the frames in stamp order, one at a time; stamps strictly increase."""


@dataclass(frozen=True)
class FrameFiles:
    """The files of one frame.

    Attributes:
        stamp_ns: stamp of the depth image, nanoseconds.
        depth: 16-bit PNG.
        color: JPEG or PNG, or None.
    """

    stamp_ns: int
    depth: Path
    color: Path | None


@dataclass(frozen=True)
class FileRecording(Recording):
    """A recording whose every image is a file; the folder formats derive from it."""

    path: Path
    files: tuple[FrameFiles, ...]
    camera: Camera
    depth_scale: float
    color_registered: bool
    given_trajectory: GivenTrajectory | None
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.files)

    def frames(self) -> Iterator[RawFrame | DamagedFrame]:
        """Read the files frame by frame."""
        for files in self.files:
            try:
                yield self._frame(files)
            except DamagedImageError as error:
                yield DamagedFrame(str(error))

    def clean_depth(self, depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Give invalid pixels the value 0; returns the very same array where nothing is to be done."""
        return depth

    def _frame(self, files: FrameFiles) -> RawFrame:
        data = read_image_file(files.depth)
        decoded = decode_depth_png(data, str(files.depth))
        depth = self.clean_depth(decoded)
        color = None
        if files.color is not None:
            color = (files.color.suffix, read_image_file(files.color))
        unchanged = data if depth is decoded else None
        return RawFrame(str(files.depth), files.stamp_ns, depth, unchanged, color)


def read_image_file(path: Path) -> bytes:
    """Read a file whole.

    Raises:
        DamagedImageError: it is missing or cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DamagedImageError(f"{path}: the recording lists this image, but it is missing") from error
    except OSError as error:
        raise DamagedImageError(f"{path}: cannot be read ({error.strerror})") from error


def first_depth_size(files: Sequence[FrameFiles]) -> tuple[int, int]:
    """Width and height in pixels of the first depth image that is whole.

    Raises:
        RecordingError: none of them is; the message is about the first.
    """
    complaint: DamagedImageError | None = None
    for frame in files:
        try:
            return image_header(read_image_file(frame.depth), str(frame.depth))[1:]
        except DamagedImageError as error:
            complaint = complaint or error
    raise RecordingError(f"{complaint}; none of the {len(files)} depth images is usable") from complaint
