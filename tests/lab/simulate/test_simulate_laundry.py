"""Washing machines: closed surfaces, a drum that is air and open to the front or the top, varied."""

import numpy as np
import pytest
from numpy.typing import NDArray
from object_checks import check_solid, check_thickness, check_variety, drawn, is_solid, reach_m

from kinectbench.lab.simulate.objects.shapes import Subject

SEEDS = range(10)


@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_one_watertight_solid_of_true_size(seed: int) -> None:
    check_solid(
        drawn("washing_machine", seed), (0.38, 0.4, 0.72), (1.05, 1.25, 1.6), (100, 300), steady_m=0.03
    )
    check_thickness(drawn("washing_machine", seed), 0.0149)


def holes(seed: int) -> tuple[Subject, bool, NDArray[np.float64]]:
    """The housing's corners, whether it is opened at the front, and a point in its drum."""
    subject = drawn("washing_machine", seed)
    pieces = {piece.name: piece.mesh.vertices for piece in subject.pieces}
    housing = pieces["housing"]
    low, high = housing.min(axis=0), housing.max(axis=0)
    if "collar" in pieces:
        x, _, z = (pieces["collar"].min(axis=0) + pieces["collar"].max(axis=0)) / 2
        return subject, True, np.array([x, low[1] + 0.5 * (high - low)[1], z])
    # Beside the agitator.
    return (
        subject,
        False,
        np.array([(low[0] + 0.22 * (high - low)[0]), 0.6 * high[1] + 0.4 * low[1], high[2] - 0.2]),
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_its_drum_is_air_with_one_way_out(seed: int) -> None:
    subject, at_front, point = holes(seed)
    assert not is_solid(subject, point)[0]
    ways = {"front": (0, 1, 0), "back": (0, -1, 0), "left": (-1, 0, 0), "right": (1, 0, 0)}
    closed = [way for name, way in ways.items() if not (at_front and name == "front")]
    assert all(reach_m(subject, point, way) < 0.45 for way in closed)
    assert reach_m(subject, point, (0, 0, -1)) < 0.5
    if at_front:
        leaves = [
            reach_m(subject, point, (x, 1.0, z)) for x in (-0.4, -0.2, 0, 0.2, 0.4) for z in (-0.2, 0.2)
        ]
        assert np.isinf(leaves).any()
        assert reach_m(subject, point, (0, 0, 1)) < 0.45
    else:
        assert np.isinf(reach_m(subject, point, (0, 0.2, 1)))


def test_some_open_at_the_front_and_some_at_the_top() -> None:
    assert len({holes(seed)[1] for seed in SEEDS}) == 2
    check_variety("washing_machine", SEEDS, 1.2)
