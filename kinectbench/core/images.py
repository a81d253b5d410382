"""Pictures of a view's depth, colour and masks; their encoding; and the sharpness of images."""

import base64
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.encoded_images import decoded_image, image_head
from kinectbench.core.errors import StorageError
from kinectbench.core.types import Bools, Float64, Rgb
from kinectbench.core.untrusted import IMAGE_BYTES, read_plain

NO_DEPTH = 40
CONTOUR_RGB = (255, 120, 20)


def depth_picture(depth_mm: NDArray[np.uint16]) -> Rgb:
    """Colour a depth image (height, width) by distance: near is bright, no measurement is dark grey."""
    import cv2

    valid = depth_mm > 0
    if not valid.any():
        return np.full((*depth_mm.shape, 3), NO_DEPTH, np.uint8)
    low, high = np.percentile(depth_mm[valid], [2, 98])
    scaled = np.clip((high - depth_mm.astype(np.float64)) / max(high - low, 1.0), 0, 1)
    bgr = cv2.applyColorMap((scaled * 235 + 20).astype(np.uint8), cv2.COLORMAP_CIVIDIS)
    rgb = np.asarray(bgr, np.uint8)[..., ::-1].copy()
    rgb[~valid] = NO_DEPTH
    return rgb


def overlay_mask(picture: Rgb, mask: Bools) -> Rgb:
    """Dim a picture outside a mask (height, width) of its size, and draw the mask's contour."""
    import cv2

    result = np.ascontiguousarray(np.where(mask[..., None], picture, picture * 0.55), dtype=np.uint8)
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(result, contours, -1, CONTOUR_RGB, max(2, picture.shape[1] // 200))
    return result


def shrunk(picture: Rgb, size_px: int) -> Rgb:
    """Shrink a picture if a side is longer than `size_px`."""
    import cv2

    height, width = picture.shape[:2]
    factor = size_px / max(height, width)
    if factor >= 1:
        return picture
    shape = (max(1, round(width * factor)), max(1, round(height * factor)))
    return np.asarray(cv2.resize(picture, shape, interpolation=cv2.INTER_AREA), np.uint8)


def data_uri(picture: Rgb, quality: int = 82) -> str:
    """Encode RGB (height, width, 3) as a JPEG `data:` address."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg(picture, quality)).decode()


def jpeg(picture: Rgb, quality: int = 82) -> bytes:
    """Encode RGB (height, width, 3) as a JPEG file."""
    import cv2

    bgr = np.ascontiguousarray(picture[..., ::-1])
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def png(image: NDArray[np.generic]) -> bytes:
    """Encode depth or a mask (height, width), uint16 or uint8, or BGR (height, width, 3), as a PNG file."""
    import cv2

    return bytes(cv2.imencode(".png", np.ascontiguousarray(image))[1].tobytes())


def read_color(path: Path) -> Rgb:
    """Read a colour image: (height, width, 3) uint8 RGB.

    Raises:
        StorageError: the file is damaged or of another kind.
    """
    import cv2

    return np.asarray(_decode(path, cv2.IMREAD_COLOR), np.uint8)[..., ::-1]


def read_gray(path: Path) -> NDArray[np.uint16]:
    """Read an image of one channel (depth, mask): (height, width), widened to uint16.

    Raises:
        StorageError: the file is damaged or of another kind.
    """
    import cv2

    pixels = _decode(path, cv2.IMREAD_UNCHANGED)
    if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16):
        raise _unreadable(path)
    return pixels.astype(np.uint16)


def _decode(path: Path, mode: int) -> NDArray[np.generic]:
    try:
        data = read_plain(path, IMAGE_BYTES)
        image_head(data)
        return decoded_image(data, mode)
    except (OSError, ValueError) as error:
        raise _unreadable(path) from error


def _unreadable(path: Path) -> StorageError:
    return StorageError(f"{path}: not a readable image of its kind; build this recording's views again")


# Motion first removes detail finer than this, in pixels of the halved image.
COARSE_SIGMA_PX = 2.0
# Below this variance the coarse detail of an image is rounding error: the image shows nothing.
MIN_COARSE_VARIANCE = 0.01


def image_sharpness(gray: NDArray[np.uint8]) -> float:
    """Return the ratio of fine to coarse detail of an image; NaN for an image without detail.

    The variance of the Laplacian (Pech-Pacheco et al., "Diatom autofocusing in brightfield microscopy", ICPR
    2000), divided by that of the smoothed image, so that the ratio depends little on the scene and not on
    exposure (chosen here).

    Args:
        gray: (height, width) uint8, about 320 wide: at this size the sensor's noise adds little detail.
    """
    import cv2

    image = gray.astype(np.float32)
    coarse = cv2.GaussianBlur(image, (0, 0), COARSE_SIGMA_PX)
    fine_variance, coarse_variance = (
        float(cv2.meanStdDev(cv2.Laplacian(each, cv2.CV_32F))[1][0, 0] ** 2) for each in (image, coarse)
    )
    return fine_variance / coarse_variance if coarse_variance > MIN_COARSE_VARIANCE else np.nan


def relative_blur(sharpness: Float64) -> Float64:
    """Return blur (n,) by sharpness (n,): 1: as sharp as the median frame, 2: half as sharp, NaN: unknown."""
    known = np.isfinite(sharpness) & (sharpness > 0)
    relative = np.full(len(sharpness), np.nan)
    if known.any():
        relative[known] = np.median(sharpness[known]) / sharpness[known]
    return relative
