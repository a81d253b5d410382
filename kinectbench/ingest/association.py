"""Pairing depth with colour by time: as many pairs as possible, then the closest ones, none used twice."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import NamedTuple, Optional

TOLERANCE_NS = 20_000_000


class _Matching(NamedTuple):
    """The best pairs so far, as a linked list; compared by (pairs, -total gap)."""

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

    Of all ways to pair stamps that differ by `tolerance_ns` at most, the one with the most pairs, and of
    those the one with the least sum of differences. On a line such pairs never need to cross, so dynamic
    programming over the sorted stamps finds it (own rule; TUM RGB-D's tolerance of 0.02 s).

    Args:
        depth_ns: increasing stamps of depth.
        color_ns: increasing stamps of colour, same clock.
        tolerance_ns: largest difference of a pair.

    Returns:
        For each depth frame the index of its colour frame, or None.
    """
    # best[j]: the best matching of the depth frames so far with the colours before j; known up to `reach`.
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
