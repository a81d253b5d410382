"""Read the names of images: order of frames, frame numbers, and stamps in s, ms, us or ns.

A number in a name is a time only if it cannot be a frame number: it has decimals, counts from 1970, or has
steps of thousands, as micro- and nanoseconds have. Whole milliseconds from 0 look like frame numbers, and are
read as such.
"""

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise

import numpy as np

from kinectbench.core.trajectory.stamps import LIMIT_NS, NS_PER_S, TODAY_NS, no_times, typical_period_ns

# Longer numbers are no frame numbers.
FRAME_NUMBER = re.compile(r"\d{1,9}")
# Redwood and SUN3D: a frame number and a stamp in microseconds, different for depth and colour.
NUMBER_AND_STAMP = re.compile(r"(\d{1,9})-(\d{12})")
NUMBER = re.compile(r"\d+(?:\.\d+)?")
# A date, the time of day, and the fraction of a second. Digits without separators are no stamp in
# nanoseconds: that has 19 digits, and a date of 14 leaves 3, 6 or 9 for the fraction.
DATE = re.compile(
    r"(?<!\d)((?:19[7-9]|20\d)\d)(\D?)(\d\d)\2(\d\d)\D{0,2}(\d\d)(\D?)(\d\d)\6(\d\d)"
    r"(?:\D(\d{1,9})|(\d{3}|\d{6}|\d{9})|)(?!\d)"
)
# Names of several cameras or recordings: at most so many series of at least so many images (chosen by hand).
MOST_SERIES, LEAST_OF_SERIES = 8, 5
# Words before the number of a device, and the fewest digits of a serial number: those of RealSense and of
# Azure Kinect have 12, and seconds since 1970 have ten.
DEVICE = re.compile(
    r".*(?:cam(?:era)?|kinect|sensor|realsense|device|serial|(?<![a-z])(?:dev|rs|sn))[-_. ]*", re.IGNORECASE
)
SERIAL_DIGITS = 11
# How many numbers a name, and how many digits a stamp may have: nanoseconds with decimals have no more.
MOST_NUMBERS, MOST_DIGITS = 16, 30
# Units of time in nanoseconds: s, ms, us, ns.
UNITS_NS = (NS_PER_S, NS_PER_S // 10**3, NS_PER_S // 10**6, 1)
# Largest number of digits of a fraction of a second. A fraction is read as a count if its largest step is
# then this many times smaller than as decimals. If it is a count, reading it as decimals leaves a gap of two
# frames or more, from 10 Hz on, in the first tenth of each second.
PART_DIGITS, MORE_REGULAR = 9, 1.5
# Fractions closer to each other are counts of frames (333 Hz, as below).
LEAST_PART_STEP_NS = 3 * NS_PER_S // 10**3
# Plausible steps between frames: at most 2000 Hz, and keyframes up to 10 s apart.
LEAST_STEP_NS, MOST_STEP_NS = NS_PER_S // 2000, 10 * NS_PER_S
# From this step on, a number is in nanoseconds, microseconds or milliseconds: 3 ms are 333 Hz, and keyframes
# are less than 3 s apart.
STEPS_OF_UNITS = ((3e6, UNITS_NS[3]), (3e3, UNITS_NS[2]), (3.0, UNITS_NS[1]))


def counting_key(stem: str) -> list[tuple[int, str]]:
    """Return a sort key for names that compares the numbers in them by value: 2 before 10."""
    # Names in an index may have any length, and Python refuses numbers of 4300 digits.
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d{1,18})", stem)]


def frame_key(stem: str) -> str:
    """Return the key that pairs depth and colour: the frame number without leading zeros, else the name."""
    redwood = NUMBER_AND_STAMP.fullmatch(stem)
    if redwood:
        return str(int(redwood[1]))
    return str(int(stem)) if FRAME_NUMBER.fullmatch(stem) else stem


def frame_numbers(stems: Sequence[str]) -> list[int] | None:
    """Return the frame number in each name: the last number that differs between names.

    Return None if there is no such number, or if it does not rise from name to name. A number that restarts,
    such as in each second or scene, is not a frame number.

    Args:
        stems: names of one stream without suffix, such as depth_0001, depth_0002.
    """
    columns = _columns(stems)
    for place, column in reversed(list(enumerate(columns))):
        if all(FRAME_NUMBER.fullmatch(text) for text in column) and len(set(column)) > 1:
            numbers = [int(text) for text in column]
            return numbers if _rises(numbers, columns[:place]) else None
    return None


def times_of_names(stems: Sequence[str]) -> list[int] | None:
    """Return stamps in nanoseconds from the names of a stream; None if the names contain none.

    Names of four kinds contain stamps:
    - Redwood's NUMBER-MICROSECONDS;
    - a date with the time of day, optionally with a fraction of a second, such as 20240115_103045_160407;
    - seconds since 1970 and a fraction, such as 1305031102_160407000 (see `_with_parts`);
    - one number that rises from name to name; its size and steps suggest the unit. A number that restarts is
      only a part of a time.

    Args:
        stems: names of the images of one stream, without suffix.
    """
    redwood = [NUMBER_AND_STAMP.fullmatch(stem) for stem in stems]
    if stems and all(redwood):
        recorded_ns = [int(match[2]) * UNITS_NS[2] for match in redwood if match]
        return None if no_times(recorded_ns) else _if_times(recorded_ns)
    dated = [DATE.search(stem) for stem in stems]
    if stems and all(dated):
        stamps = _if_parts(_of_dates([match for match in dated if match]))
        if stamps:
            return stamps
    columns = _columns(stems)
    for whole, fraction in pairwise(columns):
        if all(len(text) == 10 and text.isdecimal() for text in whole) and _are_parts(fraction):
            return _if_parts(_with_parts([int(text) for text in whole], fraction))
    for place, column in reversed(list(enumerate(columns))):
        stamps = _of_one_number(column)
        if stamps and _rises(stamps, columns[:place]):
            return stamps
    return None


def several_series(stems: Sequence[str]) -> list[str]:
    """Return the first name of each series if names are of several, as cam0_0001 and cam1_0001; else [].

    Series differ in one word, in one number behind a word for devices, or in one serial number. Other numbers
    may be minutes, parts or rows, in which the last number restarts, as in 01_0001 and 02_0001. Each other
    series has at least half of its images in common with the first, by the rest of the name. Names that are
    times are one series.

    Args:
        stems: names of one stream without suffix, in numeric order.
    """
    rows = [re.split(r"(\d{1,18})", stem) for stem in stems]
    if len({len(row) for row in rows}) != 1 or times_of_names(stems) is not None:
        return []
    for place in range(len(rows[0])):
        series, firsts = dict[str, set[tuple[str, ...]]](), dict[str, str]()
        for stem, row in zip(stems, rows, strict=True):
            firsts.setdefault(row[place], stem)
            series.setdefault(row[place], set()).add((*row[:place], *row[place + 1 :]))
        first, *others = series.values()
        if not 1 < len(series) <= MOST_SERIES or min(map(len, series.values())) < LEAST_OF_SERIES:
            continue
        of_device = all(DEVICE.fullmatch(row[place - 1]) for row in rows)
        if place % 2 and not of_device and min(map(len, series)) < SERIAL_DIGITS:
            continue
        if all(2 * len(first & other) >= len(other) for other in others):
            return list(firsts.values())
    return []


def stamps_of_names(stems: Sequence[str]) -> list[int]:
    """Return stamps, ns, from times in names. Without times, frame numbers or positions count as seconds."""
    times_ns = times_of_names(stems)
    if times_ns is not None:
        return times_ns
    keys = [frame_key(stem) for stem in stems]
    numbered = all(FRAME_NUMBER.fullmatch(key) for key in keys) and len(set(keys)) == len(keys)
    return [(int(key) if numbered else index) * NS_PER_S for index, key in enumerate(keys)]


def _columns(stems: Sequence[str]) -> list[list[str]]:
    """Return the numbers in the names: a list for each of the places where names have a number.

    It is empty if the names differ in more than their numbers, or have no number or more than 16.
    """
    if not stems or len({NUMBER.sub("#", stem) for stem in stems}) > 1:
        return []
    rows = [NUMBER.findall(stem) for stem in stems]
    if not 0 < len(rows[0]) <= MOST_NUMBERS:
        return []
    return [list(column) for column in zip(*rows, strict=True)]


def _rises(values: Sequence[int], left: Sequence[Sequence[str]]) -> bool:
    """Whether a column's values rise strictly if names are sorted by the columns `left` of it, then by it."""
    names = zip(*([Decimal(text) for text in column] for column in left), values, strict=True)
    return all(first < second for (*_, first), (*_, second) in pairwise(sorted(names)))


def _are_parts(texts: Sequence[str]) -> bool:
    return all(text.isdecimal() and len(text) <= PART_DIGITS for text in texts)


def _of_dates(dated: Sequence[re.Match[str]]) -> list[int]:
    """Return stamps in nanoseconds from matches of DATE; empty if a date is invalid."""
    try:
        times = [
            datetime(int(m[1]), int(m[3]), int(m[4]), int(m[5]), int(m[7]), int(m[8]), tzinfo=UTC)
            for m in dated
        ]
    except ValueError:
        return []
    return _with_parts([int(time.timestamp()) for time in times], [m[9] or m[10] or "0" for m in dated])


def _with_parts(whole: Sequence[int], fractions: Sequence[str]) -> list[int]:
    """Return stamps in nanoseconds from whole seconds and fractions, either decimals or counts of a unit.

    A fraction of 5 is 0.5 s as decimals, and 5 ms, us or ns as a count. Fractions are decimals if all have
    the same length, or if one starts with a zero. Otherwise they are counts if they could not be times as
    decimals, or if one has nine digits and the seconds count from 1970 (no float has so many digits).
    Otherwise they are counts only if this makes the steps between stamps clearly more regular.

    Args:
        whole: whole seconds of each stamp.
        fractions: fraction of each stamp, up to 9 digits.
    """
    longest = max(map(len, fractions))
    unit_ns = 10 ** (PART_DIGITS - 3 * -(-longest // 3))
    pairs = list(zip(whole, fractions, strict=True))
    decimals = [s * NS_PER_S + int(text.ljust(PART_DIGITS, "0")) for s, text in pairs]
    counts = [s * NS_PER_S + int(text) * unit_ns for s, text in pairs]
    if len(set(map(len, fractions))) == 1 or any(len(text) > 1 and text[0] == "0" for text in fractions):
        return decimals
    today = min(whole) * NS_PER_S >= TODAY_NS[0]
    if (today and longest == PART_DIGITS) or not _if_times(decimals):
        return counts
    regular = MORE_REGULAR * _largest_step(counts) < _largest_step(decimals)
    return counts if regular and _if_times(counts) else decimals


def _largest_step(stamps_ns: Sequence[int]) -> int:
    return max((second - first for first, second in pairwise(sorted(stamps_ns))), default=0)


def _of_one_number(column: Sequence[str]) -> list[int] | None:
    """Return stamps in nanoseconds if the numbers of a column are times; else None."""
    if max(map(len, column)) > MOST_DIGITS:
        return None
    values, points = [Decimal(text) for text in column], [text.partition(".") for text in column]
    unit_ns = _unit_ns(values, decimals=any(point for _, point, _ in points))
    if unit_ns == NS_PER_S and all(len(rest) <= PART_DIGITS for *_, rest in points):
        return _if_times(
            _with_parts([int(whole) for whole, *_ in points], [rest or "0" for *_, rest in points])
        )
    return _if_times([int(value * unit_ns) for value in values]) if unit_ns else None


def _if_times(stamps_ns: list[int]) -> list[int] | None:
    """Return the stamps, in any order, if all differ and can be times of frames; else None."""
    usable = 0 < len(set(stamps_ns)) == len(stamps_ns) and max(stamps_ns) < LIMIT_NS
    return stamps_ns if usable and not no_times(sorted(stamps_ns)) else None


def _if_parts(stamps_ns: list[int]) -> list[int] | None:
    """Return the stamps if they can be times, at least `LEAST_PART_STEP_NS` apart typically; else None."""
    stamps = _if_times(stamps_ns)
    period_ns = typical_period_ns(np.array(sorted(stamps or []), np.int64))
    return stamps if not period_ns or period_ns >= LEAST_PART_STEP_NS else None


def _unit_ns(values: list[Decimal], *, decimals: bool) -> int | None:
    """Guess the unit, in nanoseconds, of numbers in file names from their size and typical step.

    Return None if they cannot be times. `decimals`: whether any number has a decimal point, so that all must
    be times.
    """
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
    """Return the typical step between the sorted numbers; 0 for a single number."""
    # In thousandths and relative to the first, because numbers of 19 digits overflow 64-bit integers.
    first = min(values)
    thousandths = np.array(sorted(int((value - first) * 1000) for value in values), object)
    if len(thousandths) < 2 or thousandths[-1] >= LIMIT_NS:
        return 0.0
    return typical_period_ns(thousandths.astype(np.int64)) / 1000
