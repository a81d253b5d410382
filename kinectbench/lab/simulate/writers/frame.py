"""Input of the writers (camera rig and frames), and code that they share, such as number formats."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera
from kinectbench.core.images import jpeg
from kinectbench.core.trajectory.stamps import NS_PER_S

JPEG_QUALITY = 85
# Units per metre of depth in millimetres, as in all formats except TUM.
DEPTH_SCALE = 1000.0


@dataclass(frozen=True)
class Rig:
    """The cameras that record together.

    Attributes:
        depth: intrinsics of the depth images.
        color: intrinsics of the colour images.
        color_registered: colour pixels lie on depth pixels; then `color` equals `depth`.
        T_color_depth: (4, 4), depth camera to colour camera.
    """

    depth: Camera
    color: Camera
    color_registered: bool
    T_color_depth: NDArray[np.float64]


@dataclass(frozen=True)
class ColorImage:
    """One image of a colour stream.

    Attributes:
        stamp_ns: the recorded stamp, nanoseconds.
        rgb: (height, width, 3) uint8, from the rig's colour camera.
    """

    stamp_ns: int
    rgb: NDArray[np.uint8]

    def jpeg(self) -> bytes:
        """Return the image as a JPEG file."""
        return jpeg(self.rgb, JPEG_QUALITY)


@dataclass(frozen=True)
class RecordedFrame:
    """The sensor's output at one time.

    Attributes:
        stamp_ns: recorded time of depth, nanoseconds.
        depth_m: (height, width) float32, metres along z, 0 = no measurement.
        color_stamp_ns: recorded time of colour, nanoseconds.
        color_rgb: (height, width, 3) uint8, from the rig's colour camera.
        T_world_camera: (4, 4) float64, pose of the depth camera given with the recording, optical axes; or
            None.
        pose_stamp_ns: recorded time of that pose, nanoseconds; None: the time of depth.
        mask: (height, width) bool, the object's mask given with the recording, in depth pixels; or None.
        own_colors: images, any number, that a separate colour stream took since the previous depth image;
            None: each depth image has one colour image. Formats that store pairs of images ignore it.
    """

    stamp_ns: int
    depth_m: NDArray[np.float32]
    color_stamp_ns: int
    color_rgb: NDArray[np.uint8]
    T_world_camera: NDArray[np.float64] | None
    pose_stamp_ns: int | None = None
    mask: NDArray[np.bool_] | None = None
    own_colors: tuple[ColorImage, ...] | None = None

    @property
    def colors(self) -> tuple[ColorImage, ...]:
        """The images of the colour stream since the last depth image: `own_colors`, or this frame's image."""
        if self.own_colors is None:
            return (ColorImage(self.color_stamp_ns, self.color_rgb),)
        return self.own_colors

    @property
    def given_ns(self) -> int:
        """Recorded time of the given pose, nanoseconds; the time of depth if the pose has no time."""
        return self.stamp_ns if self.pose_stamp_ns is None else self.pose_stamp_ns

    def color_jpegs(self) -> list[tuple[int, bytes]]:
        """Return the images of `colors` as (stamp in nanoseconds, JPEG file)."""
        if self.own_colors is None:
            return [(self.color_stamp_ns, self.color_jpeg())]
        return [(color.stamp_ns, color.jpeg()) for color in self.own_colors]

    def depth_native(self, depth_scale: float = DEPTH_SCALE) -> NDArray[np.uint16]:
        """Return depth (height, width) uint16 in units of 1 / `depth_scale` metres, 0 = none or too large."""
        native = np.round(self.depth_m.astype(np.float64) * depth_scale)
        return np.where(native > 65534, 0, native).astype(np.uint16)

    def depth_png(self, depth_scale: float = DEPTH_SCALE) -> bytes:
        """Return `depth_native` as a 16-bit PNG file."""
        return png_bytes(self.depth_native(depth_scale))

    @property
    def color_bgr(self) -> NDArray[np.uint8]:
        """Return colour in OpenCV's order: (height, width, 3) uint8 in blue, green, red."""
        return np.ascontiguousarray(self.color_rgb[..., ::-1])

    def add_mask(self, file: Path) -> None:
        """Write the mask, if any, as a PNG (255 = object); create the folder."""
        if self.mask is not None:
            file.parent.mkdir(exist_ok=True)
            file.write_bytes(png_bytes(np.where(self.mask, np.uint8(255), np.uint8(0))))

    def color_jpeg(self) -> bytes:
        """Return colour as a JPEG file."""
        return ColorImage(self.color_stamp_ns, self.color_rgb).jpeg()


def frames_as_seconds(index: int, stamp_ns: int) -> int:
    """Return the stamp in ns that readers give frame `index` in a layout without stamps: `index` seconds."""
    return index * NS_PER_S


def whole_microseconds(index: int, stamp_ns: int) -> int:
    """Return the stamp in nanoseconds as read from a layout that keeps only whole microseconds."""
    return stamp_ns // 1000 * 1000


def nanoseconds(index: int, stamp_ns: int) -> int:
    """Return the stamp in nanoseconds unchanged, as read from a layout that stores it whole, such as bags."""
    return stamp_ns


Writer = Callable[[Path, Rig, Iterable[RecordedFrame]], None]


@dataclass(frozen=True)
class FileFormat:
    """A format in which recordings are written.

    Attributes:
        write: called with (path, camera rig, frames); fills an empty folder, or makes a new file.
        stamp_as_read: called with (index of a written frame, from 0; its stamp in nanoseconds); returns the
            stamp in nanoseconds that a reader of the file finds.
        suffix: suffix of the file; "" for a folder.
        masks: whether the format can store masks.
    """

    write: Writer
    stamp_as_read: Callable[[int, int], int] = nanoseconds
    suffix: str = ""
    masks: bool = False

    def write_new(self, stem: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> Path:
        """Write a recording to a new path, which is `stem` plus the format's suffix; return this path."""
        path = stem.with_name(stem.name + self.suffix)
        if not self.suffix:
            path.mkdir()
        self.write(path, rig, frames)
        return path


def png_bytes(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Return an image (height, width), or (height, width, 3) in blue, green, red, as a PNG file."""
    # A fixed filter and a low level take a third of the default's time on noisy depth, for 15 % more bytes.
    options = [cv2.IMWRITE_PNG_COMPRESSION, 3, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB]
    ok, encoded = cv2.imencode(".png", image, options)
    assert ok
    return bytes(encoded)


def color_json(rig: Rig) -> dict[str, object]:
    """Return the colour camera's intrinsics and its pose relative to depth, as plain JSON values.

    The key `color_registered` is always there. If its value is false, there are also `color_camera` (size and
    intrinsics in pixels) and `T_color_depth` (four rows, metres, depth camera to colour camera).
    """
    if rig.color_registered:
        return {"color_registered": True}
    return {
        "color_registered": False,
        "color_camera": asdict(rig.color),
        "T_color_depth": rig.T_color_depth.tolist(),
    }


def matrix_rows(matrix: NDArray[np.float64]) -> list[str]:
    """Return each row of a matrix (n, m) as text: numbers at full precision, separated by spaces."""
    return [" ".join(repr(number) for number in row) for row in matrix.tolist()]


def make_folders(folder: Path, *names: str) -> None:
    """Make subfolders of a recording's folder, for its images."""
    for name in names:
        (folder / name).mkdir()


def write_lines(path: Path, lines: Sequence[str]) -> None:
    """Write a text file of lines."""
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
