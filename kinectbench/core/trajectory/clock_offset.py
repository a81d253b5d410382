"""The offset between a trajectory's clock and the clock of frames that have poses from another source.

A motion capture system and a camera have separate clocks. In TUM's freiburg1 the depth stamps of the Kinect
lag the motion capture by 28 ms, which doubles the absolute trajectory error there.
"""

from dataclasses import dataclass

import numpy as np

from kinectbench.core.geometry import transform_points
from kinectbench.core.sequence import GivenTrajectory, counts_frames
from kinectbench.core.trajectory.compare import align_positions, has_pose
from kinectbench.core.types import Float64, Int64

# Lags to try: up to 0.2 s, for clocks that were synchronised by hand or over a network.
STEP_NS = 10_000_000
LAGS_NS = np.arange(-20, 21) * STEP_NS
# Half of the frames are then six, as many as an alignment has unknowns.
LEAST_FRAMES = 12
# Positions are interpolated over gaps of this length, or of this many median steps, as in `inspect`.
BRIDGED_S, BRIDGED_STEPS = 0.2, 2.5
# An offset is reported if it lowers the error to this ratio, and if both halves of the frames agree with it
# to 20 ms or a fifth. On 32 frames of freiburg1_xyz the halves give -34 and -4 ms, and all frames -19 ms,
# which lowers the error by 16 %. An offset below 3 ms hardly matters: 1 mm at 0.3 m/s.
BETTER, AGREED_NS, AGREED_SHARE, LEAST_NS = 0.9, 20_000_000, 0.2, 3_000_000


@dataclass(frozen=True)
class ClockOffset:
    """The offset of a trajectory's clock.

    Attributes:
        late_s: by how much the trajectory's stamps are late, seconds; < 0: they are early.
        ate_m: absolute trajectory error (rmse), metres, without correction, over the frames that the
            reference covers at every lag.
        ate_moved_m: the same error after the stamps are moved back by `late_s`.
    """

    late_s: float
    ate_m: float
    ate_moved_m: float


def clock_offset(stamps_ns: Int64, T_world_camera: Float64, reference: GivenTrajectory) -> ClockOffset | None:
    """Estimate the clock offset of a reference: the lag that best aligns its positions with the frames'.

    At each lag the reference is interpolated, and the frames are aligned to it without scale. Near the best
    lag the mean squared distance is approximately a parabola.

    Args:
        stamps_ns: (n,) int64, stamps of the frames, increasing.
        T_world_camera: (n, 4, 4) the frames' poses from another source; NaN where unknown.
        reference: the trajectory whose clock offset is estimated, in any world frame.

    Returns:
        None if there is no offset or it cannot be determined: the frames have no stamps, the camera hardly
            moved, or another cause, such as drift, dominates the error.
    """
    posed = has_pose(T_world_camera)
    frames_ns, positions = stamps_ns[posed], T_world_camera[posed, :3, 3]
    if len(frames_ns) < LEAST_FRAMES or counts_frames(stamps_ns) or len(reference.stamps_ns) < 2:
        return None
    squares = _squares(frames_ns, positions, reference, LAGS_NS)
    if squares.shape[1] < LEAST_FRAMES:
        return None
    late_ns = _best_ns(squares)
    halves_ns = [_best_ns(half) for half in np.array_split(squares, 2, axis=1)]
    if late_ns is None or abs(late_ns) < LEAST_NS:
        return None
    agreed_ns = max(AGREED_NS, AGREED_SHARE * abs(late_ns))
    if any(half_ns is None or abs(half_ns - late_ns) > agreed_ns for half_ns in halves_ns):
        return None
    ends_ns = np.array([*LAGS_NS[[0, -1]], 0, late_ns])  # the end lags select the same frames
    as_it_is, moved = np.sqrt(_squares(frames_ns, positions, reference, ends_ns).mean(axis=1)[2:])
    return ClockOffset(late_ns / 1e9, float(as_it_is), float(moved)) if moved < BETTER * as_it_is else None


def _best_ns(squares: Float64) -> int | None:
    """Return the lag, ns, with the lowest mean of `squares` (lags, frames), refined by a parabola.

    The result is None if this lag is the first or the last.
    """
    means = squares.mean(axis=1)
    best = int(np.argmin(means))
    if best in (0, len(means) - 1):
        return None
    return int(LAGS_NS[best]) + round(steps_to_vertex(means, best) * STEP_NS)


def steps_to_vertex(values: Float64, best: int) -> float:
    """Return the signed offset, in steps, from the extremum of evenly spaced values to a parabola's vertex.

    The parabola passes through the extremum and its two neighbours. The extremum of the values (n,) is at the
    index `best`, neither the first nor the last.

    Returns:
        In [-1, 1]; 0 if the three values lie on a line.
    """
    before, at_best, after = values[best - 1 : best + 2]
    bend = before - 2 * at_best + after
    return float(np.clip(0.5 * (before - after) / bend, -1, 1)) if bend else 0.0


def _squares(frames_ns: Int64, positions: Float64, reference: GivenTrajectory, lags_ns: Int64) -> Float64:
    """Return squared distances (lags, k), m^2, to the reference, of k frames that it covers at every lag."""
    # Times relative to the first, because nanoseconds since 1970 exceed the precision of a float.
    known_ns = reference.stamps_ns - reference.stamps_ns[0]
    wanted_ns = frames_ns - reference.stamps_ns[0] + lags_ns[:, None]
    steps_ns = np.diff(known_ns)
    after = np.clip(np.searchsorted(known_ns, wanted_ns), 1, len(known_ns) - 1)
    bridged_ns = max(BRIDGED_S * 1e9, BRIDGED_STEPS * float(np.median(steps_ns)))
    inside = (wanted_ns >= 0) & (wanted_ns <= known_ns[-1]) & (steps_ns[after - 1] <= bridged_ns)
    usable = inside.all(axis=0)
    squares = np.zeros((len(lags_ns), int(usable.sum())))
    for lag, at_ns in enumerate(wanted_ns[:, usable]):
        columns = reference.T_world_camera[:, :3, 3].T
        known = np.stack([np.interp(at_ns / 1e9, known_ns / 1e9, column) for column in columns], axis=1)
        if len(known):
            aligned = transform_points(align_positions(positions[usable], known), positions[usable])
            squares[lag] = ((aligned - known) ** 2).sum(axis=1)
    return squares
