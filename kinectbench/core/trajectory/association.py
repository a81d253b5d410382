"""Association in time: of colour frames with depth frames, and of given poses with frames.

Depth and colour are paired one to one: first as many pairs as possible, then the closest. A given trajectory
is interpolated at the stamps of frames.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import NamedTuple, Optional

import numpy as np

from kinectbench.core.geometry import interpolate_rigid
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.types import Float64, Int64

# Largest time difference within a pair, as in the association tool of TUM RGB-D.
TOLERANCE_NS = 20_000_000
# A step between frames longer than this many median steps contains a missing frame.
MISSING_STEPS = 1.5


class _Matching(NamedTuple):
    """The best pairs so far, as a linked list; more pairs are better, then a smaller total gap.

    Attributes:
        pairs: number of pairs.
        minus_gap_ns: minus the sum of their time differences, nanoseconds.
        pair: the last pair of indices, (depth, colour); None at the start of the list.
        before: the pairs before the last one.
    """

    pairs: int
    minus_gap_ns: int
    pair: tuple[int, int] | None
    before: Optional["_Matching"]

    @property
    def score(self) -> tuple[int, int]:
        return self.pairs, self.minus_gap_ns


def associate(
    depth_ns: Sequence[int], color_ns: Sequence[int], tolerance_ns: int = TOLERANCE_NS
) -> list[int | None]:
    """Give each depth frame at most one colour frame, and each colour frame at most one depth frame.

    Stamps may be paired if they differ by `tolerance_ns` at most. The result has the largest number of pairs,
    and among those the smallest sum of differences. Optimal pairs never need to cross, so dynamic programming
    over the sorted stamps finds them. The default tolerance of 0.02 s is that of TUM RGB-D. The stamps of
    each stream increase, by one clock.

    Returns:
        For each depth frame, the index of its colour frame; None if it has no partner.
    """
    # best[j]: the best matching of the depth frames so far with colour frames before j; complete up to
    # `reach`.
    best = [_Matching(0, 0, None, None)] * (len(color_ns) + 1)
    reach = 0
    for i, stamp_ns in enumerate(depth_ns):
        low = bisect_left(color_ns, stamp_ns - tolerance_ns)
        high = bisect_right(color_ns, stamp_ns + tolerance_ns)
        best[reach + 1 : high + 1] = [best[reach]] * (high - reach)
        reach = max(reach, high)
        for j in range(high - 1, low - 1, -1):
            gap_ns = abs(color_ns[j] - stamp_ns)
            paired = _Matching(best[j].pairs + 1, best[j].minus_gap_ns - gap_ns, (i, j), best[j])
            best[j + 1] = max(best[j + 1], paired, key=lambda matching: matching.score)
        for j in range(low, high):
            best[j + 1] = max(best[j], best[j + 1], key=lambda matching: matching.score)
    partners: list[int | None] = [None] * len(depth_ns)
    matching: _Matching | None = best[reach]
    while matching is not None and matching.pair is not None:
        i, j = matching.pair
        partners[i] = j
        matching = matching.before
    return partners


def half_step_ns(stamps_ns: Sequence[int] | Int64) -> int:
    """Half the median interval between stamps, nanoseconds; `TOLERANCE_NS` for fewer than two stamps."""
    steps = np.diff(np.unique(np.asarray(stamps_ns, np.int64)))
    return int(np.median(steps)) // 2 if len(steps) else TOLERANCE_NS


def pairing_tolerance_ns(depth_ns: Sequence[int] | Int64, color_ns: Sequence[int] | Int64) -> int:
    """Return the largest accepted time difference between a frame's depth and colour image, nanoseconds.

    It is half a frame interval of the faster stream plus half the larger jitter of the two streams, at most
    `TOLERANCE_NS`. Below that limit, it includes the nearest image, and mostly excludes that of the next
    frame. The stamps are in nanoseconds, in any order.
    """
    streams = [np.unique(np.asarray(stamps_ns, np.int64)) for stamps_ns in (depth_ns, color_ns)]
    halves_ns = [half_step_ns(stream) for stream in streams]
    stray_ns = 0
    for stream, half_ns in zip(streams, halves_ns, strict=True):
        steps = np.diff(stream)
        single = steps[steps <= 2 * MISSING_STEPS * half_ns]
        stray_ns = max(stray_ns, int(single.max(initial=0)) - 2 * half_ns)
    return min(TOLERANCE_NS, min(halves_ns) + (stray_ns + 1) // 2)


def poses_at(given: GivenTrajectory, stamps_ns: Int64, max_gap_s: float) -> Float64:
    """Interpolate T_world_camera at each stamp, by slerp between the poses before and after it.

    Args:
        given: the trajectory.
        stamps_ns: (n,) int64, stamps of the frames, nanoseconds.
        max_gap_s: largest time between two poses to interpolate, seconds.

    Returns:
        (n, 4, 4) float64; NaN where the gap is larger, before the first pose and after the last. A pose at
            exactly the stamp is used as it is.
    """
    poses = np.full((len(stamps_ns), 4, 4), np.nan)
    known_ns = given.stamps_ns
    after = np.searchsorted(known_ns, stamps_ns)
    met = after < len(known_ns)
    met[met] = known_ns[after[met]] == stamps_ns[met]
    poses[met] = given.T_world_camera[after[met]]
    between = ~met & (after > 0) & (after < len(known_ns))
    right = after[between]
    gap_ns = known_ns[right] - known_ns[right - 1]
    fraction = (stamps_ns[between] - known_ns[right - 1]) / gap_ns
    bridged = gap_ns <= max_gap_s * 1e9
    between[between] = bridged
    right = right[bridged]
    poses[between] = interpolate_rigid(
        given.T_world_camera[right - 1], given.T_world_camera[right], fraction[bridged]
    )
    return poses
