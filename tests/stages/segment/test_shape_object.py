"""The stage `segment` on a simulated chair, its folder, and its grids."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chair_model import FUSION, Chair
from chair_model import chair as make_chair
from raising import raises
from same_fields import assert_same_fields
from typed import present

from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import SegmentationError, StorageError
from kinectbench.core.geometry import OrientedBox, invert_rigid, transform_points
from kinectbench.release.publish.held_back import own_floor
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.floor_choice import NO_CHOICE
from kinectbench.stages.segment.find.planes import floor_frame
from kinectbench.stages.segment.object_model import read_object, write_object
from kinectbench.stages.segment.solid.grids import FLOOR_LAYERS, MARGIN_M, object_grid, surround_grid

pytestmark = pytest.mark.xdist_group("chair_model")
FLOOR = Floor(np.array([0.0, 0, 1, 0.3]), floor_frame(np.array([0.0, 0, 1, 0.3])), 0.001, 0.5)


@pytest.fixture(scope="module")
def chair() -> Chair:
    return make_chair()


def test_the_solid_is_the_true_chair(chair: Chair) -> None:
    shape = chair.model.shape
    true = chair.recorded.occupancy(shape.grid)
    iou = (shape.solid & true).sum() / (shape.solid | true).sum()
    assert iou > 0.78  # voxels of 8 mm, 24 noisy frames
    sure = np.isin(shape.labels, [Label.FREE, Label.SURFACE, Label.INTERIOR])
    assert (shape.solid == true)[sure].mean() > 0.985
    assert (shape.labels == Label.FREE).mean() > 0.3


def test_the_floor_is_the_true_floor(chair: Chair) -> None:
    true = chair.recorded.floor_plane_world
    found = chair.model.floor.plane_world
    assert np.degrees(np.arccos(min(1.0, float(true[:3] @ found[:3])))) < 0.4
    under = chair.recorded.T_world_object[:3, 3]
    assert abs(found[:3] @ under + found[3]) < 0.005


def test_the_box_holds_the_chair(chair: Chair) -> None:
    corners = transform_points(chair.model.floor.T_floor_world, chair.recorded.mesh_world.vertices)
    assert chair.model.box.grown(0.03).contains(corners).mean() > 0.99
    assert chair.model.box.size_m[2] == pytest.approx(corners[:, 2].max(), abs=0.02)
    assert 0.7 < present(chair.model.quality.repeatability_iou) <= 1
    assert 0.0002 < chair.model.surface_sigma_m < 0.005


def test_the_surround_holds_every_cube(chair: Chair) -> None:
    """Whatever the orientation: a cube's corner is at most half its diagonal from the mesh's middle."""
    model = chair.model
    vertices = model.shape.mesh.vertices
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    rng = np.random.default_rng(0)
    for _ in range(20):
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turned = vertices @ rotation
        half = np.ptp(turned, axis=0).max() * 256 / 252 / 2
        centre = (turned.min(axis=0) + turned.max(axis=0)) / 2
        signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T
        corners = (centre + half * signs) @ rotation.T
        local = transform_points(model.surround.T_grid_world, corners)
        assert (local > 0).all() and (local < model.surround.size_m).all()
    assert np.isfinite(middle).all()
    assert set(np.unique(model.surround_labels)) <= {Label.FREE, Label.OTHER, Label.UNKNOWN}


def test_surround_agrees_with_the_truth(chair: Chair) -> None:
    """Nothing of the chair is free, and below the floor nothing is."""
    model = chair.model
    true = chair.recorded.occupancy(model.surround)
    assert (model.surround_labels[true] == Label.FREE).mean() < 0.1
    index = np.argwhere(model.surround_labels == Label.FREE)
    points = transform_points(
        model.floor.T_floor_world @ model.surround.T_world_grid, (index + 0.5) * model.surround.voxel_size_m
    )
    assert points[:, 2].min() > 0


def test_object_grid_is_upright_and_holds_the_box() -> None:
    box = OrientedBox((0.4, -0.3, 0.25), (0.5, 0.3, 0.5), 0.6)
    grid = object_grid(box, FLOOR, 0.005)
    assert all(n % 16 == 0 for n in grid.shape)
    T_floor_grid = FLOOR.T_floor_world @ grid.T_world_grid
    np.testing.assert_allclose(T_floor_grid[:3, 2], [0, 0, 1], atol=1e-12)
    assert T_floor_grid[2, 3] == pytest.approx(-FLOOR_LAYERS * 0.005)  # a cell border lies at z = 0
    corners = transform_points(invert_rigid(T_floor_grid), box.corners_floor())
    assert corners[:, :2].min() >= MARGIN_M - 1e-9
    assert (grid.size_m[:2] - corners[:, :2].max(axis=0)).min() >= MARGIN_M - 1e-9
    assert grid.size_m[2] - corners[:, 2].max() >= MARGIN_M - 1e-9
    assert np.all(grid.size_m - np.ptp(corners @ np.eye(3), axis=0) < 2 * MARGIN_M + 16 * 0.005 + 0.02)


def test_too_large_an_object() -> None:
    with raises(SegmentationError, "segmentation.too-large", match=r"of 1 mm.*box"):
        object_grid(OrientedBox((0, 0, 1), (3, 3, 2)), FLOOR, 0.001)
    said = r"the given box is 60\.1 x 60\.1 x .* too large for voxels of 5 mm; give a smaller one"
    with raises(SegmentationError, "segmentation.too-large", match=said):
        object_grid(OrientedBox((0, 0, 45), (60, 60, 90)), FLOOR, 0.005, given=True)
    for size_m in (1e5, 1e6, 1e7):  # the voxels of the second are more than 2^63
        with raises(SegmentationError, "segmentation.too-large", match="of 5 mm"):
            object_grid(OrientedBox((0, 0, 1), (size_m, size_m, size_m)), FLOOR, 0.005, given=True)


def test_an_object_as_large_as_a_room_is_refused_at_the_usual_voxels() -> None:
    with raises(SegmentationError, "segmentation.too-large", match=r"4.9.*1.1.*5"):
        object_grid(OrientedBox((0, 0, 0.53), (4.8, 4.8, 1.06)), FLOOR, 0.005)


@pytest.mark.parametrize(("side_m", "cell_m"), [(0.6, 0.020), (3.4, 0.025)])
def test_the_surround_holds_every_cube_and_stays_small(side_m: float, cell_m: float) -> None:
    grid = object_grid(OrientedBox((0, 0, 0.2), (side_m, side_m, 0.4)), FLOOR, 0.005)
    surround = surround_grid(grid, FLOOR)
    assert surround.voxel_size_m == pytest.approx(cell_m)
    assert max(surround.shape) <= 416
    # A cube of the longest diagonal, whatever its orientation, in the middle of the grid.
    middle = transform_points(grid.T_world_grid, grid.size_m / 2)
    half_m = np.sqrt(3.0) * np.linalg.norm(grid.size_m) / 2
    around = transform_points(invert_rigid(surround.T_world_grid), middle[None])[0]
    assert around.min() >= half_m and (surround.size_m - around).min() >= half_m


def test_folder_round_trip(chair: Chair, tmp_path: Path) -> None:
    model = chair.model
    assert model.shape.underside.any()
    write_object(model, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "floor.json", "mesh.ply", "volume.npz", "surround.npz", "quality.json"
    }  # fmt: skip
    again = read_object(tmp_path)
    stored_rounded = {
        "floor.noise_m": 5e-7,
        "floor.inlier_share": 5e-5,
        "floor.tilt_rad": 5e-5,
        "box.center_m": 5e-5,
        "box.size_m": 5e-5,
        "box.yaw_rad": 5e-6,
        "shape.probability": 5e-4,
        "shape.mesh.vertices": 5e-7,
    }
    # The planes that were not taken are for people: nothing reads them.
    assert_same_fields(replace(model, floor=replace(model.floor, choice=NO_CHOICE)), again, stored_rounded)
    stored = FloorFile.read(tmp_path).candidates
    assert len(stored) == len(model.floor.choice.candidates) > 0
    assert [row.plane_world.tolist() for row in stored if row.refused is None] == [
        present(model.floor.choice.chosen).plane.tolist()
    ]
    assert own_floor(FloorFile.read(tmp_path)).candidates == ()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    write_object(model, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert FUSION.voxel_size_m == again.shape.grid.voxel_size_m


def test_what_an_older_folder_lacks_is_not_known(chair: Chair, tmp_path: Path) -> None:
    write_object(chair.model, tmp_path)
    content = json.loads((tmp_path / "floor.json").read_text())
    del content["tilt_rad"]
    (tmp_path / "floor.json").write_text(json.dumps(content))
    with np.load(tmp_path / "volume.npz") as volume:
        arrays = {name: volume[name] for name in volume.files if name != "underside"}
    np.savez(tmp_path / "volume.npz", **arrays)
    again = read_object(tmp_path)
    assert np.isnan(again.floor.tilt_rad) and not again.shape.underside.any()


@pytest.mark.parametrize("name", ["floor.json", "mesh.ply", "volume.npz", "surround.npz", "quality.json"])
@pytest.mark.parametrize("damage", ["missing", "cut", "other"])
def test_damaged_folder(chair: Chair, tmp_path: Path, name: str, damage: str) -> None:
    write_object(chair.model, tmp_path)
    path = tmp_path / name
    if damage == "missing":
        path.unlink()
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:100])
    elif name.endswith("npz"):
        np.savez(path, x=np.zeros(3))
    else:
        path.write_text("{}")
    with raises(StorageError, "storage.damaged", match=r"--force") as caught:
        read_object(tmp_path)
    assert str(tmp_path) in str(caught.value)
