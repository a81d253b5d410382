"""The object's mask in a view: from rendered depth, from the recording, or drawn by the user."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import OrientedBox, depth_sigma_m
from kinectbench.core.types import Bools, Float32

# Wide, so that the sensor's noise stays in the network's input.
AGREEMENT_SIGMAS = 5.0
# Depth at edges is off by a pixel or two: the silhouette is eroded by the first, and depth may agree with a
# pixel as far away as the second. Beside the silhouette one pixel suffices.
ERODE_PX, WITHIN_PX, FRINGE_PX = 2, 2, 1
# A point this many standard deviations of its depth above the floor is not on the floor.
CLEAR_SIGMAS = 3.0
# A point lower than this is on the floor: the solid's feet are square to the floor, and round feet are
# narrower there.
FLOOR_M = 0.002
# Endings of the names of the user's PNGs, in the order in which they are applied.
KINDS = ("", ".include", ".exclude")
MASK_NAME = re.compile(r"(frame_)?([0-9]{1,9})(|\.include|\.exclude)\.(?i:png)")
# A view's number has at least this many digits; a frame's number any.
VIEW_DIGITS = 3
# Names to list in one line.
MOST_NAMED = 5


def agreement_mask(measured_m: Float32, rendered_m: Float32, tolerance_m: float, beside_px: int = 0) -> Bools:
    """Find the pixels whose depth is within max(5 sigma, tolerance) of the rendered depth at or near them.

    The tolerance is wide on purpose: a tight mask would remove noisy pixels from the network's input, and so
    reveal the true shape.

    Args:
        measured_m: (height, width) metres, 0 = none.
        rendered_m: (height, width) metres, 0 = not on the object.
        tolerance_m: smallest tolerance, metres.
        beside_px: a pixel may agree with any rendered pixel up to this many rows and columns away.
    """
    agrees = np.zeros(measured_m.shape, np.bool_)
    ends = [np.flatnonzero((rendered_m > 0).any(axis=axis))[[0, -1]] for axis in (1, 0) if rendered_m.any()]
    if ends:
        near = tuple(slice(max(first - beside_px, 0), last + beside_px + 1) for first, last in ends)
        allowed_m = np.maximum(AGREEMENT_SIGMAS * depth_sigma_m(rendered_m[near]), tolerance_m)
        agrees[near] = _agrees(measured_m[near], rendered_m[near], allowed_m.astype(np.float32), beside_px)
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
    """Find the object's mask in a view: pixels whose depth agrees with the rendered object at or near them.

    Depth at edges is off by a pixel or two, and a solid made from noisy depth is often a pixel too narrow. So
    a pixel inside the rendered silhouette may agree with a rendered pixel up to two pixels away. A pixel
    outside may agree with one up to one pixel away, if its point is clearly above the floor. A point at the
    floor's height belongs to the floor.

    Args:
        measured_m: (height, width) metres, 0 = none.
        rendered_m: (height, width) metres, 0 = not on the object.
        heights_m: (height, width) metres, height of the measured points above the floor.
        tolerance_m: smallest tolerance, metres.
        clear_m: points outside the silhouette that are lower than this may be the floor, metres.
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
    """Make the object's mask in a view from the mask that came with the recording.

    Only pixels whose points lie inside the object's box are kept, because at its outline a recorded mask also
    covers pixels that have the depth of the background.

    Args:
        measured_m: (height, width) metres, 0 = none.
        recorded: (height, width), the mask that came with the recording.
        points_floor: (height, width, 3) metres, the measured points, floor frame.
        box: the object's box.
        margin_m: the box grows by this on every side, metres.
    """
    inside: Bools = recorded & (measured_m > 0) & box.grown(margin_m).contains(points_floor)
    return inside


def inner_silhouette(rendered_m: Float32) -> Bools:
    """Erode the rendered silhouette by 2 pixels, so that depth inside it should belong to the object."""
    silhouette = (rendered_m > 0).astype(np.uint8)
    kernel = np.ones((2 * ERODE_PX + 1,) * 2, np.uint8)
    return np.asarray(cv2.erode(silhouette, kernel), dtype=np.bool_)


class MaskName(NamedTuple):
    """The parsed file name of a mask given by the user.

    Attributes:
        number: index of the frame in the sequence, or number of the view.
        of_frame: whether the number is a frame's, not a view's. Older masks are named by views, whose numbers
            may change.
        kind: "" replaces the automatic mask, ".include" adds to it, ".exclude" removes from it.
    """

    number: int
    of_frame: bool
    kind: str


def mask_name(file: str, *, plain_of_frame: bool = False) -> MaskName | None:
    """Parse the name of a mask such as frame_000024.exclude.png; return None if it is no mask's name.

    Args:
        file: name of the file.
        plain_of_frame: whether a number without "frame_" means a frame, as with `segment_by: masks`. If not,
            it means a view.
    """
    match = MASK_NAME.fullmatch(file)
    if match is None or not (match[1] or plain_of_frame or len(match[2]) >= VIEW_DIGITS):
        return None
    return MaskName(int(match[2]), plain_of_frame or match[1] is not None, match[3])


@dataclass(frozen=True)
class GivenMasks:
    """Masks given by the user, named by frame (`frame_<index>.png`, `.include.png`, `.exclude.png`) or view.

    Attributes:
        folder: the folder, for messages.
        names: names of the existing files, sorted.
        read: reads a mask by name, (height, width) bool; raises SegmentationError for a bad file.
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
        """Return the name of the file with this kind (`MaskName.kind`) of mask for a view or frame.

        The result is None if there is no such file.

        Raises:
            SegmentationError: there are several such masks.
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
    """Apply the user's masks, if any, to the automatic mask of a view.

    `frame_<index>.png` replaces the mask; `.include.png` adds its pixels, `.exclude.png` removes them.

    Raises:
        SegmentationError: a mask is unreadable or has another size than depth, or there are two of one kind.
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
    """Return warnings about unused files: the name is not that of a mask, or its frame is not a view.

    Args:
        given: the user's masks.
        views: {name of the view: index of its frame}.
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
    """Return a line with the first `MOST_NAMED` names, and the number of further names."""
    more = len(names) - MOST_NAMED
    return ", ".join(names[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
