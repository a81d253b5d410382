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
from kinectbench.ingest.images import DamagedImageError, decode_depth_png, decode_mask, image_header
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
        mask: (height, width) bool, the pixels that a given mask says are the object, or None.
    """

    name: str
    stamp_ns: int
    depth: NDArray[np.uint16]
    depth_png: bytes | None
    color: tuple[str, bytes] | None
    mask: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class DamagedFrame:
    """A frame that is listed but cannot be read; `why` names the file and the damage."""

    why: str


@dataclass(frozen=True)
class ColorCalibration:
    """How colour that does not lie on depth pixels can be brought there.

    Attributes:
        camera: intrinsics of the colour images, pixels.
        distortion: k1 k2 p1 p2 [k3 [k4 k5 k6]] of the colour images (Brown 1971); empty: none.
        T_color_depth: (4, 4) float64, depth camera to colour camera, metres.
    """

    camera: Camera
    distortion: tuple[float, ...]
    T_color_depth: NDArray[np.float64]

    def lies_on(self, depth: Camera) -> bool:
        """Whether colour has the depth camera's pixels: it is registered as it stands."""
        return (
            self.camera == depth
            and not self.distortion
            and np.allclose(self.T_color_depth, np.eye(4), atol=1e-7)
        )


@dataclass(frozen=True, kw_only=True)
class Recording(ABC):
    """A recording that was opened: its camera is known, its frames are read when asked for.

    Attributes:
        path: the folder or file.
        format: name of the format, as in the registry.
        looks_for: what a folder or file must hold to be taken for this format.
        verified: on what real files, or files of other programs, the reader was tried; "" if it was written
            from documents only.
        camera: intrinsics of the depth images, pixels.
        depth_scale: native depth units per metre.
        color_registered: colour pixels lie on depth pixels.
        color_calibration: how colour can be registered, where it is not and that is known; or None.
        given_trajectory: the trajectory that came with it, or None.
        trajectory_error: why the trajectory that came with it cannot be used, or "".
        color_delay_s: taken off the stamps of colour, as the settings say, seconds.
        trajectory_delay_s: taken off the stamps of given poses, as the settings say, seconds.
        warnings: what its user should know, one line each.
    """

    format: ClassVar[str]
    looks_for: ClassVar[str]
    verified: ClassVar[str] = ""
    path: Path
    camera: Camera
    depth_scale: float
    color_registered: bool
    color_calibration: ColorCalibration | None = None
    given_trajectory: GivenTrajectory | None = None
    trajectory_error: str = ""
    color_delay_s: float = 0.0
    trajectory_delay_s: float = 0.0
    warnings: tuple[str, ...] = ()

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

    @property
    @abstractmethod
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamp of each frame listed, nanoseconds, strictly increasing; nothing is decoded for it."""

    @property
    def recorded_stamps_ns(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Stamps of every depth and of every colour image, in the order in which they were recorded.

        They can repeat or go back, and colour need not have a partner; a format without stamps of its own for
        colour gives none.
        """
        return self.stamps_ns, np.empty(0, np.int64)

    @abstractmethod
    def frame(self, index: int) -> RawFrame:
        """Read any frame.

        Raises:
            DamagedImageError: its depth is damaged.
        """

    def frames(self) -> Iterator[RawFrame | DamagedFrame]:
        """Read the frames in stamp order, one at a time."""
        for index in range(len(self)):
            try:
                yield self.frame(index)
            except DamagedImageError as error:
                yield DamagedFrame(str(error))


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
    """A recording whose every image is a file; the folder formats derive from it."""

    files: tuple[FrameFiles, ...]
    # Stamps of depth and of colour in the order of their lists, where the format has lists.
    recorded: tuple[tuple[int, ...], tuple[int, ...]] | None = None

    def __len__(self) -> int:
        return len(self.files)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamp of each frame listed, nanoseconds."""
        return np.array([files.stamp_ns for files in self.files], np.int64)

    @property
    def recorded_stamps_ns(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Stamps of depth and of colour in the order of recording."""
        if self.recorded is None:
            return super().recorded_stamps_ns
        return np.array(self.recorded[0], np.int64), np.array(self.recorded[1], np.int64)

    def frame(self, index: int) -> RawFrame:
        """Read the files of a frame."""
        files = self.files[index]
        data = read_image_file(files.depth)
        decoded = decode_depth_png(data, str(files.depth))
        depth = self.clean_depth(decoded, index)
        unchanged = data if depth is decoded else None
        mask = None if files.mask is None else decode_mask(read_image_file(files.mask), str(files.mask))
        return RawFrame(str(files.depth), files.stamp_ns, depth, unchanged, self.color(index), mask)

    def color(self, index: int) -> tuple[str, bytes] | None:
        """Colour of a frame as it was encoded: (suffix, bytes), or None."""
        file = self.files[index].color
        return None if file is None else (file.suffix, read_image_file(file))

    def clean_depth(self, depth: NDArray[np.uint16], index: int) -> NDArray[np.uint16]:
        """Give invalid pixels the value 0; returns the very same array where nothing is to be done."""
        return depth


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
