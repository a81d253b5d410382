"""By how much one stream's stamps are late against another's, from the motion that both show."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LONGEST_NS = 500_000_000
STEP_NS = 2_000_000
# Less agreement is no agreement; a lag that is the best of its neighbours only by chance agrees less.
LEAST_CORRELATION = 0.5
LEAST_SAMPLES = 20
SMALL_PX = (80, 60)


@dataclass(frozen=True)
class Motion:
    """How the image moves over time.

    Attributes:
        times_ns: (n,) int64, increasing: the middle between two frames.
        shift_px_s: (n, 2) float64: the shift of the image in x and y, pixels (of any one size) a second.
    """

    times_ns: NDArray[np.int64]
    shift_px_s: NDArray[np.float64]


@dataclass(frozen=True)
class Delay:
    """An estimated delay.

    Attributes:
        delay_ns: the second stream's stamps are late by this.
        correlation: of both motions once it is taken off, at most 1.
    """

    delay_ns: int
    correlation: float


def image_motion(stamps_ns: Sequence[int], images: Iterable[NDArray[np.generic]]) -> Motion:
    """The shift between images in a row, by phase correlation (Kuglin and Hines 1975).

    Args:
        stamps_ns: (n,) increasing, nanoseconds.
        images: n images (height, width), depth or grey; those of depth may have holes.
    """
    import cv2

    window = cv2.createHanningWindow(SMALL_PX, cv2.CV_32F)
    shifts, last = [], None
    for image in images:
        small = cv2.resize(np.asarray(image, np.float32), SMALL_PX, interpolation=cv2.INTER_AREA)
        if last is not None:
            shifts.append(cv2.phaseCorrelate(last - last.mean(), small - small.mean(), window)[0])
        last = small
    stamps = np.asarray(stamps_ns, np.int64)
    return _motion(stamps, np.array(shifts, np.float64).reshape(-1, 2))


def estimate_delay(first: Motion, second: Motion) -> Delay | None:
    """The delay of the second stream's stamps at which both motions agree best (own rule).

    Every lag up to half a second is tried on the samples of the first stream, the second interpolated, by the
    correlation of both components together; the best is refined by a parabola.

    Returns:
        None if there is too little motion in common to tell.
    """
    lags_ns = np.arange(-LONGEST_NS, LONGEST_NS + 1, STEP_NS)
    scores = np.array([_agreement(first, second, int(lag)) for lag in lags_ns])
    best = int(np.argmax(scores))
    if not scores[best] >= LEAST_CORRELATION or best in (0, len(lags_ns) - 1):
        return None
    before, here, after = scores[best - 1 : best + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return Delay(round(float(lags_ns[best]) + float(np.clip(shift, -1, 1)) * STEP_NS), float(here))


def _motion(stamps_ns: NDArray[np.int64], shifts_px: NDArray[np.float64]) -> Motion:
    steps_s = np.diff(stamps_ns) / 1e9
    # A frame that was dropped makes a longer step, which says less about when it moved.
    usual = steps_s < 2.5 * np.median(steps_s) if len(steps_s) else np.zeros(0, bool)
    middle = stamps_ns[:-1] + np.diff(stamps_ns) // 2
    return Motion(middle[usual], shifts_px[usual] / steps_s[usual, None])


def _agreement(first: Motion, second: Motion, lag_ns: int) -> float:
    """Correlation of the first motion with the second at stamps that are later by a lag."""
    if len(second.times_ns) < 2:
        return -1.0
    times = first.times_ns + lag_ns
    common = (times >= second.times_ns[0]) & (times <= second.times_ns[-1])
    if common.sum() < LEAST_SAMPLES:
        return -1.0
    # Relative times, as nanoseconds since 1970 have more digits than a float.
    at, known = (times[common] - second.times_ns[0]) / 1e9, (second.times_ns - second.times_ns[0]) / 1e9
    there = np.stack([np.interp(at, known, second.shift_px_s[:, axis]) for axis in (0, 1)], axis=1)
    a, b = (values - values.mean(axis=0) for values in (first.shift_px_s[common], there))
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0 else -1.0
