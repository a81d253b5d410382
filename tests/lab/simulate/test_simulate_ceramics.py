"""Mugs, kettles, bottles and vases: walls of one thickness, openings under handles, true cavities."""

import numpy as np
import pytest
from kinectbench_plugins.families.ceramics import band, horn, smooth_profile, vessel
from object_checks import check_solid, check_thickness, check_variety, checked, drawn, is_solid, reach_m
from slow import first

SEEDS = range(10)
BOUNDS = {
    "mug": ((0.10, 0.065, 0.10), (0.24, 0.16, 0.165), (0.15, 1.5)),
    "kettle": ((0.2, 0.16, 0.13), (0.42, 0.26, 0.34), (1.5, 9.0)),
    "bottle": ((0.059, 0.059, 0.155), (0.085, 0.085, 0.285), (0.2, 1.4)),
    "vase": ((0.10, 0.10, 0.19), (0.40, 0.36, 0.46), (0.3, 5.0)),
}
THICK_M = {"mug": 0.0079, "kettle": 0.0119, "bottle": 0.0119, "vase": 0.0079}


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", first(3, SEEDS))
def test_it_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    check_solid(drawn(family, seed), *BOUNDS[family])
    check_thickness(drawn(family, seed), THICK_M[family])


@pytest.mark.parametrize("family", ["mug", "vase"])
@pytest.mark.parametrize("seed", SEEDS)
def test_the_cavity_is_open_at_the_top(family: str, seed: int) -> None:
    subject = drawn(family, seed)
    piece = next(piece for piece in subject.pieces if piece.name == "body")
    x, y = piece.mesh.vertices[:, :2].max(axis=0) / 2 + piece.mesh.vertices[:, :2].min(axis=0) / 2
    top = piece.mesh.vertices[:, 2].max()
    # Along the middle it is air from a floor of at most 25 mm up to the rim, and the sky is seen from there.
    heights = np.linspace(0.026, top, 30)
    assert not is_solid(subject, np.column_stack([np.full((30, 2), (x, y)), heights])).any()
    assert np.isinf(reach_m(subject, (x, y, 0.026), (0, 0, 1)))
    assert 0.004 < 0.026 - reach_m(subject, (x, y, 0.026), (0, 0, -1)) < 0.026
    assert all(np.isfinite(reach_m(subject, (x, y, 0.5 * top), (np.cos(a), np.sin(a), 0))) for a in range(6))


@pytest.mark.parametrize("family", ["mug", "kettle"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_handle_leaves_an_opening(family: str, seed: int) -> None:
    # A body with one handle is a ring: one hole, Euler's number 0.
    assert checked(drawn(family, seed)).euler_number == 0


@pytest.mark.parametrize("family", BOUNDS)
def test_they_vary(family: str) -> None:
    check_variety(family, SEEDS, 1.2)


def test_a_vessel_has_its_walls_and_its_volume() -> None:
    straight = np.array([(0.05, 0.0), (0.05, 0.1)])
    cup, room = vessel(straight, 0.01, 0.015)
    # 96 sides inscribed in a circle; the rim is a torus' upper half of 5 mm: Pappus.
    share = 96 / 2 * np.sin(2 * np.pi / 96) / np.pi
    walls = np.pi * (0.05**2 * 0.015 + (0.05**2 - 0.04**2) * 0.085)
    rim = np.pi * 0.005**2 / 2 * 2 * np.pi * 0.045
    assert cup.volume() == pytest.approx(share * (walls + rim), rel=5e-3)
    assert room.bounding_box()[3] == pytest.approx(0.04, abs=1e-6)
    assert room.bounding_box()[5] > 0.15


def test_a_profile_stays_between_its_points_and_a_band_lies_around_it() -> None:
    line = smooth_profile([(0.03, 0.0), (0.06, 0.1), (0.04, 0.2)])
    assert np.allclose(line[[0, -1]], [(0.03, 0.0), (0.04, 0.2)])
    assert line[:, 0].max() <= 0.06
    ring = band(np.array([(0.05, 0.0), (0.05, 0.1)]), 0.02, 0.04, 0.002, 0.005)
    assert ring.bounding_box()[2:] == pytest.approx((0.02, 0.052, 0.052, 0.04), abs=1e-4)
    assert ring.volume() == pytest.approx(np.pi * (0.052**2 - 0.045**2) * 0.02, rel=0.01)


def test_a_horn_is_a_cone_between_balls() -> None:
    straight = horn(np.array([(0, 0, 0), (0, 0, 0.1)]), np.array([0.02, 0.02]))
    whole = np.pi * 0.02**2 * 0.1 + 4 / 3 * np.pi * 0.02**3
    assert 0.95 * whole < straight.volume() < whole
