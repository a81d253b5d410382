"""Detect a still camera in front of a moving object, by the change of each pixel over time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import depth_sigma_m
from kinectbench.core.sequence import Sequence as Recorded
from kinectbench.core.threads import ahead
from kinectbench.core.types import Bools, Float32

# Number of frames to compare, and the smallest number.
FRAMES, MIN_FRAMES = 24, 6
# Width of the compared images: enough to find objects of 4 % of the width.
COLUMNS = 160
# A pixel is judged if it has depth in this ratio of the frames.
SEEN_SHARE = 0.6
# With noise alone, four fifths of a pixel's values lie within 2.6 standard deviations.
STILL_SIGMAS, MOVED_SIGMAS = 4.0, 6.0
# Smallest depth change of a moving object; the quantisation of depth is smaller at 2 m.
MOVED_M = 0.012
# Grey levels, after correction for exposure; measured on real recordings.
STILL_GRAY = 8.0
# An object has no surroundings if this ratio of the image has depth in fewer than RARELY of the frames.
EMPTY_SHARE, RARELY = 0.3, 0.15
# The camera stands still if these ratios of the static pixels have constant depth and, with colour, constant
# grey (the pattern of a turntable's plate may turn), and if static pixels fill the third ratio of the image.
# Something moves if moving pixels fill the last ratio of the image.
STILL_SHARE, STILL_GRAY_SHARE, AROUND_SHARE, MOVING_SHARE = 0.9, 0.5, 0.1, 0.004
# Unstable depth along edges forms strips thinner than this, pixels.
OPENED_PX = 3
# Noise alone changes the ratio of valid depth between quarters of the recording by less than OFTEN.
QUARTERS, OFTEN = 4, 0.7
# Pixels this close to a moving object are not used to judge the camera. Chosen by hand.
NEAR_PX = 4


@dataclass(frozen=True)
class Watched:
    """Which pixels of a recording are static and which change over time.

    Attributes:
        still_m: (height, width) float32, the depth of static pixels, 0 elsewhere.
        behind_m: (height, width) float32, the farthest depth over time (90 % quantile); infinite where most
            frames have no depth.
        moving: (height, width) bool, pixels in which something moves.
        moving_share: ratio of the image that is `moving` and also has a different depth in different quarters
            of the recording. Unstable edges move, but do not differ in that way.
        still_share: of the pixels with depth away from moving ones, the ratio with constant depth.
        still_gray_share: ratio of the static pixels whose grey is constant too; None with too little colour.
        around_share: ratio of the image with constant depth, away from moving pixels.
        empty_share: ratio of the image that hardly ever has depth.
    """

    still_m: Float32
    behind_m: Float32
    moving: Bools
    moving_share: float
    still_share: float
    still_gray_share: float | None
    around_share: float
    empty_share: float

    @property
    def camera_still(self) -> bool:
        """Whether the camera stands still, as shown by static surroundings."""
        still_gray = self.still_gray_share is None or self.still_gray_share >= STILL_GRAY_SHARE
        return self.around_share >= AROUND_SHARE and self.still_share >= STILL_SHARE and still_gray

    @property
    def plain(self) -> bool:
        """Whether the space around the object is empty, so that the object or the camera may move."""
        return self.around_share < AROUND_SHARE and self.empty_share >= EMPTY_SHARE

    @property
    def something_moves(self) -> bool:
        """Whether so much of the image changes that an object moves, if the camera stands still."""
        return self.moving_share >= MOVING_SHARE


def some_of(count: int) -> list[int]:
    """Return indices of at most 24 of `count` frames, evenly spread."""
    indices: list[int] = evenly(count, FRAMES).tolist()
    return indices


def watch(depths_m: Sequence[Float32], grays: Sequence[NDArray[np.uint8] | None]) -> Watched | None:
    """Compare the frames of a recording pixel by pixel.

    Args:
        depths_m: k frames from the whole recording, (height, width) metres each, 0 = none.
        grays: for each frame a grey image of about the same view, of any size; None if it has no colour.

    Returns:
        None if there are fewer than six frames.
    """
    if len(depths_m) < MIN_FRAMES:
        return None
    depth_m = np.stack(depths_m)
    seen = depth_m > 0
    measured = seen.mean(axis=0) >= SEEN_SHARE
    values = np.where(seen & measured, depth_m, np.nan)
    values[:, ~measured] = 0.0
    low_m, middle_m, high_m = _nanquantiles(values, (0.1, 0.5, 0.9))
    spread_m, sigma_m = high_m - low_m, depth_sigma_m(middle_m)
    moved = measured & (spread_m > np.maximum(MOVED_SIGMAS * sigma_m, MOVED_M))
    moving = _opened(moved | _comes_and_goes(seen))
    still = measured & (spread_m <= np.maximum(STILL_SIGMAS * sigma_m, MOVED_M))
    away = measured & ~_near(moving)
    return Watched(
        still_m=np.where(still, middle_m, np.float32(0)),
        behind_m=np.where(measured, high_m, np.float32(np.inf)),
        moving=moving,
        moving_share=float((_opened(_differs(values, seen, sigma_m)) & moving).mean()),
        still_share=float(still[away].mean()) if away.any() else 0.0,
        still_gray_share=_still_in_gray(grays, still & away),
        around_share=float((still & away).mean()),
        empty_share=float((seen.mean(axis=0) <= RARELY).mean()),
    )


def _nanquantiles(values: Float32, shares: Sequence[float]) -> list[Float32]:
    """Return `np.nanquantile(values, shares, axis=0)` as float32; 24 frames of 160x120 take 4 ms, not 1.2 s.

    Args:
        values: (k, height, width), NaN = none; every pixel has at least one value.
        shares: each in [0, 1].
    """
    ordered = np.sort(values, axis=0)  # NaN comes last
    last = (~np.isnan(values)).sum(axis=0) - 1
    quantiles = []
    for share in shares:
        place = share * last
        below = np.floor(place).astype(np.intp)
        a, b = (
            np.take_along_axis(ordered, np.minimum(index, last)[None], axis=0)[0]
            for index in (below, below + 1)
        )
        quantiles.append((a + (b - a) * (place - below)).astype(np.float32))
    return quantiles


class SomeWatched(NamedTuple):
    """The frames that `watch_some` compared: their depth in metres, the pixel stride, and the result."""

    depths_m: list[Float32]
    step_px: int
    watched: Watched | None


def watch_some(sequence: Recorded) -> SomeWatched:
    """Run `watch` on at most 24 frames of a sequence, with depth reduced to about 160 columns."""
    step = max(1, round(sequence.camera.width / COLUMNS))
    chosen = some_of(len(sequence))
    depths_m = list(ahead(lambda index: sequence.depth_m(index)[::step, ::step], chosen))
    colors = ahead(sequence.color_rgb, chosen)
    grays = [None if rgb is None else np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)) for rgb in colors]
    return SomeWatched(depths_m, step, watch(depths_m, grays))


def _differs(values: Float32, seen: Bools, sigma_m: Float32) -> Bools:
    """Pixels whose median depth, or ratio of frames with depth, differs between quarters of the frames.

    Args:
        values: (k, height, width) metres, NaN without depth; 0 for pixels that have depth in too few frames.
        seen: (k, height, width) bool, whether the pixel has depth.
        sigma_m: (height, width) standard deviation of the depth, metres.
    """
    parts = np.array_split(np.arange(len(values)), QUARTERS)
    # A quarter without depth gets the median of all frames.
    whole = np.nanmedian(values, axis=0)
    medians = [np.nanmedian(np.concatenate([values[part], whole[None]]), axis=0) for part in parts]
    often = [seen[part].mean(axis=0) for part in parts]
    differs: Bools = np.ptp(medians, axis=0) > np.maximum(MOVED_SIGMAS * sigma_m, MOVED_M)
    rarer: Bools = np.ptp(often, axis=0) > OFTEN
    return differs | rarer


def _comes_and_goes(seen: Bools) -> Bools:
    """Return which pixels have depth in only some frames, as if an object passes before empty space."""
    share = seen.mean(axis=0)
    between: Bools = (share > RARELY) & (share < SEEN_SHARE)
    return between


def _still_in_gray(grays: Sequence[NDArray[np.uint8] | None], still: Bools) -> float | None:
    """Fraction of the pixels with constant depth whose grey changes little; None with too little colour."""
    recorded = [gray for gray in grays if gray is not None]
    if len(recorded) < MIN_FRAMES or not still.any():
        return None
    size = (still.shape[1], still.shape[0])
    small = np.stack([cv2.resize(gray, size, interpolation=cv2.INTER_AREA)[still] for gray in recorded])
    values = small.astype(np.float32)
    # Automatic exposure changes all pixels by one factor, which is removed here.
    values *= np.median(values) / np.maximum(np.median(values, axis=1, keepdims=True), 1)
    low, high = np.quantile(values, [0.1, 0.9], axis=0)
    return float((high - low <= 2 * STILL_GRAY).mean())


def _opened(mask: Bools) -> Bools:
    """Morphological opening by three pixels: removes unstable depth along edges."""
    kernel = np.ones((OPENED_PX, OPENED_PX), np.uint8)
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel), dtype=bool)


def _near(mask: Bools) -> Bools:
    kernel = np.ones((2 * NEAR_PX + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel), dtype=bool)
