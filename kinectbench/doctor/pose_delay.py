"""Estimate the clock offset between given poses and depth: at which shift in time the poses fit best."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.clock_offset import steps_to_vertex
from kinectbench.core.trajectory.pose_convention import PoseConvention
from kinectbench.doctor.covered import covered
from kinectbench.doctor.delays import ASSUMED_HZ, LEAST_NS, clock_ns, offset_in_words
from kinectbench.doctor.finding import Finding, camera_line
from kinectbench.doctor.fit import FramePair, disagreements, fits, frames_of, pair_residual_m
from kinectbench.doctor.probe import Probe

# Lags up to half a second either way, enough for clocks that were synchronised over the network.
LAGS_NS = np.arange(-500_000_000, 500_000_001, 50_000_000)
# Step of the fine search around the best coarse lag, over more than two coarse steps either way. The parabola
# is fitted to the minimum and four steps either way, because a single step is within the noise of the costs.
FINE_STEP_NS = 10_000_000
FINE_NS = np.arange(-12, 13) * FINE_STEP_NS
ARM = 4
# An offset is reported only if shifted poses lower the cost to this ratio.
BETTER = 0.93
# Smallest offset that is reported, if both halves of the pairs agree to 10 ms. Measured: shifting the poses
# of five recordings by 20 and 30 ms shifts the result by as much, to 2 ms. Unshifted poses fit at most 1.2 %
# better at other times, except freiburg1_xyz with 21 %, whose depth lags the motion capture.
LEAST_FINE_NS, AGREED_NS = 15_000_000, 10_000_000
# Fewer pairs are not judged. No pose is interpolated over a longer gap. Chosen by hand.
LEAST_PAIRS = 4
MAX_GAP_S = 0.2


class FitsMoved(Finding):
    """A clock offset of given poses that fit the depth, and not only better, when shifted by it."""


def check_trajectory_delay(
    probe: Probe, given: GivenTrajectory, convention: PoseConvention, pairs: tuple[FramePair, ...]
) -> Iterator[Finding]:
    """Report given poses that fit the depth clearly better when shifted in time; `FitsMoved` if they fit."""
    delay_ns = _trajectory_delay_ns(probe, given, convention, pairs)
    # Without stamps, an offset of less than a frame is no clock offset.
    if delay_ns is None or abs(delay_ns) < (LEAST_NS if probe.counts_frames else LEAST_FINE_NS):
        return
    when = offset_in_words(delay_ns / 1e9)
    what = f"the stamps of the given poses are {when}: so moved, they fit the depth best"
    advice = camera_line("trajectory_delay_s", probe.recording.trajectory_delay_s + delay_ns / 1e9)
    if probe.counts_frames:
        which = "late" if delay_ns > 0 else "early"
        what = f"the given poses are {abs(delay_ns) * ASSUMED_HZ / 1e9:.0f} frames {which}"
        advice = "number them again"
    kind = FitsMoved if _fit_moved(probe, given, convention, pairs, delay_ns) else Finding
    yield kind("trajectory_delay", "warning", what, probe.where, advice)


def on_clock(probe: Probe, given: GivenTrajectory) -> GivenTrajectory:
    """Return the given trajectory with its stamps as if at 30 Hz if the recording only counts frames.

    `clock_ns` does the same to the stamps of frames.
    """
    divisor = ASSUMED_HZ if probe.counts_frames else 1
    return GivenTrajectory(given.stamps_ns // divisor, given.T_world_camera)


def _trajectory_delay_ns(
    probe: Probe, given: GivenTrajectory, convention: PoseConvention, pairs: tuple[FramePair, ...]
) -> int | None:
    """Return how late the poses' stamps are, in nanoseconds, by the best fit to depth; None if it is unclear.

    Lags up to half a second either way are tried in steps of 50 ms, then in steps of 10 ms around the best
    one, or around 0 if none is clearly better. Only pairs with poses at all lags are used, and at least four.
    The result is None if the shifted poses do not fit better than the unshifted ones and than a static
    camera, over the points that both cover.
    """

    def costs(lags_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the disagreement of poses and depth at each lag in each usable pair: (lags, pairs)."""
        poses = np.stack([_poses(probe, given, pairs, int(lag)) for lag in lags_ns])
        posed = np.all(np.isfinite(poses[:, :, 0, 0]), axis=0)
        usable = [pair for pair in pairs if posed[pair.first] and posed[pair.second]]
        return disagreements(usable, np.stack([convention.apply(each) for each in poses]))

    coarse_ns = _coarse_ns(costs(LAGS_NS))
    lags_ns = FINE_NS + FINE_STEP_NS * round((coarse_ns or 0) / FINE_STEP_NS)
    fine_ns = _fine_ns(lags_ns, costs(np.append(lags_ns, 0)))
    delay_ns = coarse_ns if fine_ns is None else fine_ns
    return delay_ns if delay_ns and _gains(probe, given, convention, pairs, delay_ns) else None


def _gains(
    probe: Probe,
    given: GivenTrajectory,
    convention: PoseConvention,
    pairs: tuple[FramePair, ...],
    delay_ns: int,
) -> bool:
    """Whether poses shifted by a delay fit better than unshifted ones and than a static camera.

    Only points count that both cover: shifted to a time when the camera stood, poses leave more of them
    inside the image.
    """
    shifted, unshifted = (convention.apply(_poses(probe, given, pairs, lag_ns)) for lag_ns in (delay_ns, 0))
    posed = np.isfinite(shifted[:, 0, 0]) & np.isfinite(unshifted[:, 0, 0])
    usable = [pair for pair in pairs if posed[pair.first] and posed[pair.second]]
    standing = np.tile(np.eye(4), (len(shifted), 1, 1))
    points = covered(usable, np.stack([shifted, unshifted, standing]))
    by_shift = [points.over_both(0, other) for other in (1, 2)]
    return all(mine < BETTER * theirs for mine, theirs in by_shift)


def _fit_moved(
    probe: Probe,
    given: GivenTrajectory,
    convention: PoseConvention,
    pairs: tuple[FramePair, ...],
    delay_ns: int,
) -> bool:
    """Whether poses shifted by a delay fit the depth, in the pairs of which both frames then have a pose."""
    shifted = convention.apply(_poses(probe, given, pairs, delay_ns))
    posed = np.isfinite(shifted[:, 0, 0])
    usable = [pair for pair in pairs if posed[pair.first] and posed[pair.second]]
    return bool(usable) and fits(pair_residual_m(usable, shifted), usable)


def _coarse_ns(costs: NDArray[np.float64]) -> int | None:
    """Return the best of LAGS_NS by costs (lags, pairs), refined by a parabola.

    The result is 0 if lag 0 is the best. It is None if the best lag is the first or last one, if it is not
    clearly better than lag 0, or for fewer than four pairs.
    """
    if costs.shape[1] < LEAST_PAIRS:
        return None
    means = costs.mean(axis=1)
    best, still = int(np.argmin(means)), len(LAGS_NS) // 2
    if best in (0, len(LAGS_NS) - 1) or means[best] > BETTER * means[still]:
        return 0 if best == still else None
    return round(float(LAGS_NS[best]) + steps_to_vertex(means, best) * float(LAGS_NS[1] - LAGS_NS[0]))


def _fine_ns(lags_ns: NDArray[np.int64], costs: NDArray[np.float64]) -> int | None:
    """Return the best lag if both halves of the pairs agree on it; None if it is unclear.

    Args:
        lags_ns: (k,) the fine lags.
        costs: (k + 1, pairs) disagreements at these lags, and in the last row at lag 0.
    """
    if costs.shape[1] < 2 * LEAST_PAIRS:
        return None
    whole_ns, *halves_ns = (
        _lowest_ns(lags_ns, part[:-1].mean(axis=1)) for part in (costs, *np.array_split(costs, 2, axis=1))
    )
    if whole_ns is None or costs[:-1].mean(axis=1).min() > BETTER * costs[-1].mean():
        return None
    agreed = all(half_ns is not None and abs(half_ns - whole_ns) <= AGREED_NS for half_ns in halves_ns)
    return whole_ns if agreed else None


def _lowest_ns(lags_ns: NDArray[np.int64], costs: NDArray[np.float64]) -> int | None:
    """Return the lag of the lowest cost (lags,), refined by a parabola; None if it is at an end or flat."""
    best = int(np.argmin(costs))
    around = slice(max(best - ARM, 0), best + ARM + 1)
    if best in (0, len(costs) - 1):
        return None
    steps = (lags_ns[around] - lags_ns[best]) / FINE_STEP_NS
    bend, slope, _ = np.polyfit(steps, costs[around], 2)
    if bend <= 0 or abs(slope) > 2 * ARM * bend:
        return None
    return int(lags_ns[best]) - round(float(slope / (2 * bend)) * FINE_STEP_NS)


def _poses(
    probe: Probe, given: GivenTrajectory, pairs: tuple[FramePair, ...], lag_ns: int
) -> NDArray[np.float64]:
    """Return poses (n, 4, 4) of the probe's n frames, at stamp + lag for paired frames, NaN for others."""
    needed = frames_of(pairs)
    poses = np.full((len(probe.frames), 4, 4), np.nan)
    moved = on_clock(probe, given)
    poses[needed] = poses_at(moved, clock_ns(probe, probe.frames)[needed] + lag_ns, longest_gap_s(moved))
    return poses


def longest_gap_s(given: GivenTrajectory) -> float:
    """Return the longest gap to interpolate over, seconds: 0.2, or 2.5 median steps of poses if larger."""
    median_s = float(np.median(np.diff(given.stamps_ns))) / 1e9 if len(given.stamps_ns) > 1 else 0.0
    return max(MAX_GAP_S, 2.5 * median_s)
