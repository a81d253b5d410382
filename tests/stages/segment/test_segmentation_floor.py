"""The floor: below a larger table top, beside a wall, in any world frame."""

from typing import Any

import numpy as np
import pytest
from analytic_scenes import ring
from bounds import within
from numpy.random._generator import Generator
from numpy.typing import NDArray
from raising import raises
from typed import present

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import invert_rigid, rigid, rotation_from_quaternion_xyzw, transform_points
from kinectbench.stages.segment.find.floor import Floor, find_floor
from kinectbench.stages.segment.find.floor_choice import REASONS, PlaneCandidate, PlaneChoice, Reason
from kinectbench.stages.segment.find.planes import floor_frame, noise_about_m

CELL_M = 0.03
FOCUS = np.array([0.0, 0.0, 0.3])
CAMERAS = ring(12, 1.6, (0.0, 0.0, 0.3), (0.35, 0.6))
WORLDS = {
    "upright": np.eye(4),
    "tilted": rigid(rotation_from_quaternion_xyzw([0.4, -0.5, 0.2, 0.7]), [1.0, -2.0, 0.7]),
    "camera": invert_rigid(CAMERAS[0]),
}


def patch(
    u: tuple[float, float],
    v: tuple[float, float],
    height: float,
    normal_axis: int,
    noise_m: float,
    rng: Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points every 30 mm on a rectangle at `height` along an axis, with noise along it; and normals."""
    a, b = np.meshgrid(np.arange(*u, CELL_M), np.arange(*v, CELL_M))
    points = np.insert(np.column_stack([a.ravel(), b.ravel()]), normal_axis, height, axis=1)
    points[:, normal_axis] += rng.normal(0, noise_m, len(points))
    normals = np.zeros_like(points)
    normals[:, normal_axis] = 1
    normals += rng.normal(0, 0.03, normals.shape)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def room(
    noise_m: float = 0.004, floor: bool = True, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A floor of 1.8 x 1.8 m, a table top of 2.5 x 2 m at 0.55 m (larger), and a wall larger than both."""
    rng = np.random.default_rng(seed)
    parts = [
        patch((0.9, 3.4), (-1.0, 1.0), 0.55, 2, noise_m, rng),
        patch((-2.0, 2.0), (0.0, 2.4), 2.5, 1, noise_m, rng),
    ]
    if floor:
        parts.append(patch((-0.9, 0.9), (-0.9, 0.9), 0.0, 2, noise_m, rng))
    points, normals = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    assert 1.8**2 < 2.5 * 2.0
    return points, normals


def found_in(
    world: str,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    cameras: NDArray[np.float64] = CAMERAS,
    seed: int = 0,
) -> Floor | None:
    T = WORLDS[world]
    return find_floor(
        transform_points(T, points), normals @ T[:3, :3].T, T @ cameras, transform_points(T, FOCUS), seed
    )


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("seed", [0, 7])
def test_the_floor_is_found_below_a_larger_table(world: str, seed: int) -> None:
    points, normals = room(seed=seed)
    floor = present(found_in(world, points, normals, seed=seed))
    T = WORLDS[world]
    up = T[:3, :3] @ [0, 0, 1]
    assert np.degrees(np.arccos(min(1.0, float(floor.plane_world[:3] @ up)))) < 0.2
    # Height of the true floor below the focus above the plane that was found.
    height_m = floor.plane_world[:3] @ transform_points(T, np.zeros(3)) + floor.plane_world[3]
    assert abs(height_m) < 0.003
    assert np.linalg.norm(floor.plane_world[:3]) == pytest.approx(1)
    assert floor.noise_m == pytest.approx(0.004, rel=0.25)
    assert floor.inlier_share == pytest.approx(3721 / len(points), abs=0.05)


def test_same_seed_same_floor() -> None:
    points, normals = room()
    one, two = (present(found_in("tilted", points, normals)) for _ in range(2))
    np.testing.assert_array_equal(one.plane_world, two.plane_world)


def test_a_point_kilometres_away_costs_no_memory() -> None:
    """As of one frame whose pose is far off."""
    points, normals = room()
    far = np.append(points, [[3e5, -4e5, 0.0]], axis=0), np.append(normals, [[0.0, 0.0, 1.0]], axis=0)
    with within(20, megabytes=200):
        floor = present(found_in("tilted", *far))
    up = WORLDS["tilted"][:3, 2]
    assert np.degrees(np.arccos(min(1.0, float(floor.plane_world[:3] @ up)))) < 0.5


def test_no_floor() -> None:
    points, normals = room(floor=False)
    wall = normals[:, 1] > 0.5
    with raises(SegmentationError, "segmentation.no-floor", match=r"on.*plane_world"):
        found_in("upright", points[wall], normals[wall])


@pytest.mark.parametrize("low_cameras", [1, 3])
def test_a_floor_below_some_cameras_only_is_told_and_below_few_refused(low_cameras: int) -> None:
    points, normals = room()
    low = CAMERAS.copy()
    low[:low_cameras, 2, 3] = 0.05  # less than 0.1 m above the floor, as one whose pose is off
    if low_cameras == 3:
        with raises(SegmentationError, "segmentation.no-floor", match="cameras look"):
            found_in("upright", points, normals, low)
        return
    floor = present(found_in("upright", points, normals, low))
    assert abs(floor.plane_world[3]) < 0.003
    assert any("only 92% of the cameras look down on the plane" in line for line in floor.choice.warnings())
    assert present(found_in("upright", points, normals)).choice.warnings() == ()


def table_in_a_corner() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A table of 0.7 x 0.5 m, fronts of lower things behind it, and a wall at its left; no floor."""
    rng = np.random.default_rng(0)
    parts = [
        patch((-0.35, 0.35), (-0.25, 0.25), 0.0, 2, 0.002, rng),
        patch((-0.35, 0.35), (-0.4, -0.1), 0.6, 1, 0.002, rng),
        patch((-0.3, 0.3), (-0.4, -0.1), 0.6, 0, 0.002, rng),
        patch((-1.0, 1.0), (-0.3, 0.9), -0.8, 0, 0.002, rng),  # the wall, normal along x
    ]
    points, normals = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    return points, normals


@pytest.mark.parametrize("world", WORLDS)
def test_a_refused_plane_makes_no_other_one_likelier(world: str) -> None:
    """Much lies lower than the table, nothing beyond the wall: it is the table, and that is told."""
    points, normals = table_in_a_corner()
    before = CAMERAS[CAMERAS[:, 0, 3] > -0.6]  # before the wall
    floor = present(found_in(world, points, normals, before))
    up = WORLDS[world][:3, :3] @ [0, 0, 1]
    assert np.degrees(np.arccos(min(1.0, float(floor.plane_world[:3] @ up)))) < 0.5
    assert abs(floor.plane_world[:3] @ WORLDS[world][:3, 3] + floor.plane_world[3]) < 0.003
    chosen, others = present(floor.choice.chosen), [each for each in floor.choice.candidates if each.reason]
    assert chosen.reason == "" and chosen.plane[:3] @ up > 0.99
    assert others and all(each.reason in REASONS for each in others)
    lower = f"{chosen.below_share:.0%} of the surface lies lower than the plane"
    assert any(lower in line for line in floor.choice.warnings())


def test_a_top_above_what_is_seen_right_below_it_is_no_floor() -> None:
    """A chair on a floor without depth: where its seat is its legs are, too."""
    rng = np.random.default_rng(0)
    seat = patch((-0.2, 0.2), (-0.2, 0.2), 0.45, 2, 0.002, rng)
    legs = [patch((x, x + 0.06), (0.0, 0.42), y, 1, 0.002, rng) for x in (-0.2, 0.14) for y in (-0.19, 0.19)]
    points, normals = (np.concatenate([seat[k], *(leg[k] for leg in legs)]) for k in (0, 1))
    with raises(SegmentationError, "segmentation.no-floor", match="right below"):
        found_in("upright", points, normals)


def candidate(reason: Reason, share: float, turn_deg: float = 0.0, **figures: float) -> PlaneCandidate:
    turn = np.radians(turn_deg)
    plane = np.array([np.sin(turn), 0.0, np.cos(turn), -0.7])
    known: dict[str, Any] = {
        "above_share": 1.0,
        "below_share": 0.0,
        "under_share": 0.0,
        "tilt_rad": turn,
        "way": 0,
    }
    return PlaneCandidate(plane, round(10_000 * share), share, **{**known, **figures}, reason=reason)


@pytest.mark.parametrize("turn_deg", [0.0, 40.0])
@pytest.mark.parametrize(
    "reason, figures", [("top", {"under_share": 0.2}), ("cameras", {"above_share": 0.79}), ("clutter", {})]
)
def test_a_refused_plane_that_outweighs_the_floor_is_told_with_its_reason(
    reason: Reason, figures: dict[str, float], turn_deg: float
) -> None:
    floor = candidate("", 0.012)
    (line,) = PlaneChoice(floor, (floor, candidate(reason, 0.6, turn_deg, **figures))).warnings()
    assert "1% of the surface lies on the plane that was taken for the floor, and 60% on" in line
    assert f"refused: {REASONS[reason]}" in line and "floor: {plane_world" in line


@pytest.mark.parametrize(
    "other",
    [
        candidate("top", 0.3, under_share=0.9),  # a table on the floor
        candidate("clutter", 0.15, 40.0),
        candidate("cameras", 0.3, above_share=0.4),  # the board of a shelf
        candidate("turned", 0.6, 90.0),  # a wall
        candidate("lower", 0.6),
    ],
)
def test_a_refused_plane_that_is_none_is_not_told(other: PlaneCandidate) -> None:
    floor = candidate("", 0.2)
    assert PlaneChoice(floor, (floor, other)).warnings() == ()


def test_frame_of_the_floor() -> None:
    normal = np.array([0.1, 0.2, 0.97])
    normal /= np.linalg.norm(normal)
    plane = np.append(normal, -0.35)
    T_floor_world = floor_frame(plane)
    np.testing.assert_allclose(T_floor_world[:3, :3] @ T_floor_world[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T_floor_world[:3, :3]) == pytest.approx(1)
    # z up, and z = 0 on the plane
    np.testing.assert_allclose(T_floor_world[:3, :3] @ normal, [0, 0, 1], atol=1e-12)
    points = np.random.default_rng(0).normal(size=(20, 3))
    heights_m = transform_points(T_floor_world, points)[:, 2]
    np.testing.assert_allclose(heights_m, points @ normal - 0.35, atol=1e-12)
    # the world's origin is straight above (or below) the origin of the floor
    np.testing.assert_allclose(transform_points(T_floor_world, np.zeros(3))[:2], 0, atol=1e-12)
    # the world's x axis projects onto the floor's
    along = T_floor_world[:3, :3] @ [1, 0, 0]
    assert along[0] > 0 and abs(along[1]) < 1e-12


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_degenerate_x_axis_uses_z(sign: float) -> None:
    T_floor_world = floor_frame(np.array([sign, 0.0, 0.0, 0.4]))
    np.testing.assert_allclose(T_floor_world[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(T_floor_world[:3, :3] @ [1, 0, 0], [0, 0, sign], atol=1e-12)
    assert np.linalg.det(T_floor_world[:3, :3]) == pytest.approx(1)


def test_what_no_point_is_near_is_no_flat_plane() -> None:
    """Noise that is not a number would be below any bound."""
    points = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    assert noise_about_m(np.array([0.0, 0.0, 1.0, 0.0]), points, 0.02) == np.inf
    assert noise_about_m(np.array([0.0, 0.0, 1.0, -1.0]), points, 0.02) == 0
