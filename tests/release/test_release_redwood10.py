"""Import of SDS-Complete's ten scans: a replica of its layout, of our own making, and its metrics by hand."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from file_damage import seal
from numpy.typing import NDArray
from raising import raises
from reference_models import drawn, moved
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from kinectbench.core.errors import PairError, ReleaseError, SettingsError
from kinectbench.core.geometry import TriangleMesh, rigid, transform_points
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.core.geometry.mesh import join, read_own_ply, write_ply
from kinectbench.core.voxels.pair_file import TRUTH_KEYS, unpack
from kinectbench.release.check.verify import verify
from kinectbench.release.exchange import redwood10
from kinectbench.release.exchange.bop import export_bop
from kinectbench.release.exchange.rgbd import export_rgbd
from kinectbench.release.release import Release, open_release
from kinectbench.report.gallery import read_pair_truth
from kinectbench.report.run import write_galleries
from kinectbench.report.space_table import space_table
from kinectbench.scoring.camera import bounds
from kinectbench.scoring.camera.bounds import points_by_area
from kinectbench.scoring.camera.surface import surface_of
from kinectbench.scoring.camera_shape import CameraShape, read_shape, write_shape
from kinectbench.scoring.score import score

Float64 = NDArray[np.float64]
SCANS = {"05117": "chair:7", "06188": "toy_car:1"}


def camera_of(size_m: float) -> Float64:
    """T_camera_floor of a camera that looks down at a thing from twice its size."""
    c, s = np.cos(0.5), np.sin(0.5)
    R = np.array([[1.0, 0, 0], [0, -s, -c], [0, c, -s]])
    return rigid(R, [0.02, 0.3 * size_m, 2.0 * size_m])


def write_scan(folder: Path, scan: str, name: str) -> TriangleMesh:
    """The files of a scan; its object, open below, in the camera frame."""
    upright = drawn(name)
    size_m = float(np.ptp(upright.vertices, axis=0).max())
    middle = upright.vertices[upright.faces].mean(axis=1)
    upright = upright.keep_faces(middle[:, 2] > 0.01 * size_m)
    corners = size_m * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    floor = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    T_camera_floor = camera_of(size_m)
    mine, scene = (mesh.transformed(T_camera_floor) for mesh in (upright, join([floor, upright])))
    depth_m = DepthRenderer(scene).depth_m(redwood10.CAMERA, np.eye(4))
    alone_m = DepthRenderer(mine).depth_m(redwood10.CAMERA, np.eye(4))
    mask = (alone_m > 0) & (alone_m <= depth_m + 1e-4)
    theirs, T_mesh_camera = moved(scene, 5)
    of = {"scan": scan, "frame": redwood10.SCANS[scan][1]}
    arrays = {
        redwood10.MASK_FILE: mask,
        redwood10.POSE_FILE: np.linalg.inv(T_mesh_camera),
        redwood10.VERTICES_FILE: np.arange(4, len(scene.vertices)),
    }
    for file, array in arrays.items():
        path = folder / file.format(**of)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, array)
    path = folder / redwood10.DEPTH_FILE.format(**of)
    path.parent.mkdir(parents=True)
    cv2.imwrite(str(path), np.rint(depth_m * 1000).astype(np.uint16))
    (folder / "mesh").mkdir(exist_ok=True)
    write_ply(theirs, folder / redwood10.MESH_FILE.format(**of))
    return mine


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, TriangleMesh]]:
    """A folder in the layout, and the true open meshes."""
    folder = tmp_path_factory.mktemp("sds")
    return folder, {scan: write_scan(folder, scan, name) for scan, name in SCANS.items()}


@pytest.fixture(scope="module")
def release(made: tuple[Path, dict[str, TriangleMesh]], tmp_path_factory: pytest.TempPathFactory) -> Release:
    out = tmp_path_factory.mktemp("out") / "redwood10"
    assert redwood10.import_redwood10(made[0], out) == len(SCANS)
    return open_release(out)


def test_the_release_has_inputs_and_open_meshes(
    release: Release, made: tuple[Path, dict[str, TriangleMesh]]
) -> None:
    assert verify(release.folder) == []
    assert [(t.recording, t.category, t.split) for t in release.targets] == [
        ("05117", "chair", "test"),
        ("06188", "motorcycle", "test"),
    ]
    for target in release.targets:
        with np.load(release.pair_path(target)) as pair:
            assert not set(pair) & set(TRUTH_KEYS)
            cells = np.argwhere(np.unpackbits(pair["partial_256"], axis=-1))
            points = transform_points(pair["T_world_grid"], (cells + 0.5) * pair["voxel_size_m"])
            far = 2 * float(pair["voxel_size_m"])
        true = made[1][target.recording]
        mesh = read_own_ply(release.folder / f"surfaces/{target.recording}.ply")
        np.testing.assert_allclose(mesh.vertices, true.vertices, atol=1e-5)
        exact = points_by_area(surface_of(CameraShape("mesh", true.vertices, true.faces.astype(np.int64))))
        assert np.quantile(cKDTree(exact).query(points)[0], 0.99) < far + 0.01
    with raises(ReleaseError, "release.surface-truth"):
        release.require_truth(["test"])
    card = (release.folder / "README.md").read_text()
    assert "is open meshes" in card and "non-commercial" in card


def test_a_damaged_open_mesh_is_named_once(release: Release, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(release.folder, tmp_path / "copy"))
    first = release.targets[0]
    shutil.copy(copy / first.file, copy / first.file.replace("000", "001"))
    (copy / f"surfaces/{first.recording}.ply").write_bytes(b"no mesh")
    seal(copy)
    assert sum("not a readable mesh" in line for line in verify(copy)) == 1


def test_it_is_exported_as_inputs(release: Release, tmp_path: Path) -> None:
    assert export_bop(release, tmp_path / "bop") == export_rgbd(release, tmp_path / "rgbd")[0] == len(SCANS)
    assert not list((tmp_path / "bop/models").glob("*.ply"))


def test_its_metrics_are_those_by_hand(
    release: Release,
    made: tuple[Path, dict[str, TriangleMesh]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bounds, "POINTS", 1024)  # all of them count
    shapes: dict[str, dict[str, CameraShape]] = {}
    for scan, true in made[1].items():
        exact = CameraShape("mesh", true.vertices, true.faces.astype(np.int64))
        points = true.vertices[true.faces].mean(axis=1)
        none = np.zeros((0, 3), np.int64)
        shapes[scan] = {
            "near": exact.transformed(rigid(np.eye(3), [0.02, -0.01, 0.0])),
            "larger": exact.transformed(np.diag([1.1, 1.1, 1.1, 1.0])),
            "points": CameraShape("points", points + np.array([0.0, 0.0, 0.03]), none),
        }
    for kind in ("near", "larger", "points"):
        folder = tmp_path / kind
        for scan, of_scan in shapes.items():
            write_shape(of_scan[kind], folder / scan / "000")
        content = {"format_version": 1, "name": kind, "frame": "camera", "unit": "m", "axes": "cv"}
        (folder / "method.json").write_text(json.dumps(content))
        table = score(release, folder, method=kind, protocols=["camera"])
        assert not table.failures and any("open mesh" in line for line in table.warnings)
        # It is drawn and said to be there, though it has no figures of an inside.
        names = [name for name, _ in space_table([table]).groups["camera"]]
        assert names == [kind]
        table.write(tmp_path / "scores" / kind)
        write_galleries(release, folder, [table], tmp_path / "scores" / kind, "trilinear")
        whole = {row.recording: row for row in table.rows if row.part == "whole"}
        assert all(row.iou is None and row.precision is None for row in table.rows)
        for scan in shapes:
            # As float32 in the files; the world is the camera's frame.
            (path,) = (folder / scan).iterdir()
            p, t = (
                points_by_area(surface_of(read_shape(file, file.name)))
                for file in (path, release.folder / f"surfaces/{scan}.ply")
            )
            ways = [cKDTree(b).query(a)[0] * 1000 for a, b in ((p, t), (t, p))]
            row = whole[scan].as_papers
            assert row is not None and row.sds_emd_mm is not None
            assert row.sds_chamfer_l1_mm == pytest.approx(sum(w.mean() for w in ways) / 2, rel=1e-6)
            assert row.sds_chamfer_l2_mm2 == pytest.approx(sum((w**2).mean() for w in ways), rel=1e-6)
            far_mm = cdist(p, t) * 1000
            exact_mm = far_mm[linear_sum_assignment(far_mm)].mean()
            assert exact_mm * (1 - 1e-9) <= row.sds_emd_mm <= exact_mm * 1.005


def test_the_page_draws_the_open_truth(release: Release) -> None:
    for target in release.split("test"):
        truth = read_pair_truth(release, target)
        full, partial = unpack(truth.full), unpack(truth.partial)
        near = sum(np.roll(full, by, axis) for axis in range(3) for by in (-1, 0, 1)) > 0
        assert full.any() and (partial & near).sum() > 0.9 * partial.sum() and not truth.unseen.any()


@pytest.mark.parametrize("coordinate", [np.nan, 1e30])
def test_a_mesh_that_is_nowhere_is_refused(tmp_path: Path, coordinate: float) -> None:
    write_scan(tmp_path / "sds", "05117", "chair:7")
    path = tmp_path / "sds" / redwood10.MESH_FILE.format(scan="05117")
    mesh = read_own_ply(path)
    mesh.vertices[:] = coordinate
    write_ply(mesh, path)
    with pytest.raises(PairError, match="not finite"):
        redwood10.import_redwood10(tmp_path / "sds", tmp_path / "out")


def test_what_cannot_be_read_is_one_line(made: tuple[Path, dict[str, TriangleMesh]], tmp_path: Path) -> None:
    with raises(SettingsError, "settings.no-file"):
        redwood10.import_redwood10(tmp_path, tmp_path / "out")
    write_scan(tmp_path / "sds", "05117", "chair:7")
    of = {"scan": "05117", "frame": redwood10.SCANS["05117"][1]}
    for file, content in (
        (redwood10.MESH_FILE, b"ply\n"),
        (redwood10.VERTICES_FILE, b"\x93NUMPY"),
        (redwood10.POSE_FILE, None),
        (redwood10.DEPTH_FILE, b"no image"),
    ):
        path = tmp_path / "sds" / file.format(**of)
        kept = path.read_bytes()
        path.unlink() if content is None else path.write_bytes(content)
        with pytest.raises((PairError, ReleaseError), match=path.name) as caught:
            redwood10.import_redwood10(tmp_path / "sds", tmp_path / "out")
        assert "\n" not in str(caught.value)
        path.write_bytes(kept)
    assert not (tmp_path / "out").exists()
