"""Toy cars and helmets: closed surfaces, nothing thin, wheels on the floor, room for a head, varied."""

import numpy as np
import pytest
from object_checks import check_solid, check_thickness, check_variety, drawn, is_solid, reach_m

SEEDS = range(12)
BOUNDS = {
    "toy_car": ((0.1, 0.22, 0.07), (0.3, 0.52, 0.28), (1.0, 18)),
    "helmet": ((0.17, 0.23, 0.12), (0.3, 0.42, 0.3), (0.8, 7)),
}
THICK_M = {"toy_car": 0.0119, "helmet": 0.0079}


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    check_solid(drawn(family, seed), *BOUNDS[family], steady_m=0.02)
    check_thickness(drawn(family, seed), THICK_M[family])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_toy_car_stands_on_its_wheels_alone(seed: int) -> None:
    pieces = drawn("toy_car", seed).pieces
    wheels = [piece for piece in pieces if piece.name == "wheel"]
    assert len(wheels) in (4, 6)
    assert all(wheel.mesh.vertices[:, 2].min() < 1e-6 for wheel in wheels)
    assert all(piece.mesh.vertices[:, 2].min() > 0.004 for piece in pieces if piece.name != "wheel")


@pytest.mark.parametrize("seed", SEEDS)
def test_a_head_fits_into_a_helmet_from_below(seed: int) -> None:
    subject = drawn("helmet", seed)
    shell = next(piece.mesh.vertices for piece in subject.pieces if piece.name == "shell")
    middle = (shell.min(axis=0) + shell.max(axis=0)) / 2
    # A ball of 11 cm is air inside, and straight down one meets nothing.
    ball = np.random.default_rng(0).normal(size=(200, 3))
    ball = 0.055 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    assert not is_solid(subject, ball + np.array([middle[0], middle[1], 0.056])).any()
    assert np.isinf(reach_m(subject, (middle[0], middle[1], 0.05), (0, 0, -1)))
    assert reach_m(subject, (middle[0], middle[1], 0.05), (0, 0, 1)) < 0.25


@pytest.mark.parametrize("family", BOUNDS)
def test_they_vary(family: str) -> None:
    check_variety(family, SEEDS, 1.25)
