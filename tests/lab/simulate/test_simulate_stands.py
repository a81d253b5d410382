"""Clothes horses and easels: closed surfaces, nothing thin, open between their bars, varied."""

import numpy as np
import pytest
from object_checks import check_solid, check_thickness, check_variety, drawn, is_solid

SEEDS = range(10)
BOUNDS = {
    "clothes_horse": ((0.5, 0.38, 0.7), (1.0, 1.5, 1.45), (2, 35)),
    "easel": ((0.5, 0.35, 0.8), (1.3, 0.9, 1.8), (5, 60)),
}


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    check_solid(drawn(family, seed), *BOUNDS[family], steady_m=0.02)
    check_thickness(drawn(family, seed), 0.012)


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_most_of_its_box_is_air(family: str, seed: int) -> None:
    subject = drawn(family, seed)
    low, high = subject.mesh.vertices.min(axis=0), subject.mesh.vertices.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (4000, 3))
    assert 0.001 < is_solid(subject, points).mean() < 0.15


def test_some_clothes_horses_carry_clothes_and_every_easel_a_board() -> None:
    cloths = [sum(p.name == "cloth" for p in drawn("clothes_horse", seed).pieces) for seed in SEEDS]
    assert min(cloths) == 0 and max(cloths) > 0
    for seed in SEEDS:
        subject = drawn("easel", seed)
        boards = [p.mesh.vertices for p in subject.pieces if p.name in ("board", "canvas")]
        # A sheet: much wider and higher than it is thick.
        assert all(np.prod(np.ptp(board, axis=0)[[0, 2]]) > 0.1 for board in boards) and boards


@pytest.mark.parametrize("family", BOUNDS)
def test_they_vary(family: str) -> None:
    check_variety(family, SEEDS, 1.2)
