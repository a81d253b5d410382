"""Names that hold a time in several numbers: frames stay in the order in which they were recorded."""

from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
import pytest

from kinectbench.core.types import Int64
from kinectbench.stages.ingest.image_names import counting_key, frame_numbers, stamps_of_names, times_of_names

NS = 10**9
START_NS = 1_705_314_645_912_345_678  # 2024-01-15 10:30:45.912


def date(pattern: str, ns: int) -> str:
    return datetime.fromtimestamp(ns // NS, UTC).strftime(pattern)


# By how many nanoseconds each form rounds.
FORMS: dict[str, tuple[int, Callable[[int, int], str]]] = {
    "seconds_count of ns": (1, lambda i, ns: f"{ns // NS}_{ns % NS}"),
    "seconds.count of ns": (1, lambda i, ns: f"{ns // NS}.{ns % NS}"),
    "seconds-count of us": (1000, lambda i, ns: f"{ns // NS}-{ns % NS // 1000}"),
    "seconds_count of ms": (10**6, lambda i, ns: f"{ns // NS}_{ns % NS // 10**6}"),
    "seconds_padded": (1, lambda i, ns: f"{ns // NS}_{ns % NS:09d}"),
    "decimals as Python writes them": (1000, lambda i, ns: repr(ns // 1000 / 10**6)),
    "decimals after _": (1000, lambda i, ns: repr(ns // 1000 / 10**6).replace(".", "_")),
    "count, seconds, count of ns": (1, lambda i, ns: f"{i}_{ns // NS}_{ns % NS}"),
    "date and microseconds": (1000, lambda i, ns: date("%Y%m%d_%H%M%S_", ns) + f"{ns % NS // 1000:06d}"),
    "date and a count of us": (1000, lambda i, ns: date("%Y%m%d_%H%M%S_", ns) + f"{ns % NS // 1000}"),
    "date and ms": (10**6, lambda i, ns: date("%Y-%m-%d-%H-%M-%S.", ns) + f"{ns % NS // 10**6:03d}"),
    "date without a gap": (1000, lambda i, ns: date("%Y%m%d%H%M%S", ns) + f"{ns % NS // 1000:06d}"),
    "word, date, number": (1000, lambda i, ns: date("k2_%Y%m%dT%H%M%S_", ns) + f"{ns % NS // 1000:06d}_{i}"),
}  # fmt: skip
# What holds no whole time: the order is that of counting, and none of their numbers is a time.
ORDERED: dict[str, Callable[[int, int], str]] = {
    "time of day": lambda i, ns: date("%H%M%S_", ns) + f"{ns % NS // 1000:06d}",
    "minute, second, ms": lambda i, ns: date("%M_%S_", ns) + f"{ns % NS // 10**6:03d}",
    "seconds from 0, count of ns": lambda i, ns: f"{(ns - START_NS) // NS}_{(ns - START_NS) % NS}",
    "a number that begins anew": lambda i, ns: f"scene{i // 12}_{ns % NS}",
}


def times(rate_hz: float, count: int = 150) -> Int64:
    jitter = np.random.default_rng(3).integers(-2_000_000, 2_000_000, count)
    return START_NS + (np.arange(count) * NS / rate_hz).astype(np.int64) + jitter


def in_order(stems: list[str]) -> list[int]:
    """As a folder's images are listed: the indices of names by counting, then by their stamps."""
    listed = sorted(range(len(stems)), key=lambda i: counting_key(stems[i]))
    stamps_ns = stamps_of_names([stems[i] for i in listed])
    return [listed[k] for k in sorted(range(len(listed)), key=stamps_ns.__getitem__)]


@pytest.mark.parametrize("rate_hz", [5, 10, 13.4, 20, 25, 30, 60])
@pytest.mark.parametrize("form", FORMS)
def test_a_time_of_several_numbers_is_read_whole(form: str, rate_hz: float) -> None:
    rounded_ns, name = FORMS[form]
    for count in (12, 40, 150):
        stamps_ns = times(rate_hz, count).tolist()
        stems = [name(i, ns) for i, ns in enumerate(stamps_ns)]
        assert in_order(stems) == list(range(count))
        found = times_of_names(stems)
        assert found is not None
        late_ns = np.array(found) - stamps_ns
        assert np.ptp(late_ns) <= 2 * rounded_ns


@pytest.mark.parametrize("rate_hz", [10, 13.4, 20, 25, 30])
@pytest.mark.parametrize("form", ORDERED)
def test_a_number_that_begins_anew_is_no_time(form: str, rate_hz: float) -> None:
    stamps_ns = times(rate_hz).tolist()
    stems = [ORDERED[form](i, ns) for i, ns in enumerate(stamps_ns)]
    assert times_of_names(stems) is None and frame_numbers(stems) is None
    if "anew" not in form:
        assert in_order(stems) == list(range(150))


@pytest.mark.parametrize(
    "stems",
    [
        [f"20240115_103045_{i:04d}" for i in range(40)],  # when the recording began, and a count
        [f"20240115_{103045 + i // 30}_{i}" for i in range(40)],
        [f"1705314645_{i}" for i in range(40)],
        [f"20241399_103045_{i}" for i in range(40)],
        [f"9999999999_{i}" for i in range(40)],  # beyond 64 bits of nanoseconds
    ],
)
def test_a_count_beside_a_time_is_no_part_of_a_second(stems: list[str]) -> None:
    assert times_of_names(stems) is None
    assert in_order(stems) == list(range(40))


def test_keyframes_of_few_decimals_are_decimals() -> None:
    assert times_of_names(["0.25", "3.5", "4.125"]) == [NS // 4, 7 * NS // 2, 33 * NS // 8]
