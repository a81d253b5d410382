"""What would top the table of predictions in the camera frame without being the object; what ends a run."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from raising import raises

from kinectbench.core.errors import PredictionError
from kinectbench.core.voxels.pair_file import pack
from kinectbench.scoring import camera_shape
from kinectbench.scoring.camera import surface
from kinectbench.scoring.camera.metrics import PartFigures, figures_by_part
from kinectbench.scoring.camera.solid import solid_in
from kinectbench.scoring.camera.surface import mesh_surface, point_surface
from kinectbench.scoring.camera.truth import SpaceTruth, space_truth
from kinectbench.scoring.camera_shape import CameraShape, occupancy_shape, read_shape
from kinectbench.scoring.closed_mesh import closed_mesh

SIDE, VOXEL_M = 256, 0.004
LOW, HIGH = np.array([28, 66, 53]), np.array([228, 190, 203])


@pytest.fixture(scope="module")
def truth() -> SpaceTruth:
    """A box of 0.8 x 0.5 x 0.6 m, all of it known, in a grid that is the camera's frame."""
    full = np.zeros((SIDE,) * 3, bool)
    full[tuple(slice(a, b) for a, b in zip(LOW, HIGH, strict=True))] = True
    all_of_it = np.full((SIDE, SIDE, SIDE // 8), 255, np.uint8)
    return space_truth(pack(full), all_of_it, np.zeros_like(all_of_it), np.eye(4), VOXEL_M)


def scored(truth: SpaceTruth, shape: CameraShape) -> PartFigures:
    own = surface.surface_of(shape)
    solid = solid_in(truth, shape, closed_mesh(shape), truth.T_grid_camera)
    return figures_by_part(truth, own.transformed(truth.T_grid_camera), solid)[0]["whole"]


def lattice(count: int) -> np.ndarray:
    """Points (count^3, 3) through the whole grid."""
    steps = (np.arange(count) + 0.5) / count * SIDE * VOXEL_M
    return np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("edge_m", [1e-7, 2e-4])
def test_dust_costs_what_it_gains(truth: SpaceTruth, edge_m: float) -> None:
    x, y, z = LOW * VOXEL_M
    right, down, _ = HIGH * VOXEL_M
    front = np.array([[x, y, z], [right, y, z], [right, down, z], [x, down, z]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    alone = scored(truth, CameraShape("mesh", front, faces))
    corners = lattice(70)[:, None] + edge_m * np.eye(3)
    dust = 4 + np.arange(3 * len(corners)).reshape(-1, 3)
    points = np.concatenate([front, corners.reshape(-1, 3)])
    dusty = scored(truth, CameraShape("mesh", points, np.concatenate([faces, dust])))
    assert dusty.surface.f_score_20mm is not None and alone.surface.f_score_20mm is not None
    assert dusty.surface.f_score_20mm < alone.surface.f_score_20mm + 0.05


def test_samples_that_are_judged_cannot_be_chosen(truth: SpaceTruth) -> None:
    cloud = lattice(60)
    step = -(-len(cloud) // 30_000)
    cloud[step // 2 :: step] = (LOW * VOXEL_M + HIGH * VOXEL_M) / 2 * [1, 1, 0] + [0, 0, LOW[2] * VOXEL_M]
    # Every so-manieth point lies on a face; all the others are anywhere.
    found = scored(
        truth,
        CameraShape("points", cloud + 1e-9 * np.arange(len(cloud))[:, None], np.zeros((0, 3), np.int64)),
    )
    assert found.surface.f_score_10mm is not None and found.surface.f_score_10mm < 0.7


@pytest.mark.parametrize("turned", [False, True])
def test_a_second_box_outside_counts_however_it_is_wound(truth: SpaceTruth, turned: bool) -> None:
    one = trimesh.creation.box((HIGH - LOW) * VOXEL_M)
    middle = (LOW + HIGH) / 2 * VOXEL_M
    points = np.concatenate([one.vertices + middle, one.vertices + middle + [1.5, 0, 0]])
    second = one.faces[:, ::-1] if turned else one.faces
    faces = np.concatenate([one.faces, second + len(one.vertices)]).astype(np.int64)
    assert scored(truth, CameraShape("mesh", points, faces)).voxels.iou == pytest.approx(0.5, abs=0.01)


def test_a_mesh_without_area_has_finite_figures(truth: SpaceTruth) -> None:
    points = np.array([[0.1, 0.1, 0.1], [0.1, 0.1, 0.1], [0.5, 0.5, 0.5], [0.6, 0.5, 0.5]])
    own = mesh_surface(points, np.array([[0, 0, 1], [2, 3, 3]]))
    own = replace(own, areas=np.zeros(len(own)))
    found = figures_by_part(truth, own, None)[0]["whole"]
    assert found.surface.chamfer_l1_m is not None and np.isfinite(found.surface.chamfer_l1_m)


def test_equal_points_are_one() -> None:
    points = np.repeat([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]], 50_000, axis=0)
    assert len(point_surface(points, np.ones_like(points))) == 2


def test_noise_in_cells_is_refused_before_it_takes_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    noise = np.indices((32,) * 3).sum(axis=0) % 2 == 0
    shape = occupancy_shape(noise, np.eye(4), 0.01)
    monkeypatch.setattr(surface, "MOST_SAMPLES", 1000)
    with raises(PredictionError, "prediction.too-large"):
        surface.surface_of(shape)
    monkeypatch.setattr(camera_shape, "MOST_SHOWN", 1000)
    with raises(PredictionError, "prediction.too-large"):
        occupancy_shape(noise, np.eye(4), 0.01)


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"points_m": np.zeros((4, 3)), "occupancy": np.ones((4, 4, 4), bool)}, "save one of them"),
        ({"points_m": np.zeros((1 << 23, 3), np.int8)}, "at most"),
        ({"sdf_m": np.full((4, 4, 4), 1e300), "T_camera_grid": np.eye(4), "voxel_size_m": 0.1}, "finite"),
        (
            {"occupancy": np.ones((4, 4, 4), bool), "T_camera_grid": np.eye(4), "voxel_size_m": 1e-200},
            "positive",
        ),
    ],
)
def test_files_that_would_end_a_run_are_one_line(tmp_path: Path, arrays: dict[str, Any], says: str) -> None:
    np.savez_compressed(tmp_path / "000.npz", **arrays)
    with pytest.raises(PredictionError, match=says):
        read_shape(tmp_path / "000.npz", "chair/000")
