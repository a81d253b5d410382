"""Masks of a view: rendered object with agreeing depth, the recording's own, or a person's."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import OrientedBox
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.types import Bools, Float32

# Generous, so that the mask leaves the sensor's noise in the input.
AGREEMENT_SIGMAS = 5.0
# Along edges a sensor's depth wanders by a pixel or two: by so much the silhouette is eroded, and so far away
# depth may agree. Beside the silhouette one pixel is enough.
ERODE_PX, WITHIN_PX, FRINGE_PX = 2, 2, 1
# What lies so many standard deviations of the depth above the floor is not the floor.
CLEAR_SIGMAS = 3.0
# What was measured lower than this is the floor: feet are drawn square to the floor, and round ones are
# narrower there.
FLOOR_M = 0.002
# How the names of a person's PNGs end, in the order in which they are applied.
KINDS = ("", ".include", ".exclude")
MASK_NAME = re.compile(r"(frame_)?([0-9]{1,9})(|\.include|\.exclude)\.(?i:png)")
# A view's number has so many or more, a frame's any.
VIEW_DIGITS = 3
# Names in one line.
MOST_NAMED = 5


def agreement_mask(measured_m: Float32, rendered_m: Float32, tolerance_m: float, beside_px: int = 0) -> Bools:
    """Pixels whose depth agrees with the object rendered at or near them, within max(5 sigma, tolerance).

    Generous on purpose: a tight mask would delete the sensor's noise from the input and leak the truth
    into it.

    Args:
        measured_m: (height, width) metres, 0 = none.
        rendered_m: (height, width) metres, 0 = not on the object.
        tolerance_m: least difference allowed, metres.
        beside_px: up to so many rows and columns away any rendered pixel may agree.
    """
    allowed_m = np.maximum(AGREEMENT_SIGMAS * depth_sigma_m(rendered_m), tolerance_m).astype(np.float32)
    agrees: Bools = _agrees(measured_m, rendered_m, allowed_m, beside_px)
    return agrees


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _agrees(measured_m, rendered_m, allowed_m, beside_px):  # type: ignore[no-untyped-def]
    height, width = measured_m.shape
    agrees = np.zeros((height, width), np.bool_)
    for row in range(height):
        for column in range(width):
            depth_m = measured_m[row, column]
            if depth_m <= 0:
                continue
            for i in range(max(row - beside_px, 0), min(row + beside_px + 1, height)):
                for j in range(max(column - beside_px, 0), min(column + beside_px + 1, width)):
                    if rendered_m[i, j] > 0 and abs(depth_m - rendered_m[i, j]) <= allowed_m[i, j]:
                        agrees[row, column] = True
                        break
                if agrees[row, column]:
                    break
    return agrees


def object_mask(
    measured_m: Float32,
    rendered_m: Float32,
    heights_m: NDArray[np.floating],
    tolerance_m: float,
    clear_m: float,
) -> Bools:
    """The object in a view: pixels whose depth agrees with the rendering, and the edge pixels.

    The sensor's depth wanders along edges, and a solid made of noisy depth is often a pixel too narrow in the
    image. So a pixel's depth may agree with the object up to two pixels away. Beside the silhouette it
    may do so one pixel away, if it certainly lies above the floor. What was measured at the floor's height
    belongs to the floor.

    Args:
        measured_m: (height, width) metres, 0 = none.
        rendered_m: (height, width) metres, 0 = not on the object.
        heights_m: (height, width) metres, of the measured points above the floor.
        tolerance_m: least difference allowed, metres.
        clear_m: lower pixels may be the floor, metres.
    """
    on_object = rendered_m > 0
    within = agreement_mask(measured_m, rendered_m, tolerance_m, WITHIN_PX) & on_object
    fringe = agreement_mask(measured_m, rendered_m, tolerance_m, FRINGE_PX) & ~on_object
    above = heights_m > np.maximum(clear_m, CLEAR_SIGMAS * depth_sigma_m(measured_m))
    return np.asarray((within & (heights_m >= FLOOR_M)) | (fringe & above))


def recorded_mask(
    measured_m: Float32,
    recorded: Bools,
    points_floor: NDArray[np.floating],
    box: OrientedBox,
    margin_m: float,
) -> Bools:
    """The object in a view by the mask that came with the recording.

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


def inner_silhouette(rendered_m: Float32) -> Bools:
    """The rendered silhouette, eroded by 2 pixels, within which depth should be the object's."""
    import cv2

    silhouette = (rendered_m > 0).astype(np.uint8)
    kernel = np.ones((2 * ERODE_PX + 1,) * 2, np.uint8)
    return np.asarray(cv2.erode(silhouette, kernel), dtype=np.bool_)


class MaskName(NamedTuple):
    """The parts of a person's mask's name.

    Attributes:
        number: of the frame in the sequence, or of the view.
        of_frame: whether it is the frame's; masks named by views are older, and views change.
        kind: "" replaces the mask, ".include" adds to it, ".exclude" takes away.
    """

    number: int
    of_frame: bool
    kind: str


def mask_name(file: str, *, plain_of_frame: bool = False) -> MaskName | None:
    """The parts of a name such as frame_000024.exclude.png; None if it is no mask.

    Args:
        file: the name.
        plain_of_frame: a number alone is that of a frame, with `segment_by: masks`; else that of a view.
    """
    match = MASK_NAME.fullmatch(file)
    if match is None or not (match[1] or plain_of_frame or len(match[2]) >= VIEW_DIGITS):
        return None
    return MaskName(int(match[2]), plain_of_frame or match[1] is not None, match[3])


@dataclass(frozen=True)
class GivenMasks:
    """A person's masks: `frame_<index>.png`, `.include.png`, `.exclude.png`; older ones: `<view>.png`, ….

    Attributes:
        folder: where they are, for messages.
        names: of the files that are there, sorted.
        read: the mask of one of these names, (height, width) bool; raises SegmentationError for a bad file.
    """

    folder: str
    names: tuple[str, ...]
    read: Callable[[str], Bools]

    @cached_property
    def _of(self) -> Mapping[MaskName, list[str]]:
        by_mask: dict[MaskName, list[str]] = {}
        for file in self.names:
            if name := mask_name(file):
                by_mask.setdefault(name, []).append(file)
        return by_mask

    def of_image(self, view: str, frame: int, kind: str) -> str | None:
        """The name of an image's mask of one kind, or None.

        Raises:
            SegmentationError: there are several.
        """
        of_view = [
            name for name in self._of.get(MaskName(int(view), False, kind), ()) if name == f"{view}{kind}.png"
        ]
        files = [*self._of.get(MaskName(frame, True, kind), ()), *of_view]
        if len(files) > 1:
            raise SegmentationError(
                f"{self.folder}: {files[0]} and {files[1]} are masks of one image; remove one of them",
                what="bad-mask",
            )
        return files[0] if files else None


def override_mask(mask: Bools, given: GivenMasks, view: str, frame: int) -> Bools:
    """Apply a person's masks, if any, to the automatic mask of a view.

    `frame_<index>.png` replaces the mask; `.include.png` adds its pixels, `.exclude.png` takes them away.

    Args:
        mask: (height, width), the automatic one.
        given: the person's.
        view: its name.
        frame: its frame's index in the sequence.

    Raises:
        SegmentationError: one cannot be read, or is not of the depth image's size; there are two of a kind.
    """
    result = mask
    for kind in KINDS:
        name = given.of_image(view, frame, kind)
        if name is None:
            continue
        own = given.read(name)
        if own.shape != mask.shape:
            raise SegmentationError(
                f"{given.folder}/{name}: the mask is {own.shape[1]}x{own.shape[0]}, the depth image "
                f"{mask.shape[1]}x{mask.shape[0]}; draw it in depth pixels",
                what="mask-size",
            )
        result = {"": own, ".include": result | own, ".exclude": result & ~own}[kind]
    return result


def unused_masks(given: GivenMasks, views: Mapping[str, int]) -> list[str]:
    """Warnings of files that are not used: no mask has such a name, or its frame is no view.

    Args:
        given: a person's masks.
        views: the frame of each view.
    """
    frames, lines, waiting = set(views.values()), [], []
    of_views = {f"{view}{kind}.png" for view in views for kind in KINDS}
    for file in given.names:
        name = mask_name(file)
        if name is not None and name.of_frame:
            waiting += [] if name.number in frames else [file]
        elif file not in of_views and not file.startswith("."):
            lines.append(
                f"{given.folder}/{file}: not used, no mask has that name; they are called frame_<index>.png, "
                f".include.png or .exclude.png, as in frame_{min(frames):06d}.exclude.png"
            )
    if waiting:
        lines.append(f"{given.folder}: not used, as their frames are no views: {first_of(waiting)}")
    return lines


def first_of(names: Sequence[str]) -> str:
    """Some names in one line, and the number of others."""
    more = len(names) - MOST_NAMED
    return ", ".join(names[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
