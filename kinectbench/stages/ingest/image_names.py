"""What names of images say: the order of frames, their numbers, and stamps in seconds, ms, us or ns.

A number in a name is a time only where it can be no frame number: it has decimals, counts from 1970, or
goes in steps of thousands, as micro- and nanoseconds do. Whole milliseconds from 0 look like frame numbers,
and are taken for these.
"""

import re
from collections.abc import Sequence
from decimal import Decimal
from itertools import pairwise

import numpy as np

from kinectbench.core.trajectory.stamps import LIMIT_NS, NS_PER_S, no_times, usual_period_ns

# Longer numbers are no frame numbers.
FRAME_NUMBER = re.compile(r"\d{1,9}")
# Redwood's scans and SUN3D: frame number and stamp in microseconds, which differs between depth and colour.
NUMBER_AND_STAMP = re.compile(r"(\d{1,9})-(\d{12})")
NUMBER = re.compile(r"\d+(?:\.\d+)?")
# Names hold few numbers, and a stamp no more digits than nanoseconds with decimals have (own choices).
MOST_NUMBERS, MOST_DIGITS = 16, 30
# Units of time in nanoseconds, by how many there are in a second; a fraction of seconds by its digits.
UNITS_NS = (NS_PER_S, NS_PER_S // 10**3, NS_PER_S // 10**6, 1)
FRACTIONS_NS = {3: NS_PER_S // 10**3, 6: NS_PER_S // 10**6, 9: 1}
# Stamps of today: seconds from 2001 to 2096.
TODAY_NS = (10**9 * NS_PER_S, 4 * 10**9 * NS_PER_S)
# Steps between frames, if the unit is right (own choices): at most 2000 Hz, keyframes of up to 10 s.
LEAST_STEP_NS, MOST_STEP_NS = NS_PER_S // 2000, 10 * NS_PER_S
# From so many units a step on a number is of milliseconds, micro- and nanoseconds: 3 ms are 333 Hz, and
# keyframes are less than 3 s apart (own choice).
STEPS_OF_UNITS = ((3e6, UNITS_NS[3]), (3e3, UNITS_NS[2]), (3.0, UNITS_NS[1]))


def counting_key(stem: str) -> list[tuple[int, str]]:
    """What sorts names in the order people count: 2 before 10."""
    # A name may stand in an index, where it can have any length; Python refuses numbers of 4300 digits.
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d{1,18})", stem)]


def frame_key(stem: str) -> str:
    """What must agree for depth and colour to be one frame: the name, without leading zeros of a number."""
    redwood = NUMBER_AND_STAMP.fullmatch(stem)
    if redwood:
        return str(int(redwood[1]))
    return str(int(stem)) if FRAME_NUMBER.fullmatch(stem) else stem


def frame_numbers(stems: Sequence[str]) -> list[int] | None:
    """The number of each name: the last that is not the same in all; None if there is none, or one is twice.

    Args:
        stems: of one stream, such as depth_0001, depth_0002.
    """
    for column in reversed(_columns(stems)):
        if all(FRAME_NUMBER.fullmatch(text) for text in column) and len(set(column)) > 1:
            numbers = [int(text) for text in column]
            return numbers if len(set(numbers)) == len(numbers) else None
    return None


def times_of_names(stems: Sequence[str]) -> list[int] | None:
    """Stamps in nanoseconds, where the names of a stream hold such; None where they hold none.

    Read are Redwood's NUMBER-MICROSECONDS; seconds and their fraction as two numbers, such as
    1305031102_160407000; and one number, with or without others beside it, in the unit that its size and its
    steps tell.

    Args:
        stems: names of the images of one stream, without what they end in.
    """
    redwood = [NUMBER_AND_STAMP.fullmatch(stem) for stem in stems]
    if stems and all(redwood):
        return _if_times([int(match[2]) * UNITS_NS[2] for match in redwood if match])
    columns = _columns(stems)
    for whole, rest in pairwise(columns):
        unit_ns = FRACTIONS_NS.get(len(rest[0]))
        padded = unit_ns and all(text.isdecimal() and len(text) == len(rest[0]) for text in rest)
        if unit_ns and padded and all(len(text) == 10 and text.isdecimal() for text in whole):
            return _if_times([int(s) * NS_PER_S + int(f) * unit_ns for s, f in zip(whole, rest, strict=True)])
    for column in reversed(columns):
        if max(map(len, column)) <= MOST_DIGITS and len(set(column)) == len(column):
            values = [Decimal(text) for text in column]
            unit_ns = _unit_ns(values, decimals=any("." in text for text in column))
            found = unit_ns and _if_times([int(value * unit_ns) for value in values])
            if found:
                return found
    return None


def stamps_of_names(stems: Sequence[str]) -> list[int]:
    """Stamps in nanoseconds by names; where these hold none a number counts seconds, or the order does."""
    times_ns = times_of_names(stems)
    if times_ns is not None:
        return times_ns
    keys = [frame_key(stem) for stem in stems]
    numbered = all(FRAME_NUMBER.fullmatch(key) for key in keys) and len(set(keys)) == len(keys)
    return [(int(key) if numbered else index) * NS_PER_S for index, key in enumerate(keys)]


def _columns(stems: Sequence[str]) -> list[list[str]]:
    """The numbers in names, column by column; none where names are built differently."""
    if not stems or len({NUMBER.sub("#", stem) for stem in stems}) > 1:
        return []
    rows = [NUMBER.findall(stem) for stem in stems]
    if not 0 < len(rows[0]) <= MOST_NUMBERS:
        return []
    return [list(column) for column in zip(*rows, strict=True)]


def _if_times(stamps_ns: list[int]) -> list[int] | None:
    """Stamps, if all differ, and they are times of frames."""
    usable = len(set(stamps_ns)) == len(stamps_ns) and max(stamps_ns) < LIMIT_NS
    return stamps_ns if usable and not no_times(stamps_ns) else None


def _unit_ns(values: list[Decimal], *, decimals: bool) -> int | None:
    """The unit of numbers if they are times, nanoseconds; else None."""
    step = _step(values)
    for unit_ns in UNITS_NS:
        today = min(values) * unit_ns >= TODAY_NS[0] and max(values) * unit_ns < TODAY_NS[1]
        if today and (decimals or not step or LEAST_STEP_NS <= step * unit_ns <= MOST_STEP_NS):
            return unit_ns
    for least, unit_ns in STEPS_OF_UNITS:
        if step >= least and (decimals or unit_ns < UNITS_NS[1]):
            return unit_ns if step * unit_ns <= MOST_STEP_NS else None
    return NS_PER_S if decimals else None


def _step(values: list[Decimal]) -> float:
    """The usual step from one number to the next larger one; 0 if there is one number only."""
    # In thousandths, and from the first: numbers of 19 digits are more than integers of 64 bits can hold.
    first = min(values)
    thousandths = np.array(sorted(int((value - first) * 1000) for value in values), object)
    if len(thousandths) < 2 or thousandths[-1] >= LIMIT_NS:
        return 0.0
    return usual_period_ns(thousandths.astype(np.int64)) / 1000
