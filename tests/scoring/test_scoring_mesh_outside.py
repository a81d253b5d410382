"""Meshes that reach out of the cube are cut off and told, those beyond it refused; what is empty is told."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from kinectbench.core.errors import PredictionError
from kinectbench.release.release import Release
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.mesh_prediction import IN_CAMERA, outside_share
from kinectbench.scoring.prediction_file import Loaded, load_hashed
from kinectbench.scoring.predictions import check
from kinectbench.scoring.score import score
from kinectbench.scoring.truth import read_voxel_size

VOXEL_M = 0.004
SIDE_M = 256 * VOXEL_M


def sphere(centre_cells: tuple[float, float, float], radius_cells: float, fine: int = 5) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(fine, radius_cells * VOXEL_M)
    return ball.apply_translation(np.array(centre_cells) * VOXEL_M)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=np.array([low, high]) * VOXEL_M)


def loaded(mesh: trimesh.Trimesh, folder: Path) -> Loaded:
    path = folder / "000.ply"
    path.write_bytes(mesh.export(file_type="ply"))
    return load_hashed(path, "chair_01/000.ply", VOXEL_M)


PARTLY = {
    # mesh, share of it outside, share's tolerance
    "a ball on an edge": (sphere((0, 0, 128), 60), 0.75, 1e-5),
    "a ball on a corner": (sphere((0, 256, 0), 60), 0.875, 1e-5),
    "a ball on a wall, inwards": (sphere((128, 128, 256), 60), 0.5, 1e-5),
    "a box": (box((100, 100, -100), (150, 150, 300)), 144 / 400, 1e-6),
    "a plate thinner than a cell": (box((-10, 100.3, 10), (30, 100.7, 20)), 0.25, 1e-5),
    "all around": (box((-256, -256, -256), (512, 512, 512)), 26 / 27, 1e-6),
    "a corner into it": (box((250, 250, 250), (260, 260, 260)), 0.784, 1e-6),
}


@pytest.mark.parametrize("kind", PARTLY)
def test_what_reaches_out_is_cut_off_and_measured(kind: str, tmp_path: Path) -> None:
    mesh, share, near = PARTLY[kind]
    found = loaded(mesh, tmp_path)
    assert found.outside_share == pytest.approx(share, abs=max(near, 2e-6))
    # The same as if the cube stood elsewhere: a cell is set where its centre is inside.
    centres = np.stack(np.meshgrid(*[np.arange(0, 256, 8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    low, high = mesh.bounds / VOXEL_M
    far = ((centres + 0.5 < low) | (centres + 0.5 > high)).any(axis=1)
    assert not found.prediction[tuple(centres[far].T)].any()
    if "ball" not in kind:
        within = ((centres + 0.5 > low) & (centres + 0.5 < high)).all(axis=1)
        assert found.prediction[tuple(centres[within].T)].all()
    elif "edge" in kind:
        reach = np.hypot(*(np.indices((256, 256)) + 0.5))
        assert (found.prediction[:, :, 128] == (reach < 59.9))[np.abs(reach - 59.9) > 0.5].all()
    mesh.invert()
    assert loaded(mesh, tmp_path).outside_share == pytest.approx(share, abs=max(near, 2e-6))
    mesh.invert()


def test_shares_of_turned_boxes_are_those_that_points_say() -> None:
    """200,000 points in each: three standard deviations are below .0034."""
    random = np.random.default_rng(0)
    for _ in range(8):
        extents, turn = (
            random.uniform(0.2, 2, 3),
            trimesh.transformations.random_rotation_matrix(random.random(3)),
        )
        turn[:3, 3] = random.uniform(0, 1, 3)
        mesh = trimesh.creation.box(extents=extents, transform=turn)
        points = (random.random((200_000, 3)) - 0.5) * extents @ turn[:3, :3].T + turn[:3, 3]
        expected = 1 - ((points >= 0) & (points <= 1)).all(axis=1).mean()
        found = outside_share(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32), 1.0)
        assert found == pytest.approx(expected, abs=0.0034)


BEYOND = {
    "beside": sphere((-61, 128, 128), 60),
    "in front, as in the camera's frame": sphere((0, 0, 600), 100),
    "by a corner": sphere((-40, -40, 128), 50),
    "between two centres": box((-5, 100, 100), (0.4, 150, 150)),
}


@pytest.mark.parametrize("kind", BEYOND)
def test_what_has_nothing_in_the_cube_is_refused_for_that(kind: str, tmp_path: Path) -> None:
    with pytest.raises(PredictionError) as caught:
        loaded(BEYOND[kind], tmp_path)
    assert "the mesh lies outside the cube of its pair (x " in str(caught.value)
    assert "in another frame?" in str(caught.value) and len(str(caught.value)) < 300


def test_rounding_is_not_outside(tmp_path: Path) -> None:
    assert loaded(box((-1e-6, 0, 0), (256.0001, 256, 100)), tmp_path).outside_share == 0


def test_doubtful_predictions_are_counted_in_a_line_each(release: Release, tmp_path: Path) -> None:
    targets = release.split("test")
    for target in targets:
        (tmp_path / target.recording).mkdir(exist_ok=True)
        np.save(tmp_path / f"{target.name}.npy", np.zeros((4, 4, 4), bool))
    np.save(tmp_path / f"{targets[1].name}.npy", np.full((4, 4, 4), 0.7, np.float16))
    size_m = read_voxel_size(release.pair_path(targets[0]), targets[0].sha256)
    ball = sphere((0, 128, 128), 60, fine=3).apply_scale(size_m / VOXEL_M)
    (tmp_path / f"{targets[0].name}.npy").unlink()
    (tmp_path / f"{targets[0].name}.ply").write_bytes(ball.export(file_type="ply"))
    warnings = score(release, tmp_path, method="mine", protocols=["known"], surface=False).warnings
    assert (
        f"1 mesh lies partly outside the cube and is cut off there, {targets[0].name} by 50.0% of its "
        "volume: in another frame?"
    ) in warnings
    assert f"2 of 4 predictions predict nothing at their threshold, such as {targets[2].name}" in warnings
    assert f"1 of 4 predictions fill the whole cube at their threshold, such as {targets[1].name}" in warnings
    assert check(release, tmp_path) == [
        f"{targets[0].name}.ply: 50% of its volume lies outside the cube: use the grid's axes, {IN_CAMERA}"
    ]
    write_baselines(release, tmp_path / "baselines", ["empty"])
    folder = tmp_path / "baselines" / "empty"
    baseline = score(release, folder, method="empty", protocols=["known"], surface=False).warnings
    assert not any("predict nothing" in line for line in baseline)
