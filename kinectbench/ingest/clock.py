"""Whether a clock ran as it should: dropped and repeated frames, jumps, resets, time going back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

# A longer pause is not a few dropped frames.
JUMP_PERIODS, JUMP_NS = 10, 1_000_000_000
# A step back by more than this begins another clock.
RESET_NS = 1_000_000_000


@dataclass(frozen=True)
class StampFaults:
    """What is wrong with the stamps of a stream, in the order in which it was recorded.

    Attributes:
        period_ns: the usual step between frames, as `usual_period_ns` has it.
        dropped: frames that are missing in gaps between two frames.
        repeated: frames with the stamp of the one before.
        backwards: frames that are a little earlier than the one before.
        jumps: frames before which the time jumped ahead, longer than a few dropped frames explain.
        resets: frames before which the clock began anew, more than a second back.
    """

    period_ns: int
    dropped: int
    repeated: int
    backwards: int
    jumps: tuple[int, ...]
    resets: tuple[int, ...]

    @property
    def any(self) -> bool:
        """Whether anything is wrong."""
        return bool(self.dropped or self.repeated or self.backwards or self.jumps or self.resets)


def usual_period_ns(stamps_ns: NDArray[np.int64]) -> int:
    """The step between frames where none is missing; 0: unknown.

    The median of the steps forward that are shorter than one and a half of their lower quartile: where every
    third frame is gone, the median of all is that of two steps (own rule).
    """
    steps = np.diff(stamps_ns)
    forward = steps[steps > 0]
    if not len(forward):
        return 0
    single = forward[forward < 1.5 * np.quantile(forward, 0.25, method="lower")]
    return int(np.median(single))


def find_stamp_faults(stamps_ns: ArrayLike) -> StampFaults:
    """Look over the stamps of one stream (own rule).

    Args:
        stamps_ns: (n,) nanoseconds, in the order of recording.
    """
    stamps = np.asarray(stamps_ns, np.int64)
    steps, period_ns = np.diff(stamps), usual_period_ns(stamps)
    is_jump = (steps > JUMP_NS) & (steps > JUMP_PERIODS * period_ns)
    gaps = steps[(steps > 0) & ~is_jump]
    missing = np.rint(gaps / period_ns).astype(np.int64) - 1 if period_ns else np.zeros(0, np.int64)
    is_reset = steps < -RESET_NS
    return StampFaults(
        period_ns=period_ns,
        dropped=int(np.maximum(missing, 0).sum()),
        repeated=int((steps == 0).sum()),
        backwards=int(((steps < 0) & ~is_reset).sum()),
        jumps=tuple((np.flatnonzero(is_jump) + 1).tolist()),
        resets=tuple((np.flatnonzero(is_reset) + 1).tolist()),
    )


def find_doubled(digests: Sequence[bytes]) -> tuple[int, ...]:
    """The frames whose content, by a digest, is that of the frame before: the driver delivered it twice."""
    return tuple(i for i in range(1, len(digests)) if digests[i] == digests[i - 1])
