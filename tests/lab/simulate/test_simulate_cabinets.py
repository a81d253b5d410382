"""Cabinets and refrigerators: closed surfaces, true rooms inside that stand open, nothing thin."""

import numpy as np
import pytest
from numpy.typing import NDArray
from object_checks import check_solid, check_thickness, check_variety, drawn, is_solid, reach_m
from slow import first

from kinectbench.lab.simulate.objects.shapes import Subject

SEEDS = range(10)
BOUNDS = {
    "open_cabinet": ((0.40, 0.5, 0.6), (1.9, 1.2, 1.9), (30, 500)),
    "fridge": ((0.55, 0.9, 1.19), (1.2, 1.5, 1.91), (120, 700)),
}


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    check_solid(drawn(family, seed), *BOUNDS[family], steady_m=0.03)
    check_thickness(drawn(family, seed), 0.0149)


def case_of(subject: Subject) -> NDArray[np.float64]:
    return next(piece.mesh.vertices for piece in subject.pieces if piece.name == "case")


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", first(4, SEEDS))
def test_its_rooms_are_air_and_open_to_the_front(family: str, seed: int) -> None:
    subject = drawn(family, seed)
    case = case_of(subject)
    low, high = case.min(axis=0), case.max(axis=0)
    # Points all over the case, 2 cm before its back at the least.
    share = np.stack(np.meshgrid(*[np.linspace(0.03, 0.97, 24)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = low + share * (high - low)
    air = points[~is_solid(subject, points)]
    assert len(air) > 0.25 * len(points)
    # From a middle of the air rays leave to the front where no door stands.
    rng = np.random.default_rng(0)
    some = air[rng.choice(len(air), 60, replace=False)]
    leaves = [
        np.isinf(reach_m(subject, at, (x, 1.0, 0.0))) for at in some for x in (-1.5, -0.5, 0.0, 0.5, 1.5)
    ]
    assert np.mean(leaves) > 0.15
    # To the back and upwards none does.
    assert all(np.isfinite(reach_m(subject, at, (0.0, -1.0, 0.0))) for at in some)
    assert all(np.isfinite(reach_m(subject, at, (0.0, 0.0, 1.0))) for at in some)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_walls_of_a_refrigerator_are_thick(seed: int) -> None:
    subject = drawn("fridge", seed)
    case = case_of(subject)
    low, high = case.min(axis=0), case.max(axis=0)
    # Level through both sides at many heights: 40 to 60 mm, or more where a shelf is met.
    y, zs = (low[1] + high[1]) / 2, np.linspace(0.15, 0.9, 16) * high[2]
    for side in (-1, 1):
        start = np.array([(high[0] if side > 0 else low[0]), y, 0.0])
        walls = [reach_m(subject, [start[0] - side * 1e-4, y, z], (-side, 0, 0)) for z in zs]
        assert min(walls) > 0.0398
        assert min(walls) < 0.0602


@pytest.mark.parametrize("family", BOUNDS)
def test_doors_stand_out_and_the_parts_vary(family: str) -> None:
    check_variety(family, SEEDS, 1.25)
    names = []
    for seed in SEEDS:
        subject = drawn(family, seed)
        doors = [piece.mesh.vertices for piece in subject.pieces if piece.name == "door"]
        assert 1 <= len(doors) <= 2
        assert max(door[:, 1].max() for door in doors) > case_of(subject)[:, 1].max() + 0.15
        names.append(tuple(sorted(piece.name for piece in subject.pieces)))
    assert len(set(names)) >= 6
    assert any("shelf" in found for found in names)
