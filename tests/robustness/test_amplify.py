"""Twice the input takes twice the time, and never the memory: of each reader's largest cheap input."""

import sys
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
from fuzz.amplify import ALWAYS_SECONDS, AMPLIFIERS, MOST_MB, MOST_SECONDS, MOST_TIMES, Cost, cost

from kinectbench.core.errors import KinectBenchError

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="processes are forked"),
    pytest.mark.xdist_group("fuzz"),
]


def cost_of(name: str, folder: Path, times: int) -> Cost:
    folder.mkdir()
    return cost(AMPLIFIERS[name].make(folder, times * AMPLIFIERS[name].units))


@pytest.mark.parametrize("name", AMPLIFIERS)
def test_costs_grow_with_the_input_and_no_faster(name: str, tmp_path: Path) -> None:
    (tmp_path / "first").mkdir()
    with suppress(KinectBenchError):
        AMPLIFIERS[name].make(tmp_path / "first", 2)()  # what is imported on the way costs once
    for attempt in "ab":  # what else the machine does is charged to one of them, what multiplies to both
        once, twice = (cost_of(name, tmp_path / f"{attempt}{times}", times) for times in (1, 2))
        if twice.seconds < MOST_TIMES * once.seconds + ALWAYS_SECONDS:
            break
    assert {once.end, twice.end} <= {"done", "refused"}, (once, twice)
    assert twice.seconds < MOST_TIMES * once.seconds + ALWAYS_SECONDS, (once, twice)
    assert twice.seconds < MOST_SECONDS, twice
    assert twice.megabytes < MOST_MB, twice


def test_what_multiplies_is_seen() -> None:
    def pairs(count: int) -> int:
        return sum(a == b for a in range(count) for b in range(count))

    once, twice = (cost(partial(pairs, count)) for count in (4000, 8000))
    assert twice.seconds > MOST_TIMES * once.seconds + ALWAYS_SECONDS
    assert cost(lambda: bytearray(600 << 20)).megabytes > MOST_MB
    assert cost(lambda: [][0]).end.startswith("IndexError")
