"""Time stamps: exact conversion from seconds in text to nanoseconds, and faults of clocks.

Faults of a clock are repeated stamps, jumps, resets and steps back.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

import numpy as np
from numpy.typing import ArrayLike

from kinectbench.core.errors import RecordingError
from kinectbench.core.types import Int64
from kinectbench.core.untrusted import printable

NS_PER_S = 10**9
LIMIT_NS = 2**63
# Range of stamps that count from 1970: seconds from 2001 to 2096.
TODAY_NS = (10**9 * NS_PER_S, 4 * 10**9 * NS_PER_S)
# The likely unit of stamps since 1970 by their power of ten, and of others by the smallest step between
# frames.
UNITS_OF_TODAY = {12: "milliseconds", 15: "microseconds", 18: "nanoseconds"}
UNITS_OF_STEPS = {3e6: "nanoseconds", 3e3: "microseconds", 3.0: "milliseconds"}
# A pause longer than this is a jump of the clock, not a few dropped frames.
JUMP_PERIODS, JUMP_NS = 10, 1_000_000_000
# Stamps with a higher rate, or that decrease more often, are no times; fewer stamps are not judged. Chosen by
# hand.
FASTEST_HZ, BACK_SHARE, LEAST_STAMPS = 1000.0, 0.1, 10
# A step back by more than this is a reset of the clock.
RESET_NS = 1_000_000_000


def parse_stamp_ns(text: str, where: str) -> int:
    """Convert decimal seconds to nanoseconds without floats; digits beyond the ninth are rounded.

    Args:
        text: such as "1305031107.130308" or "1.305e9".
        where: file and line, for the message.

    Raises:
        RecordingError: not a finite number, or beyond 64-bit nanoseconds (292 years).
    """
    try:
        stamp = Decimal(text.replace("_", "?"))  # Python would take 1_0 for 10
    except InvalidOperation:
        stamp = Decimal("NaN")
    is_short = stamp.is_finite() and stamp.adjusted() <= 11
    stamp_ns = int((stamp * NS_PER_S).to_integral_value()) if is_short else LIMIT_NS
    if abs(stamp_ns) >= LIMIT_NS:
        unit = UNITS_OF_TODAY.get(stamp.adjusted() // 3 * 3) if stamp.is_finite() else None
        advice = f"it looks like {unit}: write seconds" if unit else "correct or remove the line"
        raise RecordingError(
            f"{where}: '{printable(text)}' is not a time stamp in seconds; {advice}", what="bad-stamp"
        )
    return stamp_ns


def check_unit(stamps_ns: Sequence[int], where: str) -> list[str]:
    """Check by their intervals that stamps, in the order of recording, were in seconds, as they should be.

    Returns:
        One warning if the stamps may be in milliseconds, or in seconds of a slow series; else none.

    Raises:
        RecordingError: the stamps are micro- or nanoseconds.
    """
    period_s = typical_period_ns(np.asarray(stamps_ns, np.int64)) / NS_PER_S
    unit = next((unit for least_s, unit in UNITS_OF_STEPS.items() if period_s >= least_s), None)
    if unit is None:
        return []
    if unit == "milliseconds":
        return [f"{where}: images are {period_s:g} s apart; if the stamps are {unit}, write seconds"]
    what = f"images are {period_s:g} s apart: the stamps look like {unit}"
    raise RecordingError(f"{where}: {what}; write seconds", what="bad-stamp")


def no_times(stamps_ns: Sequence[int]) -> str:
    """Return why stamps cannot be the times of frames (they may be time steps, for example); "" if they can.

    Args:
        stamps_ns: of images, in the order of recording, nanoseconds.
    """
    if len(stamps_ns) < LEAST_STAMPS:
        return ""
    steps = np.diff(np.asarray(stamps_ns, np.int64))
    back_share = float((steps < 0).mean())
    # The rows of a list may be in any order.
    if back_share >= BACK_SHARE and not are_of_today(stamps_ns):
        return f"they go back in {back_share:.0%} of their steps"
    period_ns = typical_period_ns(np.sort(np.asarray(stamps_ns, np.int64)))
    if 0 < period_ns < NS_PER_S / FASTEST_HZ:
        return f"they would be of {NS_PER_S / period_ns:.0f} frames a second"
    return ""


def are_of_today(stamps_ns: Sequence[int]) -> bool:
    """Whether all stamps are ns since 1970, of 2001 to 2096: they are times even if out of order."""
    return all(TODAY_NS[0] <= stamp_ns < TODAY_NS[1] for stamp_ns in stamps_ns)


def counted_ns(count: int) -> list[int]:
    """Make stamps, nanoseconds, for frames without times: frame i has the stamp i seconds."""
    return [index * NS_PER_S for index in range(count)]


def format_stamp(stamp_ns: int) -> str:
    """Write nanoseconds as decimal seconds with exactly nine decimals."""
    sign, magnitude = ("-", -stamp_ns) if stamp_ns < 0 else ("", stamp_ns)
    return f"{sign}{magnitude // NS_PER_S}.{magnitude % NS_PER_S:09d}"


def first_by_stamp(stamps_ns: Sequence[int], where: str, what: str) -> tuple[list[int], list[str]]:
    """Sort stamps and drop repeated stamps.

    Stamps are in nanoseconds, in any order. `what` they are of, such as "rows", is for the warning.

    Returns:
        Indices into `stamps_ns` with strictly increasing stamps (the first of equal stamps), and a warning if
        stamps were dropped.
    """
    _, first = np.unique(np.asarray(stamps_ns, dtype=np.int64), return_index=True)
    repeated = len(stamps_ns) - len(first)
    line = f"{where}: {repeated} {what} repeat an earlier stamp and were left out"
    return first.tolist(), [line] if repeated else []


@dataclass(frozen=True)
class StampFaults:
    """Faults in the stamps of a stream; frames are indexed in the order of recording.

    Attributes:
        repeated: number of frames with the stamp of the previous frame.
        backwards: number of frames up to a second earlier than the previous frame.
        jumps: indices of frames before which time jumps ahead by more than a few dropped frames.
        resets: indices of frames before which the clock goes back by more than a second.
    """

    repeated: int
    backwards: int
    jumps: tuple[int, ...]
    resets: tuple[int, ...]


def typical_period_ns(stamps_ns: Int64) -> int:
    """Return the typical interval between frames, ignoring gaps; 0: unknown.

    It is the median of the forward steps that are shorter than 1.5 times their lower quartile. Where every
    third frame is missing, the plain median would be two steps.
    """
    steps = np.diff(stamps_ns)
    forward = steps[steps > 0]
    if not len(forward):
        return 0
    single = forward[forward < 1.5 * np.quantile(forward, 0.25, method="lower")]
    return int(np.median(single))


def find_stamp_faults(stamps_ns: ArrayLike) -> StampFaults:
    """Find the faults of the stamps (n,) of one stream, nanoseconds, in the order of recording."""
    stamps = np.asarray(stamps_ns, np.int64)
    steps = np.diff(stamps)
    is_jump = (steps > JUMP_NS) & (steps > JUMP_PERIODS * typical_period_ns(stamps))
    is_reset = steps < -RESET_NS
    return StampFaults(
        repeated=int((steps == 0).sum()),
        backwards=int(((steps < 0) & ~is_reset).sum()),
        jumps=tuple((np.flatnonzero(is_jump) + 1).tolist()),
        resets=tuple((np.flatnonzero(is_reset) + 1).tolist()),
    )


def find_doubled(digests: Sequence[bytes]) -> tuple[int, ...]:
    """Find frames whose digest equals the previous frame's: the driver delivered an image twice."""
    return tuple(i for i in range(1, len(digests)) if digests[i] == digests[i - 1])
