"""How probable inside is, by each thing that the frames can say of a voxel."""

from dataclasses import replace

import numpy as np
import pytest
from evidence_by_hand import evidence_of

from kinectbench.stages.segment.probability import (
    AMONG_INSIDE_SHARE,
    AMONG_M,
    AMONG_SHARE,
    BELOW_INSIDE_SHARE,
    BESIDE_INSIDE_SHARE,
    CAVITY_INSIDE_SHARE,
    CRACK_INSIDE_SHARE,
    DOUBTFUL_INSIDE_SHARE,
    EMPTY_BESIDE_SHARE,
    EMPTY_UNDER_SHARE,
    ENCLOSING,
    HOLLOW_INSIDE_SHARE,
    INSIDE_SHARE,
    INTERIOR_SHARE,
    OPEN_BELOW,
    RIGHT_BELOW_INSIDE_SHARE,
    RIGHT_BELOW_M,
    RIGHT_BELOW_MAX_RAY_M,
    SIGNED_INSIDE_SHARE,
    SIGNED_VOXELS,
    UNDER_INSIDE_SHARE,
    measured_probability,
    unseen_probability,
)

ONE = (1, 1, 1)
VOXEL_M = 0.025


def of_one_voxel(**given: float) -> float:
    """The probability of one unseen voxel, which is enclosed on all sides if nothing else is said."""
    kinds = {"enclosed": np.float32, "ups": np.uint8, "levels": np.uint8, "downs": np.uint8}
    said = {"enclosed": 1.0, "unseen": True, **given}
    arrays = {name: np.full(ONE, value, kinds.get(name, bool)) for name, value in said.items()}
    probability = unseen_probability(evidence_of(ONE, **arrays), VOXEL_M)
    assert probability.dtype == np.float32 and probability.shape == ONE
    return float(probability[0, 0, 0])


def test_what_was_counted_is_a_probability_and_rises_with_enclosure() -> None:
    tables = (
        CRACK_INSIDE_SHARE,
        BESIDE_INSIDE_SHARE,
        BELOW_INSIDE_SHARE,
        CAVITY_INSIDE_SHARE,
        AMONG_INSIDE_SHARE,
    )
    for shares in (INSIDE_SHARE, SIGNED_INSIDE_SHARE, *tables):
        assert shares.min() >= 0 and shares.max() <= 1
    assert (np.diff(ENCLOSING) > 0).all() and (np.diff(INSIDE_SHARE) >= 0).all()
    assert (ENCLOSING[0], ENCLOSING[-1]) == (0, 1)
    # Of ten ways up and nine level ones each has its own; more of them open is never more likely inside.
    assert len(CAVITY_INSIDE_SHARE) == 10 and (np.diff(CAVITY_INSIDE_SHARE) <= 0).all()
    assert len(CRACK_INSIDE_SHARE) == 10 and (np.diff(CRACK_INSIDE_SHARE) <= 0).all()
    assert len(BELOW_INSIDE_SHARE) == 9 and (np.diff(BELOW_INSIDE_SHARE) <= 0).all()
    # What is open below, too, is air more often, and a cavity more often than what lies below a crack.
    assert len(BESIDE_INSIDE_SHARE) == 9 and (BELOW_INSIDE_SHARE <= BESIDE_INSIDE_SHARE).all()
    assert (CAVITY_INSIDE_SHARE < CRACK_INSIDE_SHARE).all()
    # What is called interior, and known, is more likely inside than not.
    assert np.interp(INTERIOR_SHARE, ENCLOSING, INSIDE_SHARE) > 0.5


def test_enclosed_voxels() -> None:
    line = ENCLOSING.reshape(-1, 1, 1)
    evidence = evidence_of(line.shape, enclosed=line, unseen=np.ones(line.shape, bool))
    np.testing.assert_allclose(unseen_probability(evidence, VOXEL_M).ravel(), INSIDE_SHARE, atol=1e-6)
    between = (ENCLOSING[3] + ENCLOSING[4]) / 2
    assert of_one_voxel(enclosed=between) == pytest.approx((INSIDE_SHARE[3] + INSIDE_SHARE[4]) / 2)


@pytest.mark.parametrize(
    ("rules", "share"),
    [
        (("under",), UNDER_INSIDE_SHARE),
        (("under", "empty"), EMPTY_UNDER_SHARE),
        (("empty",), EMPTY_BESIDE_SHARE),
        (("doubtful",), DOUBTFUL_INSIDE_SHARE),
        (("doubtful", "under"), min(DOUBTFUL_INSIDE_SHARE, UNDER_INSIDE_SHARE)),
        (("hollow",), HOLLOW_INSIDE_SHARE),
    ],
)
def test_what_a_rule_says_is_the_most(rules: tuple[str, ...], share: np.float32) -> None:
    said = dict.fromkeys(rules, True)
    assert of_one_voxel(**said) == pytest.approx(share)
    # Less where little encloses it; but for hollows, of which that was counted.
    little = 0.0 if rules != ("hollow",) else share
    assert of_one_voxel(enclosed=0.0, **said) == pytest.approx(little)


@pytest.mark.parametrize(
    ("rays", "share"),
    [
        *[({"ups": n, "cavity": True}, CAVITY_INSIDE_SHARE[n]) for n in (1, 4, 9)],
        *[({"ups": n}, CRACK_INSIDE_SHARE[n]) for n in (1, 4, 9)],
        ({"ups": 9, "levels": 8, "downs": 9}, CRACK_INSIDE_SHARE[9]),
        *[({"levels": n}, BESIDE_INSIDE_SHARE[n]) for n in (0, 1, 8)],
        ({"levels": 8, "downs": OPEN_BELOW - 1}, BESIDE_INSIDE_SHARE[8]),
        *[({"levels": n, "downs": OPEN_BELOW}, BELOW_INSIDE_SHARE[n]) for n in (0, 5, 8)],
    ],
)
def test_what_is_open(rays: dict[str, int], share: np.float32) -> None:
    assert of_one_voxel(open=True, **rays) == pytest.approx(share)
    # Not more than by its enclosure, except behind a surface, where that says nothing.
    assert of_one_voxel(open=True, enclosed=0.0, **rays) == 0
    assert of_one_voxel(open=True, enclosed=0.0, behind=True, **rays) == pytest.approx(share)
    # Rays do not matter where nothing is open.
    assert of_one_voxel(**rays) == pytest.approx(INSIDE_SHARE[-1])


def test_a_rule_holds_for_what_is_open_too() -> None:
    assert of_one_voxel(open=True, ups=1, under=True) == pytest.approx(UNDER_INSIDE_SHARE)
    # It was counted among what is not open.
    assert of_one_voxel(open=True, levels=1, doubtful=True) == pytest.approx(BESIDE_INSIDE_SHARE[1])


@pytest.mark.parametrize(
    ("rays", "goes_on"),
    [
        ({"levels": 3, "downs": 9}, True),
        ({"levels": 3, "downs": OPEN_BELOW - 1}, False),
        ({"levels": 3, "downs": 9, "ups": 1}, False),
        ({"levels": 3, "downs": 9, "cavity": 1}, False),
        ({"levels": 3, "downs": 9, "hung": 1}, False),
    ],
)
def test_a_board_goes_on_right_below_what_was_measured(rays: dict[str, int], goes_on: bool) -> None:
    """The uppermost of three voxels lies just behind a surface; 5 mm below that are the next one."""
    shape, open_below = (1, 1, 3), np.array([[[True, True, False]]])
    kinds = {name: bool if name in ("cavity", "hung") else np.uint8 for name in rays}
    said = {name: np.full(shape, value, kinds[name]) for name, value in rays.items()}
    evidence = evidence_of(shape, open=open_below, unseen=open_below, behind=~open_below, **said)
    below, right_below, _ = unseen_probability(evidence, RIGHT_BELOW_M)[0, 0]
    for ray_width_m, holds in ((0.99 * RIGHT_BELOW_MAX_RAY_M, goes_on), (RIGHT_BELOW_MAX_RAY_M, False)):
        seen = replace(evidence, ray_width_m=ray_width_m)
        lower, upper, _ = unseen_probability(seen, RIGHT_BELOW_M)[0, 0]
        assert lower == below and upper == (right_below if holds else below)
    assert (right_below == RIGHT_BELOW_INSIDE_SHARE[3]) == goes_on
    assert right_below > below if goes_on else right_below == below


def test_each_voxel_has_its_own() -> None:
    """Far from each other: closed, below a crack, in a cavity, and beside it."""
    shape, at = (70, 1, 1), [5, 25, 45, 65]
    ups, is_open, cavity = np.zeros(shape, np.uint8), *np.zeros((2, *shape), bool)
    ups[at, 0, 0], is_open[at, 0, 0], cavity[at, 0, 0] = [3, 3, 3, 0], [0, 1, 1, 1], [0, 0, 1, 0]
    enclosed = np.ones(shape, np.float32)
    evidence = evidence_of(shape, enclosed=enclosed, ups=ups, open=is_open, cavity=cavity, unseen=is_open)
    expected = [INSIDE_SHARE[-1], CRACK_INSIDE_SHARE[3], CAVITY_INSIDE_SHARE[3], BESIDE_INSIDE_SHARE[0]]
    np.testing.assert_allclose(unseen_probability(evidence, VOXEL_M)[at, 0, 0], expected, rtol=1e-6)


def in_a_body(
    sealed: np.ndarray, enclosed: float = 1.0, cavity: bool = False, voxel_m: float = VOXEL_M
) -> float:
    """Of the voxel in the middle; all are unseen, open to three ways up where they are not sealed."""
    is_open = ~sealed
    evidence = evidence_of(
        sealed.shape,
        unseen=np.ones(sealed.shape, bool),
        enclosed=np.where(is_open, np.float32(1), np.float32(enclosed)),
        open=is_open,
        ups=(3 * is_open).astype(np.uint8),
        cavity=is_open & cavity,
    )
    return float(unseen_probability(evidence, voxel_m)[tuple(n // 2 for n in sealed.shape)])


def test_a_streak_among_sealed_voxels_is_of_the_body() -> None:
    sealed = np.ones((21, 21, 21), bool)
    sealed[10, 10, 10:] = False
    assert in_a_body(sealed) == pytest.approx(AMONG_INSIDE_SHARE[-1])
    # Voxels that are not enclosed do not seal it, nor do those far away; and a cavity is one all the same.
    assert in_a_body(sealed, enclosed=0.5) == pytest.approx(CRACK_INSIDE_SHARE[3])
    assert in_a_body(sealed, cavity=True) == pytest.approx(CAVITY_INSIDE_SHARE[3])
    half = round((AMONG_M / VOXEL_M - 1) / 2)
    for reach, is_streak in ((half, False), (half - 1, True)):
        hole = np.ones((21, 21, 21), bool)
        hole[10 - reach : 11 + reach, 10 - reach : 11 + reach, 10 - reach : 11 + reach] = False
        assert (in_a_body(hole) > CRACK_INSIDE_SHARE[3]) == is_streak


def test_the_more_of_it_is_sealed_the_more_probable() -> None:
    """By its share in the cube of 17 voxels of 5 mm, which is 85 mm wide."""
    found, shares = [], []
    for share in (0.0, 0.1, 0.25, 0.3, 0.35, 0.5, 0.9):
        sealed = np.random.default_rng(0).random((21, 21, 21)) < share
        sealed[10, 10, 10] = False
        found.append(in_a_body(sealed, voxel_m=0.005))
        shares.append(sealed[2:19, 2:19, 2:19].mean())
    assert found == sorted(found) and found[0] == found[1] == pytest.approx(CRACK_INSIDE_SHARE[3])
    np.testing.assert_allclose(found[2:], np.interp(shares[2:], AMONG_SHARE, AMONG_INSIDE_SHARE), atol=1e-4)
    assert AMONG_INSIDE_SHARE[0] < found[2] < found[4] < found[-1] == pytest.approx(AMONG_INSIDE_SHARE[-1])


@pytest.mark.parametrize("voxel_m", [0.005, 0.02])
def test_near_a_measured_surface(voxel_m: float) -> None:
    found = measured_probability(SIGNED_VOXELS * np.float32(voxel_m), voxel_m)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, SIGNED_INSIDE_SHARE, atol=1e-4)
    assert measured_probability(np.zeros(1, np.float32), voxel_m)[0] == 0.5
    assert (np.diff(measured_probability(np.linspace(-1, 5, 61) * voxel_m, voxel_m)) <= 0).all()
