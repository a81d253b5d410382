"""Common parts for phones with LiDAR: one camera, colour far larger than depth, and confidence."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import IntrinsicsError, RecordingError
from kinectbench.core.even_choice import evenly
from kinectbench.core.trajectory.stamps import LIMIT_NS, NS_PER_S
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import (
    DamagedImageError,
    OddImageError,
    decode_color_bgr,
    encode_png,
    image_header,
)
from kinectbench.stages.ingest.intrinsics import Intrinsics, gives_intrinsics
from kinectbench.stages.ingest.known_names import first_file, in_any_case, visible
from kinectbench.stages.ingest.recording import FileRecording, FrameFiles, read_image_file

# Size of ARKit's colour images, used if there is none.
COLOR_PX = (1920, 1440)
# ARKit's camera looks along -z with y up, as OpenGL's does.
OPENGL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])
# Values of high confidence: of ARKit (after 0, 1), RTAB-Map (after 0, 50) and Polycam (after 0, 127).
FULL = (2, 100, 255)
# Number of images that are looked at for the values of confidence: low and high occur in nearly every image.
SAMPLED = 16
# By Polycam's page, intrinsics differ "a pixel or two" between frames, because a phone focuses.
USUAL_PX = 2.0
# Frames whose focal lengths differ by more than this share are from several cameras.
LARGEST_SHARE = 0.03
# ARKit's world: y is up by gravity (`gravity`, the default of ARConfiguration.worldAlignment).
GRAVITY_UP = (0.0, 1.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class ConfidenceRecording(FileRecording):
    """Images with confidence of depth, as phones with LiDAR write it: depth of low confidence is dropped.

    Attributes:
        confidence: file of each frame's confidence image; None if there is none.
        min_confidence: depth with lower confidence counts as no measurement.
        full_confidence: the value of high confidence in the images; 0 is low, and any other is middle.
    """

    confidence: tuple[Path | None, ...] = ()
    min_confidence: int = 0
    full_confidence: int = 2

    def clean_depth(self, depth: NDArray[np.uint16], index: int) -> NDArray[np.uint16]:
        """Set depth of low confidence to 0.

        Raises:
            DamagedImageError: the confidence image is damaged or of another size.
        """
        file = self.confidence[index] if self.confidence else None
        if file is None or self.min_confidence == 0:
            return depth
        confidence = self.levels(decode_color_bgr(read_image_file(file), str(file))[..., 0])
        if confidence.shape != depth.shape:
            raise DamagedImageError(f"{file}: its size is not that of the depth image")
        return np.where(confidence >= self.min_confidence, depth, np.uint16(0))

    def levels(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Convert a confidence image (height, width) to 0, 1 or 2: low, middle, high."""
        return np.where(image >= self.full_confidence, np.uint8(2), np.minimum(image, np.uint8(1)))


class PhoneRecording(ConfidenceRecording):
    """Images of a phone: colour is scaled to depth's size, and depth of low confidence is dropped."""

    def color(self, index: int) -> tuple[str, bytes] | None:
        """Return a frame's colour image at depth's size: (suffix, encoded image).

        An image that already has depth's size is returned as it is. Any other is scaled and encoded as PNG.
        The result is None if the frame has no colour.
        """
        file = self.places[index].color
        if file is None:
            return None
        return at_size(read_image_file(file), (self.camera.width, self.camera.height), str(file))

    def shrunk(self, bgr: NDArray[np.uint8], name: str) -> tuple[str, bytes]:
        """Downsample colour (height, width, 3) to depth's size by averaging: (".png", encoded image)."""
        return shrunk_png(bgr, (self.camera.width, self.camera.height), name)


def confidence_beside(
    path: Path, files: Sequence[FrameFiles], size_px: tuple[int, int], least: int
) -> tuple[tuple[Path | None, ...], int, tuple[str, ...]]:
    """Find the images in confidence/ beside depth/, named as those of depth.

    Confidence of another size than depth's is not used.

    Returns:
        `confidence` and `full_confidence` of `ConfidenceRecording` (no files if none is used), and warnings.
    """
    folder = in_any_case(path, "confidence")
    found = tuple(first_file([folder / f"{frame.depth.stem}.png"]) for frame in files)
    named = [file for file in found if file is not None]
    if not named or files[0].depth.parent == path:
        others = visible(folder, "*.png")
        unlike = f"{folder}: its {len(others)} images are not read: none is named as a depth image of depth/"
        return (), 2, (unlike,) if others else ()
    seen = list[NDArray[np.uint8]]()
    for at in evenly(len(named), SAMPLED).tolist():
        with suppress(DamagedImageError):  # reported with its frame
            data = read_image_file(named[at])
            if tuple(image_header(data, str(named[at]))[1:]) != size_px:
                return (), 2, (f"{folder}: is not read, because its images are not of depth's size",)
            seen.append(np.unique(decode_color_bgr(data, str(named[at]))[..., 0]))
    values = np.unique(np.concatenate(seen)) if seen else np.zeros(1, int)
    if len(values) <= 3 and values[-1] in FULL:
        cut = f"depth of a confidence below {least} (of 0, 1 and 2) is left out: `min_confidence` sets that"
        return found, int(values[-1]), (f"{folder}: {cut}",) if least else ()
    levels = ", ".join(map(str, values[:4])) + (", ..." if len(values) > 4 else "")
    odd = f"holds the values {levels}, and not 0, 1, 2 (or 0, 50, 100 or 0, 127, 255) on depth's pixels"
    return (), 2, (f"{folder}: is not read, because it {odd}",)


def at_size(data: bytes, size_px: tuple[int, int], name: str) -> tuple[str, bytes]:
    """Return an image file of this size as it is, any other scaled: (suffix, encoded image)."""
    suffix, *found_px = image_header(data, name)
    whole = tuple(found_px) == size_px
    return (suffix, data) if whole else shrunk_png(decode_color_bgr(data, name), size_px, name)


def shrunk_png(bgr: NDArray[np.uint8], size_px: tuple[int, int], name: str) -> tuple[str, bytes]:
    """Downsample colour (height, width, 3) to a size by averaging: (".png", encoded image).

    Raises:
        OddImageError: the aspect ratios differ.
    """
    import cv2

    height, width = bgr.shape[:2]
    if not _same_shape((width, height), size_px):
        raise OddImageError(
            f"{name}: colour is {width}x{height}, another shape than depth's {size_px[0]}x{size_px[1]}",
            advice="export colour again in the shape of depth, or leave it out",
        )
    if (width, height) != size_px:
        bgr = np.asarray(cv2.resize(bgr, size_px, interpolation=cv2.INTER_AREA), np.uint8)
    return ".png", encode_png(bgr)


def scaled_to_depth(
    K: Float64, color_px: tuple[int, int], depth_px: tuple[int, int], path: Path
) -> Intrinsics:
    """Scale colour's intrinsics (3, 3) to depth's size, if both images have the same aspect ratio.

    Pixel centres are integers, and the edges of both images coincide.

    Raises:
        RecordingError: the aspect ratios differ by more than a pixel of depth.
    """
    if not _same_shape(color_px, depth_px):
        raise IntrinsicsError(
            f"{path}: the intrinsics are for {color_px[0]}x{color_px[1]} images, but the depth images are "
            f"{depth_px[0]}x{depth_px[1]}, which is another shape: export both again, whole and not turned"
        )
    x, y = depth_px[0] / color_px[0], depth_px[1] / color_px[1]
    return Intrinsics(
        fx=float(K[0, 0]) * x,
        fy=float(K[1, 1]) * y,
        cx=(float(K[0, 2]) + 0.5) * x - 0.5,
        cy=(float(K[1, 2]) + 0.5) * y - 0.5,
    )


def intrinsics_of_depth(
    K: Float64,
    color_px: tuple[int, int] | None,
    depth_px: tuple[int, int],
    path: Path,
    settings: CameraSettings,
) -> Intrinsics:
    """Scale colour's intrinsics (3, 3) to depth's size, and let the settings override them.

    Without colour images, K is taken to be for images of the phone's usual size, unless the settings give all
    intrinsics: then K is not used.

    Raises:
        RecordingError: the aspect ratios differ by more than a pixel of depth.
    """
    if color_px is None and gives_intrinsics(settings):
        return Intrinsics().overridden_by(settings)
    return scaled_to_depth(K, color_px or COLOR_PX, depth_px, path).overridden_by(settings)


def _same_shape(color_px: tuple[int, int], depth_px: tuple[int, int]) -> bool:
    """Whether two images have the same aspect ratio, to a pixel of depth."""
    (width, height), (depth_width, depth_height) = color_px, depth_px
    return min(color_px) > 0 and abs(width * depth_height / height - depth_width) <= 1


def times_or_counted(times_s: Float64, counted_ns: Sequence[int], path: Path) -> tuple[list[int], list[str]]:
    """Return stamps, ns (own stamps if all frames have one and they rise, else `counted_ns`), and warnings.

    Args:
        times_s: (n,) own times of the frames, seconds; NaN, or another shape, if some are missing.
        counted_ns: stamps of the n frames by counting, nanoseconds.
        path: the recording, for the warning.
    """
    if times_s.shape == (len(counted_ns),) and (np.abs(times_s) < LIMIT_NS / NS_PER_S).all():  # false for NaN
        stamps_ns = [round(time_s * NS_PER_S) for time_s in times_s.tolist()]
        if all(after > before for before, after in pairwise(stamps_ns)):
            return stamps_ns, []
    warning = f"{path}: not every frame has a time of its own; frames are counted instead"
    return list(counted_ns), [warning]


def one_camera(rows: Float64, path: Path) -> tuple[Float64, list[str]]:
    """Compute the median camera of frames whose fx, fy, cx, cy (n, 4), pixels, differ slightly.

    Returns:
        The pinhole matrix (3, 3), and a warning if frames differ more than usual.

    Raises:
        RecordingError: a focal length is not positive, or frames differ so much that they are from several
            cameras.
    """
    fx, fy, cx, cy = np.median(rows, axis=0).tolist()
    if (rows[:, :2] <= 0).any():
        raise IntrinsicsError(f"{path}: a focal length is not positive; export the recording again")
    apart_px = float(np.abs(rows - [fx, fy, cx, cy]).max())
    if apart_px > LARGEST_SHARE * fx:
        raise RecordingError(
            f"{path}: the intrinsics of its frames differ by {apart_px:.0f} pixels; a recording must keep "
            "one camera and zoom: give the frames of one",
            what="two-cameras",
        )
    warnings = []
    if apart_px > USUAL_PX:
        what = f"the intrinsics of its frames differ by {apart_px:.1f} pixels; their medians are taken"
        warnings.append(f"{path}: {what}")
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), warnings
