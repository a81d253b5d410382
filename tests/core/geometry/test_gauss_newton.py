"""Steps, priors and sums against closed forms; rotations that are none."""

import numpy as np
import pytest

from kinectbench.core.geometry import (
    interpolate_rigid,
    quaternion_xyzw_from_rotation,
    rigid,
    rotation_from_quaternion_xyzw,
)
from kinectbench.core.geometry.gauss_newton import (
    DAMPING,
    HALF_AT_MEDIANS,
    NormalEquations,
    descend,
    eliminated,
    projective_residuals,
    robust_weights,
    weighted_products,
)
from kinectbench.core.geometry.rigid import rigid_from_twist, twist_from_rigid

RNG = np.random.default_rng(5)
ROWS, WEIGHTS = RNG.normal(size=(1300, 9)), RNG.random(1300)
J, R = ROWS[:, :-1], ROWS[:, -1]


def test_products_are_the_weighted_sum() -> None:
    products = weighted_products(ROWS, WEIGHTS)
    np.testing.assert_allclose(products, (ROWS * WEIGHTS[:, None]).T @ ROWS, rtol=1e-12, atol=1e-10)
    np.testing.assert_array_equal(products, products.T)
    np.testing.assert_array_equal(weighted_products(ROWS[:0], WEIGHTS[:0]), np.zeros((9, 9)))


def test_the_step_is_that_of_least_squares() -> None:
    step = NormalEquations.of_products(weighted_products(ROWS, WEIGHTS)).step()
    root = np.sqrt(WEIGHTS)
    expected = np.linalg.lstsq(J * root[:, None], R * root, rcond=None)[0]
    np.testing.assert_allclose(step, expected, rtol=0, atol=1e-12)


def test_sums_are_those_of_all_residuals() -> None:
    parts = [NormalEquations.of_products(weighted_products(ROWS[k::2], WEIGHTS[k::2])) for k in range(2)]
    whole = NormalEquations.of_products(weighted_products(ROWS, WEIGHTS))
    np.testing.assert_allclose((parts[0] + parts[1]).step(), whole.step(), rtol=1e-10)


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_a_prior_gives_the_mean_weighted_by_information(steps: int) -> None:
    """A measurement y = H x with noise R, x ~ N(0, P): x = P H^T (H P H^T + R)^-1 y, in one step or more."""
    H, noise, y = RNG.normal(size=(5, 3)), np.diag([0.1, 0.2, 0.3, 0.4, 0.5]), RNG.normal(size=5)
    spread = RNG.normal(size=(3, 3))
    P = spread @ spread.T + 0.1 * np.eye(3)
    information = np.asarray(np.linalg.inv(P), np.float64)
    expected = P @ H.T @ np.linalg.solve(H @ P @ H.T + noise, y)

    def advance(x: np.ndarray) -> tuple[np.ndarray, float]:
        rows = np.column_stack([H, y - H @ x])
        measured = NormalEquations.of_products(weighted_products(rows, 1 / np.diag(noise)))
        step = (measured + NormalEquations.of_prior(information, x)).step()
        return x + step, float(np.abs(step).max())

    found, moved = descend(advance, np.zeros(3), steps)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    assert (moved < 1e-10) == (steps > 1)


def test_damping_leaves_what_nothing_holds() -> None:
    matrix = np.diag([4.0, 0.0])
    step = NormalEquations(matrix, np.array([8.0, 0.0])).damped().step()
    np.testing.assert_allclose(step, [2 / (1 + DAMPING), 0])
    with pytest.raises(np.linalg.LinAlgError):
        NormalEquations(matrix, np.zeros(2)).step()


@pytest.mark.parametrize(("still", "steps", "last"), [(0.3, 10, 0.25), (0.0, 3, 0.125), (0.25, 10, 0.125)])
def test_it_ends_at_a_short_step_or_after_the_last(still: float, steps: int, last: float) -> None:
    state, moved = descend(lambda x: (x / 2, x / 2), 1.0, steps, still)
    assert state == moved == last


def test_without_steps_nothing_moves() -> None:
    assert descend(lambda x: (x / 2, x / 2), 1.0, 0, 1.0) == (1.0, np.inf)


def test_eliminated_columns_follow() -> None:
    """Least squares of all columns and of those that are left are the same."""
    products, prior = weighted_products(ROWS, WEIGHTS), np.diag([3.0, 5.0])
    whole = NormalEquations.of_products(products)
    whole.matrix[:2, :2] += prior
    expected = whole.step()
    products[:2, :2] -= prior  # `whole` is a view of it
    rest, follows = eliminated(products, 2, prior)
    step = NormalEquations.of_products(rest).step()
    np.testing.assert_allclose(step, expected[2:], rtol=1e-10)
    np.testing.assert_allclose(follows[:, -1] - follows[:, :-1] @ step, expected[:2], rtol=1e-10)


@pytest.mark.parametrize(("power", "share"), [(1, 1 / 2), (2, 1 / 4)])
def test_far_distances_weigh_less(power: int, share: float) -> None:
    weights = robust_weights(np.array([0.0, 1.0, HALF_AT_MEDIANS]), power=power)
    assert weights.sum() == pytest.approx(1)
    assert weights[2] / weights[0] == pytest.approx(share)
    counted = robust_weights(np.array([0.0, 0.0, 1.0]), np.array([1.0, 3.0, 0.0]), power)
    np.testing.assert_allclose(counted, [0.25, 0.75, 0])
    assert not len(robust_weights(np.zeros(0), power=power))


def test_projective_residuals_by_hand() -> None:
    """A wall at 2 m, seen with f = 10: 1 cm before it, behind the camera, out of view, far off, turned."""
    depth, facing = np.full((9, 9), 2.0), np.tile([0.0, 0.0, -1.0], (9, 9, 1))
    points = np.array([[0, 0, 1.99], [0, 0, -2], [3, 0, 1.99], [0, 0, 1.5], [0, 0, 1.99]])
    normals = np.array([[0, 0, -1.0]] * 4 + [[1.0, 0, 0]])
    given = points, normals, depth, facing, (10.0, 10.0, 4.0, 4.0), np.eye(4), 0.1
    np.testing.assert_allclose(projective_residuals(*given, 0.5), [-0.01, *[np.nan] * 4])
    of_any_side = (*given[:3], np.zeros((0, 0, 3)), *given[4:])
    np.testing.assert_allclose(projective_residuals(*of_any_side, 0.5), [-0.01, *[np.nan] * 3, 0])


NO_ROTATIONS = {
    "mirrored": np.diag([1.0, 1.0, -1.0]),
    "zero": np.zeros((3, 3)),
    "nan": np.full((3, 3), np.nan),
}


@pytest.mark.parametrize("name", NO_ROTATIONS)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_what_is_no_rotation_has_no_quaternion(name: str) -> None:
    with pytest.raises(ValueError):
        quaternion_xyzw_from_rotation(NO_ROTATIONS[name])
    T = rigid(NO_ROTATIONS[name], [0, 0, 0])
    with pytest.raises(ValueError):
        interpolate_rigid(np.eye(4), T, 0.5)


@pytest.mark.parametrize("name", ["mirrored", "zero"])
def test_twists_of_what_is_no_rotation_are_finite(name: str) -> None:
    """A step never ends a registration: the nearest rotation counts."""
    assert np.isfinite(twist_from_rigid(rigid(NO_ROTATIONS[name], [0, 0, 0]))).all()


def test_a_quaternion_without_length_is_refused() -> None:
    with pytest.raises(ValueError):
        rotation_from_quaternion_xyzw([[0, 0, 0, 1], [0, 0, 0, 0]])
    assert rotation_from_quaternion_xyzw(np.zeros((0, 4))).shape == (0, 3, 3)
    np.testing.assert_allclose(rotation_from_quaternion_xyzw([0, 0, 0, 1e-5]), np.eye(3))


def test_small_and_large_turns_come_back() -> None:
    for turn in (0.0, 1e-9, np.pi - 1e-2):
        twist = np.array([0, turn, 0, 1.0, 2.0, 3.0])
        np.testing.assert_allclose(twist_from_rigid(rigid_from_twist(twist)), twist, rtol=0, atol=1e-8)
