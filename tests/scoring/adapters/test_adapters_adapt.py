"""`adapt`: what a method wrote comes back as the truth in the camera, within a millimetre."""

import json
import shutil
from pathlib import Path

import analytic_release
import numpy as np
import pytest
import todays_outputs as outputs
from analytic_release import (
    BOX_HIGH,
    BOX_LOW,
    CENTER_M,
    RADIUS_M,
    T_floor_camera,
    is_ball,
    surface_distance_m,
)
from raising import raises

from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.errors import PredictionError, SettingsError
from kinectbench.core.geometry import transform_points
from kinectbench.core.voxels.npz import load_arrays
from kinectbench.release.release import Release, Target, open_release
from kinectbench.scoring.adapters.registry import ADAPTERS, adapt, export_for
from kinectbench.scoring.camera_predictions import CameraPredictionFile, load_camera_shape
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.depth_agreement import shape_points

MM = 1e-3


@pytest.fixture(scope="module")
def published(analytic: Path) -> Release:
    return open_release(analytic / "benchmark")


def true_in_camera(target: Target) -> CameraShape:
    return analytic_release.true_in_camera(target.recording, target.category, target.view)


def true_distance_m(target: Target, points: np.ndarray) -> np.ndarray:
    """Signed distance of points in the camera from the true shape: negative inside; by formula."""
    on_floor = transform_points(T_floor_camera(int(target.view)), points)
    far = surface_distance_m(target.category, on_floor)
    if is_ball(target.category):
        inside = np.linalg.norm(on_floor - np.array(CENTER_M), axis=1) < RADIUS_M
    else:
        inside = ((on_floor > BOX_LOW) & (on_floor < BOX_HIGH)).all(axis=1)
    return np.where(inside, -far, far)


def fake(name: str, target: Target, folder: Path) -> None:
    """What the method writes if it knows the truth."""
    mesh = true_in_camera(target)
    points = shape_points(mesh)
    T = np.array(json.loads((folder / "camera.json").read_text())["T_camera_method"])
    if name == "rayst3r":
        outputs.rayst3r(folder, points)
    elif name == "octmae":
        outputs.octmae(folder, points, points / np.linalg.norm(points, axis=1, keepdims=True))
    elif name == "sam3d":
        outputs.sam3d(folder, mesh.points_m, mesh.faces, int(target.view))
    elif name == "pointr":
        outputs.pointr(folder, points, T)
    else:
        centers = transform_points(T, (np.indices((32,) * 3).reshape(3, -1).T + 0.5) / 32)
        edge_m = float(np.cbrt(np.linalg.det(T[:3, :3])))
        outputs.patchcomplete(folder, true_distance_m(target, centers).reshape((32,) * 3), edge_m)


def method_of(folder: Path) -> MethodFile:
    method = MethodFile.read_if_there(folder)
    assert method is not None
    return method


@pytest.mark.parametrize("name", list(ADAPTERS))
def test_a_round_trip_gives_the_truth_within_a_millimetre(
    published: Release, tmp_path: Path, name: str
) -> None:
    export_for(published, tmp_path / "in", name)
    for target in published.targets:
        fake(name, target, tmp_path / "in" / target.recording / target.view)
    assert adapt(published, name, tmp_path / "in", tmp_path / "out") == (7, [])
    method = method_of(tmp_path / "out")
    assert (method.name, method.frame, method.unit, method.axes) == (name, "camera", "m", "cv")
    assert method.form == ADAPTERS[name].form and method.benchmark_sha256 == published.benchmark_sha256
    for target in published.targets:
        (path,) = (tmp_path / "out").glob(f"{target.name}.*")
        assert path.suffix == (".npz" if name == "patchcomplete" else ".ply")
        shape = load_camera_shape(CameraPredictionFile(target, target.name, path), method)
        truth = true_in_camera(target)
        if name == "sam3d":
            np.testing.assert_array_equal(shape.faces, truth.faces)
            np.testing.assert_allclose(shape.points_m, truth.points_m, rtol=0, atol=MM)
        elif name == "patchcomplete":
            arrays = load_arrays(path)
            cells, T, size = (arrays[key] for key in ("occupancy", "T_camera_grid", "voxel_size_m"))
            centers = transform_points(T, (np.indices((32,) * 3).reshape(3, -1).T + 0.5) * size)
            inside = true_distance_m(target, centers) < 0
            assert (cells.ravel() == inside).mean() > 0.9995 and cells.sum() > 1000
        else:
            np.testing.assert_allclose(shape.points_m, shape_points(truth), rtol=0, atol=MM)
    if name == "octmae":
        assert shape.normals is not None
        rays = shape.points_m / np.linalg.norm(shape.points_m, axis=1, keepdims=True)
        np.testing.assert_allclose(shape.normals, rays, atol=0.005)
    # Of a method that looks at a cube, predictions say which: scores state what it cuts.
    assert (method.volume_m is not None) == (name == "octmae")
    for low, high in (method.volume_m or {}).values():
        np.testing.assert_allclose(high - low, 1.28)


def test_a_wrong_reading_of_sam3d_is_not_within_a_millimetre(published: Release, tmp_path: Path) -> None:
    """The round trip is one that the transposed rotation fails."""
    export_for(published, tmp_path, "sam3d")
    target = published.targets[0]
    folder = tmp_path / target.recording / target.view
    mesh = true_in_camera(target)
    outputs.sam3d(folder, mesh.points_m + np.array([0, 0.1, 0]), mesh.faces, 3)
    pose = dict(np.load(folder / "pose.npz"))
    np.savez(folder / "pose.npz", **pose | {"rotation": pose["rotation"] * [[1, -1, -1, -1]]})
    adapt(published, "sam3d", tmp_path, tmp_path / "out")
    path = tmp_path / "out" / f"{target.name}.ply"
    shape = load_camera_shape(CameraPredictionFile(target, target.name, path), method_of(tmp_path / "out"))
    far = np.linalg.norm(shape.points_m - mesh.points_m - [0, 0.1, 0], axis=1)
    assert np.median(far) > 0.1


def test_what_cannot_be_used_is_said_and_the_rest_is_adapted(published: Release, tmp_path: Path) -> None:
    export_for(published, tmp_path / "in", "pointr")
    places = {one.name: tmp_path / "in" / one.recording / one.view for one in published.targets}
    first, second, third, fourth, fifth, *_ = published.targets
    for target in (first, second, third, fourth, fifth):
        fake("pointr", target, places[target.name])
    np.save(places[second.name] / "fine.npy", np.zeros((5, 4)))
    (places[third.name] / "fine.npy").write_bytes(b"no array")
    (places[fourth.name] / "camera.json").unlink()
    camera = json.loads((places[fifth.name] / "camera.json").read_text())
    camera["T_camera_method"][0][0] *= -1
    (places[fifth.name] / "camera.json").write_text(json.dumps(camera))
    count, problems = adapt(published, "pointr", tmp_path / "in", tmp_path / "out")
    assert count == 1 and len(problems) == 4
    for problem, target, words in zip(
        problems,
        (second, third, fourth, fifth),
        (
            "(5, 4) float64; (n, 3) floats are wanted",
            "not an npy array",
            "missing; export the views",
            "'T_camera_method': it ",
        ),
        strict=True,
    ):
        assert problem.startswith(f"{target.name}: ") and words in problem and "\n" not in problem
    assert [path.name for path in (tmp_path / "out").rglob("*.ply")] == [f"{first.view}.ply"]


def test_nothing_that_can_be_used(published: Release, tmp_path: Path) -> None:
    with raises(PredictionError, "prediction.no-folder"):
        adapt(published, "octmae", tmp_path / "nowhere", tmp_path / "out")
    with raises(PredictionError, "prediction.none", match=r"<view>/output\.pts"):
        adapt(published, "octmae", tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("dear")
    with raises(SettingsError, "settings.other-content"):
        adapt(published, "octmae", tmp_path, tmp_path / "mine")


def test_only_adapted_predictions_are_replaced(published: Release, tmp_path: Path) -> None:
    export_for(published, tmp_path / "in", "octmae")
    target = published.targets[0]
    fake("octmae", target, tmp_path / "in" / target.recording / target.view)
    out = tmp_path / "out"
    for _ in range(2):
        adapt(published, "octmae", tmp_path / "in", out)
    (out / "notes.txt").write_text("dear")
    with raises(SettingsError, "settings.other-content", match="holds something else"):
        adapt(published, "octmae", tmp_path / "in", out)
    (out / "notes.txt").unlink()
    MethodFile(name="mine", benchmark_sha256=published.benchmark_sha256, frame="camera").write(out)
    with raises(SettingsError, "settings.other-content"):
        adapt(published, "octmae", tmp_path / "in", out)


def test_outputs_of_another_release_or_method_are_refused(
    published: Release, release: Release, tmp_path: Path
) -> None:
    export_for(published, tmp_path / "in", "rayst3r")
    target = published.targets[0]
    folder = tmp_path / "in" / target.recording / target.view
    fake("rayst3r", target, folder)
    with raises(PredictionError, "prediction.none", match=r"camera\.json"):
        adapt(release, "rayst3r", tmp_path / "in", tmp_path / "out")
    shutil.copy(folder / "inference_points.ply", folder / "output.pts")
    with raises(PredictionError, "prediction.none", match="`export --layout rgbd --for octmae`"):
        adapt(published, "octmae", tmp_path / "in", tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "file", "content", "words"),
    [
        ("octmae", "output.pts", b"2\n1 2 3 0 1 2 3\n", "not a count of points"),
        ("octmae", "output.pts", b"", "not a count of points"),
        ("octmae", "output.pts", b"1\n1 2 nan 0 1 2 3\n", "a number is not finite"),
        ("octmae", "output.pts", b"1\n1 2 x 0 1 2 3\n", "a word that is no number"),
        ("rayst3r", "inference_points.ply", b"ply\n", "malformed header"),
        ("sam3d", "mesh.glb", b"glTF", "pose.npz: missing"),
        ("patchcomplete", "a_pred.npz", b"PK", "a_pred.npz: cannot be read"),
        ("pointr", "fine.npy", b"\x80\x04", "a pickle, which is never loaded"),
    ],
)
def test_damaged_outputs_are_one_line(
    published: Release, tmp_path: Path, name: str, file: str, content: bytes, words: str
) -> None:
    export_for(published, tmp_path / "in", name)
    target = published.targets[0]
    (tmp_path / "in" / target.recording / target.view / file).write_bytes(content)
    with pytest.raises(PredictionError) as caught:
        adapt(published, name, tmp_path / "in", tmp_path / "out")
    assert words in str(caught.value) and "\n" not in str(caught.value)
