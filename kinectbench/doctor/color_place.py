"""Find where the edges of colour lie relative to depth: a zoom about the image's middle, and a shift."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float64
from kinectbench.doctor.probe import Probe

# Images are compared 160 wide. Structure wider than FINE_PX is taken from the colour edges, which are limited
# to MOST_EDGE times the mean gradient (chosen by hand).
COLUMNS, FINE_PX, MOST_EDGE = 160, 4.0, 4.0
# Neighbours whose depth differs by this share are at an edge. A band without depth up to this share of the
# width is filled with the farther of the depths on its two sides: the shadow of a near thing.
JUMP_SHARE, SHADOW_SHARE = 0.06, 0.08
# How many times as large colour is tried: 0.6 to 1.73, as a D435's colour is 1.5 times as large as its depth;
# A step is 4 %: zooms that are 3 % off score nearly as much.
ZOOM_STEP, ZOOMS = 1.04, np.arange(-13, 15)
# Shifts (right, down) up to a quarter and a fifth of these images are tried (chosen by hand).
REACH_PX = (40, 24)
# A place is reported if its score is so many times that of colour as it is, and above the first bound, or
# above the second if each half of the frames has its best score there. Measured in 18 recordings, real and
# simulated, with colour as it is, enlarged, reduced and moved: 9.8 to 28 where it has edges enough, found by
# both halves; in 54 trials with colour mirrored, upside down or of other frames: at most 9.4, 8.1 by both.
PLACED, PLACED_BY_BOTH, PLACED_BETTER = 12.0, 9.5, 1.5
# Colour that lies on depth scores 10.6 to 28 there; where it fits nowhere, at most 5.8.
ON_DEPTH = 10.0
# The places of both halves agree if they differ by no more than a step of zoom, and pixels of these images.
SAME_PX = 3.0
# Ratio of aspects of colour and depth that are still one shape.
SAME_SHAPE = 0.02


@dataclass(frozen=True)
class ColorPlace:
    """The zoom about the image's middle, and the shift, by which the edges of colour differ from depth.

    A score is the correlation of depth jumps with colour edges of the same direction at one shift, minus the
    median of the correlations at all shifts, divided by their standard deviation.

    Attributes:
        zoom: size of objects in colour, relative to depth.
        shift_px: (2,) how far colour lies to the right of and below depth at the middle, depth pixels.
        score: the score with this zoom and shift.
        here: the best score without zoom, at shifts of at most one pixel of the images compared.
        by_both: whether each half of the frames alone, every second one, has its best score near this place.
    """

    zoom: float
    shift_px: NDArray[np.float64]
    score: float
    here: float
    by_both: bool = False

    @property
    def is_found(self) -> bool:
        """Whether colour clearly has this zoom and shift."""
        return self.score > (PLACED_BY_BOTH if self.by_both else PLACED)

    @property
    def clear(self) -> bool:
        """Whether colour fits clearly better with this zoom and shift than unchanged."""
        return self.is_found and self.score > PLACED_BETTER * self.here

    @property
    def seen(self) -> bool:
        """Whether colour clearly lies on depth as it is."""
        return self.here > ON_DEPTH


@dataclass(frozen=True)
class _Edges:
    """Edges of one direction in a frame: the conjugate spectrum of depth's, and colour's (height, width)."""

    jumps: NDArray[np.complex128]
    color: NDArray[np.float32]


def place_color(probe: Probe) -> ColorPlace | None:
    """Find the zoom and shift of colour that fit depth best, over the probe's full-size frames.

    Return None if no frame has colour of depth's aspect ratio.
    """
    frames = [
        list(_edges(frame.depth, frame.bgr))
        for frame in probe.whole
        if frame.bgr is not None and of_one_shape(frame.bgr, frame.depth)
    ]
    if not frames:
        return None
    pixel_px = probe.recording.camera.width / COLUMNS
    place = _best(frames, pixel_px)
    if place.is_found or place.score <= PLACED_BY_BOTH or len(frames) == 1:
        return place
    halves = [_best(frames[first::2], pixel_px) for first in (0, 1)]
    return replace(place, by_both=all(_is_near(half, place, SAME_PX * pixel_px) for half in halves))


def _best(frames: Sequence[Sequence[_Edges]], pixel_px: float) -> ColorPlace:
    """Return the place with the best score; `pixel_px`: depth pixels per pixel of these images."""
    scores = {zoom: _at_zoom(list(chain(*frames)), zoom) for zoom in (ZOOM_STEP**ZOOMS).tolist()}
    here = next(table for zoom, table in scores.items() if zoom == 1)
    down, right = (count // 2 for count in here.shape)
    at = max(scores, key=lambda zoom: float(scores[zoom].max()))
    row, column = np.unravel_index(int(np.argmax(scores[at])), here.shape)
    shift = np.array([column - right, row - down]) * at * pixel_px
    beside = here[down - 1 : down + 2, right - 1 : right + 2]
    return ColorPlace(at, shift, float(scores[at].max()), float(beside.max()))


def _is_near(one: ColorPlace, other: ColorPlace, most_px: float) -> bool:
    """Whether two places differ by no more than a step of zoom and `most_px` (depth pixels) each way."""
    zoom = max(one.zoom, other.zoom) / min(one.zoom, other.zoom)
    return zoom < ZOOM_STEP**1.5 and bool((np.abs(one.shift_px - other.shift_px) <= most_px).all())


def of_one_shape(bgr: NDArray[np.uint8], depth: NDArray[np.uint16]) -> bool:
    """Return whether colour (height, width, 3) and depth (height, width) have the same aspect ratio."""
    ratio, of_depth = (image.shape[1] / image.shape[0] for image in (bgr, depth))
    return bool(abs(ratio - of_depth) <= SAME_SHAPE)


def _edges(depth: NDArray[np.uint16], bgr: NDArray[np.uint8]) -> Iterator[_Edges]:
    """Yield the edges across rows, and those across columns."""
    height, width = depth.shape
    size = (COLUMNS, round(height * COLUMNS / width))
    z = np.asarray(cv2.resize(depth.astype(np.float32), size, interpolation=cv2.INTER_NEAREST), np.float64)
    gray = cv2.resize(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), size, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), 1.0)
    steep = [cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)]
    mean = float(cv2.magnitude(*steep).mean()) + 1e-3
    for jumps, gradient in zip((_jumps(z), _jumps(z.T).T), steep, strict=True):
        color = np.minimum(np.abs(gradient) / mean, MOST_EDGE).astype(np.float32)
        fine = color - cv2.GaussianBlur(color, (0, 0), FINE_PX)
        yield _Edges(np.conj(np.fft.rfft2(jumps)), np.asarray(fine, np.float32))


def _jumps(z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an image (height, width) that is 1 where depth (the same) jumps along its row, else 0.

    A narrow band without depth counts as the farther of its two sides.
    """
    count = z.shape[1]
    columns, known = np.arange(count), z > 0
    left = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, columns, count)[:, ::-1], axis=1)[:, ::-1]
    sides = [np.take_along_axis(z, np.clip(at, 0, count - 1), axis=1) for at in (left, right)]
    narrow = (left >= 0) & (right < count) & (right - left <= SHADOW_SHARE * COLUMNS)
    filled = np.where(known, z, np.where(narrow, np.maximum(*sides), 0.0))
    before, after = filled[1:-1, :-2], filled[1:-1, 2:]
    far = np.abs(before - after) > JUMP_SHARE * np.minimum(before, after)
    jumps = np.zeros(z.shape)
    jumps[1:-1, 1:-1] = (before > 0) & (after > 0) & far
    return jumps


def _at_zoom(parts: Sequence[_Edges], zoom: float) -> Float64:
    """Return a table of the scores of colour, reduced by `zoom`, at all shifts; shift 0 is in its middle."""
    height, width = parts[0].color.shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    reduce = np.column_stack([zoom * np.eye(2), (1 - zoom) * middle])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    spectra = (
        edges.jumps * np.fft.rfft2(cv2.warpAffine(edges.color, reduce, (width, height), flags=flags))
        for edges in parts
    )
    table = np.roll(np.fft.irfft2(sum(spectra), (height, width)), (height // 2, width // 2), (0, 1))
    table = (table - np.median(table)) / (table.std() + 1e-9)
    right, down = (min(reach, count // 2) for reach, count in zip(REACH_PX, (width, height), strict=True))
    return np.asarray(
        table[height // 2 - down : height // 2 + down + 1, width // 2 - right : width // 2 + right + 1]
    )
