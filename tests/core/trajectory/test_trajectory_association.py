import itertools

from hypothesis import given
from hypothesis import strategies as st

from kinectbench.core.trajectory.association import TOLERANCE_NS, associate

MS = 1_000_000
stamps = st.lists(st.integers(0, 400), max_size=40, unique=True).map(lambda ms: sorted(m * MS for m in ms))
few = st.lists(st.integers(0, 100), max_size=5, unique=True).map(lambda ms: sorted(m * MS for m in ms))


def score(depth: list[int], color: list[int], partners: list[int | None]) -> tuple[int, int]:
    gaps = [abs(depth[i] - color[j]) for i, j in enumerate(partners) if j is not None]
    return len(gaps), -sum(gaps)


def best_score(depth: list[int], color: list[int]) -> tuple[int, int]:
    """By trying every assignment."""
    slots = [*range(len(color)), *[None] * len(depth)]
    allowed = (
        choice
        for choice in set(itertools.permutations(slots, len(depth)))
        if all(j is None or abs(depth[i] - color[j]) <= TOLERANCE_NS for i, j in enumerate(choice))
    )
    return max(score(depth, color, list(choice)) for choice in allowed)


@given(stamps, stamps)
def test_pairs_are_close_one_to_one_and_in_order(depth: list[int], color: list[int]) -> None:
    partners = associate(depth, color)
    assert len(partners) == len(depth)
    used = [j for j in partners if j is not None]
    assert used == sorted(set(used))
    assert all(abs(depth[i] - color[j]) <= TOLERANCE_NS for i, j in enumerate(partners) if j is not None)


@given(st.lists(st.integers(0, 100), max_size=3, unique=True).map(lambda ms: sorted(m * MS for m in ms)), few)
def test_no_assignment_is_better(depth: list[int], color: list[int]) -> None:
    assert score(depth, color, associate(depth, color)) == best_score(depth, color)


@given(stamps)
def test_equal_stamps_pair_with_themselves(stamps_ns: list[int]) -> None:
    assert associate(stamps_ns, stamps_ns) == list(range(len(stamps_ns)))


def test_greedy_would_use_one_colour_frame_twice() -> None:
    # The colour frame at 15 ms is the nearest of both depth frames.
    assert associate([0, 20 * MS], [15 * MS, 38 * MS]) == [0, 1]


def test_no_colour_within_the_tolerance() -> None:
    assert associate([0, 100 * MS], [21 * MS]) == [None, None]
    assert associate([0], [20 * MS]) == [0]
    assert associate([0, 5], []) == [None, None]


def test_a_long_recording_takes_no_time() -> None:
    depth = [i * 33_333_333 for i in range(20_000)]
    assert associate(depth, [t + 16_000_000 for t in depth]) == list(range(20_000))
