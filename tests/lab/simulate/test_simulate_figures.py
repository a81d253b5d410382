"""Shoes that a foot fits into and toy animals."""

import numpy as np
import pytest
from object_checks import check_solid, check_thickness, check_variety, checked, drawn, is_solid, reach_m
from slow import first

SEEDS = range(6)
BOUNDS = {
    "shoe": ((0.09, 0.245, 0.08), (0.15, 0.32, 0.30), (0.7, 3.5)),
    "toy_animal": ((0.08, 0.19, 0.12), (0.30, 0.40, 0.40), (0.6, 12.0)),
}
THICK_M = {"shoe": 0.008, "toy_animal": 0.012}


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", first(3, SEEDS))
def test_it_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    check_solid(drawn(family, seed), *BOUNDS[family])
    check_thickness(drawn(family, seed), THICK_M[family])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_foot_fits_into_a_shoe(seed: int) -> None:
    subject = drawn("shoe", seed)
    low, high = checked(subject).bounds
    # The heel's place lies under the opening, a good quarter of the length before the back.
    y = low[1] + 0.27 * (high - low)[1]
    down = reach_m(subject, (0.0, y, high[2] + 0.1), (0, 0, -1))
    floor = high[2] + 0.1 - down
    assert 0.01 < floor < 0.08
    assert high[2] - floor > 0.04
    inside = np.array([0.0, y, floor + 0.02])
    assert not is_solid(subject, inside)[0]
    assert np.isinf(reach_m(subject, inside, (0, 0, 1)))
    # The cavity goes on to the toes, under the upper: 60 % of the length from the back to its end.
    toes = reach_m(subject, inside, (0, 1, -0.1))
    assert 0.4 < toes / (high - low)[1] < 0.75
    ahead = inside + 0.8 * toes * np.array([0, 1, -0.1]) / np.hypot(1, 0.1)
    assert np.isfinite(reach_m(subject, ahead, (0, 0, 1)))
    assert checked(subject).euler_number == 2


@pytest.mark.parametrize("seed", SEEDS)
def test_a_toy_animal_stands_on_four_feet(seed: int) -> None:
    subject = drawn("toy_animal", seed)
    vertices = subject.mesh.vertices[subject.mesh.vertices[:, 2] < 0.002]
    feet = {(x > 0, y > np.mean(vertices[:, 1])) for x, y, _ in vertices}
    assert len(feet) == 4
    # Between its legs there is air: seen from the side and from the front.
    y = (vertices[:, 1].min() + vertices[:, 1].max()) / 2
    assert np.isinf(reach_m(subject, (-1.0, y, 0.01), (1, 0, 0)))
    assert np.isinf(reach_m(subject, (0.0, 1.0, 0.01), (0, -1, 0)))
    assert not np.isinf(reach_m(subject, (0.0, y, -0.5), (0, 0, 1)))


@pytest.mark.parametrize("family", BOUNDS)
def test_they_vary(family: str) -> None:
    check_variety(family, SEEDS, 1.2)
