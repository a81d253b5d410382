"""Closed meshes to solids: against analytic shapes and solid angles."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from trimesh.caching import TrackedArray

from kinectbench.core.geometry import (
    Grid,
    invert_rigid,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import voxelize_solid


def centers_world(grid: Grid) -> np.ndarray:
    index = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1)
    return transform_points(grid.T_world_grid, (index + 0.5) * grid.voxel_size_m)


def turned_grid(side: int, voxel_m: float, seed: int, offset_m: float = 0.0) -> Grid:
    rng = np.random.default_rng(seed)
    rotation = rotation_from_quaternion_xyzw(rng.normal(size=4))
    corner = -rotation @ np.full(3, side * voxel_m / 2) + rng.uniform(-1, 1, 3) * voxel_m + offset_m
    return Grid((side,) * 3, voxel_m, rigid(rotation, corner))


def solid_of(
    vertices: TrackedArray | NDArray[np.float64], faces: TrackedArray | NDArray[np.int64], grid: Grid
) -> np.ndarray:
    packed = voxelize_solid(np.asarray(vertices, float), np.asarray(faces, np.int32), grid)
    assert packed.dtype == np.uint8 and packed.shape == (*grid.shape[:2], grid.shape[2] // 8)
    return unpack(packed)


@pytest.mark.parametrize("seed", range(4))
def test_ball_in_turned_grids(seed: int) -> None:
    """Cells farther from the sphere than its facets' sagitta must be exact."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.3)
    grid = turned_grid(64, 0.0125, seed)
    distance = np.linalg.norm(centers_world(grid), axis=-1) - 0.3
    sure = np.abs(distance) > 2e-4
    solid = solid_of(ball.vertices, ball.faces, grid)
    np.testing.assert_array_equal(solid[sure], (distance < 0)[sure])
    assert sure.mean() > 0.99


@pytest.mark.parametrize("seed", range(3))
def test_torus_keeps_its_hole(seed: int) -> None:
    torus = trimesh.creation.torus(0.25, 0.1, major_sections=256, minor_sections=128)
    grid = turned_grid(48, 0.016, seed)
    p = centers_world(grid)
    distance = np.hypot(np.hypot(p[..., 0], p[..., 1]) - 0.25, p[..., 2]) - 0.1
    sure = np.abs(distance) > 3e-4
    np.testing.assert_array_equal(solid_of(torus.vertices, torus.faces, grid)[sure], (distance < 0)[sure])


def winding(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Winding numbers by solid angles (van Oosterom & Strackee 1983), for every point and triangle."""
    total = np.zeros(len(points))
    for corners in triangles:
        a, b, c = (corner - points for corner in corners)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        top = (a * np.cross(b, c)).sum(1)
        bottom = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        total += np.arctan2(top, bottom)
    return total / (2 * np.pi)


def test_a_crooked_mesh_against_solid_angles() -> None:
    crooked = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    crooked.vertices *= 1 + 0.4 * np.random.default_rng(2).random((len(crooked.vertices), 1))
    grid = turned_grid(24, 0.04, 5)
    numbers = winding(centers_world(grid).reshape(-1, 3), crooked.triangles).reshape(grid.shape)
    np.testing.assert_allclose(numbers, np.rint(numbers), atol=1e-6)
    solid = solid_of(crooked.vertices, crooked.faces, grid)
    np.testing.assert_array_equal(solid, numbers > 0.5)
    assert solid.sum() > 1000


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_box_on_cell_borders_is_exact(axis: int) -> None:
    """Faces on whole cell borders, edges and diagonals through rows of corners: no cell too many."""
    extents, low = np.array([6, 7, 9]), np.array([3, 5, 4])
    extents, low = np.roll(extents, axis), np.roll(low, axis)
    box = trimesh.creation.box(extents * 0.25)  # a power of two: exact in binary
    vertices = box.vertices + (low + extents / 2) * 0.25
    solid = solid_of(vertices, box.faces, Grid((16, 16, 16), 0.25, np.eye(4)))
    expected = np.zeros((16, 16, 16), bool)
    expected[tuple(slice(a, a + n) for a, n in zip(low, extents, strict=True))] = True
    np.testing.assert_array_equal(solid, expected)


def test_box_through_cell_centres_is_counted_once() -> None:
    """Faces exactly through centres: every cell on one of two opposite faces belongs, on the other not."""
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    vertices = box.vertices + 0.5 + 0.625  # 0.625 .. 1.625, centres of cells 2 and 6 at 0.25 a cell
    solid = solid_of(vertices, box.faces, Grid((16, 16, 16), 0.25, np.eye(4)))
    assert solid.sum() == 4**3


def test_mesh_partly_outside_the_grid() -> None:
    """What sticks out on any side changes nothing within: also below, where columns begin inside."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    for shift in np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 1], [-1, -1, -1]]]) * 0.4:
        T = rigid(np.eye(3), np.full(3, -0.4) + shift)
        grid = Grid((32, 32, 32), 0.025, T)
        distance = np.linalg.norm(centers_world(grid), axis=-1) - 0.5
        sure = np.abs(distance) > 5e-4
        solid = solid_of(ball.vertices, ball.faces, grid)
        np.testing.assert_array_equal(solid[sure], (distance < 0)[sure])
    far = Grid((32, 32, 32), 0.025, rigid(np.eye(3), [5.0, 0, 0]))
    assert not solid_of(ball.vertices, ball.faces, far).any()
    within = Grid((8, 8, 8), 0.025, rigid(np.eye(3), [-0.1, -0.1, -0.1]))
    assert solid_of(ball.vertices, ball.faces, within).all()


def test_overlapping_parts_are_their_union() -> None:
    """Winding numbers add up to two where parts overlap: still inside."""
    one = trimesh.creation.icosphere(subdivisions=4, radius=0.25)
    other = trimesh.creation.box([0.5, 0.2, 0.3])
    other.apply_translation([0.15, 0.02, 0.01])
    vertices = np.concatenate([one.vertices, other.vertices])
    faces = np.concatenate([one.faces, other.faces + len(one.vertices)])
    grid = turned_grid(64, 0.015, 3)
    parts = solid_of(one.vertices, one.faces, grid) | solid_of(other.vertices, other.faces, grid)
    assert parts.sum() > solid_of(one.vertices, one.faces, grid).sum()
    np.testing.assert_array_equal(solid_of(vertices, faces, grid), parts)


def test_a_cavity_is_empty() -> None:
    outer = trimesh.creation.icosphere(subdivisions=4, radius=0.4)
    inner = trimesh.creation.icosphere(subdivisions=4, radius=0.2)
    vertices = np.concatenate([outer.vertices, inner.vertices])
    faces = np.concatenate([outer.faces, inner.faces[:, ::-1] + len(outer.vertices)])
    grid = turned_grid(48, 0.02, 8)
    solid = solid_of(vertices, faces, grid)
    radius = np.linalg.norm(centers_world(grid), axis=-1)
    assert not solid[radius < 0.19].any()
    assert solid[(radius > 0.21) & (radius < 0.39)].all()


def test_grids_need_not_be_cubes() -> None:
    box = trimesh.creation.box([0.5, 0.25, 1.0])
    T = rigid(rotation_from_quaternion_xyzw([0.3, 0.1, -0.4, 0.8]), [-0.1, 0.1, -0.2])
    grid = Grid((20, 12, 40), 0.05, T)
    local = np.abs(centers_world(grid)) - np.array([0.25, 0.125, 0.5])
    sure = np.abs(local.max(axis=-1)) > 1e-5
    solid = solid_of(box.vertices, box.faces, grid)
    np.testing.assert_array_equal(solid[sure], np.all(local < 0, axis=-1)[sure])
    assert solid.sum() > 0 and np.allclose(invert_rigid(grid.T_world_grid), grid.T_grid_world)
