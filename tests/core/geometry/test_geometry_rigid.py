import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinectbench.core.geometry import (
    closest_rotation,
    interpolate_rigid,
    invert_rigid,
    quaternion_xyzw_from_rotation,
    rigid,
    rotation_angle_rad,
    rotation_from_quaternion_xyzw,
    transform_points,
)

quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(
    lambda q: float(np.linalg.norm(q)) > 0.1
)
points = arrays(np.float64, 3, elements=st.floats(-10, 10))


def about_z(angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def test_a_quarter_turn_about_z_by_hand() -> None:
    half = np.sqrt(0.5)
    rotation = rotation_from_quaternion_xyzw([0, 0, half, half])
    np.testing.assert_allclose(rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    T_a_b = rigid(rotation, [1, 2, 3])
    np.testing.assert_allclose(transform_points(T_a_b, np.array([1.0, 0, 0])), [1, 3, 3], atol=1e-15)


@given(quaternions)
@settings(deadline=None)
def test_quaternions_round_trip(q: np.ndarray) -> None:
    rotation = rotation_from_quaternion_xyzw(q)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    back = quaternion_xyzw_from_rotation(rotation)
    assert back[3] >= 0
    unit = q / np.linalg.norm(q)
    assert abs(back @ unit) == pytest.approx(1, abs=1e-12)


def test_quaternions_of_many_rotations_at_once() -> None:
    q = np.random.default_rng(0).normal(size=(2, 5, 4))
    rotations = rotation_from_quaternion_xyzw(q)
    assert rotations.shape == (2, 5, 3, 3)
    np.testing.assert_allclose(rotations[1, 3], rotation_from_quaternion_xyzw(q[1, 3]))


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]])
def test_half_turns_survive(axis: list[int]) -> None:
    q = np.array([*axis, 0.0]) / np.linalg.norm(axis)
    rotation = rotation_from_quaternion_xyzw(q)
    np.testing.assert_allclose(
        rotation_from_quaternion_xyzw(quaternion_xyzw_from_rotation(rotation)), rotation, atol=1e-12
    )


@given(quaternions, points, points)
@settings(deadline=None)
def test_the_inverse_undoes(q: np.ndarray, translation_m: np.ndarray, point: np.ndarray) -> None:
    T_a_b = rigid(rotation_from_quaternion_xyzw(q), translation_m)
    np.testing.assert_allclose(invert_rigid(T_a_b), np.linalg.inv(T_a_b), atol=1e-9)
    there = transform_points(T_a_b, point)
    np.testing.assert_allclose(transform_points(invert_rigid(T_a_b), there), point, atol=1e-9)


def test_inverses_and_points_in_batches() -> None:
    q = np.random.default_rng(1).normal(size=(6, 4))
    T = np.stack([rigid(rotation_from_quaternion_xyzw(row), row[:3]) for row in q])
    np.testing.assert_allclose(invert_rigid(T) @ T, np.broadcast_to(np.eye(4), (6, 4, 4)), atol=1e-12)
    many = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    moved = transform_points(T[0], many)
    assert moved.shape == many.shape and moved.dtype == np.float64
    np.testing.assert_allclose(moved[1, 2], (T[0] @ [*many[1, 2], 1])[:3])


@given(quaternions, st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_closest_rotation_removes_small_errors(q: np.ndarray, seed: int) -> None:
    rotation = rotation_from_quaternion_xyzw(q)
    np.testing.assert_allclose(closest_rotation(rotation), rotation, atol=1e-12)
    np.testing.assert_allclose(closest_rotation(1.1 * rotation), rotation, atol=1e-12)
    noisy = rotation + np.random.default_rng(seed).normal(scale=1e-3, size=(3, 3))
    found = closest_rotation(noisy)
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-12)
    assert np.linalg.norm(found - noisy) <= np.linalg.norm(rotation - noisy) + 1e-12


def test_closest_rotation_is_never_a_reflection() -> None:
    matrices = np.stack([np.diag([1.0, 1.0, -1.0]), np.eye(3)])
    found = closest_rotation(matrices)
    np.testing.assert_allclose(np.linalg.det(found), [1, 1])
    np.testing.assert_allclose(found[1], np.eye(3), atol=1e-15)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-4, 0.5, 3.0, np.pi])
def test_rotation_angle(angle_rad: float) -> None:
    assert rotation_angle_rad(about_z(angle_rad)) == pytest.approx(angle_rad, rel=1e-9, abs=1e-15)
    assert rotation_angle_rad(about_z(-angle_rad)) == pytest.approx(angle_rad, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 1.0])
def test_interpolation_turns_and_moves_evenly(fraction: float) -> None:
    middle = interpolate_rigid(rigid(about_z(0.2), [0, 0, 0]), rigid(about_z(1.0), [4, 0, -2]), fraction)
    np.testing.assert_allclose(
        middle, rigid(about_z(0.2 + 0.8 * fraction), [4 * fraction, 0, -2 * fraction]), atol=1e-12
    )


def test_interpolation_takes_the_short_way() -> None:
    middle = interpolate_rigid(rigid(about_z(3.0), [0, 0, 0]), rigid(about_z(-3.0), [0, 0, 0]), 0.5)
    np.testing.assert_allclose(middle[:3, :3], about_z(np.pi), atol=1e-12)


def test_interpolation_between_equal_rotations() -> None:
    T = rigid(about_z(0.7), [1, 2, 3])
    np.testing.assert_allclose(interpolate_rigid(T, T, 0.3), T, atol=1e-12)


def test_many_at_once_are_what_each_is_alone() -> None:
    """Against the turn between them by Rodrigues, transform after transform."""
    rng = np.random.default_rng(0)
    turns = rotation_from_quaternion_xyzw(rng.normal(size=(2, 50, 4)))
    turns[1, 0], turns[0, 1], turns[1, 1] = turns[0, 0], np.eye(3), about_z(np.pi)
    T0, T1 = ([rigid(turn, rng.normal(size=3)) for turn in each] for each in turns)
    fractions = rng.random(50)
    found = interpolate_rigid(np.stack(T0), np.stack(T1), fractions)
    for k, fraction in enumerate(fractions):
        turn = cv2.Rodrigues(T0[k][:3, :3].T @ T1[k][:3, :3])[0]
        turned = T0[k][:3, :3] @ cv2.Rodrigues(fraction * turn)[0]
        moved = (1 - fraction) * T0[k][:3, 3] + fraction * T1[k][:3, 3]
        if k != 1:  # half a turn goes either way
            np.testing.assert_allclose(found[k], rigid(turned, moved), rtol=0, atol=1e-9)
        np.testing.assert_array_equal(found[k], interpolate_rigid(T0[k], T1[k], float(fraction)))
        np.testing.assert_array_equal(
            quaternion_xyzw_from_rotation(turns[0])[k], quaternion_xyzw_from_rotation(turns[0, k])
        )


def test_inputs_are_left_alone() -> None:
    T, matrix = rigid(about_z(0.3), [1, 2, 3]), about_z(0.3) * 1.01
    kept = T.copy(), matrix.copy()
    invert_rigid(T), closest_rotation(matrix), interpolate_rigid(T, T, 0.5)
    np.testing.assert_array_equal(T, kept[0])
    np.testing.assert_array_equal(matrix, kept[1])
