"""Wheelbarrows, troughs and watering cans: closed surfaces, true cavities that are open above, varied."""

import numpy as np
import pytest
from object_checks import check_solid, check_thickness, check_variety, drawn, is_solid, reach_m

SEEDS = range(10)
BOUNDS = {
    "wheelbarrow": ((1.2, 0.5, 0.45), (1.8, 0.95, 0.75), (10, 130)),
    "trough": ((0.68, 0.28, 0.2), (1.4, 0.7, 0.85), (6, 80)),
    "watering_can": ((0.28, 0.13, 0.2), (0.6, 0.3, 0.45), (0.8, 5)),
}
THICK_M = {"wheelbarrow": 0.0124, "trough": 0.0124, "watering_can": 0.0079}
HOLLOW = {"wheelbarrow": "tray", "trough": "trough", "watering_can": "body"}


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    check_solid(drawn(family, seed), *BOUNDS[family], steady_m=0.02)
    check_thickness(drawn(family, seed), THICK_M[family])


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_its_cavity_is_air_and_open_above(family: str, seed: int) -> None:
    subject = drawn(family, seed)
    vessel = next(piece.mesh.vertices for piece in subject.pieces if piece.name == HOLLOW[family])
    low, high = vessel.min(axis=0), vessel.max(axis=0)
    # At the side that no cover closes, in the upper quarter, which no load fills.
    share = np.array([0.35, 0.5, 0.85])
    at = low + share * (high - low)
    assert not is_solid(subject, at)[0]
    # Past a handle or a bar above it.
    assert any(np.isinf(reach_m(subject, at, (x, y, 1.0))) for x in (-0.1, 0.1) for y in (-0.5, 0.5))
    # It has walls all around, and a floor.
    for way in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, -1)):
        assert reach_m(subject, at - [0, 0, 0.1 * (high - low)[2]], way) < 1.2


def test_a_wheelbarrow_stands_on_a_wheel_and_two_props() -> None:
    for seed in SEEDS:
        pieces = drawn("wheelbarrow", seed).pieces
        names = [piece.name for piece in pieces]
        assert names.count("wheel") in (1, 2) and names.count("handle") == names.count("grip") == 2
        for piece in pieces:
            if piece.name in ("wheel", "prop"):
                assert piece.mesh.vertices[:, 2].min() < 0.002


@pytest.mark.parametrize("family", BOUNDS)
def test_they_vary(family: str) -> None:
    check_variety(family, SEEDS, 1.15)
