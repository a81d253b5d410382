"""Read the images of a release's view: depth, mask and colour, from untrusted files."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import ReleaseError
from kinectbench.core.encoded_images import decoded_image, image_head
from kinectbench.core.store.address import shown
from kinectbench.core.types import MM_PER_M, Bools, FileArray, Float32, Rgb
from kinectbench.release.contents import VIEW_IMAGES
from kinectbench.release.published import published_bytes
from kinectbench.release.release import Release, Target


class Kind(NamedTuple):
    """A kind of image.

    Attributes:
        suffix: the end of the file name, after the view's name.
        words: what messages call this kind.
        format: what the file's header must state: suffix, bits per channel, and colour type as PNG numbers it
            (0 grey, 2 RGB).
    """

    suffix: str
    words: str
    format: tuple[str, int, int]


DEPTH = Kind(VIEW_IMAGES[0], "PNG of 16-bit depth", (".png", 16, 0))
MASK = Kind(VIEW_IMAGES[1], "PNG of 8-bit grey", (".png", 8, 0))
COLOR = Kind(".color.jpg", "JPEG", (".jpg", 8, 2))


def depth_m(release: Release, target: Target) -> Float32:
    """Read the depth of a pair's view: (height, width) float32, metres, 0 without a measurement.

    Raises:
        ReleaseError: the release has no such image, or the image is damaged or not the published one.
    """
    return _pixels(release, target, DEPTH).astype(np.float32) / np.float32(MM_PER_M)


def mask(release: Release, target: Target) -> Bools:
    """Read the object's mask in a pair's view: (height, width) bool, aligned with the depth.

    Raises:
        ReleaseError: as in `depth_m`.
    """
    return np.asarray(_pixels(release, target, MASK) > 0)


def mask_file(release: Release, target: Target) -> tuple[Path, str] | None:
    """Return the path and expected SHA-256 of a view's mask image; None if the release has no such mask."""
    name = f"views/{target.recording}/{target.view}{MASK.suffix}"
    return (release.folder / name, release.sums[name]) if name in release.sums else None


def read_mask(path: Path, sha256: str) -> Bools:
    """Read a mask, (height, width) bool, given the path and hash that `mask_file` returns.

    Raises:
        ReleaseError: as in `depth_m`.
    """
    return np.asarray(mask_levels(published_bytes(path, sha256), shown(path)) > 0)


def color(release: Release, target: Target) -> Rgb:
    """Read the colour of a pair's view: (height, width, 3) uint8 RGB.

    Raises:
        ReleaseError: as in `depth_m`; most releases have no colour.
    """
    return np.ascontiguousarray(_pixels(release, target, COLOR)[..., ::-1])


def depth_mm(png: bytes, where: str) -> NDArray[np.uint16]:
    """Decode a stored depth image: (height, width) uint16, millimetres.

    Raises:
        ReleaseError: the bytes are no depth image; the message begins with `where`.
    """
    return np.asarray(_decoded(png, where, DEPTH), dtype=np.uint16)


def mask_levels(png: bytes, where: str) -> NDArray[np.uint8]:
    """Decode a stored mask: (height, width) uint8, 255 = the object, 0 elsewhere.

    Raises:
        ReleaseError: the bytes are no mask; the message begins with `where`.
    """
    return np.asarray(_decoded(png, where, MASK), dtype=np.uint8)


def _pixels(release: Release, target: Target, kind: Kind) -> FileArray:
    name = f"views/{target.recording}/{target.view}{kind.suffix}"
    if name not in release.sums:
        raise ReleaseError(
            f"{shown(release.folder / name)}: the release has no such image", what="missing-file"
        )
    return _decoded(release.content(name), name, kind)


def _decoded(content: bytes, where: str, kind: Kind) -> FileArray:
    """Decode an image (colour as BGR), after checking that its header states the expected kind."""
    import cv2

    try:
        head = image_head(content)
        if (head.suffix, head.bits, head.color_type) != kind.format:
            raise ValueError("another kind of image")
        return decoded_image(content, cv2.IMREAD_COLOR if kind is COLOR else cv2.IMREAD_UNCHANGED)
    except ValueError as error:
        raise ReleaseError(f"{where}: not a {kind.words} ({error}); run `verify`") from error
