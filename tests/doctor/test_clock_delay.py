"""Faults of clocks put in by hand, and delays of motions that are known."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from kinectbench.core.trajectory.stamps import StampFaults, find_doubled, find_stamp_faults, typical_period_ns
from kinectbench.doctor.clocks import check_partners
from kinectbench.doctor.delays import Motion, check_color_drift, estimate_delay_ns, image_motion
from kinectbench.doctor.probe import Probe, SmallFrame, frames_to_read

STEP_NS = 33_333_333
START_NS = 1_400_000_000_000_000_000


def stamps(count: int = 100) -> NDArray[np.int64]:
    jitter = np.random.default_rng(1).integers(-3_000_000, 3_000_000, count)
    return START_NS + np.arange(count) * STEP_NS + jitter


def test_a_good_clock() -> None:
    nothing = StampFaults(repeated=0, backwards=0, jumps=(), resets=())
    assert find_stamp_faults(stamps()) == nothing
    assert find_stamp_faults([]) == nothing
    assert abs(typical_period_ns(stamps()) - STEP_NS) < 1_000_000
    assert typical_period_ns(np.array([5])) == 0


@pytest.mark.parametrize("every", [2, 3])
def test_many_dropped_frames_do_not_make_the_step_longer(every: int) -> None:
    """Of three frames one is gone, or of four two: most steps are then not those of the clock."""
    index = np.arange(120)
    kept = index % 3 != 1 if every == 3 else (index % 4) // 2 == 0
    assert abs(typical_period_ns(stamps(120)[kept]) - STEP_NS) < 3_000_000


def test_repeats_steps_back_jumps_and_resets() -> None:
    found = stamps()
    found[10] = found[9]
    found[[20, 21]] = found[[21, 20]]
    found[50:] += 7_000_000_000
    found[80:] -= 10**17
    faults = find_stamp_faults(found)
    assert (faults.repeated, faults.backwards) == (1, 1)
    assert (faults.jumps, faults.resets) == ((50,), (80,))


def test_doubled_content() -> None:
    assert find_doubled([b"a", b"b", b"b", b"b", b"a", b"c"]) == (2, 3)
    assert find_doubled([]) == ()


def place_m(times_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """How a hand moves the camera sideways and up and down, (n, 2) metres."""
    t = (times_ns - START_NS) / 1e9
    x = 0.12 * np.sin(2.1 * t) + 0.04 * np.sin(5.3 * t + 1)
    return np.stack([x, 0.07 * np.sin(3.3 * t + 0.5) + 0.02 * np.sin(7.1 * t)], axis=1)


FOCAL_PX, WALL_M = 80.0, 1.5


def images(times_ns: NDArray[np.int64], seed: int) -> Iterator[NDArray[np.float32]]:
    """A wall of blotches, seen from a camera that moves alongside."""
    rng = np.random.default_rng(seed)
    wall = cv2.GaussianBlur(rng.random((200, 260)).astype(np.float32), (0, 0), 2.5) * 1000
    for x, y in place_m(times_ns) * FOCAL_PX / WALL_M:
        matrix = np.array([[1, 0, -80 - x], [0, 1, -70 - y]])
        yield cv2.warpAffine(wall, matrix, (80, 60), flags=cv2.INTER_LINEAR)


@pytest.mark.parametrize("delay_ms", [-200, -37, 0, 15, 120])
def test_the_delay_of_colour(delay_ms: int) -> None:
    depth_ns = stamps(150)
    color_ns = START_NS + 9_000_000 + np.arange(150) * 30_000_000
    depth = image_motion(depth_ns.tolist(), images(depth_ns, 1))
    color = image_motion((color_ns + delay_ms * 1_000_000).tolist(), images(color_ns, 2))
    found = estimate_delay_ns(depth, color)
    assert found is not None
    assert abs(found / 1e6 - delay_ms) < 6


def test_without_motion_in_common_nothing_is_offered() -> None:
    times = START_NS + np.arange(100) * STEP_NS
    still = Motion(times, np.zeros((100, 2)))
    rng = np.random.default_rng(3)
    noise = [Motion(times, rng.normal(size=(100, 2))) for _ in range(2)]
    assert estimate_delay_ns(still, noise[0]) is None
    assert estimate_delay_ns(*noise) is None
    few = Motion(times[:5], np.ones((5, 2)))
    assert estimate_delay_ns(few, noise[0]) is None


@dataclass
class Recorded:
    """What the checks of colour's clock ask of a recording."""

    stamps_ns: NDArray[np.int64]
    color_delay_s: float = 0.0
    path: str = "r"

    @property
    def recorded_stamps_ns(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        return self.stamps_ns, self.stamps_ns


@pytest.mark.parametrize(
    ("colours", "said"),
    [
        (9, []),
        (3, [("color_unpaired", "6 of the 9 frames looked at have no colour image")]),
        (0, [("no_color", "there is no colour")]),
    ],
)
def test_frames_without_colour_are_counted_where_colour_has_no_stamps(
    colours: int, said: list[tuple[str, str]]
) -> None:
    @dataclass
    class Unstamped(Recorded):
        @property
        def recorded_stamps_ns(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
            return self.stamps_ns, np.zeros(0, np.int64)

    depth, gray = np.ones((3, 4), np.float32), np.zeros((3, 4), np.uint8)
    frames = tuple(SmallFrame(i, i, depth, gray if i < colours else None, b"") for i in range(9))
    look = Probe(Unstamped(np.arange(9)), frames, (), (), (), 1)  # type: ignore[arg-type]
    found = [*check_partners(look)]
    assert [(each.name, each.what) for each in found] == said
    assert all(each.severity == "note" for each in found)


@pytest.mark.parametrize(
    ("first_ms", "last_ms", "count"),
    [
        *((*ends, 2024) for ends in ((0, 0), (80, 80), (0, 298), (-150, 150), (0, -200))),
        # Few enough to be read all, and more by so few that the runs meet.
        *((0, last, count) for last in (0, 200) for count in (190, 250, 251, 260, 271, 272)),
    ],
)
def test_clocks_that_drift_apart(first_ms: int, last_ms: int, count: int) -> None:
    """Redwood's colour, paired by number, is 298 ms late at the end of 2,024 frames."""
    stamps_ns = START_NS + np.arange(count) * STEP_NS
    late_ns = (np.linspace(first_ms, last_ms, count) * 1e6).astype(np.int64)
    indices = frames_to_read(count)
    depth = images(stamps_ns[indices], 1)
    gray = images((stamps_ns - late_ns)[indices], 2)
    frames = tuple(
        SmallFrame(int(i), int(stamps_ns[i]), d, (g / 4).astype(np.uint8), b"")
        for i, d, g in zip(indices, depth, gray, strict=True)
    )
    look = Probe(Recorded(stamps_ns), frames, (), (), (), 1)  # type: ignore[arg-type]
    found = list(check_color_drift(look))
    assert bool(found) == (first_ms != last_ms)
    if found:
        (said,) = re.findall(r"drift apart by (\d+) ms a minute", found[0].what)
        a_minute = abs(last_ms - first_ms) / (count * STEP_NS / 60e9)
        # Within a run of few frames so fast a clock moves by much.
        assert float(said) == pytest.approx(a_minute, rel=0.15 if count > 1000 else 0.25)
        assert ("late at the end" if last_ms > 0 else "early at the end") in found[0].what
