"""Registration of predictions to the truth: what was done to a shape is undone; a mirror image stays one."""

from typing import Any

import numpy as np
import pytest
import trimesh
from raising import raises
from scipy.spatial.transform import Rotation
from typed import present

from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.errors import PredictionError
from kinectbench.core.geometry import Grid, rotation_angle_rad, transform_points
from kinectbench.core.geometry.rigid import similarity_scale
from kinectbench.core.voxels.pair_file import pack
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.scoring.camera.align import KINDS, register_surface
from kinectbench.scoring.camera.score_view import Scored, asked_rows, score_shape
from kinectbench.scoring.camera.surface import Surface, mesh_surface
from kinectbench.scoring.camera.truth import SpaceTruth, space_truth
from kinectbench.scoring.camera_shape import CameraShape, distance_shape, occupancy_shape

SIDE = 256
EVERYWHERE = np.full((SIDE, SIDE, SIDE // 8), 255, np.uint8)
# Extents and middles of boxes, metres.
SHAPES = {
    "chair": [
        ((0.5, 0.5, 0.05), (0, 0, 0)),
        ((0.5, 0.05, 0.6), (0, 0.225, 0.32)),
        *(((0.05, 0.05, 0.45), (x, y, -0.25)) for x in (0.2, -0.2) for y in (0.2, -0.2)),
        ((0.05, 0.4, 0.05), (0.24, 0, 0.2)),
        ((0.2, 0.2, 0.1), (0.1, -0.1, 0.08)),
    ],
    "corner": [
        ((0.8, 0.2, 0.15), (0, 0, 0)),
        ((0.15, 0.5, 0.2), (0.3, 0.3, 0.02)),
        ((0.2, 0.2, 0.4), (-0.25, 0, 0.2)),
    ],
}


def shape_of(name: str) -> trimesh.Trimesh:
    """A shape without symmetry, closed, askew in its grid as furniture is in a view's."""
    boxes = [
        trimesh.creation.box(extents=extents, transform=trimesh.transformations.translation_matrix(middle))
        for extents, middle in SHAPES[name]
    ]
    mesh = trimesh.boolean.union(boxes, engine="manifold")
    mesh.vertices = mesh.vertices @ Rotation.from_rotvec([0.4, 0.5, 0.3]).as_matrix().T
    mesh.apply_translation(mesh.extents.max() * 0.55 - mesh.bounds.mean(axis=0))
    return mesh


def truth_of(mesh: trimesh.Trimesh, known: np.ndarray = EVERYWHERE) -> SpaceTruth:
    voxel_m = float(mesh.extents.max() * 1.1 / SIDE)
    grid = Grid((SIDE,) * 3, voxel_m, np.eye(4))
    full = voxelize_solid(np.asarray(mesh.vertices), mesh.faces.astype(np.int32), grid)
    return space_truth(full, known, np.zeros_like(full), np.eye(4), voxel_m)


MESHES = {name: shape_of(name) for name in SHAPES}
TRUTHS = {name: truth_of(mesh) for name, mesh in MESHES.items()}


def surface(mesh: trimesh.Trimesh, T: np.ndarray) -> Surface:
    return mesh_surface(transform_points(T, mesh.vertices), mesh.faces.astype(np.int64))


def similarity(
    mesh: trimesh.Trimesh, shift_m: np.ndarray, scale: float = 1.0, rotvec: np.ndarray | None = None
) -> np.ndarray:
    """About the middle of the mesh."""
    T = np.eye(4)
    T[:3, :3] = scale * Rotation.from_rotvec(np.zeros(3) if rotvec is None else rotvec).as_matrix()
    middle = mesh.bounds.mean(axis=0)
    T[:3, 3] = middle + shift_m - T[:3, :3] @ middle
    return T


def drawn(seed: int, kind: str, mesh: trimesh.Trimesh) -> np.ndarray:
    """A shift of 0.2 m, a scale of 1/2 to 2, a turn of up to 30 degrees, as far as the kind undoes them."""
    rng = np.random.default_rng(seed)
    shift, axis = rng.normal(size=(2, 3))
    scale = 2 ** rng.uniform(-1, 1) if "s" in kind else 1.0
    rotvec = np.radians(rng.uniform(10, 30)) * axis / np.linalg.norm(axis) if "R" in kind else None
    return similarity(mesh, 0.2 * shift / np.linalg.norm(shift), scale, rotvec)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SHAPES)
def test_what_was_done_to_a_shape_is_undone(name: str, kind: str) -> None:
    mesh = MESHES[name]
    for seed in range(6):
        T = drawn(seed, kind, mesh)
        found = register_surface(TRUTHS[name], surface(mesh, T), kind)
        rest = found.T @ T
        moved = np.linalg.norm(transform_points(rest, mesh.vertices) - mesh.vertices, axis=1)
        turn = np.degrees(rotation_angle_rad(rest[:3, :3] / similarity_scale(rest)))
        assert found.ok and moved.max() < 1e-3, (seed, moved.max())
        assert turn < 0.5 and abs(similarity_scale(rest) - 1) < 0.005
        assert np.linalg.det(found.T[:3, :3]) > 0


def boxes(*boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> trimesh.Trimesh:
    """Extents and middles -> their union, askew in its grid."""
    SHAPES["drawn here"] = list(boxes)
    try:
        return shape_of("drawn here")
    finally:
        del SHAPES["drawn here"]


def test_a_shape_whose_distance_rises_on_the_way_to_rest_comes_to_it() -> None:
    """Shelves slide on each other: at first the distance along normals falls below that of the rest."""
    shelves = [((0.8, 0.3, 0.02), (0, 0, z)) for z in (0, 0.3, 0.6, 0.9)]
    sides = [((0.02, 0.3, 0.92), (x, 0, 0.45)) for x in (-0.4, 0.4)]
    things = [((0.15, 0.2, 0.12), (0.2, 0.02, 0.37)), ((0.1, 0.2, 0.2), (-0.25, 0.03, 0.7))]
    mesh = boxes(*shelves, *sides, *things)
    truth = truth_of(mesh)
    for seed in range(4):
        T = drawn(seed, "t", mesh)
        found = register_surface(truth, surface(mesh, T), "t")
        assert found.ok and np.abs((found.T @ T)[:3, 3]).max() < 1e-3


def test_what_turns_about_its_axis_is_at_rest_and_another_shape_is_not() -> None:
    ball = trimesh.creation.icosphere(4, 0.5)
    ball.apply_translation([0.55, 0.55, 0.55])
    truth = truth_of(ball)
    T = drawn(0, "R+t+s", ball)
    found = register_surface(truth, surface(ball, T), "R+t+s")
    middle = ball.bounds.mean(axis=0)
    assert found.ok and np.abs(transform_points(found.T @ T, middle) - middle).max() < 1e-3
    assert not register_surface(truth, surface(MESHES["chair"], np.eye(4)), "R+t+s").ok


def test_largest_turns_and_scales_are_within_reach() -> None:
    """Corners of what is promised: 30 degrees about each axis, and half and double size."""
    mesh = MESHES["chair"]
    for axis in np.eye(3):
        for scale in (0.5, 2.0):
            T = similarity(mesh, np.array([0.115, -0.115, 0.115]), scale, np.radians(30) * axis)
            rest = register_surface(TRUTHS["chair"], surface(mesh, T), "R+t+s").T @ T
            assert np.abs(transform_points(rest, mesh.vertices) - mesh.vertices).max() < 1e-3


def rows_of(truth: SpaceTruth, shape: CameraShape, **declared: Any) -> dict[str, Scored]:
    method = MethodFile(name="net", frame="camera", **declared)
    used = ("camera", "aligned") if method.scale == "metric" else ("aligned",)
    return {
        f"{row.protocol} {row.alignment.kind if row.alignment else ''} {row.part}": row
        for row in score_shape(truth, shape, asked_rows(used, method.scale))
    }


def test_a_mirror_image_is_not_undone() -> None:
    """A chiral shape's mirror keeps a distance of more than 10 mm under every kind: det R is +1."""
    mesh, truth = MESHES["corner"], TRUTHS["corner"]
    mirrored = mesh.vertices * [-1, 1, 1] + [2 * mesh.bounds.mean(axis=0)[0], 0, 0]
    rows = rows_of(truth, CameraShape("mesh", mirrored, mesh.faces[:, ::-1].astype(np.int64)))
    for kind in KINDS:
        far = rows[f"aligned {kind} whole"].figures.surface.chamfer_l1_m
        assert far is not None and far > 0.01, (kind, far)


def test_rows_say_what_was_needed() -> None:
    mesh, truth = MESHES["corner"], TRUTHS["corner"]
    T = similarity(mesh, np.array([0.1, 0, 0]), 2.0, np.radians(20) * np.array([0, 0, 1]))
    shape = CameraShape("mesh", transform_points(T, mesh.vertices), mesh.faces.astype(np.int64))
    rows = rows_of(truth, shape)
    row = rows["aligned R+t+s whole"]
    assert row.alignment is not None and row.alignment.ok
    assert row.alignment.scale == pytest.approx(0.5, rel=0.005)
    assert row.alignment.rotation_deg == pytest.approx(20, abs=0.5)
    # Of the middle of its surface, which is not the middle that it was turned about.
    middle = np.average(mesh.triangles_center, axis=0, weights=mesh.area_faces)
    shift_m = np.linalg.norm(transform_points(T, middle) - middle)
    assert row.alignment.translation_m == pytest.approx(shift_m, abs=2e-3)
    assert row.figures.voxels.iou is not None and row.figures.voxels.iou > 0.98
    camera = rows["camera  whole"].figures
    assert present(camera.surface.chamfer_l1_m) > 10 * present(row.figures.surface.chamfer_l1_m)
    # What a kind does not free stays.
    assert (
        present(rows["aligned t whole"].alignment).scale == 1
        and present(rows["aligned t whole"].alignment).rotation_deg == 0
    )
    free = rows_of(truth, shape, scale="free")
    assert {key.split()[1] for key in free} == {"t+s", "R+t+s"}


@pytest.mark.parametrize("scale", [0.001, 1000.0])
def test_a_free_size_is_ok_whatever_its_unit(scale: float) -> None:
    """Of a shape in millimetres, or a thousandth of its size, the registration comes to rest as of others."""
    mesh = MESHES["corner"]
    found = register_surface(TRUTHS["corner"], surface(mesh, similarity(mesh, np.zeros(3), scale)), "t+s")
    assert found.ok and similarity_scale(found.T) == pytest.approx(1 / scale, rel=0.005)
    assert not register_surface(TRUTHS["corner"], surface(mesh, similarity(mesh, np.zeros(3), scale)), "t").ok


def test_only_known_truth_is_looked_at_and_the_result_is_the_same_each_time() -> None:
    """A third of the truth is unknown; what the prediction has there does not pull it."""
    mesh = MESHES["chair"]
    known = np.ones((SIDE,) * 3, bool)
    known[: SIDE // 3] = False
    truth, T = truth_of(mesh, pack(known)), drawn(1, "R+t+s", mesh)
    first = register_surface(truth, surface(mesh, T), "R+t+s")
    rest = first.T @ T
    assert np.abs(transform_points(rest, mesh.vertices) - mesh.vertices).max() < 5e-3
    assert np.array_equal(register_surface(truth, surface(mesh, T), "R+t+s").T, first.T)


def test_failures_are_said() -> None:
    """Nothing of the truth is known: nothing is registered."""
    mesh = MESHES["corner"]
    truth = truth_of(mesh, np.zeros_like(EVERYWHERE))
    found = register_surface(truth, surface(mesh, np.eye(4)), "t")
    assert not found.ok and np.array_equal(found.T, np.eye(4))


ODD: dict[str, CameraShape] = {
    "one point": CameraShape("points", np.zeros((1, 3)), np.zeros((0, 3), np.int64)),
    "one place": CameraShape("points", np.full((5, 3), 0.3), np.zeros((0, 3), np.int64)),
    "no normals": CameraShape("points", np.eye(3), np.zeros((0, 3), np.int64), np.full((3, 3), np.nan)),
    "far away": CameraShape("points", np.eye(3) * 1e6, np.zeros((0, 3), np.int64)),
    "no area": CameraShape("mesh", np.zeros((3, 3)), np.array([[0, 1, 2]])),
    "two sides": CameraShape("mesh", np.eye(3), np.array([[0, 1, 2], [2, 1, 0]])),
    "one cell": occupancy_shape(np.ones((1, 1, 1), bool), np.eye(4), 0.01),
    "all inside": distance_shape(np.full((8, 8, 8), -0.001, np.float32), np.eye(4), 0.01),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_shapes_have_finite_figures(name: str) -> None:
    rows = rows_of(TRUTHS["corner"], ODD[name])
    for row in rows.values():
        far = row.figures.surface.chamfer_l1_m
        assert (far is None) == (row.part == "visible")
        assert far is None or np.isfinite(far)


def test_distances_without_a_surface_are_refused() -> None:
    shape = distance_shape(np.full((8, 8, 8), 0.001, np.float32), np.eye(4), 0.01)
    with raises(PredictionError, "prediction.empty"):
        rows_of(TRUTHS["corner"], shape)
