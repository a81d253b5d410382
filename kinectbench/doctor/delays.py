"""Estimate the clock offset between colour and depth, from the image motion in both streams."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.trajectory.association import pairing_tolerance_ns
from kinectbench.core.trajectory.clock_offset import steps_to_vertex
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.doctor.edges import color_edges, depth_jumps
from kinectbench.doctor.finding import Finding, camera_line
from kinectbench.doctor.probe import END_RUN, Probe, SmallFrame

LONGEST_NS = 500_000_000
STEP_NS = 2_000_000
# Smallest correlation of a valid lag; chance maxima are lower.
LEAST_CORRELATION = 0.6
LEAST_SAMPLES = 20
SMALL_PX = (80, 60)


@dataclass(frozen=True)
class Motion:
    """Image motion of a stream over time, between n pairs of consecutive frames.

    Attributes:
        times_ns: (n,) int64, increasing: the time halfway between the two frames.
        shift_px_s: (n, 2) float64: speed of the image in x and y, pixels of images 80 x 60 per second.
    """

    times_ns: NDArray[np.int64]
    shift_px_s: NDArray[np.float64]


def image_motion(stamps_ns: Sequence[int], images: Iterable[NDArray[np.generic]]) -> Motion:
    """Measure a stream's image motion by phase correlation of consecutive images (Kuglin and Hines 1975).

    Pairs of images that are 2.5 median steps or more apart are left out.

    Args:
        stamps_ns: (n,) increasing, nanoseconds.
        images: n images (height, width): depth, which may have holes, or grey.
    """
    window = cv2.createHanningWindow(SMALL_PX, cv2.CV_32F)
    shifts, last = [], None
    for image in images:
        small = cv2.resize(np.asarray(image, np.float32), SMALL_PX, interpolation=cv2.INTER_AREA)
        if last is not None:
            shifts.append(cv2.phaseCorrelate(last - last.mean(), small - small.mean(), window)[0])
        last = small
    stamps = np.asarray(stamps_ns, np.int64)
    steps_s = np.diff(stamps) / 1e9
    # A dropped frame makes a longer step, whose time is less precise.
    regular = steps_s < 2.5 * np.median(steps_s) if len(steps_s) else np.zeros(0, bool)
    middle = stamps[:-1] + np.diff(stamps) // 2
    shifts_px = np.array(shifts, np.float64).reshape(-1, 2)
    return Motion(middle[regular], shifts_px[regular] / steps_s[regular, None])


def estimate_delay_ns(first: Motion, second: Motion) -> int | None:
    """Return how late the second stream's stamps are, in nanoseconds, by the motion in both streams.

    Lags up to half a second either way are tried in steps of 2 ms. The score of a lag is the correlation of
    both motion components at the times of the first stream, with the second stream interpolated. A parabola
    refines the best lag.

    Returns:
        The delay, negative if the stamps are early; None if no lag has a correlation above 0.6 over at least
            20 samples, or if the best is the first or last lag.
    """
    lags_ns = np.arange(-LONGEST_NS, LONGEST_NS + 1, STEP_NS)
    scores = np.array([_agreement(first, second, int(lag)) for lag in lags_ns])
    best = int(np.argmax(scores))
    if not scores[best] > LEAST_CORRELATION or best in (0, len(lags_ns) - 1):
        return None
    return round(float(lags_ns[best]) + steps_to_vertex(scores, best) * STEP_NS)


def _agreement(first: Motion, second: Motion, lag_ns: int) -> float:
    """Return the correlation of the first motion with the second taken `lag_ns` later.

    It is -1 with fewer than 20 common samples, or without motion.
    """
    if len(second.times_ns) < 2:
        return -1.0
    times = first.times_ns + lag_ns
    common = (times >= second.times_ns[0]) & (times <= second.times_ns[-1])
    if common.sum() < LEAST_SAMPLES:
        return -1.0
    # Times relative to the start, because nanoseconds since 1970 exceed the precision of a float.
    at, known = (times[common] - second.times_ns[0]) / 1e9, (second.times_ns - second.times_ns[0]) / 1e9
    shifted = np.stack([np.interp(at, known, second.shift_px_s[:, axis]) for axis in (0, 1)], axis=1)
    a, b = (values - values.mean(axis=0) for values in (first.shift_px_s[common], shifted))
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0 else -1.0


# Assumed frame rate of recordings whose stamps only count frames.
ASSUMED_HZ = 30
# Smaller delays are hard to measure and hardly matter: 60 ms, and this many frame periods of colour.
LEAST_NS, LEAST_PERIODS = 60_000_000, 1.3
EDGE_LAGS, EDGE_SIZE = 12, (160, 120)
# The best lag must score this many standard errors, and this many times the score without a lag. Without a
# delay, a board of 15 mm scored 5.8 at a lag of two frames. With one, nine of eleven recordings scored 9.6 or
# more; two of objects of 10 cm scored 6.5 and 7.0, and are not found.
EDGE_CLEAR, EDGE_BETTER = 8.0, 1.15
PAIRED_SHARE = 0.8


def check_color_delay(probe: Probe) -> Iterator[Finding]:
    """Report a constant delay, at least 60 ms and 1.3 frames, between colour and the depth paired with it."""
    run = tuple(frame for frame in probe.longest_run() if frame.gray is not None)
    if len(run) < 3:
        return
    stamps_ns = clock_ns(probe, run)
    period_ns = float(np.median(np.diff(stamps_ns)))
    delay_ns = _color_delay_ns(probe, run, stamps_ns)
    if delay_ns is None or abs(delay_ns) < max(LEAST_NS, LEAST_PERIODS * period_ns):
        return
    delay_ns = _with_partners_ns(probe, delay_ns)
    late, frames = delay_ns / 1e9, delay_ns / period_ns
    own_clock = len(probe.recording.recorded_stamps_ns[1]) > 0 and not probe.counts_frames
    line = camera_line("color_delay_s", probe.recording.color_delay_s + late)
    what = (
        f"colour is {offset_in_words(late)} against depth (about {abs(frames):.1f} frames), by what both show"
    )
    advice = line if own_clock else "pair the images again: they have no stamps of their own"
    yield Finding("color_delay", "warning", what, probe.where, advice)


def check_color_drift(probe: Probe) -> Iterator[Finding]:
    """Report a drift between the clocks of colour and depth: a delay that grows over the recording.

    The delay is measured in runs of frames at the beginning, middle and end, or in the thirds of one long
    run. It must grow by at least 60 ms. To exclude chance results, the delay in the middle must also be near
    the value that a linear drift would give.
    """
    runs = [run for run in probe.runs() if len(run) >= END_RUN and all(f.gray is not None for f in run)]
    if len(runs) < 3:
        longest = max(runs, key=len, default=())
        third = len(longest) // 3
        if third < END_RUN:
            return
        runs = [longest[:third], longest[third : 2 * third], longest[2 * third :]]
    delays: list[tuple[float, int]] = []
    for run in (runs[0], max(runs[1:-1], key=len), runs[-1]):
        stamps_ns = clock_ns(probe, run)
        depth = image_motion(stamps_ns.tolist(), [frame.depth_m for frame in run])
        color = image_motion(stamps_ns.tolist(), [frame.gray for frame in run if frame.gray is not None])
        delay_ns = estimate_delay_ns(depth, color)
        if delay_ns is None:
            return
        delays.append((float(stamps_ns.mean()), delay_ns))
    (first_at, first_ns), (middle_at, middle_ns), (last_at, last_ns) = delays
    grown_ns = last_ns - first_ns
    expected_ns = first_ns + grown_ns * (middle_at - first_at) / (last_at - first_at)
    if abs(grown_ns) < LEAST_NS or abs(middle_ns - expected_ns) > max(LEAST_NS / 2, abs(grown_ns) / 4):
        return
    a_minute_ms = grown_ns / (last_at - first_at) * 60_000
    first, last = (offset_in_words(delay_ns / 1e9) for delay_ns in (first_ns, last_ns))
    what = (
        f"colour is {first} at the beginning and {last} at the end, by what both show: the clocks drift "
        f"apart by {abs(a_minute_ms):.0f} ms a minute"
    )
    advice = (
        "record both with one clock, or correct colour's stamps by the delay, which grows as said"
        if len(probe.recording.recorded_stamps_ns[1]) and not probe.counts_frames
        else "each stream counts its own frames: name the images by their time stamps, which then pair them"
    )
    yield Finding("color_drift", "warning", what, probe.where, advice)


def clock_ns(probe: Probe, frames: tuple[SmallFrame, ...]) -> NDArray[np.int64]:
    """Return the stamps (n,) of frames, nanoseconds; 30 Hz is assumed if the recording only counts frames."""
    stamps_ns = np.array([frame.stamp_ns for frame in frames], np.int64)
    return stamps_ns // ASSUMED_HZ if probe.counts_frames else stamps_ns


def _color_delay_ns(probe: Probe, run: tuple[SmallFrame, ...], stamps_ns: NDArray[np.int64]) -> int | None:
    """Return colour's delay, ns, found by motion, or by edges if motion fails and colour is registered.

    The result is None if no method finds a delay.
    """
    delay_ns = _motion_delay_ns(run, stamps_ns)
    if delay_ns is None and probe.recording.color_registered:
        return _edge_delay_ns(run, stamps_ns)
    return delay_ns


def _motion_delay_ns(run: tuple[SmallFrame, ...], stamps_ns: NDArray[np.int64]) -> int | None:
    """Return colour's delay by the motion in both streams; None unless both halves of the run confirm it."""
    depth = image_motion(stamps_ns.tolist(), [frame.depth_m for frame in run])
    color = image_motion(stamps_ns.tolist(), [frame.gray for frame in run if frame.gray is not None])
    middle = len(depth.times_ns) // 2
    delays_ns: list[int] = []
    for part in (slice(None), slice(middle), slice(middle, None)):
        delay_ns = estimate_delay_ns(Motion(depth.times_ns[part], depth.shift_px_s[part]), color)
        if delay_ns is None:
            return None
        delays_ns.append(delay_ns)
    apart_ns = max(LEAST_NS, float(np.median(np.diff(stamps_ns))))
    return delays_ns[0] if max(abs(half_ns - delays_ns[0]) for half_ns in delays_ns[1:]) <= apart_ns else None


def _with_partners_ns(probe: Probe, delay_ns: int) -> int:
    """Return colour's delay, corrected if it leaves over 20 % of the colour images without a depth partner.

    The correction adds the median time by which a colour image, once shifted by the delay, follows its
    nearest depth image.
    """
    depth_ns, color_ns = (np.unique(stamps_ns) for stamps_ns in probe.recording.recorded_stamps_ns)
    if len(depth_ns) < 2 or not len(color_ns):
        return delay_ns
    color_ns = color_ns - round(probe.recording.color_delay_s * NS_PER_S) - delay_ns
    after = np.clip(np.searchsorted(depth_ns, color_ns), 1, len(depth_ns) - 1)
    apart_ns = np.stack([color_ns - depth_ns[after - 1], color_ns - depth_ns[after]])
    nearest_ns = np.where(np.abs(apart_ns[0]) < np.abs(apart_ns[1]), *apart_ns)
    if (np.abs(nearest_ns) <= pairing_tolerance_ns(depth_ns, color_ns)).mean() >= PAIRED_SHARE:
        return delay_ns
    return delay_ns + int(np.median(nearest_ns))


def _edge_delay_ns(run: tuple[SmallFrame, ...], stamps_ns: NDArray[np.int64]) -> int | None:
    """Return the delay of registered colour at which its edges coincide best with depth discontinuities.

    Lags up to 12 frames either way are tried. The result is None if there are fewer than 26 frames, if the
    best lag is not significant or is the first or last one, or if the best lag of either half of the run is
    more than one frame away from it.
    """
    if len(run) // 2 <= EDGE_LAGS:
        return None
    fits = _edge_fits(run)
    by_lag = [np.diagonal(fits, lag) for lag in range(-EDGE_LAGS, EDGE_LAGS + 1)]
    whole = [float(pairs.mean()) for pairs in by_lag]
    best = int(np.argmax(whole))
    error = float(fits.std()) / math.sqrt(len(by_lag[best]))
    clear = whole[best] > EDGE_CLEAR * error and whole[best] >= EDGE_BETTER * whole[EDGE_LAGS]
    halves = zip(*(np.array_split(pairs, 2) for pairs in by_lag), strict=True)
    agreed = all(abs(int(np.argmax([pairs.mean() for pairs in half])) - best) <= 1 for half in halves)
    if best in (0, 2 * EDGE_LAGS) or not clear or not agreed:
        return None
    # Colour that matches the depth of an earlier frame is late.
    return round((best - EDGE_LAGS) * float(np.median(np.diff(stamps_ns))))


def _edge_fits(run: tuple[SmallFrame, ...]) -> NDArray[np.float64]:
    """Return an array (n, n): [i, j] is the overlap of frame i's depth discontinuities and j's colour edges.

    The mean of each row and of each column is subtracted.
    """
    jumps = np.stack([depth_jumps(frame.depth_m, EDGE_SIZE).astype(np.float32).ravel() for frame in run])
    edges = np.stack([_edges_of(frame).astype(np.float32).ravel() for frame in run])
    fits = (jumps @ edges.T).astype(np.float64)
    # Jumps and edges concentrate in the middle of all images, so means are subtracted.
    return np.asarray(fits - fits.mean(axis=0) - fits.mean(axis=1, keepdims=True) + fits.mean())


def _edges_of(frame: SmallFrame) -> NDArray[np.float64]:
    assert frame.gray is not None
    edges = color_edges(frame.gray, EDGE_SIZE)
    return np.asarray(edges - edges.mean())


def offset_in_words(late_s: float) -> str:
    """Return a delay in words, such as "28 ms late"."""
    return f"{abs(late_s) * 1000:.0f} ms {'late' if late_s > 0 else 'early'}"
