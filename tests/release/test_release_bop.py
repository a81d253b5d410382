"""A BOP data set, read by a reader that knows the format page alone, and held against formulas."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from analytic_release import (
    BOX_HIGH,
    BOX_LOW,
    CAMERA,
    RADIUS_M,
    T_floor_camera,
    T_world_floor,
    true_depth_m,
    true_mesh,
)
from raising import raises
from read_pictures import read_picture

from kinectbench.core.errors import ReleaseError
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.release.exchange.bop import export_bop, model_info, object_in_view
from kinectbench.release.release import open_release
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.readers.bop import BopRecording

HALF_BOX_MM = (np.array(BOX_HIGH) - np.array(BOX_LOW)) * 500
SCENES = {"chair_01": "test/000001", "chair_02": "test/000002", "chair_03": "val/000003"}
SCENES |= {"table_01": "test/000004", "table_02": "val/000005"}


@pytest.fixture(scope="module")
def bop(analytic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("bop") / "data"
    assert export_bop(open_release(analytic / "benchmark"), out) == 7
    return out


class Scene:
    """A BOP scene as its format page describes it; millimetres."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.camera = json.loads((folder / "scene_camera.json").read_text())
        self.gt = json.loads((folder / "scene_gt.json").read_text())
        self.gt_info = json.loads((folder / "scene_gt_info.json").read_text())

    def depth_mm(self, image: str) -> np.ndarray:
        raw = read_picture(self.folder / "depth" / f"{int(image):06d}.png", cv2.IMREAD_UNCHANGED)
        assert raw.dtype == np.uint16
        depth_mm: np.ndarray = raw * self.camera[image]["depth_scale"]
        return depth_mm

    def mask(self, image: str, kind: str) -> np.ndarray:
        return read_picture(self.folder / kind / f"{int(image):06d}_000000.png", cv2.IMREAD_UNCHANGED) > 0

    def K(self, image: str) -> np.ndarray:
        return np.array(self.camera[image]["cam_K"]).reshape(3, 3)

    def camera_from_model(self, image: str) -> tuple[np.ndarray, np.ndarray]:
        row = self.gt[image][0]
        return np.array(row["cam_R_m2c"]).reshape(3, 3), np.array(row["cam_t_m2c"])


def read_model(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, normals and triangles of a PLY that has float x y z nx ny nz and lists of int."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = [
        line for line in header.decode().splitlines() if line.startswith(("element", "property", "form"))
    ]
    assert lines[0] == "format binary_little_endian 1.0"
    counts = [int(line.split()[2]) for line in lines if line.startswith("element")]
    assert [line for line in lines if line.startswith("property")] == [
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        "property list uchar int vertex_indices",
    ]
    vertices = np.frombuffer(body, "<f4", counts[0] * 6).reshape(-1, 6).astype(float)
    faces = np.frombuffer(body, np.dtype([("n", "u1"), ("at", "<i4", 3)]), counts[1], counts[0] * 24)
    assert (faces["n"] == 3).all() and len(body) == counts[0] * 24 + counts[1] * 13
    return vertices[:, :3], vertices[:, 3:], faces["at"]


def distance_mm(recording: str, points_mm: np.ndarray) -> np.ndarray:
    """Of points in the model's frame from the true surface: the model's origin is the middle of its box."""
    if recording.startswith("chair"):
        return np.asarray(np.abs(np.linalg.norm(points_mm, axis=1) - RADIUS_M * 1000))
    outside = np.abs(points_mm) - HALF_BOX_MM
    beyond = np.linalg.norm(np.maximum(outside, 0), axis=1)
    return np.asarray(np.where((outside > 0).any(axis=1), beyond, -outside.max(axis=1)))


@pytest.mark.parametrize("recording", list(SCENES))
def test_depth_lies_on_the_true_surface(bop: Path, recording: str) -> None:
    scene = Scene(bop / SCENES[recording])
    for image in scene.camera:
        depth_mm, K = scene.depth_mm(image), scene.K(image)
        v, u = np.nonzero(depth_mm)
        assert len(u) > 2000
        z = depth_mm[v, u]
        points = np.column_stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z])
        R, t = scene.camera_from_model(image)
        # Depth is rounded to whole millimetres, along z.
        assert distance_mm(recording, (points - t) @ R).max() < 0.6
        assert abs(np.linalg.det(R) - 1) < 1e-9


@pytest.mark.parametrize("recording", list(SCENES))
def test_the_model_reprojected_agrees_with_the_depth_image(bop: Path, recording: str) -> None:
    scene = Scene(bop / SCENES[recording])
    number = int(SCENES[recording][-6:])
    vertices, normals, faces = read_model(bop / "models" / f"obj_{number:06d}.ply")
    corners = vertices[faces]
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], (len(faces), max(1, 6000 // len(faces))))
    points = (weights @ corners).reshape(-1, 3)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    assert distance_mm(recording, points).max() < 0.5
    assert (np.einsum("ij,ij->i", normals[faces[:, 0]], facing) > 0).all(), "normals point inward"
    facing = np.repeat(facing, weights.shape[1], axis=0)
    for image in scene.camera:
        R, t = scene.camera_from_model(image)
        seen = points @ R.T + t
        # The objects are convex: what faces the camera well inside its outline is seen.
        towards = -np.einsum("ij,ij->i", facing @ R.T, seen / np.linalg.norm(seen, axis=1, keepdims=True))
        seen = seen[towards > 0.3]
        pixels = seen @ scene.K(image).T
        u, v = (pixels[:, :2] / pixels[:, 2:]).T
        depth_mm, visible = scene.depth_mm(image), scene.mask(image, "mask_visib")
        u0, v0 = np.floor(u).astype(int), np.floor(v).astype(int)
        whole = np.ones(len(u), bool)
        for du, dv in ((0, 0), (1, 0), (0, 1), (1, 1)):
            whole &= visible[v0 + dv, u0 + du] & (depth_mm[v0 + dv, u0 + du] > 0)
        a, b = u - u0, v - v0
        measured = (
            depth_mm[v0, u0] * (1 - a) * (1 - b)
            + depth_mm[v0, u0 + 1] * a * (1 - b)
            + depth_mm[v0 + 1, u0] * (1 - a) * b
            + depth_mm[v0 + 1, u0 + 1] * a * b
        )
        off = np.abs(measured - seen[:, 2])[whole]
        assert whole.mean() > 0.8 and np.median(off) < 0.5
        # Between pixels lie curvature and, on boxes, edges.
        assert np.quantile(off, 0.95) < 2.0


def test_dataset_files(bop: Path, analytic: Path) -> None:
    infos = json.loads((bop / "models" / "models_info.json").read_text())
    ball, table = infos["1"], infos["4"]
    assert ball["diameter"] == pytest.approx(600, abs=0.5) and ball["size_z"] == pytest.approx(600, abs=0.5)
    assert table["diameter"] == pytest.approx(2 * np.linalg.norm(HALF_BOX_MM), abs=1e-2)
    for axis, half in zip("xyz", HALF_BOX_MM, strict=True):
        assert table[f"min_{axis}"] == pytest.approx(-half, abs=1e-2)
        assert table[f"size_{axis}"] == pytest.approx(2 * half, abs=1e-2)
    targets = json.loads((bop / "test_targets_bop19.json").read_text())
    assert [(row["scene_id"], row["im_id"]) for row in targets] == [(1, 0), (1, 1), (2, 0), (4, 0)]
    assert all(row["obj_id"] == row["scene_id"] and row["inst_count"] == 1 for row in targets)
    camera = json.loads((bop / "camera.json").read_text())
    assert (camera["fx"], camera["cy"], camera["width"], camera["depth_scale"]) == (262.5, 121.0, 320, 1.0)
    exported = json.loads((bop / "export.json").read_text())
    assert [row["recording"] for row in exported["scenes"]] == list(SCENES)
    assert [row["unknown_share"] for row in exported["scenes"]] == [[0.0] * n for n in (2, 1, 2, 1, 1)]
    assert exported["benchmark_sha256"] == open_release(analytic / "benchmark").benchmark_sha256


def test_cameras_are_in_the_scene_s_world(bop: Path) -> None:
    row = Scene(bop / "test/000001").camera["1"]
    R, t = np.array(row["cam_R_w2c"]).reshape(3, 3), np.array(row["cam_t_w2c"])
    np.testing.assert_allclose(row["cam_K"], [262.5, 0, 157.5, 0, 260, 121, 0, 0, 1])
    T_world_camera = T_world_floor(0) @ T_floor_camera(1)
    np.testing.assert_allclose(-R.T @ t / 1000, T_world_camera[:3, 3], atol=1e-12)
    np.testing.assert_allclose(R.T, T_world_camera[:3, :3], atol=1e-12)


def test_our_own_reader(bop: Path) -> None:
    recording = open_recording(bop / "test/000001", None)
    assert recording.format == "bop" and recording.depth_scale == 1000.0
    assert recording.camera == CAMERA and len(recording.places) == 2
    given = recording.given_trajectory
    assert given is not None
    np.testing.assert_allclose(given.T_world_camera[1], T_world_floor(0) @ T_floor_camera(1), atol=1e-9)
    assert isinstance(recording, BopRecording) and recording.places[0].mask is not None


def test_masks_of_a_whole_view(bop: Path) -> None:
    for recording, name in SCENES.items():
        scene = Scene(bop / name)
        for image, rows in scene.gt_info.items():
            true = true_depth_m("chair" if recording.startswith("chair") else "table", int(image)) > 0
            mask, visible = scene.mask(image, "mask"), scene.mask(image, "mask_visib")
            # Pixels on the outline itself: a mesh is no exact ball.
            assert (mask ^ true).sum() < 0.01 * true.sum() and (mask == visible).all()
            assert rows[0]["px_count_all"] == rows[0]["px_count_visib"] == mask.sum()
            assert rows[0]["px_count_valid"] == (mask & (scene.depth_mm(image) > 0)).sum()
            ys, xs = np.nonzero(mask)
            box = [xs.min(), ys.min(), np.ptp(xs), np.ptp(ys)]
            assert rows[0]["bbox_obj"] == rows[0]["bbox_visib"] == box


def test_a_flat_mesh_has_a_diameter() -> None:
    square = np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0], [0, 4, 0], [1, 1, 0]])
    faces = np.array([[0, 1, 2], [2, 1, 0]], np.int32)
    for vertices in (square, square[:3], np.zeros((6, 3)), square * [1, 0, 0]):
        largest = float(np.linalg.norm(vertices[:, None] - vertices, axis=-1).max())
        assert model_info(TriangleMesh(vertices, faces))["diameter"] == pytest.approx(largest, abs=1e-9)


def test_what_is_hidden_missing_or_beyond_the_image() -> None:
    """A ball cut by the image: strips that are covered, without depth, 10 mm and 30 mm nearer."""
    mesh = true_mesh("chair", 0)
    T_world_camera = T_world_floor(0) @ T_floor_camera(2)
    # Moved so that the outline leaves the image at the right.
    camera = replace(CAMERA, cx=CAMERA.cx + 110)
    wide = replace(camera, width=960, height=720, cx=camera.cx + 320, cy=camera.cy + 240)
    renderer = DepthRenderer(mesh)
    whole_m = renderer.depth_m(wide, T_world_camera)
    true_mm = np.rint(whole_m[240:480, 320:640] * 1000).astype(np.uint16)
    silhouette = true_mm > 0
    columns = np.flatnonzero(silhouette.any(axis=0))
    covered, empty, near, nearer = (columns[0] + np.arange(20 * i, 20 * i + 20) for i in range(4))
    depth_mm = true_mm.copy()
    depth_mm[:, covered] = 300
    depth_mm[:, empty] = 0
    for strip, by in ((near, 10), (nearer, 30)):
        depth_mm[:, strip] = np.where(true_mm[:, strip] > 0, true_mm[:, strip] - by, 0)
    seen = object_in_view(depth_mm, camera, T_world_camera, mesh, renderer)
    hidden = np.zeros_like(silhouette)
    hidden[:, np.concatenate([covered, nearer])] = True
    np.testing.assert_array_equal(seen.mask, silhouette)
    np.testing.assert_array_equal(seen.mask_visib, silhouette & ~hidden)
    assert seen.px_count_all == (whole_m > 0).sum() > silhouette.sum()
    assert seen.px_count_valid == (silhouette & (depth_mm > 0)).sum()
    assert seen.px_count_visib == seen.mask_visib.sum()
    assert seen.visib_fract == seen.px_count_visib / seen.px_count_all
    ys, xs = np.nonzero(whole_m)
    assert seen.bbox_obj == (xs.min() - 320, ys.min() - 240, int(np.ptp(xs)), int(np.ptp(ys)))
    ys, xs = np.nonzero(seen.mask_visib)
    assert seen.bbox_visib == (xs.min(), ys.min(), int(np.ptp(xs)), int(np.ptp(ys)))
    gone = object_in_view(np.full_like(depth_mm, 200), camera, T_world_camera, mesh, renderer)
    assert gone.bbox_obj == gone.bbox_visib == (-1, -1, -1, -1) and gone.visib_fract == 0


def test_a_damaged_release_is_not_exported(analytic: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(analytic / "benchmark", tmp_path / "benchmark"))
    path = folder / "objects" / "chair_02" / "mesh.ply"
    path.write_bytes(path.read_bytes()[:-1])
    with raises(ReleaseError, "release.changed", match=r"chair_02/mesh\.ply"):
        export_bop(open_release(folder), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("recording", list(SCENES))
def test_models_of_fewer_triangles_are_there_for_errors(bop: Path, recording: str) -> None:
    name = f"obj_{int(SCENES[recording][-6:]):06d}.ply"
    vertices, normals, faces = read_model(bop / "models_eval" / name)
    whole = len(read_model(bop / "models" / name)[2])
    assert len(faces) <= 10_000 and (len(faces) < whole or whole == 12)
    assert distance_mm(recording, vertices).max() < 0.5
    assert np.isfinite(normals).all()
    info = [(bop / models / "models_info.json").read_text() for models in ("models", "models_eval")]
    assert info[0] == info[1]
