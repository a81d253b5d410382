"""Checks of colour: registration to depth, exposure, blur, and frames of another scene."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.images import image_sharpness, relative_blur
from kinectbench.core.trajectory.coverage import in_order_of_time
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.probe import Probe, SmallFrame

COLUMNS = 320
JUMP_SHARE = 0.06
REACH_PX = 24
# A larger shift is an error; pixels of images 320 wide.
OFF_PX = 4.0
# The best shift must exceed the mean of the others by so many of their standard deviations.
CLEAR = 5.0
MUCH_BETTER, MIRROR_BETTER = 1.25, 1.5
WHITE, BLACK = 254, 8
MANY_SATURATED = 0.2
JUMP_RATIO = 1.25
FEW = 0.02
BLURRED, MANY_BLURRED = 2.5, 0.1
THUMB_PX = (40, 30)
# Depths whose ratio is below this show the same place.
SAME_DEPTH = 1.15
# A frame is of another scene if its neighbours agree with each other by this much more than with it.
ODD_BY, BESIDE_AGREE = 0.4, 0.55
# In seven ordered recordings, real and simulated, neighbouring frames agree in 0.90 to 1.00 of their pixels,
# at least 0.24 more than frames half the recording apart. In a shuffled recording they agree in 0.63, 0.03
# less than distant frames. In a static recording all frames agree. Short recordings are not judged.
MORE_SIMILAR, STILL_SIMILAR, FEWEST_IN_ORDER = 0.1, 0.9, 20


@dataclass(frozen=True)
class EdgeFit:
    """How well edges of colour coincide with depth discontinuities.

    A score is a correlation minus the median of the correlations at all shifts up to 96 px, in images 320 px
    wide, divided by their standard deviation.

    Attributes:
        here: the score without a shift.
        best: the best score at a shift up to 24 px in these images; the shift is `shift_px`.
        mirrored: the best score with colour mirrored left to right.
        shift_px: (2,) best shift: how far colour lies to the right of and below depth, depth pixels.
    """

    here: float
    best: float
    mirrored: float
    shift_px: NDArray[np.float64]

    @property
    def clear(self) -> bool:
        """Whether the best score is significant."""
        return self.best > CLEAR


def fit_edges(probe: Probe) -> EdgeFit | None:
    """Correlate depth discontinuities with colour edges, summed over the probe's full-size frames.

    Frames are left out if they have no colour, if colour has another aspect ratio than depth, or if the image
    has too few rows for the shifts that are tried. The result is None if no frame is left.
    """
    import cv2

    sums: list[NDArray[np.float64]] = []
    factor = 1.0
    for frame in probe.whole:
        height, width = frame.depth.shape
        factor = width / COLUMNS
        size = (COLUMNS, round(height / factor))
        if frame.bgr is None or not _of_one_shape(frame.bgr, frame.depth) or size[1] <= 2 * REACH_PX:
            continue
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


def _of_one_shape(bgr: NDArray[np.uint8], depth: NDArray[np.uint16]) -> bool:
    """Return whether colour (height, width, 3) and depth (height, width) have the same aspect ratio."""
    ratio, of_depth = (image.shape[1] / image.shape[0] for image in (bgr, depth))
    return bool(abs(ratio - of_depth) <= 0.02)


def check_edges(probe: Probe, fit: EdgeFit | None) -> Iterator[Finding]:
    """Report colour that is mirrored, or not registered to depth although the recording says that it is.

    A note reports colour that is only for display, because it is neither registered nor calibrated.
    """
    if fit is None:
        shapes = (_of_one_shape(frame.bgr, frame.depth) for frame in probe.whole if frame.bgr is not None)
        if probe.recording.color_registered and not all(shapes):
            what = "colour and depth images are of different shapes, but colour is taken to lie on depth"
            advice = "`color_registered: false` in camera.json"
            yield Finding("color_not_registered", "warning", what, probe.where, advice)
        return
    if fit.mirrored > CLEAR and fit.mirrored > MIRROR_BETTER * fit.best:
        what = "colour is mirrored left to right against depth"
        yield Finding("color_mirrored", "warning", what, probe.where, "mirror one of the two, and look which")
        return
    off_px = float(np.linalg.norm(fit.shift_px))
    off = off_px > OFF_PX * probe.recording.camera.width / COLUMNS
    if probe.recording.color_registered and fit.clear and off and fit.best > MUCH_BETTER * fit.here:
        right, down = fit.shift_px
        what = (
            f"colour is said to lie on depth, but its edges are {abs(right):.0f} px to the "
            f"{'right' if right > 0 else 'left'} and {abs(down):.0f} px {'down' if down > 0 else 'up'}"
        )
        advice = "register it, give its calibration, or say `color_registered: false` in camera.json"
        yield Finding("color_not_registered", "warning", what, probe.where, advice)
    elif not probe.recording.color_registered and probe.recording.color_calibration is None:
        lies = " although its edges are near those of depth" if fit.clear and not off else ""
        what = f"colour does not lie on depth, or it is not known that it does{lies}: it is for display only"
        yield Finding("color_display_only", "note", what, probe.where)


def depth_jumps(depth: NDArray[np.generic], size: tuple[int, int]) -> NDArray[np.float64]:
    """Return an image, resized to `size` (width, height), that is 1 at depth discontinuities, else 0.

    A discontinuity is a large relative difference between measured neighbours on both sides of a pixel.
    """
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
    """Return a grey image's gradient magnitude at `size` (width, height), relative to its mean, at most 4."""
    import cv2

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
    """Normalise correlations; return those at shifts up to REACH_PX (r): (2 r + 1, 2 r + 1), 0 in the middle.

    Their median is subtracted, then they are divided by their standard deviation, both at shifts up to 4 r.
    """

    def window(reach: int) -> NDArray[np.float64]:
        rolled = np.roll(scores, (reach, reach), axis=(0, 1))
        return rolled[: 2 * reach + 1, : 2 * reach + 1]

    wide = window(4 * REACH_PX)
    return np.asarray((window(REACH_PX) - np.median(wide)) / (wide.std() + 1e-9))


def check_light(probe: Probe) -> Iterator[Finding]:
    """Report faults of exposure, blur, frames in no order of time, and frames that show another scene."""
    yield from _exposure(probe)
    yield from _blur(probe)
    yield from _odd_frames(probe)


def _exposure(probe: Probe) -> Iterator[Finding]:
    grays = [frame.gray for frame in probe.frames if frame.gray is not None]
    if not grays:
        return
    for name, share, how in (
        ("overexposed", np.median([(gray >= WHITE).mean() for gray in grays]), "white"),
        ("underexposed", np.median([(gray <= BLACK).mean() for gray in grays]), "black"),
    ):
        if share > MANY_SATURATED:
            what = f"{share:.0%} of the colour pixels are {how}"
            yield Finding(name, "note", what, probe.where, "fix the exposure: colour helps to close loops")
    jumps = [
        second.index
        for first, second in probe.neighbours()
        if _brightness_ratio(first, second) > JUMP_RATIO and _match(_thumb(first), _thumb(second)) > 0.8
    ]
    if len(jumps) > FEW * len(grays):
        what = f"the brightness jumps before {len(jumps)} frames, such as {jumps[0]}"
        yield Finding("exposure_jumps", "note", what, probe.where, "fix the exposure and white balance")


def _brightness_ratio(first: SmallFrame, second: SmallFrame) -> float:
    if first.gray is None or second.gray is None:
        return 1.0
    a, b = float(first.gray.mean()) + 1, float(second.gray.mean()) + 1
    return max(a / b, b / a)


def _blur(probe: Probe) -> Iterator[Finding]:
    blurs = relative_blur(
        np.array([np.nan if f.gray is None else image_sharpness(f.gray) for f in probe.frames])
    )
    blurred = np.flatnonzero(blurs > BLURRED)
    if len(blurred) > MANY_BLURRED * max(int(np.isfinite(blurs).sum()), 1):
        few = f"under {1 / BLURRED:.0%} of the median detail"
        what = f"{len(blurred)} of {len(blurs)} frames have {few}: blur"
        yield Finding("blur", "note", what, probe.where, "move more slowly, or give it more light")


def _odd_frames(probe: Probe) -> Iterator[Finding]:
    thumbs = {frame.index: _thumb(frame) for frame in probe.frames}
    given = probe.recording.given_trajectory
    if given is not None and not in_order_of_time(given.T_world_camera):
        return  # views in no order of time do not resemble their neighbours
    if given is None and _shuffled(probe):
        what = "frames that follow each other are no more similar than any two: they are in no order of time"
        advice = "number them in the order in which they were recorded, or give their poses"
        yield Finding("frame_order", "warning", what, probe.where, advice)
        return
    odd = []
    for index, thumb in thumbs.items():
        before, after = thumbs.get(index - 1), thumbs.get(index + 1)
        if before is None or after is None:
            continue
        beside = _match(before, after)
        if beside > BESIDE_AGREE and max(_match(before, thumb), _match(thumb, after)) < beside - ODD_BY:
            odd.append(index)
    if odd:
        what = (
            f"{len(odd)} of {len(thumbs)} frames look nothing like those beside them, such as frame "
            f"{odd[0]}: another scene?"
        )
        yield Finding("odd_frames", "warning", what, f"{probe.where}: frame {odd[0]}", "remove them")


def _shuffled(probe: Probe) -> bool:
    """Return whether frames are in random order: neighbours hardly more similar than distant frames.

    The frames of the longest run are compared, distant ones half that run apart. The result is False if it
    has fewer than 20 frames, or if neighbours agree in 90 % of their pixels, as with a static camera.
    """
    thumbs = [_thumb(frame) for frame in probe.longest_run()]
    if len(thumbs) < FEWEST_IN_ORDER:
        return False
    beside, apart = (
        np.mean([_match(first, second) for first, second in zip(thumbs, thumbs[step:], strict=False)])
        for step in (1, len(thumbs) // 2)
    )
    return bool(beside < apart + MORE_SIMILAR and beside < STILL_SIMILAR)


def _thumb(frame: SmallFrame) -> NDArray[np.float32]:
    import cv2

    return np.asarray(cv2.resize(frame.depth_m, THUMB_PX, interpolation=cv2.INTER_NEAREST), np.float32)


def _match(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Return the share of pixels, of those with depth in both, whose depths agree to 15 %; 1 without any."""
    both = (first > 0) & (second > 0)
    if not both.any():
        return 1.0
    ratio = first[both] / second[both]
    return float(((ratio < SAME_DEPTH) & (ratio > 1 / SAME_DEPTH)).mean())
