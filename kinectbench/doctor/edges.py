"""Check the registration of colour to depth: compare the edges of both."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.doctor.color_place import ColorPlace, of_one_shape, place_color
from kinectbench.doctor.finding import Finding, Registration
from kinectbench.doctor.probe import Probe, WholeFrame

# Images are compared 320 wide, as the probe keeps grey images. Pixels whose neighbours' depth differs by this
# share are at an edge; colour is looked for at shifts up to this many pixels (chosen by hand).
COLUMNS, JUMP_SHARE, REACH_PX = 320, 0.06, 24
# A larger shift is an error; pixels of images 320 wide.
OFF_PX = 4.0
# The best shift must exceed the mean of the others by this many of their standard deviations.
CLEAR = 5.0
# It is an error if the best score is this many times the unchanged (unmirrored) score; chosen by hand.
MUCH_BETTER, MIRROR_BETTER = 1.25, 1.5
# How one of the two images may lie against the other, and what brings colour onto depth: rows and columns.
FLIPS = {"mirrored left to right": (1, -1), "mirrored top to bottom": (-1, 1), "turned upside down": (-1, -1)}


@dataclass(frozen=True)
class EdgeFit:
    """The agreement of colour edges with depth discontinuities.

    A score is the correlation at one shift, minus the median of the correlations at all shifts up to 96 px,
    divided by their standard deviation. These shifts are in pixels of images 320 px wide.

    Attributes:
        here: the score without a shift.
        best: the best score at a shift up to 24 px in these images; the shift is `shift_px`.
        flipped: the best score with colour mirrored or turned as in `FLIPS`.
        flip: the key of that score in `FLIPS`.
        shift_px: (2,) best shift: how far colour lies to the right of and below depth, depth pixels.
        pixel_px: pixels of depth per pixel of these images.
        place: the best fit with zoom and shift; None: not searched.
    """

    here: float
    best: float
    flipped: float
    flip: str
    shift_px: NDArray[np.float64]
    pixel_px: float
    place: ColorPlace | None = None

    @property
    def clear(self) -> bool:
        """Whether the best score is significant."""
        return self.best > CLEAR

    @property
    def off(self) -> bool:
        """Whether the best shift is too large for registered colour."""
        return bool(np.linalg.norm(self.shift_px) > OFF_PX * self.pixel_px)

    @property
    def shifted(self) -> bool:
        """Whether colour fits clearly better with the best shift."""
        return self.clear and self.off and self.best > MUCH_BETTER * self.here

    @property
    def elsewhere(self) -> bool:
        """Whether colour fits clearly better with a shift, or with a zoom and a shift."""
        return self.shifted or (self.place is not None and self.place.clear)

    @property
    def registration(self) -> Registration:
        """What edges say about the stated registration of colour: "seen", "unclear" or "contradicted"."""
        if self.elsewhere:
            return "contradicted"
        seen = self.here > CLEAR or (self.place is not None and self.place.seen)
        return "seen" if seen else "unclear"


def fit_edges(probe: Probe) -> EdgeFit | None:
    """Correlate depth discontinuities with colour edges, summed over the probe's full-size frames.

    Frames are left out if they have no colour, if colour has another aspect ratio than depth, or if the image
    has too few rows for the shifts that are tried. The result is None if no frame is left.
    """
    sums: list[NDArray[np.float64]] = []
    factor = 1.0
    for frame in probe.whole:
        height, width = frame.depth.shape
        factor = width / COLUMNS
        size = (COLUMNS, round(height / factor))
        if frame.bgr is None or not of_one_shape(frame.bgr, frame.depth) or size[1] <= 2 * REACH_PX:
            continue
        gray = cv2.cvtColor(frame.bgr, cv2.COLOR_BGR2GRAY)
        jumps, edges = depth_jumps(frame.depth, size), color_edges(np.asarray(gray, np.uint8), size)
        ways = [edges[::rows, ::columns] for rows, columns in ((1, 1), *FLIPS.values())]
        sums.append(np.stack([_correlation(jumps, way) for way in ways]))
    if not sums:
        return None
    right, *flipped = np.sum(sums, axis=0)
    near, scores = _around(right), [float(_around(each).max()) for each in flipped]
    row, column = np.unravel_index(int(np.argmax(near)), near.shape)
    shift = np.array([column - REACH_PX, row - REACH_PX]) * factor
    here, best = float(near[REACH_PX, REACH_PX]), float(near.max())
    fit = EdgeFit(here, best, max(scores), list(FLIPS)[int(np.argmax(scores))], shift, factor)
    unclear = probe.recording.color_registered and (here <= CLEAR or fit.shifted)
    return replace(fit, place=place_color(probe)) if unclear else fit


def check_edges(probe: Probe, fit: EdgeFit | None) -> Iterator[Finding]:
    """Report colour that is mirrored, on its side, or not registered to depth although it is said to be.

    A note reports colour whose registration no edges prove, or colour that is only for display, because it is
    neither registered nor calibrated.
    """
    if fit is None:
        shapes = (of_one_shape(frame.bgr, frame.depth) for frame in probe.whole if frame.bgr is not None)
        if any(_on_its_side(frame) for frame in probe.whole):
            what = "colour is upright and depth on its side, or the other way round"
            advice = "turn one by 90 degrees (with depth its intrinsics and poses, too), or leave colour out"
            yield Finding("color_not_registered", "warning", what, probe.where, advice)
        elif probe.recording.color_registered and not all(shapes):
            what = "colour and depth images are of different shapes, but colour is taken to lie on depth"
            advice = "`color_registered: false` in camera.json"
            yield Finding("color_not_registered", "warning", what, probe.where, advice)
        return
    if fit.flipped > CLEAR and fit.flipped > MIRROR_BETTER * fit.best:
        what, advice = f"colour is {fit.flip} against depth", "correct one of the two, and look which"
        yield Finding("color_mirrored", "warning", what, probe.where, advice)
        return
    if probe.recording.color_registered and fit.elsewhere:
        what = f"colour is said to lie on depth, but its edges are {_where(fit)}"
        advice = "register it, give its calibration, or say `color_registered: false` in camera.json"
        yield Finding("color_not_registered", "warning", what, probe.where, advice)
    elif probe.recording.color_registered and fit.registration == "unclear":
        what = "nothing shows that colour lies on depth; if it does not, tracking and colours suffer"
        advice = "if it was not aligned when recorded, say `color_registered: false` in camera.json"
        yield Finding("color_unproven", "note", what, probe.where, advice)
    elif not probe.recording.color_registered and probe.recording.color_calibration is None:
        lies = " although its edges are near those of depth" if fit.clear and not fit.off else ""
        what = f"colour does not lie on depth, or it is not known that it does{lies}: it is for display only"
        yield Finding("color_display_only", "note", what, probe.where)


def _on_its_side(frame: WholeFrame) -> bool:
    """Whether one of colour and depth is wider than high, and the other higher than wide."""
    if frame.bgr is None:
        return False
    (height, width, _), (depth_height, depth_width) = frame.bgr.shape, frame.depth.shape
    return bool((height - width) * (depth_height - depth_width) < 0)


def _where(fit: EdgeFit) -> str:
    """Describe in words the size and position of the edges of unregistered colour, relative to depth."""
    (right, down), place, large = fit.shift_px.tolist(), fit.place, ""
    if place is not None and place.is_found:
        if place.zoom != 1:
            large = f"about {place.zoom:.2g} times as large as depth's, and "
        if place.zoom != 1 or not fit.shifted:  # else the shift in the larger images is more precise
            right, down = place.shift_px.tolist()
    return (
        f"{large}{abs(right):.0f} px to the {'right' if right > 0 else 'left'} and {abs(down):.0f} px "
        f"{'down' if down > 0 else 'up'}"
    )


def depth_jumps(depth: NDArray[np.generic], size: tuple[int, int]) -> NDArray[np.float64]:
    """Return an image, resized to `size` (width, height), that is 1 at depth discontinuities, else 0.

    A discontinuity is a large relative difference between measured neighbours on both sides of a pixel.
    """
    pixels = depth.astype(np.float32)
    z = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_NEAREST), np.float64)
    jumps = np.zeros(z.shape)
    for axis in (0, 1):
        before, after = (np.roll(z, shift, axis) for shift in (1, -1))
        measured = (before > 0) & (after > 0)
        far = np.abs(before - after) > JUMP_SHARE * np.minimum(before, after)
        jumps[measured & far] = 1.0
    jumps[[0, -1]] = jumps[:, [0, -1]] = 0.0
    return jumps


def color_edges(gray: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.float64]:
    """Return a grey image's gradient magnitude at `size` (width, height), relative to its mean, at most 4."""
    small = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), 1.0)
    steep = cv2.magnitude(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    mean = float(steep.mean()) + 1e-3
    return np.asarray(np.minimum(steep / mean, 4.0), np.float64)


def _correlation(jumps: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the correlation of depth jumps and colour edges at each cyclic shift (down, right) of colour."""
    spectrum = np.conj(np.fft.rfft2(jumps)) * np.fft.rfft2(edges - edges.mean())
    return np.asarray(np.fft.irfft2(spectrum, jumps.shape))


def _around(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn correlations into scores. Return the scores at shifts up to r = REACH_PX.

    A score is (correlation - median) / standard deviation, where both statistics are over shifts up to 4 r.
    The result is (2 r + 1, 2 r + 1), with shift 0 in the middle.
    """

    def window(reach: int) -> NDArray[np.float64]:
        rolled = np.roll(scores, (reach, reach), axis=(0, 1))
        return rolled[: 2 * reach + 1, : 2 * reach + 1]

    wide = window(4 * REACH_PX)
    return np.asarray((window(REACH_PX) - np.median(wide)) / (wide.std() + 1e-9))
