"""Kennels, ovens and caves for cats: closed surfaces, nothing thin, a true room behind a smaller doorway."""

import numpy as np
import pytest
from object_checks import check_solid, check_thickness, check_variety, drawn, is_solid, reach_m
from slow import first

SEEDS = range(12)


@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_one_watertight_solid_of_true_size(seed: int) -> None:
    check_solid(drawn("kennel", seed), (0.35, 0.35, 0.25), (1.0, 1.2, 1.0), (3, 200), steady_m=0.03)
    check_thickness(drawn("kennel", seed), 0.0139)


@pytest.mark.parametrize("seed", first(4, SEEDS))
def test_its_room_is_air_with_a_roof_and_a_doorway_smaller_than_itself(seed: int) -> None:
    subject = drawn("kennel", seed)
    low, high = subject.mesh.vertices.min(axis=0), subject.mesh.vertices.max(axis=0)
    rng = np.random.default_rng(0)
    points = low + rng.random((4000, 3)) * (high - low)
    air = points[~is_solid(subject, points)]
    ways = [(0, 0, 1), (-1, 0, 0), (1, 0, 0), (0, -1, 0)]
    inside = [at for at in air[:400] if all(np.isfinite(reach_m(subject, at, way)) for way in ways)]
    assert len(inside) > 20
    # Some of it is seen from straight in front, most of it is not.
    seen = [np.isinf(reach_m(subject, at, (0, 1, 0))) for at in inside]
    assert 0.02 < np.mean(seen) < 0.7


def test_they_vary() -> None:
    check_variety("kennel", SEEDS, 1.25)
    names = {tuple(sorted({piece.name for piece in drawn("kennel", seed).pieces})) for seed in SEEDS}
    assert len(names) >= 4
