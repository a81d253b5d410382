"""Masks of a view: the rendered object where the measured depth agrees, the recording's own, a person's."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import SegmentationError
from kinectbench.geometry import OrientedBox
from kinectbench.geometry.depth_noise import depth_sigma_m

Bools = NDArray[np.bool_]
Depth = NDArray[np.float32]

AGREEMENT_SIGMAS = 5.0
ERODE_PX = 2
# What lies so many standard deviations of the depth above the floor is not the floor.
CLEAR_SIGMAS = 3.0
BEYOND_M = np.float32(1e3)


def agreement_mask(measured_m: Depth, rendered_m: Depth, tolerance_m: float) -> Bools:
    """Pixels whose depth agrees with the rendered object within max(5 sigma, tolerance).

    Generous on purpose: a tight mask would delete the sensor's noise from the input and leak the truth
    into it.

    Args:
        measured_m: (height, width) metres, 0 = none.
        rendered_m: (height, width) metres, 0 = not on the object.
        tolerance_m: least difference allowed, metres.
    """
    allowed_m = np.maximum(AGREEMENT_SIGMAS * depth_sigma_m(rendered_m), tolerance_m)
    agrees: Bools = (measured_m > 0) & (rendered_m > 0) & (np.abs(measured_m - rendered_m) <= allowed_m)
    return agrees


def object_mask(
    measured_m: Depth, rendered_m: Depth, heights_m: NDArray[np.floating], tolerance_m: float, clear_m: float
) -> Bools:
    """The object in a view: where depth agrees with it rendered, and its fringe (own rule).

    A solid made of noisy depth is often a pixel too narrow in the image. So pixels beside the silhouette
    belong to the object, too, if their depth agrees with that of the nearest surface beside them, and if
    they lie above the floor beyond doubt.

    Args:
        measured_m: (height, width) metres, 0 = none.
        rendered_m: (height, width) metres, 0 = not on the object.
        heights_m: (height, width) metres, of the measured points above the floor.
        tolerance_m: least difference allowed, metres.
        clear_m: what lies lower may be the floor, metres.
    """
    import cv2

    on_object = rendered_m > 0
    nearest_m = cv2.erode(np.where(on_object, rendered_m, BEYOND_M), np.ones((3, 3), np.uint8))
    beside_m = np.where(on_object | (nearest_m >= BEYOND_M), np.float32(0), nearest_m)
    above = heights_m > np.maximum(clear_m, CLEAR_SIGMAS * depth_sigma_m(measured_m))
    fringe = agreement_mask(measured_m, beside_m, tolerance_m) & above
    return np.asarray(agreement_mask(measured_m, rendered_m, tolerance_m) | fringe)


def recorded_mask(
    measured_m: Depth, recorded: Bools, points_floor: NDArray[np.floating], box: OrientedBox, margin_m: float
) -> Bools:
    """The object in a view by the mask that came with the recording (own rule).

    Its pixels with depth whose points lie in the object's box: along outlines a mask also covers pixels whose
    depth is that of the background.

    Args:
        measured_m: (height, width) metres, 0 = none.
        recorded: (height, width), the mask that came with the recording.
        points_floor: (height, width, 3) metres, the measured points.
        box: of the object.
        margin_m: by how much the box is grown on every side, metres.
    """
    inside: Bools = recorded & (measured_m > 0) & box.grown(margin_m).contains(points_floor)
    return inside


def inner_silhouette(rendered_m: Depth) -> Bools:
    """The rendered silhouette, eroded by 2 pixels: where depth should be the object's."""
    import cv2

    silhouette = (rendered_m > 0).astype(np.uint8)
    kernel = np.ones((2 * ERODE_PX + 1,) * 2, np.uint8)
    return np.asarray(cv2.erode(silhouette, kernel), dtype=np.bool_)


def override_mask(mask: Bools, folder: Path, view: str) -> Bools:
    """Apply a person's PNGs, if there are any, to the automatic mask of a view.

    `<view>.png` replaces the mask; `<view>.include.png` adds its pixels, `<view>.exclude.png` takes its
    pixels away. Non-zero = the pixel counts.

    Raises:
        SegmentationError: a PNG cannot be read, or is not of the depth image's size.
    """
    result = mask
    for suffix in ("", ".include", ".exclude"):
        path = folder / f"{view}{suffix}.png"
        if not path.exists():
            continue
        given = _read(path, mask.shape)
        result = {"": given, ".include": result | given, ".exclude": result & ~given}[suffix]
    return result


def stray_masks(folder: Path, views: list[str]) -> list[str]:
    """One warning per PNG in the folder whose name is no view's, and which is therefore not used."""
    return [
        f"{path}: no view of that name; masks are called <view>.png, as in {views[0]}.png"
        for path in sorted(folder.glob("*.png"))
        if path.name.split(".")[0] not in views
    ]


def _read(path: Path, shape: tuple[int, ...]) -> Bools:
    import cv2

    data = path.read_bytes() if path.is_file() else b""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if image is None:
        raise SegmentationError(f"{path}: not a readable PNG; save the mask again")
    if image.shape != shape:
        raise SegmentationError(
            f"{path}: the mask is {image.shape[1]}x{image.shape[0]}, the depth image {shape[1]}x{shape[0]}; "
            "draw it in depth pixels"
        )
    return np.asarray(image, dtype=np.uint8) > 0
