"""What the guide says: each sentence by made-up coverage, and how long it stays."""

from dataclasses import replace

import numpy as np
import pytest

from kinectbench.record.guide.sentences import (
    FRAMES_ENOUGH,
    HEIGHTS,
    SECTORS,
    STAYS_S,
    Advice,
    Ring,
    Situation,
    Speaker,
    advice,
)
from kinectbench.stages.segment.judge.frontiers import Frontier

CENTER = np.array([0.0, 0.0, 0.5])


def ring(unseen: tuple[int, ...] = ()) -> Ring:
    """All sectors seen from the middle height, but for some."""
    made = Ring()
    made.frames[:, 1] = FRAMES_ENOUGH
    made.frames[list(unseen)] = 0
    return made


def standing(towards_deg: float = 0.0, rise_deg: float = 20.0, distance_m: float = 1.5) -> np.ndarray:
    turn, rise = np.radians([towards_deg, rise_deg])
    way = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    return CENTER + distance_m * way


def frontier(look_from: tuple[float, float, float], direction: str = "side", **changes: object) -> Frontier:
    way = np.array(look_from) / np.linalg.norm(look_from)
    figures = (0.1, 0.9, 0.9)
    made = Frontier(direction, 0.04, (0.2, 0.2), tuple(CENTER), tuple(way), *figures)  # type: ignore[arg-type]
    return replace(made, **changes)  # type: ignore[arg-type]


ROUND = Situation(position=standing(), center=CENTER, fits_m=1.5, ring=ring())
BELOW = frontier((0.5, 0.5, -1.0), "down", underside=True)
# An opening at the floor that is best looked into from a little below the level.
DOOR = replace(frontier((0, -1, -0.02)), center_m=(0.0, 0.0, 0.1))
UP = frontier((0.0, 0.0, 1.0), "up")
HIGH_TOO = ring()
HIGH_TOO.frames[:, -1] = FRAMES_ENOUGH


@pytest.mark.parametrize(
    ("situation", "kind", "words"),
    [
        (replace(ROUND, lost=True), "lost", "picture"),
        (replace(ROUND, shift_per_s=0.7), "slower", "slower"),
        (replace(ROUND, turn_rad_per_s=1.0), "slower", "slower"),
        (Situation(), "begin", "point the camera"),
        (replace(ROUND, position=standing(distance_m=0.9)), "farther", "farther"),
        (replace(ROUND, position=standing(distance_m=0.5), fits_m=0.2), "farther", "farther"),
        (replace(ROUND, position=standing(distance_m=3.5)), "nearer", "nearer"),
        (replace(ROUND, ring=ring((3,))), "right", "go right: the right side is unseen"),
        (replace(ROUND, ring=ring((8,))), "left", "go left: the left side is unseen"),
        (replace(ROUND, ring=ring((5,))), "right", "the back is unseen"),
        (replace(ROUND, first_rad=np.pi, ring=ring((5,))), "right", "the front is unseen"),
        (replace(ROUND, frontiers=[UP]), "top", "look into the opening at the top"),
        (replace(ROUND, frontiers=[frontier((0, 1, 1), "up")]), "top", "look into the opening at the top"),
        (replace(ROUND, frontiers=[frontier((0, 1, 0.3), "up")]), "right", "an opening at the top is unseen"),
        (replace(ROUND, frontiers=[frontier((0, -1, 0.3))]), "left", "an opening at the left side"),
        (replace(ROUND, frontiers=[frontier((1, 0, 1.2))]), "higher", "higher"),
        (replace(ROUND, frontiers=[frontier((1, 0, -0.05))]), "lower", "lower"),
        (ROUND, "enough", "enough"),
        (replace(ROUND, frontiers=[DOOR]), "left", "an opening at the left side is unseen"),
        (replace(ROUND, frontiers=[replace(UP, obstructed=True)]), "enough", "enough"),
        (replace(ROUND, frontiers=[BELOW]), "lower", "what lies below is unseen"),
        (replace(ROUND, frontiers=[replace(BELOW, center_m=(0, 0, 0.1))]), "enough", "enough"),
        (replace(ROUND, unknown_share=0.01), "enough", "enough"),
        (replace(ROUND, unknown_share=0.5), "higher", "hold the camera higher, and go around once more"),
        (replace(ROUND, unknown_share=0.5, ring=HIGH_TOO), "lower", "and go around once more"),
    ],
)
def test_each_sentence(situation: Situation, kind: str, words: str) -> None:
    said = advice(situation)
    assert said.kind == kind and words in said.sentence


def test_what_was_looked_into_in_vain_is_not_asked_for_again() -> None:
    there = np.array([standing(0, 85), standing(120, 80)])
    at_all_heights = ring()
    at_all_heights.frames[:] = FRAMES_ENOUGH
    vain = replace(ROUND, frontiers=[UP], positions=there, ring=at_all_heights)
    assert advice(vain).kind == "enough"
    assert advice(replace(vain, ring=ring())).kind == "lower"
    low = replace(vain, ring=ring(), position=standing(5, 5))
    assert advice(low).sentence == "go right: the front is unseen from low"
    small = replace(vain, ring=ring(), center=np.array([0.0, 0.0, 0.05]), fits_m=0.8)
    small = replace(small, position=standing(distance_m=0.9) - CENTER)
    assert advice(small).sentence == "hold the camera higher, and go around once more"
    assert advice(replace(ROUND, frontiers=[UP], positions=there[:1])).kind == "top"


def test_nobody_is_sent_nearer_than_the_object_or_the_sensor_allows() -> None:
    """Wherever the camera stands, `nearer` is said only beyond both distances."""
    for fits_m in (0.1, 0.5, 1.5, 3.0):
        for distance_m in np.linspace(0.05, 8.0, 200):
            at = replace(ROUND, position=standing(distance_m=float(distance_m)), fits_m=fits_m)
            said = advice(at)
            if said.kind == "nearer":
                assert said.distance_m is not None and distance_m > said.distance_m
                assert said.distance_m > max(0.9 * fits_m, 0.6)
                arrived = replace(at, position=standing(distance_m=said.distance_m))
                assert advice(arrived).kind == "enough"


def test_a_ring_counts_directions() -> None:
    made = Ring()
    assert len(made.unseen_rad) == SECTORS and made.frames.shape == (SECTORS, len(HEIGHTS))
    for _ in range(FRAMES_ENOUGH):
        made.add(np.radians(-10), np.radians(50))
    assert made.frames[SECTORS - 1, 2] == FRAMES_ENOUGH and len(made.unseen_rad) == SECTORS - 1


def test_a_sentence_stays_for_five_seconds() -> None:
    """Heard at 30 Hz, with advice drawn at random, it changes at most once in five seconds."""
    rng, speaker = np.random.default_rng(1), Speaker()
    choices = [Advice("left", "go left"), Advice("right", "go right"), Advice("enough", "enough")]
    changes, last, heard = [], None, choices[0]
    for index in range(3000):
        if rng.random() < 0.02:
            heard = choices[rng.integers(3)]
        said = speaker.hear(heard, index / 30)
        if said != last:
            changes.append(index / 30)
            last = said
    assert len(changes) > 5 and (np.diff(changes) >= STAYS_S).all()


def test_a_lost_camera_is_said_at_once() -> None:
    """Lost from the second frame on, and found again: each is said once it has held for half a second."""
    speaker, begin, lost = Speaker(), advice(Situation()), advice(Situation(lost=True))
    heard = [begin] + [lost] * 30 + [begin] * 30
    said = [speaker.hear(each, index / 30).kind for index, each in enumerate(heard)]
    assert [said.index("lost"), said.index("begin", 20)] == pytest.approx([16, 46], abs=1)


def test_it_is_said_how_far_to_go_to_an_opening() -> None:
    """A quarter around, and a little on; up to where it is seen into; what is left is kept up to date."""
    opening = frontier((0, -1, 0.3))
    left = advice(replace(ROUND, frontiers=[opening]))
    assert left.turn_rad == pytest.approx(np.radians(100)) and left.rise_rad is None
    nearer = advice(replace(ROUND, frontiers=[opening], position=standing(-60)))
    assert nearer.turn_rad == pytest.approx(np.radians(40)) and nearer.sentence == left.sentence
    higher = advice(replace(ROUND, frontiers=[frontier((1, 0, 1.0))]))
    assert higher.rise_rad == pytest.approx(np.radians(25)) and higher.turn_rad is None
    assert advice(replace(ROUND, ring=ring((3,)))).turn_rad is None  # on, as far as there is something to see
    speaker = Speaker()
    assert speaker.hear(left, 0.0) == left and speaker.hear(nearer, 0.1) == nearer


def test_a_sentence_of_a_moment_is_not_said() -> None:
    speaker, left, slower = Speaker(), Advice("left", "go left"), Advice("slower", "slower")
    heard = [left] * 200 + [slower] * 10 + [left] * 20
    assert {speaker.hear(each, index / 30) for index, each in enumerate(heard)} == {left}
    assert [speaker.hear(slower, 10 + index / 30) for index in range(20)][-1] == slower
