"""Smooth bodies: distances against known ones, solids of fields against known volumes, blobs, sculptures."""

import numpy as np
import pytest
from kinectbench_plugins.families.smooth import (
    blended,
    body,
    center_of_mass,
    cone,
    ellipsoid,
    flattened,
    limb,
)
from numpy.typing import NDArray
from object_checks import check_solid, check_thickness, check_variety, checked, drawn
from slow import first

from kinectbench.lab.simulate.objects.shapes import box

SEEDS = range(5)
BOUNDS = {
    "blob": ((0.18, 0.18, 0.15), (0.7, 0.7, 0.7), (3, 250)),
    "sculpture": ((0.2, 0.15, 0.35), (0.9, 0.9, 0.95), (3, 250)),
}
THICK_M = {"blob": 0.1, "sculpture": 0.03}


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", first(2, SEEDS))
def test_it_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    check_solid(drawn(family, seed), *BOUNDS[family], steady_m=0.015)
    check_thickness(drawn(family, seed), THICK_M[family])


def test_sculptures_have_holes_or_arms_and_blobs_have_neither() -> None:
    for seed in SEEDS:
        blob, sculpture = checked(drawn("blob", seed)), checked(drawn("sculpture", seed))
        assert blob.euler_number == 2
        assert blob.volume > 0.8 * blob.convex_hull.volume
        assert sculpture.euler_number <= 0 or sculpture.volume < 0.7 * sculpture.convex_hull.volume
    assert any(checked(drawn("sculpture", seed)).euler_number <= 0 for seed in SEEDS)


@pytest.mark.parametrize("family", BOUNDS)
def test_they_vary(family: str) -> None:
    check_variety(family, SEEDS, 1.2)


def test_distances_to_balls_bars_and_tubes_are_exact() -> None:
    points = np.array([(0.3, 0, 0), (0, 0.4, 0.0), (0, 0, 0), (0.05, 0, 0.2)])
    to_middle = np.linalg.norm(points, axis=1)
    assert np.allclose(ellipsoid(points, (0, 0, 0), (0.1, 0.1, 0.1)), to_middle - 0.1, atol=1e-9)
    # On an ellipsoid's surface the distance is 0.
    surface = np.array([(0.1, 0, 0), (0, 0.2, 0), (0, 0, -0.3)])
    assert np.allclose(ellipsoid(surface, (0, 0, 0), (0.1, 0.2, 0.3)), 0)
    a, b = np.array([0.0, 0, 0]), np.array([0.0, 0, 0.4])
    assert np.allclose(cone(points, a, b, (0.1, 0.1)), [0.2, 0.3, -0.1, -0.05])
    # Half-way along it, its radius is the mean of both.
    assert cone(np.array([(0.3, 0, 0.2)]), a, b, (0.1, 0.2))[0] == pytest.approx(0.15)
    path = np.array([a, b, (0.4, 0, 0.4)])
    assert limb(np.array([(0.2, 0.0, 0.6)]), path, np.full(3, 0.05))[0] == pytest.approx(0.15)


def test_a_blend_is_the_nearest_far_away_and_more_where_two_meet() -> None:
    near, far = np.array([0.1, 0.2]), np.array([5.0, 0.2])
    assert np.allclose(blended([near, far], 0.02), [0.1, 0.2 - 0.02 * np.log(2)])


def test_a_field_becomes_a_solid_of_its_volume_and_lone_pieces_are_left_out() -> None:
    def field(points: NDArray[np.float64]) -> NDArray[np.float64]:
        ball = np.linalg.norm(points - [0.02, 0, 0], axis=1) - 0.1
        crumb = np.linalg.norm(points - [0.2, 0.2, 0.2], axis=1) - 0.02
        return np.asarray(np.minimum(ball, crumb))

    ball = body(field, (-0.25, -0.25, -0.25), (0.25, 0.25, 0.25), 0.01)
    assert ball.volume() == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.01)
    assert np.allclose(ball.bounding_box(), (-0.08, -0.1, -0.1, 0.12, 0.1, 0.1), atol=1e-3)
    assert np.allclose(center_of_mass(ball), (0.02, 0, 0), atol=1e-4)


def test_a_body_is_cut_until_it_stands() -> None:
    assert np.allclose(center_of_mass(box((0, 0, 0), (0.2, 0.4, 0.6))), (0.1, 0.2, 0.3))
    low = flattened(box((0, 0, 0), (0.2, 0.2, 0.5)), 0.1)
    assert low.bounding_box()[2] == pytest.approx(0.05)
    # A ball of 1 m needs a foot of more than 4 cm: 10 % of its height gives one of 30 cm.
    ball = type(low).sphere(0.5, 64)
    assert flattened(ball, 0.001).bounding_box()[2] > -0.5 + 0.0008
    # A wedge on its tip at x = 0 with its mass beyond is cut until the mass lies over the foot.
    wedge = type(low).hull_points([(0, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1), (0.6, 0, 1), (0.6, 1, 1)])
    cut = flattened(wedge, 0.02)
    foot = 0.6 * cut.bounding_box()[2]
    assert center_of_mass(cut)[0] < foot - 0.04
