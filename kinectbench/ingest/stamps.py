"""Time stamps: decimal seconds as text to integer nanoseconds, exactly."""

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation

import numpy as np

from kinectbench.errors import RecordingError

NS_PER_S = 10**9
LIMIT_NS = 2**63


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
        raise RecordingError(f"{where}: '{text}' is not a time stamp in seconds; correct or remove the line")
    return int((stamp * NS_PER_S).to_integral_value())


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
