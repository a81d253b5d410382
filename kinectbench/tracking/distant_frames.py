"""Does a given trajectory drift? Frames far apart in time that see the same place are registered."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import invert_rigid
from kinectbench.tracking.covisibility import covisible, glimpse
from kinectbench.tracking.disagreement import ask, residuals_m
from kinectbench.tracking.frame_maps import MapCache
from kinectbench.tracking.odometry import is_believable, tie
from kinectbench.tracking.tracked import Tie

Float64 = NDArray[np.float64]

# At most so many pairs are registered, those farthest apart in time first; and no more than this per frame.
MAX_PAIRS, PAIRS_PER_FRAME = 120, 0.3
# Of the recording's length, what lies between two distant frames at least.
MIN_APART = 1 / 6
MIN_SHARED_VIEW = 0.3
# Of fewer pairs no share is told.
MIN_TRIED = 8
# Fewer residuals than this say nothing.
MIN_RESIDUALS = 100


def tie_distant(
    maps: MapCache, T_given: Float64, frames: NDArray[np.int64], every: int
) -> tuple[tuple[Tie, ...], Float64, float]:
    """Register frames that are far apart in time and see the same place by the given poses.

    Args:
        maps: of the recording, n frames.
        T_given: (n, 4, 4).
        frames: (k,) that have a pose, ascending.
        every: only every n-th point is used.

    Returns:
        What convinces, as loops; (m,) how far each moves b's points from where the poses put them, metres;
        and the share of pairs that ought to see the same place and fit nowhere near, NaN of few pairs.
    """
    apart = MIN_APART * len(T_given)
    seen = covisible([glimpse(maps[frame]) for frame in frames.tolist()], T_given[frames])
    pairs = [(int(frames[i]), int(frames[j])) for share, i, j in seen if share >= MIN_SHARED_VIEW]
    pairs = sorted(((a, b) for a, b in pairs if b - a >= apart), key=lambda pair: (pair[0] - pair[1], pair))
    ties, shifts_m = [], []
    tried = pairs[: min(MAX_PAIRS, int(PAIRS_PER_FRAME * len(T_given)))]
    for a, b in tried:
        T_a_b = invert_rigid(T_given[a]) @ T_given[b]
        asked = (ask(maps[b], [maps[a]], [T_a_b], coarsest, every) for coarsest in (1, 2))
        found = next((each for each in asked if each and is_believable(each.registration)), None)
        if found is not None:
            ties.append(tie(a, b, found.registration, "loop"))
            shifts_m.append(found.shift_m)
    unmatched = 1 - len(ties) / len(tried) if len(tried) >= MIN_TRIED else np.nan
    return tuple(ties), np.array(shifts_m), unmatched


def distant_residual_m(
    maps: MapCache, ties: tuple[Tie, ...], every: int, T_world_camera: Float64 | None = None
) -> float:
    """Median over the ties of the median absolute residual from b to a, metres; NaN if none tells.

    Args:
        maps: of the recording, n frames.
        ties: between distant frames.
        every: only every n-th point is used.
        T_world_camera: (n, 4, 4), NaN where a frame has no pose; None: as the ties say.
    """
    medians = []
    for each in ties:
        T_a_b = each.T_a_b
        if T_world_camera is not None:
            T_a_b = invert_rigid(T_world_camera[each.a]) @ T_world_camera[each.b]
        if np.isfinite(T_a_b).all():
            found = residuals_m(maps[each.b], maps[each.a].levels[0], T_a_b, every)
            medians += [float(np.median(found))] if len(found) >= MIN_RESIDUALS else []
    return float(np.median(medians)) if medians else np.nan
