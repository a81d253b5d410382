"""Closed meshes are closed in every form in which programs write them."""

from pathlib import Path

import numpy as np
import pytest

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.mesh import is_closed, isosurface, joined_vertices, why_open
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.closed_mesh import closed_mesh
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.stages.reference.truth import read_reference

VOXEL_M = 0.004


def ball_of_cubes() -> TriangleMesh:
    """Marching cubes of a ball whose surface runs through grid points: three places of a face are one."""
    points = np.stack(np.meshgrid(*[np.arange(11.0) - 5] * 3, indexing="ij"), -1)
    mesh = isosurface((np.linalg.norm(points, axis=-1) - 3).astype(np.float32))
    return TriangleMesh((mesh.vertices - 5) / 3, mesh.faces)


def ball_of_latitudes() -> TriangleMesh:
    """Latitudes and longitudes: the quads at the poles have two corners at one place."""
    down, around = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, 2 * np.pi, 25), indexing="ij")
    parts = [np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)]
    a = (np.arange(12)[:, None] * 25 + np.arange(24)).ravel()
    quads = np.stack([a, a + 25, a + 26, a + 1], axis=-1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return TriangleMesh(np.stack(parts, axis=-1).reshape(-1, 3), faces)


@pytest.mark.parametrize("ball", [ball_of_cubes(), ball_of_latitudes()], ids=["cubes", "latitudes"])
def test_faces_that_collapse_leave_a_mesh_closed(ball: TriangleMesh, tmp_path: Path) -> None:
    """Such a mesh is a prediction in the pair's grid, one in the camera frame, and a reference."""
    vertices, faces = joined_vertices(ball.vertices, ball.faces)
    assert 0 < len(faces) < len(ball.faces)
    assert is_closed(faces)
    assert not is_closed(faces[1:])

    points = ball.vertices * 0.3 + 0.5
    lines = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()]
    lines += [f"f {a} {b} {c}\n" for a, b, c in (ball.faces + 1).tolist()]
    path = tmp_path / "000.obj"
    path.write_text("".join(lines))
    volume_m3 = TriangleMesh(vertices * 0.3 + 0.5, faces).volume_m3
    assert volume_m3 > 0.8 * 4 / 3 * np.pi * 0.3**3
    cells = np.count_nonzero(load_prediction(path, "a", VOXEL_M))
    assert cells * VOXEL_M**3 == pytest.approx(volume_m3, rel=0.005)
    assert closed_mesh(CameraShape("mesh", points, ball.faces.astype(np.int64))) is not None
    assert read_reference(path).closed


def test_a_mesh_whose_faces_all_collapse_is_open() -> None:
    vertices, faces = joined_vertices(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    assert vertices.shape == (1, 3)
    assert faces.shape == (0, 3)
    assert not is_closed(faces)


def test_a_mesh_of_faces_without_area_is_open_for_that_reason() -> None:
    faces = joined_vertices(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))[1]
    assert len(faces) == 0 and why_open(faces) == "no face has an area"
