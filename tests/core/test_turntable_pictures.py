"""Objects that turn: each frame shows the mesh from its own azimuth, without holes."""

import numpy as np
import trimesh

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.boxes import OrientedBox
from kinectbench.core.geometry.mesh import box_mesh
from kinectbench.core.pictures import PAPER
from kinectbench.core.turntable import ELEVATION_DEG, FILLED, FRAME_PX, FRAMES, turntable


def box(size_m: tuple[float, float, float]) -> TriangleMesh:
    return box_mesh(OrientedBox((0.0, 0.0, 0.0), size_m, 0.0))


def widths_and_heights(mesh: TriangleMesh) -> np.ndarray:
    """Of what each frame shows, pixels; every row and column between the ends of a convex thing is filled."""
    found = []
    for frame in np.split(turntable(mesh), FRAMES, axis=1):
        shown = np.abs(frame.astype(int) - PAPER).max(axis=2) > 8
        rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
        for row in rows[1:-1]:
            filled = np.flatnonzero(shown[row])
            assert len(filled) == filled[-1] - filled[0] + 1
        found.append((np.ptp(columns) + 1, np.ptp(rows) + 1))
    return np.array(found)


def test_a_box_is_as_wide_and_high_as_it_is() -> None:
    length, width, height = 1.0, 0.4, 0.5
    found = widths_and_heights(box((length, width, height)))
    a, e = np.arange(FRAMES) * 2 * np.pi / FRAMES, np.deg2rad(ELEVATION_DEG)
    across = length * np.abs(np.sin(a)) + width * np.abs(np.cos(a))
    deep = length * np.abs(np.cos(a)) + width * np.abs(np.sin(a))
    high = height * np.cos(e) + deep * np.sin(e)
    px_m = FRAME_PX * FILLED / np.hypot(length, width)
    np.testing.assert_allclose(found, np.stack([across, high], axis=1) * px_m, atol=2)


def test_the_same_mesh_in_any_place_is_drawn_alike() -> None:
    mesh = box((0.6, 0.4, 0.3))
    there = TriangleMesh(mesh.vertices + np.array([5.0, -3.0, 1.0]), mesh.faces)
    assert (turntable(mesh) == turntable(there)).all()
    assert turntable(mesh).shape == (FRAME_PX, FRAMES * FRAME_PX, 3)


def test_it_has_the_colours_of_the_scene_around_it() -> None:
    """Red from x = 0 on, where the scene is; the rest is farther than 30 mm from it, and of clay."""
    fine = TriangleMesh(*trimesh.remesh.subdivide_to_size(*_arrays(box((0.6, 0.4, 0.3))), 0.02)[:2])
    there = fine.vertices[fine.vertices[:, 0] > 0]
    scene = TriangleMesh(
        there, np.zeros((0, 3), np.int32), np.tile(np.array([200, 0, 0], np.uint8), (len(there), 1))
    )
    pictures = turntable(fine, scene).astype(int)
    red = pictures[..., 0] - pictures[..., 2] > 80
    share = red.sum() / (np.abs(pictures - PAPER).max(axis=2) > 8).sum()
    assert 0.4 < share < 0.65
    assert not (turntable(fine)[..., 0].astype(int) - turntable(fine)[..., 2] > 80).any()


def _arrays(mesh: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    return mesh.vertices, mesh.faces
