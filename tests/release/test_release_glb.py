"""The GLB of an object, read by trimesh: its surface is that of mesh.ply, and it is held back with it."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from analytic_release import RADIUS_M, T_world_floor, surface_distance_m, true_mesh
from synthetic_release import synthetic_settings

from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.geometry import TriangleMesh, invert_rigid
from kinectbench.core.geometry.mesh import decimated, surface_distances_m
from kinectbench.release.check.verify import verify
from kinectbench.release.publish import object_glb
from kinectbench.release.publish.object_glb import T_GLTF_FLOOR, glb_bytes
from kinectbench.release.publish.publish import publish
from kinectbench.settings.models import RecordingSettings


def said(content: bytes) -> dict[str, Any]:
    """What a GLB says of its mesh."""
    length = int.from_bytes(content[12:16], "little")
    (mesh,) = json.loads(content[20 : 20 + length])["meshes"]
    extras: dict[str, Any] = mesh["extras"]
    return extras


def loaded(content: bytes) -> trimesh.Trimesh:
    return trimesh.load_mesh(trimesh.util.wrap_as_stream(content), file_type="glb", process=False)


def test_it_stands_on_the_floor_with_y_up(analytic: Path) -> None:
    for name, category, index in (("chair_01", "chair", 0), ("table_01", "table", 3)):
        content = (analytic / "benchmark" / "objects" / f"{name}.glb").read_bytes()
        shown = loaded(content)
        assert len(content) <= 2_000_000 and shown.is_watertight
        points_floor = np.asarray(shown.vertices) @ T_GLTF_FLOOR[:3, :3]
        assert surface_distance_m(category, points_floor).max() < 1e-3
        if category == "table":
            assert abs(shown.bounds[0][1]) < 1e-5 and abs(shown.bounds[1][1] - 0.5) < 1e-5
        T = np.array(said(content)["T_gltf_world"])
        np.testing.assert_allclose(T, T_GLTF_FLOOR @ invert_rigid(T_world_floor(index)), atol=1e-9)
        assert (shown.face_normals * (shown.triangles_center - shown.centroid)).sum(axis=1).mean() > 0


def test_a_large_mesh_is_made_smaller_and_says_by_how_much(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = true_mesh("chair", 0)
    monkeypatch.setattr(object_glb, "MOST_TRIANGLES", 2000)
    content = glb_bytes(mesh, invert_rigid(T_world_floor(0)))
    assert content is not None and content == glb_bytes(mesh, invert_rigid(T_world_floor(0)))
    shown, told = loaded(content), said(content)
    assert told["triangles"] == len(shown.faces) <= 2000 < told["triangles_of_mesh_ply"] == len(mesh.faces)
    points_floor = np.asarray(shown.vertices) @ T_GLTF_FLOOR[:3, :3]
    true_mm = surface_distance_m("chair", points_floor) * 1000
    # Of a ball the vertices lie near it, the triangles within: by r (1 - cos) of half an edge's angle.
    assert abs(told["to_mesh_ply_mm"]["max"] - true_mm.max()) < 0.2
    assert 0 < told["from_mesh_ply_mm"]["mean"] < told["from_mesh_ply_mm"]["max"] < 0.01 * RADIUS_M * 1000


def test_its_normals_are_those_of_the_surface(analytic: Path) -> None:
    shown = loaded((analytic / "benchmark/objects/chair_01.glb").read_bytes())
    outward = np.asarray(shown.vertices) - shown.centroid
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    # trimesh reads them with the file; a ball's point to its middle.
    assert (np.asarray(shown.vertex_normals) * outward).sum(axis=1).min() > 0.999


def test_a_vertex_without_a_triangle_has_no_normal() -> None:
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [5, 5, 5]])
    mesh = TriangleMesh(corners, np.array([[0, 1, 2]], np.int32))
    np.testing.assert_array_equal(mesh.vertex_normals, [[0, 0, 1]] * 3 + [[0, 0, 0]])


def test_what_is_larger_than_the_bytes_is_made_smaller_again(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = true_mesh("chair", 0)
    monkeypatch.setattr(object_glb, "MOST_GLB_BYTES", 200_000)
    content = glb_bytes(mesh, np.eye(4))
    assert content is not None and 100_000 < len(content) <= 200_000


def test_triangles_that_share_no_corner_are_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    corners = rng.random((20_000, 1, 3)) + 0.01 * rng.random((20_000, 3, 3))
    loose = TriangleMesh(corners.reshape(-1, 3), np.arange(60_000, dtype=np.int32).reshape(-1, 3))
    assert glb_bytes(loose, np.eye(4)) is not None
    monkeypatch.setattr(object_glb, "MOST_GLB_BYTES", 500_000)
    assert glb_bytes(loose, np.eye(4)) is None
    assert glb_bytes(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), np.eye(4)) is None


def test_fewer_triangles_of_a_ball() -> None:
    mesh = true_mesh("chair", 0)
    assert decimated(mesh, len(mesh.faces)) is mesh
    fewer = decimated(mesh, 1000)
    assert 900 <= len(fewer.faces) <= 1000
    assert surface_distances_m(fewer.vertices, mesh).max() < 2e-3
    # The largest polyhedron of 1000 triangles in a ball lacks 0.7 % of it; these are not all alike.
    assert 0.98 < fewer.volume_m3 / mesh.volume_m3 < 1


def test_what_is_held_back_has_none(analytic: Path, tmp_path: Path) -> None:
    options = PublishOptions(hold_back=("test",), thresholds=None)
    names = ["chair_01", "chair_03"]
    summary = publish(synthetic_settings(), analytic / "build", tmp_path / "b", names, options)
    assert summary.private is not None
    glbs = {
        folder: {path.name for path in folder.rglob("*.glb")} for folder in (summary.folder, summary.private)
    }
    assert glbs == {
        summary.folder: {"chair_03.glb"},
        summary.private: {"chair_01.glb", "chair_03.glb"},
    }
    shutil.copy(summary.private / "objects/chair_01.glb", summary.folder / "objects/chair_01.glb")
    assert "objects/chair_01.glb: truth of a split that is held back" in verify(summary.folder)


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda content: content[:10], "cut short in its head"),
        (lambda content: b"glTF\1" + content[5:], "not a binary glTF 2.0 file"),
        (lambda content: content[:-4], "bytes where its head claims"),
        (lambda content: content[:20] + b"[" + content[21:], "not valid JSON"),
        (lambda content: content + bytes(2_000_001), "are more than such a file can have"),
    ],
)
def test_verify_looks_at_it(analytic: Path, tmp_path: Path, damage: Any, told: str) -> None:
    from test_release_hostile import seal

    folder = Path(shutil.copytree(analytic / "benchmark", tmp_path / "b"))
    path = folder / "objects/chair_01.glb"
    path.write_bytes(damage(path.read_bytes()))
    lines = verify(seal(folder))
    assert len(lines) == 1 and lines[0].startswith("objects/chair_01.glb: ") and told in lines[0], lines


def test_a_recording_has_not_the_name_of_one() -> None:
    with pytest.raises(ValueError, match="files and folders of kinectbench have such names"):
        RecordingSettings.model_validate({"id": "chair.glb", "path": "x", "category": "chair"})
