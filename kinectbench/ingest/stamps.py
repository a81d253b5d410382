"""Time stamps: decimal seconds as text to integer nanoseconds, exactly."""

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation

import numpy as np

from kinectbench.errors import RecordingError
from kinectbench.ingest.clock import usual_period_ns

NS_PER_S = 10**9
LIMIT_NS = 2**63
# What seconds since 1970 are in other units, by the exponent of ten; and steps of cameras, by the least.
UNITS_OF_TODAY = {12: "milliseconds", 15: "microseconds", 18: "nanoseconds"}
UNITS_OF_STEPS = {3e6: "nanoseconds", 3e3: "microseconds", 3.0: "milliseconds"}


def parse_stamp_ns(text: str, where: str) -> int:
    """Turn decimal seconds into nanoseconds without floats; digits beyond the ninth are rounded.

    Args:
        text: such as "1305031107.130308" or "1.305e9".
        where: file and line, for the message.

    Raises:
        RecordingError: not a finite number, or beyond 64-bit nanoseconds (292 years).
    """
    try:
        stamp = Decimal(text)
    except InvalidOperation:
        stamp = Decimal("NaN")
    if not stamp.is_finite() or stamp.adjusted() > 11 or abs(stamp) * NS_PER_S >= LIMIT_NS:
        unit = UNITS_OF_TODAY.get(stamp.adjusted() // 3 * 3) if stamp.is_finite() else None
        advice = f"it looks like {unit}: write seconds" if unit else "correct or remove the line"
        raise RecordingError(f"{where}: '{text}' is not a time stamp in seconds; {advice}")
    return int((stamp * NS_PER_S).to_integral_value())


def check_unit(stamps_ns: Sequence[int], where: str) -> list[str]:
    """Whether stamps of images were written in seconds, as they must be, by the steps between them.

    Args:
        stamps_ns: in the order of recording, as they were read.
        where: file, for the message.

    Returns:
        A warning where frames are so far apart that they may be milliseconds, as those of a slow series, too.

    Raises:
        RecordingError: so far apart that they are micro- or nanoseconds.
    """
    period_s = usual_period_ns(np.asarray(stamps_ns, np.int64)) / NS_PER_S
    unit = next((unit for least_s, unit in UNITS_OF_STEPS.items() if period_s >= least_s), None)
    if unit is None:
        return []
    if unit == "milliseconds":
        return [f"{where}: images are {period_s:g} s apart; if the stamps are {unit}, write seconds"]
    what = f"images are {period_s:g} s apart: the stamps look like {unit}"
    raise RecordingError(f"{where}: {what}; write seconds")


def format_stamp(stamp_ns: int) -> str:
    """Write nanoseconds as decimal seconds with exactly nine decimals."""
    sign, magnitude = ("-", -stamp_ns) if stamp_ns < 0 else ("", stamp_ns)
    return f"{sign}{magnitude // NS_PER_S}.{magnitude % NS_PER_S:09d}"


def first_by_stamp(stamps_ns: Sequence[int]) -> tuple[list[int], int]:
    """Order by stamp, each stamp once.

    Returns:
        Indices into `stamps_ns` with strictly increasing stamps (of equal ones the first given), and
        how many were left out.
    """
    _, first = np.unique(np.asarray(stamps_ns, dtype=np.int64), return_index=True)
    return first.tolist(), len(stamps_ns) - len(first)
