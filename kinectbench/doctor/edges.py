"""Whether colour lies on depth: where depth jumps, colour should have edges."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.doctor.finding import Finding
from kinectbench.doctor.look import Look

COLUMNS = 320
JUMP_SHARE = 0.06
REACH_PX = 24
# Shifts are in pixels of images 320 wide.
OFF_PX = 4.0
# The best place must stand out of all places by so many of their standard deviations.
CLEAR = 5.0
MUCH_BETTER, MIRROR_BETTER = 1.25, 1.5


@dataclass(frozen=True)
class EdgeFit:
    """How well edges agree.

    Attributes:
        here: at no shift; `best` at `shift_px`; `mirrored`: the best with colour mirrored left to right. All
            in standard deviations over every shift of the image.
        shift_px: (2,) by which colour lies right of and below depth, pixels of the depth image.
    """

    here: float
    best: float
    mirrored: float
    shift_px: NDArray[np.float64]

    @property
    def clear(self) -> bool:
        """Whether edges say anything."""
        return self.best > CLEAR


def fit_edges(look: Look) -> EdgeFit | None:
    """Correlate edges of depth with those of colour, over all frames that were read whole (own rule).

    None if colour is missing or of another shape than depth.
    """
    import cv2

    sums: list[NDArray[np.float64]] = []
    factor = 1.0
    for frame in look.whole:
        height, width = frame.depth.shape
        if frame.bgr is None or abs(frame.bgr.shape[1] / frame.bgr.shape[0] - width / height) > 0.02:
            continue
        factor = width / COLUMNS
        size = (COLUMNS, round(height / factor))
        gray = cv2.cvtColor(frame.bgr, cv2.COLOR_BGR2GRAY)
        jumps, edges = depth_jumps(frame.depth, size), color_edges(np.asarray(gray, np.uint8), size)
        sums.append(np.stack([_correlation(jumps, edges), _correlation(jumps, edges[:, ::-1])]))
    if not sums:
        return None
    right, mirrored = np.sum(sums, axis=0)
    near = _around(right)
    row, column = np.unravel_index(int(np.argmax(near)), near.shape)
    shift = np.array([column - REACH_PX, row - REACH_PX]) * factor
    return EdgeFit(float(near[REACH_PX, REACH_PX]), float(near.max()), float(_around(mirrored).max()), shift)


def check_edges(look: Look, fit: EdgeFit | None) -> Iterator[Finding]:
    """Judge what the edges say against what the recording says of its colour."""
    if fit is None:
        if look.recording.color_registered and any(f.bgr is not None for f in look.whole):
            what = "colour and depth images are of different shapes, but colour is taken to lie on depth"
            advice = "`color_registered: false` in camera.json"
            yield Finding("color_not_registered", "warning", what, look.where, advice)
        return
    if fit.mirrored > CLEAR and fit.mirrored > MIRROR_BETTER * fit.best:
        what = "colour is mirrored left to right against depth"
        yield Finding("color_mirrored", "warning", what, look.where, "mirror one of the two, and look which")
        return
    off_px = float(np.linalg.norm(fit.shift_px))
    off = off_px > OFF_PX * look.recording.camera.width / COLUMNS
    if look.recording.color_registered and fit.clear and off and fit.best > MUCH_BETTER * fit.here:
        right, down = fit.shift_px
        what = (
            f"colour is said to lie on depth, but its edges are {abs(right):.0f} px to the "
            f"{'right' if right > 0 else 'left'} and {abs(down):.0f} px {'down' if down > 0 else 'up'}"
        )
        advice = "register it, give its calibration, or say `color_registered: false` in camera.json"
        yield Finding("color_not_registered", "warning", what, look.where, advice)
    elif not look.recording.color_registered and look.recording.color_calibration is None:
        lies = " although its edges are near those of depth" if fit.clear and not off else ""
        what = f"colour does not lie on depth, or it is not known that it does{lies}: it is for display only"
        yield Finding("color_display_only", "note", what, look.where)


def depth_jumps(depth: NDArray[np.generic], size: tuple[int, int]) -> NDArray[np.float64]:
    """1 where depth (height, width; 0 = none) jumps between measured neighbours, else 0, at a size (w, h)."""
    import cv2

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
    """Gradient of a grey image, limited so that a few strong edges do not decide, at a size (w, h)."""
    import cv2

    small = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), 1.0)
    steep = cv2.magnitude(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    usual = float(steep.mean()) + 1e-3
    return np.asarray(np.minimum(steep / usual, 4.0), np.float64)


def _correlation(jumps: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """For every cyclic shift of colour (down, right) how well it fits; 0 on average."""
    spectrum = np.conj(np.fft.rfft2(jumps)) * np.fft.rfft2(edges - edges.mean())
    return np.asarray(np.fft.irfft2(spectrum, jumps.shape))


def _around(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scores of shifts up to REACH_PX each way, in standard deviations over shifts up to four times that."""

    def window(reach: int) -> NDArray[np.float64]:
        rolled = np.roll(scores, (reach, reach), axis=(0, 1))
        return rolled[: 2 * reach + 1, : 2 * reach + 1]

    wide = window(4 * REACH_PX)
    return np.asarray((window(REACH_PX) - np.median(wide)) / (wide.std() + 1e-9))
