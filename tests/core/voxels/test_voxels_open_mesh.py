"""The authors' rule for meshes that need not be closed: against hand-counted cells and a plain reference."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from trimesh.caching import TrackedArray

from kinectbench.core.geometry import Grid, rigid, rotation_from_quaternion_xyzw, transform_points
from kinectbench.core.voxels.open_mesh import voxelize_open
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import voxelize_solid

UNIT = np.eye(4)


def cells_of(
    vertices: NDArray[np.float64] | TrackedArray,
    faces: NDArray[np.int64] | list[list[int]] | TrackedArray | NDArray[np.float64],
    grid: Grid,
) -> np.ndarray:
    packed = voxelize_open(np.asarray(vertices, float), np.asarray(faces, np.int32), grid)
    assert packed.dtype == np.uint8 and packed.shape == (*grid.shape[:2], grid.shape[2] // 8)
    return unpack(packed)


def crossings_along(axis: int, origins: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
    """Where the whole line through each origin along an axis crosses triangles, as coordinates: plain."""
    u, v = (a for a in range(3) if a != axis)
    found = []
    for p in origins:
        heights = []
        for a, b, c in triangles:
            matrix = np.array([[b[u] - a[u], c[u] - a[u]], [b[v] - a[v], c[v] - a[v]]])
            if abs(np.linalg.det(matrix)) < 1e-12:
                continue
            s, t = np.linalg.solve(matrix, [p[u] - a[u], p[v] - a[v]])
            if s >= 0 and t >= 0 and s + t <= 1:
                heights.append(a[axis] + s * (b[axis] - a[axis]) + t * (c[axis] - a[axis]))
        found.append(np.array(heights))
    return found


def reference(triangles: np.ndarray, side: int) -> np.ndarray:
    """The rule, cell by cell, for triangles in cells of a cube of `side` cells."""
    occupied = np.ones((side,) * 3, bool)
    for axis in range(3):
        lines = np.array([(i, j) for i in range(side) for j in range(side)])
        origins = np.insert(lines + 0.5, axis, 0.0, axis=1)
        for (i, j), heights in zip(lines, crossings_along(axis, origins, triangles), strict=True):
            centres = np.arange(side) + 0.5
            both = [(heights < centre).any() and (heights > centre).any() for centre in centres]
            np.moveaxis(occupied, axis, 2)[i, j] &= both
    for axis in range(3):
        lines = np.array([(i, j) for i in range(side + 1) for j in range(side + 1)])
        origins = np.insert(lines.astype(float), axis, 0.0, axis=1)
        along = np.moveaxis(occupied, axis, 2)
        for (i, j), heights in zip(lines, crossings_along(axis, origins, triangles), strict=True):
            for k in np.floor(heights[(heights >= 0) & (heights < side)]).astype(int):
                along[max(0, i - 1) : i + 1, max(0, j - 1) : j + 1, k] = True
    return occupied


@pytest.mark.parametrize("seed", range(3))
def test_loose_triangles_against_the_plain_rule(seed: int) -> None:
    """Forty triangles anywhere, also beyond the grid: no closed part among them."""
    triangles = np.random.default_rng(seed).uniform(-4, 20, (40, 3, 3))
    vertices, faces = triangles.reshape(-1, 3), np.arange(120).reshape(-1, 3)
    expected = reference(triangles, 16)
    cells = cells_of(vertices, faces, Grid((16, 16, 16), 1.0, UNIT))
    np.testing.assert_array_equal(cells, expected)
    assert 0.2 < expected.mean() < 0.9


def test_a_grid_in_another_frame_and_unit() -> None:
    triangles = np.random.default_rng(7).uniform(2, 14, (12, 3, 3))
    T = rigid(rotation_from_quaternion_xyzw([0.3, 0.1, -0.4, 0.8]), [-0.1, 0.4, -0.2])
    vertices = transform_points(T, triangles.reshape(-1, 3) * 0.05)
    cells = cells_of(vertices, np.arange(36).reshape(-1, 3), Grid((16, 16, 16), 0.05, T))
    np.testing.assert_array_equal(cells, reference(triangles, 16))


def open_box(low: list[float], high: list[float], without: int) -> tuple[np.ndarray, np.ndarray]:
    """A box from corner to corner, in cells, without the two triangles of one side."""
    box = trimesh.creation.box(bounds=[low, high])
    normals = box.face_normals
    axis, sign = without // 2, 1 if without % 2 else -1
    return np.asarray(box.vertices), np.asarray(box.faces)[normals[:, axis] * sign < 0.5]


@pytest.mark.parametrize("without", range(6))
def test_a_box_with_one_side_missing_is_its_walls(without: int) -> None:
    """From within, one of the six rays escapes: nothing but the cells of the five walls is left."""
    vertices, faces = open_box([3.3, 2.4, 4.2], [9.7, 11.6, 12.8], without)
    expected = np.zeros((16, 16, 16), bool)
    expected[3:10, 2:12, 4:13] = True
    expected[4:9, 3:11, 5:12] = False
    axis = without // 2
    side = np.moveaxis(expected, axis, 0)
    layer = (3, 2, 4)[axis] if without % 2 == 0 else (9, 11, 12)[axis]
    inner = np.moveaxis(np.zeros((16, 16, 16), bool), axis, 0)
    rows, columns = [slice(a, b) for n, (a, b) in enumerate([(4, 9), (3, 11), (5, 12)]) if n != axis]
    inner[layer, rows, columns] = True
    side[inner] = False
    np.testing.assert_array_equal(cells_of(vertices, faces, Grid((16, 16, 16), 1.0, UNIT)), expected)


def test_a_slit_open_box_is_filled_but_for_what_the_slit_sees() -> None:
    """A face is missing only in part: cells whose six rays all hit are inside, the others are not."""
    vertices, faces = open_box([2.3, 2.3, 2.3], [12.7, 12.7, 12.7], 5)
    lid = np.array([[2.3, 2.3, 12.7], [6.6, 2.3, 12.7], [6.6, 12.7, 12.7], [2.3, 12.7, 12.7]])
    faces = np.concatenate([faces, np.array([[0, 1, 2], [0, 2, 3]]) + len(vertices)])
    cells = cells_of(np.concatenate([vertices, lid]), faces, Grid((16, 16, 16), 1.0, UNIT))
    assert cells[3:6, 3:12, 3:12].all()  # below the lid
    assert not cells[7:12, 3:12, 3:12].any()  # below the opening
    assert cells[12, 2:13, 2:13].all() and not cells[13:].any()


def test_a_sheet_between_two_layers_occupies_both() -> None:
    sheet = np.array([[2.5, 2.5, 8.0], [12.5, 2.5, 8.0], [12.5, 12.5, 8.0], [2.5, 12.5, 8.0]])
    expected = np.zeros((16, 16, 16), bool)
    expected[2:13, 2:13, 7:9] = True
    faces = [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_array_equal(cells_of(sheet, faces, Grid((16, 16, 16), 1.0, UNIT)), expected)
    # Turned about: no rounding may tear holes into a sheet that lies exactly between two layers.
    T = rigid(rotation_from_quaternion_xyzw([0.2, -0.5, 0.4, 0.7]), [0.3, 0.1, -0.7])
    turned = cells_of(transform_points(T, sheet * 0.013), faces, Grid((16, 16, 16), 0.013, T))
    np.testing.assert_array_equal(turned, expected)


def test_orientation_and_order_of_the_faces_do_not_matter() -> None:
    ring = trimesh.creation.torus(0.25, 0.1)
    rng = np.random.default_rng(4)
    faces = np.asarray(ring.faces)
    mixed = np.where(rng.random(len(faces))[:, None] < 0.5, faces, faces[:, ::-1])
    mixed = mixed[rng.permutation(len(faces))]
    grid = Grid((32, 32, 32), 0.03, rigid(np.eye(3), [-0.48, -0.48, -0.48]))
    cells = cells_of(ring.vertices, faces, grid)
    assert cells.sum() > 1000
    np.testing.assert_array_equal(cells_of(ring.vertices, mixed, grid), cells)


def test_a_closed_ball_is_its_solid_and_its_surface_cells() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.3)
    grid = Grid((48, 48, 48), 0.015, rigid(np.eye(3), [-0.36, -0.361, -0.362]))
    solid = unpack(voxelize_solid(ball.vertices, ball.faces.astype(np.int32), grid))
    cells = cells_of(ball.vertices, ball.faces, grid)
    assert not (solid & ~cells).any()
    index = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1)
    centres = transform_points(grid.T_world_grid, (index + 0.5) * grid.voxel_size_m)
    outside_m = np.linalg.norm(centres, axis=-1)[cells & ~solid] - 0.3
    # A cell outside that is occupied has an edge across the surface: it is nearer than half its diagonal.
    assert outside_m.size > 0 and outside_m.max() < 0.015 * np.sqrt(3) / 2


def test_nothing_within_the_grid() -> None:
    sheet = np.array([[20.0, 20, 20], [30, 20, 20], [20, 30, 20]])
    assert not cells_of(sheet, [[0, 1, 2]], Grid((16, 16, 16), 1.0, UNIT)).any()
    assert not cells_of(np.zeros((0, 3)), np.zeros((0, 3)), Grid((16, 16, 16), 1.0, UNIT)).any()
