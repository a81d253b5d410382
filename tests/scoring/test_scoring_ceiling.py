"""What the truth's uncertainty allows, figures of other papers' code, and how far a method looks."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from kinectbench.core.geometry import Grid, invert_rigid, rigid, transform_points
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.scoring.camera.score_view import Scored, score_shape
from kinectbench.scoring.camera.truth import SpaceTruth, space_truth
from kinectbench.scoring.camera_shape import CameraShape, occupancy_shape
from kinectbench.scoring.closed_mesh import closed_mesh

SIDE, VOXEL_M, RADIUS_M = 256, 0.003, 0.3
MIDDLE_M = np.full(3, SIDE * VOXEL_M / 2)
EVERYWHERE = np.full((SIDE, SIDE, SIDE // 8), 255, np.uint8)
# The ball's middle is 2 m before the camera, on its axis.
T_GRID_CAMERA = rigid(np.eye(3), MIDDLE_M - [0, 0, 2.0])
SIGMA_M = 0.006
MANY = 300_000


def ball(radius_m: float = RADIUS_M) -> trimesh.Trimesh:
    """In the grid."""
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=radius_m)
    mesh.apply_translation(MIDDLE_M)
    return mesh


def truth_of(mesh: trimesh.Trimesh, **more: object) -> SpaceTruth:
    grid = Grid((SIDE,) * 3, VOXEL_M, np.eye(4))
    full = voxelize_solid(np.asarray(mesh.vertices), mesh.faces.astype(np.int32), grid)
    made = space_truth(full, EVERYWHERE, np.zeros_like(full), T_GRID_CAMERA, VOXEL_M)
    return SpaceTruth(**{**vars(made), **more})


def shape_of(mesh: trimesh.Trimesh) -> CameraShape:
    points = transform_points(invert_rigid(T_GRID_CAMERA), mesh.vertices)
    return CameraShape("mesh", points, mesh.faces.astype(np.int64))


def whole(truth: SpaceTruth, shape: CameraShape, volume_m: np.ndarray | None = None) -> Scored:
    return score_shape(truth, shape, [("camera", None)], volume_m)[0]


def moved(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The surface moved along its normals by a smooth normal field of standard deviation SIGMA_M."""
    rng = np.random.default_rng(2)
    waves = rng.normal(size=(300, 3))
    waves *= 2 * np.pi / 0.15 / np.linalg.norm(waves, axis=1, keepdims=True)
    field = np.cos(mesh.vertices @ waves.T + rng.uniform(0, 2 * np.pi, 300)).sum(axis=1)
    field *= SIGMA_M / field.std()
    return trimesh.Trimesh(mesh.vertices + field[:, None] * mesh.vertex_normals, mesh.faces, process=False)


def test_the_ceiling_is_what_a_surface_moved_by_sigma_has() -> None:
    """A surface of cells is nearer than what it stands for, so that a tenth is missing."""
    real = moved(ball())
    assert closed_mesh(shape_of(real)) is not None
    figures = whole(truth_of(ball(), sigma_m=SIGMA_M), shape_of(real)).figures
    found, allowed = figures.surface, figures.ceiling
    assert allowed is not None
    assert found.chamfer_l1_m == pytest.approx(allowed.chamfer_l1_m, rel=0.1)
    assert found.chamfer_l2_m2 == pytest.approx(allowed.chamfer_l2_m2, rel=0.2)
    for name in ("f_score_5mm", "f_score_10mm", "f_score_20mm", "f_score_1pct", "f_score_2pct"):
        assert getattr(found, name) == pytest.approx(getattr(allowed, name), abs=0.05), name
    assert figures.voxels.iou == pytest.approx(allowed.iou, abs=0.005)
    assert allowed.chamfer_l1_m == pytest.approx(0.7979 * SIGMA_M, rel=1e-3)
    assert allowed.f_score_5mm == pytest.approx(0.5953, abs=1e-3)  # of 5/6 sigma, by a table


def test_an_exact_truth_has_no_ceiling() -> None:
    assert whole(truth_of(ball()), shape_of(ball())).figures.ceiling is None


@pytest.fixture(scope="module")
def compared() -> tuple[Scored, np.ndarray, np.ndarray]:
    """A ball that is 8 mm larger and beside its place; points on both surfaces."""
    mesh = ball(RADIUS_M + 0.008)
    mesh.apply_translation([0.01, 0, 0])
    truth = truth_of(ball())
    ours = trimesh.sample.sample_surface(mesh, MANY, seed=1)[0]
    rng, of = np.random.default_rng(3), truth.surface
    at, inside = rng.choice(len(of), MANY, p=of.areas / of.areas.sum()), rng.random((2, MANY, 1))
    theirs = of.corner[at] + inside[0] * of.first[at] + inside[1] * of.second[at]
    return whole(truth, shape_of(mesh)), ours, theirs


def test_figures_are_those_of_octmae(compared: tuple[Scored, np.ndarray, np.ndarray]) -> None:
    """eval.py: mm; half of both ways; F at d <= t."""
    row, p, t = compared[0].figures.as_papers, *(of * 1000 for of in compared[1:])
    acc, comp = cKDTree(t).query(p)[0], cKDTree(p).query(t)[0]
    assert row is not None
    # The points here are 1 mm apart; where the surfaces cross, that is no distance from a surface.
    assert row.octmae_chamfer_l1_mm == pytest.approx((acc.mean() + comp.mean()) / 2, rel=0.06)
    assert row.octmae_chamfer_l2_mm2 == pytest.approx(((acc**2).mean() + (comp**2).mean()) / 2, rel=0.06)
    for far in (5, 10, 20, 30):
        precision, recall = (acc <= far).mean(), (comp <= far).mean()
        f = 2 * precision * recall / (precision + recall)
        assert getattr(row, f"octmae_f_{far}mm") == pytest.approx(f, abs=0.03)


def test_figures_are_those_of_pcn(compared: tuple[Scored, np.ndarray, np.ndarray]) -> None:
    """AdaPoinTr's: half of both ways x 1000, the sum of squares x 1000, F below 0.01; the diagonal is 1."""
    truth = truth_of(ball())
    row, p, t = compared[0].figures.as_papers, *(of[:16_384] / truth.size_m for of in compared[1:])
    there, back = cKDTree(t).query(p)[0], cKDTree(p).query(t)[0]
    assert row is not None
    assert row.pcn_chamfer_l1 == pytest.approx((there.mean() + back.mean()) / 2 * 1000, rel=0.03)
    assert row.pcn_chamfer_l2 == pytest.approx(((there**2).mean() + (back**2).mean()) * 1000, rel=0.03)
    precision, recall = (there < 0.01).mean(), (back < 0.01).mean()
    assert row.pcn_f == pytest.approx(2 * precision * recall / (precision + recall), abs=0.02)


def test_figures_are_those_of_sds_complete(compared: tuple[Scored, np.ndarray, np.ndarray]) -> None:
    """mm; half of both ways, and the sum of both ways of squares."""
    row, p, t = compared[0].figures.as_papers, *(of[:16_384] * 1000 for of in compared[1:])
    there, back = cKDTree(t).query(p)[0], cKDTree(p).query(t)[0]
    assert row is not None
    assert row.sds_chamfer_l1_mm == pytest.approx((there.mean() + back.mean()) / 2, rel=0.03)
    assert row.sds_chamfer_l2_mm2 == pytest.approx((there**2).mean() + (back**2).mean(), rel=0.03)


def test_a_volume_that_ends_in_the_middle_cuts_one_half() -> None:
    truth = truth_of(ball())
    assert whole(truth, shape_of(ball())).cut is None
    half = np.array([[-1.0, -1.0, 0.0], [0.0, 1.0, 5.0]])
    assert whole(truth, shape_of(ball()), half).cut == pytest.approx(0.5, abs=0.005)
    # Cells have the volume of their grid, which here begins at the ball's middle.
    T = np.eye(4)
    T[:3, 3] = [-0.5, -0.5, 2.0]
    cells = occupancy_shape(np.ones((20, 20, 20), bool), T, 0.05)
    assert whole(truth, cells).cut == pytest.approx(0.5, abs=0.005)


def test_what_projects_outside_the_mask_is_stated() -> None:
    """A camera that looks along z at the ball's middle; its mask is the left half of the image."""
    K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    mask = np.zeros((241, 321), bool)
    mask[:, :160] = True
    assert whole(truth_of(ball()), shape_of(ball())).silhouette is None
    truth = truth_of(ball(), K=K, mask=mask)
    assert whole(truth, shape_of(ball())).silhouette == pytest.approx(0.5, abs=0.01)
    assert whole(truth_of(ball(), K=K, mask=np.ones_like(mask)), shape_of(ball())).silhouette == 0
    behind = CameraShape("points", np.array([[0, 0, -2.0], [-0.1, 0, 2]]), np.zeros((0, 3), np.int64))
    assert whole(truth, behind).silhouette == 0.5


def test_parts_have_their_own_ceiling_of_the_iou() -> None:
    """A part's volume and surface: the part that was not seen is all here, the other has none."""
    rows = score_shape(truth_of(ball(), sigma_m=SIGMA_M), shape_of(ball()), [("camera", None)])
    of = {row.part: row.figures.ceiling for row in rows}
    assert of["visible"] is None and of["occluded"] == of["whole"]
