"""A folder of predictions in the camera frame: files are read, refused in one line, held to the depth."""

import json
from pathlib import Path
from typing import Any

import analytic_release
import numpy as np
import pytest
import trimesh
from raising import raises
from small_benchmark import Run

from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.errors import PredictionError
from kinectbench.core.geometry import rigid
from kinectbench.core.mesh_files import read_ply
from kinectbench.release.release import Release, Target, open_release
from kinectbench.scoring.camera_predictions import CameraPredictionFile, check_camera, load_camera_shape
from kinectbench.scoring.camera_shape import (
    CameraShape,
    distance_shape,
    occupancy_shape,
    read_shape,
    write_shape,
)
from kinectbench.scoring.method_json import read_in_camera, read_method

EYE = np.eye(4)
BOX = trimesh.creation.box(extents=(0.2, 0.3, 0.4))


@pytest.fixture(scope="module")
def published(analytic: Path) -> Release:
    return open_release(analytic / "benchmark")


def true_shape(target: Target) -> CameraShape:
    return analytic_release.true_in_camera(target.recording, target.category, target.view)


def folder_of(published: Release, folder: Path, T: np.ndarray = EYE, **keys: Any) -> Path:
    """The truth of all views, mapped by a matrix, with a method.json."""
    for target in published.targets:
        write_shape(true_shape(target).transformed(T), folder / target.recording / target.view)
    declared = {"name": "net", "frame": "camera"} | keys
    (folder / "method.json").write_text(json.dumps(declared))
    return folder


def checked(published: Release, folder: Path) -> tuple[list[str], list[str]]:
    method = read_in_camera(folder)
    assert method is not None
    return check_camera(published, folder, method)


def test_a_mesh_with_doubled_triangles_is_open_and_it_is_said_why(published: Release, tmp_path: Path) -> None:
    folder = folder_of(published, tmp_path)
    target = published.targets[0]
    shape = true_shape(target)
    doubled = CameraShape("mesh", shape.points_m, np.concatenate([shape.faces, shape.faces[:1]]))
    write_shape(doubled, folder / target.recording / target.view)
    problems, notes = checked(published, folder)
    edges = len(shape.faces) * 3 // 2
    assert problems == [] and notes[1:] == [
        f"1 of 7 predictions are open meshes, such as {target.name} (3 of {edges} edges with more than two "
        "faces: doubled triangles?): they have no inside, so they have metrics of surfaces alone"
    ]


def test_right_predictions_are_near_their_depth(published: Release, tmp_path: Path) -> None:
    problems, notes = checked(published, folder_of(published, tmp_path))
    assert problems == [] and len(notes) == 1
    assert notes[0].startswith("median distance from each prediction to its view's own depth: ")
    assert notes[0].count(" mm ") == 2 and "of 7, " in notes[0]


DECLARED: dict[str, tuple[np.ndarray, dict[str, Any]]] = {
    "mm": (np.diag([1000.0, 1000, 1000, 1]), {"unit": "mm"}),
    "pytorch3d": (np.diag([-1.0, -1, 1, 1]), {"axes": "pytorch3d"}),
    "opengl": (np.diag([1.0, -1, -1, 1]), {"axes": "opengl"}),
    "both": (np.diag([1000.0, -1000, -1000, 1]), {"axes": "opengl", "unit": "mm"}),
}


@pytest.mark.parametrize("kind", DECLARED)
def test_unit_and_axes_are_as_declared(published: Release, tmp_path: Path, kind: str) -> None:
    """What is declared is right; the same files without it are named."""
    T, keys = DECLARED[kind]
    folder = folder_of(published, tmp_path, T, **keys)
    assert checked(published, folder)[0] == []
    (folder / "method.json").write_text(json.dumps({"name": "net", "frame": "camera"}))
    problems, _ = checked(published, folder)
    # A ball in the middle of the image is the same with x to the left and y up.
    assert len(problems) == (2 if keys == {"axes": "pytorch3d"} else 7)
    assert all(("millimetres for metres?" in line) == ("unit" in keys) for line in problems)
    assert all(f"(axes: {keys.get('axes', '')})" in line for line in problems) == ("axes" in keys)


def test_a_similarity_by_view_puts_each_prediction_back(published: Release, tmp_path: Path) -> None:
    """Shapes in a box of side 1, as generators write them, in opengl's axes; two hypotheses a view."""
    flip = np.diag([1.0, -1, -1, 1])
    matrices = {}
    for number, target in enumerate(published.targets):
        true = true_shape(target)
        T = rigid(np.eye(3), true.points_m.mean(axis=0)) @ np.diag([0.3 + number / 10] * 3 + [1.0])
        matrices[target.name] = T.tolist()
        own = true.transformed(np.asarray(np.linalg.inv(T @ flip)))
        for k in range(2):
            write_shape(own, tmp_path / target.recording / f"{target.view}.{k}")
    declared = {"name": "net", "frame": "camera", "axes": "opengl", "unit": "free", "hypotheses": 2}
    (tmp_path / "method.json").write_text(json.dumps(declared | {"T_camera_prediction": matrices}))
    problems, notes = checked(published, tmp_path)
    assert problems == [] and "median of 14, " in notes[0]
    matrices[f"{published.targets[0].name}.1"] = (np.array(matrices[published.targets[0].name]) * 1).tolist()
    matrices["nobody/007"] = EYE.tolist()
    (tmp_path / "method.json").write_text(json.dumps(declared | {"T_camera_prediction": matrices}))
    (line,) = checked(published, tmp_path)[0]
    assert line == "method.json: 'T_camera_prediction' has 'nobody/007', which is no view here; correct it"


def test_shapes_of_free_size_are_read_and_not_compared(published: Release, tmp_path: Path) -> None:
    folder = folder_of(published, tmp_path, np.diag([7.0, 7, 7, 1]), scale="free", unit="free")
    assert checked(published, folder) == (
        [],
        ["7 predictions are readable; of free size: none is compared with its depth"],
    )


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_meshes_of_every_kind_are_the_same(tmp_path: Path, suffix: str) -> None:
    BOX.export(tmp_path / f"a{suffix}")
    shape = read_shape(tmp_path / f"a{suffix}", "a")
    assert shape.form == "mesh" and len(shape.faces) == 12
    corners = shape.points_m[shape.faces]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(0.2 * 0.3 * 0.4, rel=1e-5)


def test_clouds_cells_and_distances_come_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points, normals = rng.normal(size=(50, 3)), np.tile([0.0, 0, 1], (50, 1))
    cloud = CameraShape("points", points, np.zeros((0, 3), np.int64), normals)
    found = read_shape(write_shape(cloud, tmp_path / "cloud"), "cloud")
    np.testing.assert_allclose(found.points_m, points, atol=1e-6)
    assert found.form == "points" and found.normals is not None and len(found.faces) == 0
    np.savez(tmp_path / "c.npz", points_m=points)
    assert read_shape(tmp_path / "c.npz", "c").normals is None
    T = rigid(np.eye(3), [0.1, 0.2, 1.0])
    cells = np.zeros((4, 5, 6), bool)
    cells[1:3, 1:4, 1:5] = True
    solid = occupancy_shape(cells, T, 0.1)
    assert len(solid.points_m) == cells.sum()  # none has six occupied neighbours
    found = read_shape(write_shape(solid, tmp_path / "solid"), "solid")
    np.testing.assert_array_equal(found.cells, cells)
    np.testing.assert_allclose(found.points_m, solid.points_m)
    np.testing.assert_allclose(found.points_m.min(axis=0), [0.25, 0.35, 1.15])
    z = (np.arange(8) + 0.5) * 0.1
    slab = distance_shape(np.broadcast_to(z - 0.33, (8, 8, 8)).astype(np.float32), T, 0.1)
    found = read_shape(write_shape(slab, tmp_path / "sdf"), "sdf")
    assert found.form == "sdf" and np.abs(found.points_m[:, 2] - 1.33).max() < 0.1


def arrays(**of: Any) -> Any:
    return lambda path: np.savez(path, **of)


CUBE = {"T_camera_grid": EYE, "voxel_size_m": 0.1}
SOLID = np.ones((2, 2, 2), bool)
REFUSED: dict[str, tuple[str, Any, str]] = {
    "no points": ("a.npz", arrays(points_m=np.zeros((0, 3))), "rows of x, y, z are needed"),
    "pairs": ("a.npz", arrays(points_m=np.zeros((4, 2))), "rows of x, y, z are needed"),
    "texts": ("a.npz", arrays(points_m=np.array([["a", "b", "c"]])), "rows of x, y, z are needed"),
    "nan": ("a.npz", arrays(points_m=np.full((4, 3), np.nan)), "a point is not finite"),
    "normals": ("a.npz", arrays(points_m=np.zeros((4, 3)), normals=np.zeros((3, 3))), "not as many as"),
    "normals of text": (
        "a.npz", arrays(points_m=np.ones((4, 3)), normals=np.full((4, 3), "0")), "rows of x, y, z are needed"
    ),
    "complex normals": (
        "a.npz", arrays(points_m=np.ones((4, 3)), normals=np.ones((4, 3), complex)), "normals complex128"
    ),
    "nothing": ("a.npz", arrays(x=SOLID), "holds none of points_m, occupancy, sdf_m"),
    "no grid": ("a.npz", arrays(occupancy=SOLID), "holds no T_camera_grid and no voxel_size_m"),
    "empty": ("a.npz", arrays(occupancy=~SOLID, **CUBE), "an empty prediction"),
    "flat": ("a.npz", arrays(occupancy=SOLID[0], **CUBE), "must be (i, j, k)"),
    "probabilities": ("a.npz", arrays(occupancy=SOLID * 0.5, **CUBE), "apply your threshold first"),
    "sdf of ints": ("a.npz", arrays(sdf_m=SOLID.astype(int), **CUBE), "must be finite floats"),
    "a mirror": (
        "a.npz", arrays(occupancy=SOLID, T_camera_grid=np.diag([1, 1, -1, 1]), voxel_size_m=0.1), "it mirrors"
    ),
    "size 0": ("a.npz", arrays(occupancy=SOLID, T_camera_grid=EYE, voxel_size_m=0.0), "one positive number"),
    "no zip": ("a.npz", lambda path: path.write_bytes(b"PK"), "not a readable npz file"),
    "a pickle": ("a.npz", arrays(points_m=np.array([{}, {}])), "pickled Python objects"),
    "no ply": ("a.ply", lambda path: path.write_bytes(b"ply"), "not a readable ply file: a malformed header"),
    "nothing at all": ("a.ply", lambda path: path.write_bytes(b""), "0 bytes; a file of 1 to"),
    "no glb": ("a.glb", lambda path: path.write_bytes(b"glTF" * 9), "not a binary glTF 2.0 file"),
    "another kind": ("a.stl", lambda path: path.write_bytes(b"solid"), "save it as .ply, .obj, .glb, .npz"),
    "gone": ("a.ply", lambda path: None, "cannot be read (No such file"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_files_that_are_not_accepted_are_one_line(tmp_path: Path, kind: str) -> None:
    name, write, words = REFUSED[kind]
    write(tmp_path / name)
    with pytest.raises(PredictionError) as caught:
        read_shape(tmp_path / name, "chair/000")
    assert str(caught.value).startswith("chair/000: ") and words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_glb_that_claims_what_is_not_there(tmp_path: Path) -> None:
    """Every byte changed, and every end cut off: one line, or a shape of finite points."""
    content = BOX.export(file_type="glb")
    rng = np.random.default_rng(0)
    path = tmp_path / "a.glb"
    for trial in range(600):
        changed = bytearray(content)
        for place in rng.integers(0, len(content), 1 + trial % 3):
            changed[place] = rng.integers(0, 256)
        path.write_bytes(changed if trial % 3 else changed[: rng.integers(1, len(content))])
        try:
            assert np.isfinite(read_shape(path, "a").points_m).all()
        except PredictionError as error:
            assert str(error).startswith("a: ") and "\n" not in str(error)


def test_a_glb_is_placed_by_its_nodes(tmp_path: Path) -> None:
    T = rigid(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), [1.0, 2.0, 3.0])
    scene = trimesh.Scene()
    scene.add_geometry(BOX, transform=T @ np.diag([2.0, 2, 2, 1]))
    scene.add_geometry(BOX)
    scene.export(tmp_path / "a.glb")
    shape = read_shape(tmp_path / "a.glb", "a")
    low, high = shape.points_m[:8].min(axis=0), shape.points_m[:8].max(axis=0)
    middles = sorted(
        [tuple(np.round((low + high) / 2, 6)), tuple(np.round(shape.points_m[8:].mean(axis=0), 6))]
    )
    assert middles == [(0.0, 0.0, 0.0), (1.0, 2.0, 3.0)] and len(shape.faces) == 24


def test_what_a_folder_lacks_is_said(published: Release, tmp_path: Path) -> None:
    folder = folder_of(published, tmp_path, form="points")
    test, other = published.split("test")[0], published.split("test")[1]
    (folder / f"{test.name}.ply").unlink()
    (folder / f"{other.name}.obj").write_text("v 0 0 0\n")
    (folder / "chair_01" / "0.ply").write_text("ply")
    problems, _ = checked(published, folder)
    assert problems.pop().endswith(f"rename it to {test.name}.ply")
    assert f"{test.name}: no prediction; expected {test.name}.ply, .obj, .glb, .npz" in problems
    assert f"{other.name}: .ply and .obj are there; keep one" in problems
    wrong = [line for line in problems if "says 'form': 'points', and it holds mesh; correct one" in line]
    assert len(wrong) == 5 and len(problems) == 7


def test_scores_refuse_what_only_check_knows(published: Release, tmp_path: Path) -> None:
    folder = folder_of(published, tmp_path)
    with raises(PredictionError, "prediction.malformed", match="'frame' 'camera'"):
        read_method(folder)
    (folder / "method.json").write_text(json.dumps({"name": "net"}))
    assert read_in_camera(folder) is None and read_method(folder) is not None
    file = folder / f"{published.targets[0].name}.ply"
    shape = load_camera_shape(
        CameraPredictionFile(published.targets[0], "a", file), MethodFile(name="net", frame="camera")
    )
    assert len(shape.faces) == len(read_ply(file.read_bytes())[1])


def test_the_commands(published: Release, analytic: Path, tmp_path: Path, command: Any) -> None:
    """`export --for`, `adapt`, `check`: exit statuses and lines."""
    benchmark = str(analytic / "benchmark")
    run: Run = command(
        tmp_path, "export", "in", "--layout", "rgbd", "--for", "sam3d", "--benchmark", benchmark
    )
    assert (
        run.status == 0
        and "exported 7 views: in" in run.out
        and "7 of 7 views have no colour image" in run.err
    )
    run = command(tmp_path, "export", "x", "--for", "sam3d", "--benchmark", benchmark)
    assert run.status == 2 and "--for sam3d: only with `--layout rgbd`" in run.err
    run = command(tmp_path, "adapt", "sam3d", "in", "--benchmark", benchmark, "--out", "predictions/sam3d")
    assert run.status == 1 and "no <recording>/<view>/mesh.glb of the benchmark's views there" in run.err
    folder_of(published, tmp_path / "net", np.diag([1000.0, 1000, 1000, 1]))
    run = command(tmp_path, "check", "net", "--benchmark", benchmark)
    assert run.status == 3 and run.err.count("1000 times too far: millimetres for metres?") == 1
    assert "error: 7 files, first " in run.err
    told = json.loads(command(tmp_path, "check", "net", "--benchmark", benchmark, "--json").out)
    assert sum("1000 times too far: millimetres for metres?" in line for line in told) == 7
    (tmp_path / "net" / "method.json").write_text('{"name": "net", "frame": "camera", "unit": "mm"}')
    run = command(tmp_path, "check", "net", "--benchmark", benchmark)
    assert run.status == 0 and "net: all well" in run.out and "median distance from each" in run.err
