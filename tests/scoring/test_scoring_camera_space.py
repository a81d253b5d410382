"""Predictions in the camera frame against the truth in space: solids, distances, parts, unknown space."""

import time

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from typed import present

from kinectbench.core.artefacts.score_figures import ShapePart
from kinectbench.core.geometry import invert_rigid, rigid, transform_points
from kinectbench.core.voxels.pair_file import pack, unpack
from kinectbench.scoring.camera.metrics import PartFigures, figures_by_part
from kinectbench.scoring.camera.score_view import asked_rows, score_shape
from kinectbench.scoring.camera.solid import solid_in
from kinectbench.scoring.camera.surface import cell_surface, mesh_surface, surface_of
from kinectbench.scoring.camera.truth import SpaceTruth, space_truth
from kinectbench.scoring.camera_shape import CameraShape, distance_shape, occupancy_shape
from kinectbench.scoring.closed_mesh import closed_mesh

VOXEL_M = 0.003
SIDE = 256
RADIUS_M, MIDDLE_M = 0.3, np.full(3, 0.384)
EVERYWHERE = np.full((SIDE, SIDE, SIDE // 8), 255, np.uint8)
T_CAMERA = rigid(trimesh.transformations.rotation_matrix(0.4, [1, 2, 3])[:3, :3], [0.2, -0.1, -1.5])


def ball_cells() -> np.ndarray:
    away = np.indices((SIDE,) * 3).transpose(1, 2, 3, 0) + 0.5 - SIDE / 2
    return np.asarray((away**2).sum(axis=-1) * VOXEL_M**2 < RADIUS_M**2)


def ball(radius_m: float = RADIUS_M) -> CameraShape:
    """In the camera frame."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius_m)
    points = transform_points(invert_rigid(T_CAMERA), mesh.vertices + MIDDLE_M)
    return CameraShape("mesh", points, mesh.faces.astype(np.int64))


@pytest.fixture(scope="module")
def truth() -> SpaceTruth:
    """A ball of which the view saw the part at low z."""
    seen = np.zeros((SIDE,) * 3, bool)
    seen[..., : SIDE // 2] = True
    return space_truth(pack(ball_cells()), EVERYWHERE, pack(seen), T_CAMERA, VOXEL_M)


def figures(truth: SpaceTruth, shape: CameraShape) -> tuple[dict[ShapePart, PartFigures], float]:
    T = truth.T_grid_camera
    solid = solid_in(truth, shape, closed_mesh(shape), T)
    return figures_by_part(truth, surface_of(shape).transformed(T), solid)


def cube_mesh(truth: SpaceTruth) -> CameraShape:
    """The boundary of the truth's cells as a closed mesh of triangles, in the camera frame."""
    own = truth.surface
    corners = np.concatenate([own.corner, own.corner + own.first, own.corner + own.second + own.first])
    corners = np.concatenate([corners, own.corner + own.second])
    grid = np.rint(corners / truth.voxel_size_m).astype(np.int64)
    vertices, index = np.unique(grid, axis=0, return_inverse=True)
    a, b, c, d = index.reshape(4, -1)
    outwards = np.einsum("ij,ij->i", np.cross(own.first, own.second), own.points_m - _inner(truth)) > 0
    b, d = np.where(outwards, b, d), np.where(outwards, d, b)
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    points = transform_points(invert_rigid(truth.T_grid_camera), vertices * truth.voxel_size_m)
    return CameraShape("mesh", points, faces.astype(np.int64))


def _inner(truth: SpaceTruth) -> np.ndarray:
    """The centre of the occupied cell of each face."""
    return np.asarray((cell_surface(unpack(truth.full), truth.voxel_size_m)[1] + 0.5) * truth.voxel_size_m)


def exact_chamfer_m(truth: SpaceTruth, shape: CameraShape) -> float:
    """By Open3D: exact distances to triangles, of samples at random by area on both surfaces."""
    one = trimesh.Trimesh(transform_points(truth.T_grid_camera, shape.points_m), shape.faces, process=False)
    other = cube_mesh(truth)
    two = trimesh.Trimesh(transform_points(truth.T_grid_camera, other.points_m), other.faces, process=False)
    means = []
    for near, far in ((one, two), (two, one)):
        points = trimesh.sample.sample_surface(near, 200_000, seed=1)[0]
        means.append(float(exact_m(far, points).mean()))
    return sum(means) / 2


def exact_m(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Distances of points (n, 3) to triangles, by Open3D."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return np.asarray(scene.compute_distance(o3d.core.Tensor.from_numpy(points.astype(np.float32))).numpy())


def test_the_truth_as_a_mesh_is_perfect(truth: SpaceTruth) -> None:
    shape = cube_mesh(truth)
    found, left_out = figures(truth, shape)
    whole = found["whole"]
    assert left_out == 0 and closed_mesh(shape) is not None
    assert whole.voxels.iou == 1 and whole.surface.chamfer_l1_m == pytest.approx(0, abs=1e-6)
    assert whole.surface.f_score_5mm == 1 and whole.surface.f_score_1pct == 1


@pytest.mark.parametrize("radius_m", [0.28, 0.3, 0.32])
def test_a_mesh_has_its_iou_and_its_chamfer_distance(truth: SpaceTruth, radius_m: float) -> None:
    """IoU by the volumes of balls; Chamfer distance by exact distances to triangles."""
    shape = ball(radius_m)
    whole = figures(truth, shape)[0]["whole"]
    ratio = min(radius_m / RADIUS_M, RADIUS_M / radius_m) ** 3
    assert whole.voxels.iou == pytest.approx(ratio, abs=0.005)
    assert whole.surface.chamfer_l1_m == pytest.approx(exact_chamfer_m(truth, shape), abs=1e-4)
    assert whole.surface.chamfer_l1_m == pytest.approx(abs(radius_m - RADIUS_M), abs=VOXEL_M / 2)
    assert present(whole.surface.normal_consistency) > 0.99
    assert whole.surface.f_score_10mm == float(radius_m == RADIUS_M)


def test_every_form_of_a_ball_has_the_same_figures(truth: SpaceTruth) -> None:
    """Cells and distances in a grid of the method's own, turned and of another cell; points without solid."""
    T = rigid(trimesh.transformations.rotation_matrix(0.7, [3, 1, 2])[:3, :3], [0, 0, 0])
    middle = transform_points(invert_rigid(T_CAMERA), MIDDLE_M[None])[0]
    T[:3, 3] = middle - T[:3, :3] @ np.full(3, 0.36)
    away = np.linalg.norm((np.indices((120,) * 3).transpose(1, 2, 3, 0) + 0.5) * 0.006 - 0.36, axis=-1)
    distances = distance_shape((away - RADIUS_M).astype(np.float32), T, 0.006)
    cells = occupancy_shape(away < RADIUS_M, T, 0.006)
    mesh = figures(truth, ball())[0]["whole"]
    for shape, far in ((distances, 3e-4), (cells, 2e-3)):
        whole = figures(truth, shape)[0]["whole"]
        assert whole.voxels.iou == pytest.approx(mesh.voxels.iou, abs=0.03 if shape is cells else 0.003)
        assert whole.surface.chamfer_l1_m == pytest.approx(mesh.surface.chamfer_l1_m, abs=far)
        assert present(whole.surface.normal_consistency) > 0.98
    cloud = CameraShape("points", surface_of(ball()).points_m, np.zeros((0, 3), np.int64))
    whole = figures(truth, cloud)[0]["whole"]
    assert whole.voxels.iou is None and whole.surface.normal_consistency is None
    # Points are as far from each other as their gaps are wide.
    assert whole.surface.chamfer_l1_m == pytest.approx(mesh.surface.chamfer_l1_m, abs=5e-3)


def test_an_open_mesh_has_no_solid(truth: SpaceTruth) -> None:
    whole_ball = ball()
    shape = CameraShape("mesh", whole_ball.points_m, whole_ball.faces[1:])
    whole = figures(truth, shape)[0]["whole"]
    assert whole.voxels.iou is None and present(whole.surface.chamfer_l1_m) < 1e-3


def test_parts_are_what_the_view_saw_and_the_rest(truth: SpaceTruth) -> None:
    """A half ball answers the part that was seen, and the rest not at all."""
    grid_ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS_M)
    low = (grid_ball.vertices[grid_ball.faces].mean(axis=1) < 0)[:, 2]
    points = transform_points(invert_rigid(T_CAMERA), grid_ball.vertices + MIDDLE_M)
    found, _ = figures(truth, CameraShape("mesh", points, grid_ball.faces[low].astype(np.int64)))
    assert present(found["visible"].surface.f_score_5mm) > 0.99
    assert present(found["occluded"].surface.f_score_20mm) < 0.2
    assert 0.2 < present(found["whole"].surface.f_score_20mm) < 0.9
    assert found["occluded"].coverage_shape == pytest.approx(0.5, abs=0.01)


def test_what_lies_in_unknown_space_is_left_out_and_stated(truth: SpaceTruth) -> None:
    """Nobody knows the upper half: the ball is right in the rest."""
    known = np.zeros((SIDE,) * 3, bool)
    known[..., : SIDE // 2] = True
    half = space_truth(pack(ball_cells()), pack(known), pack(~known), T_CAMERA, VOXEL_M)
    found, left_out = figures(half, ball())
    whole = found["whole"]
    assert left_out == pytest.approx(0.5, abs=0.01) and half.unknown_share == pytest.approx(0.5, abs=0.01)
    assert whole.surface_unknown_share == pytest.approx(0.5, abs=0.01)
    assert present(whole.voxels.iou) > 0.99 and present(whole.surface.chamfer_l1_m) < 1e-3
    # Of what the view saw nothing is known.
    assert found["visible"].surface.chamfer_l1_m is None and found["visible"].voxels.iou is None


def test_outside_the_volume_all_is_free_and_known(truth: SpaceTruth) -> None:
    """A second ball beside the volume halves the IoU, and is far from the truth."""
    one = ball()
    far = one.points_m + invert_rigid(T_CAMERA)[:3, :3] @ [1.0, 0, 0]
    both = CameraShape(
        "mesh", np.concatenate([one.points_m, far]), np.concatenate([one.faces, one.faces + len(far)])
    )
    found, left_out = figures(truth, both)
    assert left_out == 0
    assert found["whole"].voxels.iou == pytest.approx(0.5, abs=0.005)
    assert present(found["visible"].voxels.iou) > 0.99
    assert present(found["whole"].surface.chamfer_l1_m) > 0.1


def test_large_and_small_triangles_are_exact() -> None:
    """Samples of a mesh have exact distances to it, whatever its triangles are like."""
    box = trimesh.creation.box(extents=(0.6, 0.5, 0.4))
    slivers = trimesh.creation.cylinder(0.2, 0.9, sections=300)
    for mesh in (box, slivers, trimesh.creation.icosphere(subdivisions=6, radius=0.3)):
        surface = mesh_surface(mesh.vertices, mesh.faces.astype(np.int64))
        assert surface.areas.sum() == pytest.approx(mesh.area)
        places = trimesh.sample.sample_surface(mesh, 3000, seed=3)[0] + np.random.default_rng(4).normal(
            0, 0.02, (3000, 3)
        )
        found = surface.nearest(places)[0]
        assert np.abs(found - exact_m(mesh, places)).mean() < 1e-4


def test_a_view_takes_no_longer_than_nine_searches_of_scipy(truth: SpaceTruth) -> None:
    """A mesh of 80,000 faces, all metrics and registrations, on one core; once all is compiled.

    A search: a tree of 80,000 points is made, and the nearest to 40,000 others are found, 0.1 s of a core. So
    the speed of the machine does not count. `benchmarks/speed/score_camera.py` measures views of a release.
    """
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=0.31)
    points = transform_points(invert_rigid(T_CAMERA), mesh.vertices + MIDDLE_M)
    shape = CameraShape("mesh", points, mesh.faces.astype(np.int64))
    some, others = np.split(np.random.default_rng(0).random((120_000, 3)), [80_000])
    taken, searched = [], []
    for _ in range(4):
        start = time.process_time()
        own = space_truth(truth.full, EVERYWHERE, truth.seen, T_CAMERA, VOXEL_M)
        score_shape(own, shape, asked_rows(("camera", "aligned"), "metric"))
        middle = time.process_time()
        cKDTree(some).query(others)
        taken.append(middle - start)
        searched.append(time.process_time() - middle)
    assert min(taken) < 9 * min(searched)
