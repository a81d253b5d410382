"""A GLB has the colours of the scene, where colour is registered and published; else it has none."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from analytic_release import true_mesh
from synthetic_release import synthetic_settings

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.mesh import read_own_ply, write_ply
from kinectbench.core.pictures import CLAY
from kinectbench.release.publish.object_glb import MOST_TRIANGLES, SCENE, glb_bytes
from kinectbench.release.publish.publish import publish

RED = np.array([200, 10, 20], np.uint8)


def colors_of(content: bytes) -> np.ndarray | None:
    shown = trimesh.load_mesh(trimesh.util.wrap_as_stream(content), file_type="glb", process=False)
    return np.asarray(shown.visual.vertex_colors)[:, :3] if shown.visual.kind == "vertex" else None


def test_half_a_scene_colours_half_an_object() -> None:
    """What is farther than 30 mm from what was recorded is of clay. It stays within 2 MB."""
    mesh = true_mesh("chair", 0)
    middle = mesh.vertices.mean(axis=0)
    right = mesh.vertices[mesh.vertices[:, 0] > middle[0]]
    scene = TriangleMesh(right, np.zeros((0, 3), np.int32), np.tile(RED, (len(right), 1)))
    content = glb_bytes(mesh, np.eye(4), scene)
    assert content is not None and len(content) <= 2_000_000
    assert len(mesh.faces) <= MOST_TRIANGLES
    found = colors_of(content)
    assert found is not None
    is_red = (found == RED).all(axis=1)
    assert 0.45 < is_red.mean() < 0.6 and (found[~is_red] == CLAY).all()


@pytest.mark.parametrize("color", [True, False])
def test_only_where_colour_is_published(analytic: Path, tmp_path: Path, color: bool) -> None:
    build = tmp_path / "build"
    shutil.copytree(analytic / "build/chair_01", build / "chair_01")
    mesh = read_own_ply(build / "chair_01/object/mesh.ply")
    (build / "chair_01" / SCENE).parent.mkdir(exist_ok=True)
    scene = TriangleMesh(mesh.vertices, mesh.faces, np.tile(RED, (len(mesh.vertices), 1)))
    write_ply(scene, build / "chair_01" / SCENE)
    settings = synthetic_settings(publish={"color": color})
    folder = publish(settings, build, tmp_path / "b", ["chair_01"]).folder
    found = colors_of((folder / "objects/chair_01.glb").read_bytes())
    assert (found is not None) == color
    assert found is None or (found == RED).all()
