"""Open meshes become solids by generalised winding numbers, which a plain sum over all triangles confirms."""

import json
from pathlib import Path

import analytic_release
import numpy as np
import pytest
import trimesh
from raising import raises
from typed import present

from kinectbench.core.artefacts.scores import OVERALL
from kinectbench.core.errors import SettingsError
from kinectbench.release.release import open_release
from kinectbench.report.space_table import space_table
from kinectbench.scoring.camera import solid
from kinectbench.scoring.camera.solid import inside_winding
from kinectbench.scoring.camera_shape import CameraShape, write_shape
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score

SIDE = 32
# What far triangles together may move a number by: at most 0.021 was measured on balls and half balls.
NEAR = 0.03


def plain(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Winding numbers (n,) of points (n, 3): the sum of all solid angles."""
    a, b, c = (vertices[faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(one, axis=-1) for one in (a, b, c))
    across = (a * np.cross(b, c)).sum(axis=-1)
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.asarray(np.arctan2(across, below).sum(axis=1) / (2 * np.pi))


def ball(cut: float = 9.0) -> tuple[np.ndarray, np.ndarray]:
    """Of a radius of 12 cells in the grid's middle, without what is `cut` cells above that."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=12)
    return np.asarray(mesh.vertices) + SIDE / 2, mesh.faces[mesh.triangles_center[:, 2] < cut].astype(
        np.int32
    )


@pytest.mark.parametrize("kind", ["closed", "open", "inside out", "soup", "two", "one triangle"])
def test_the_cells_are_those_of_the_plain_sum(kind: str) -> None:
    vertices, faces = ball(99.0 if kind == "closed" else 3.0)
    if kind == "inside out":
        faces = faces[:, ::-1]
    elif kind == "soup":
        vertices, faces = vertices[faces.ravel()], np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    elif kind == "two":
        vertices, faces = (
            np.concatenate([vertices, vertices + 3]),
            np.concatenate([faces, faces + len(vertices)]),
        )
    elif kind == "one triangle":
        faces = faces[:1]
    found, outside = present(inside_winding(vertices, np.ascontiguousarray(faces), SIDE))
    cells = np.random.default_rng(0).integers(0, SIDE, (1500, 3))
    numbers = np.abs(np.concatenate([plain(vertices, faces, p + 0.5) for p in np.array_split(cells, 10)]))
    low, high = vertices[faces].min(axis=(0, 1)), vertices[faces].max(axis=(0, 1))
    numbers[((cells + 0.5 < low) | (cells + 0.5 > high)).any(axis=1)] = 0  # not beyond the mesh's box
    differs = found[tuple(cells.T)] != (numbers > 0.5)
    assert (np.abs(numbers[differs] - 0.5) < NEAR).all() and differs.mean() < 0.01
    assert kind == "two" or outside == 0
    if kind == "closed":
        assert found.sum() == pytest.approx(4 / 3 * np.pi * 12**3, rel=0.02)


def test_volume_outside_the_grid_counts() -> None:
    vertices, faces = ball(11.0)
    whole = present(inside_winding(vertices, faces, SIDE))[0].sum()
    half, outside = present(inside_winding(vertices + np.array([SIDE / 2, 0, 0]), faces, SIDE))
    assert half.sum() == pytest.approx(whole / 2, rel=0.02) and outside == pytest.approx(whole / 2, rel=0.05)


@pytest.mark.parametrize("half", [450, 5000])
def test_a_grid_deep_inside_a_mesh_is_full(half: int) -> None:
    """A block that contains the grid is decided whole, or is finer than the blocks outside."""
    box = trimesh.creation.box(extents=[2 * half] * 3)
    vertices = np.asarray(box.vertices) + SIDE / 2
    found, outside = present(inside_winding(vertices, box.faces.astype(np.int32), SIDE))
    assert found.all() and outside == pytest.approx((2.0 * half) ** 3 - SIDE**3, rel=0.05)


def test_open_meshes_are_scored_as_solids_where_that_is_asked(
    analytic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    release, folder = open_release(analytic / "benchmark"), tmp_path / "open"
    for target in release.split("test"):
        shape = analytic_release.true_in_camera(target.recording, target.category, target.view)
        write_shape(CameraShape("mesh", shape.points_m, shape.faces[1:]), folder / target.name)
    (folder / "method.json").write_text(json.dumps({"name": "open", "frame": "camera"}))
    table = score(release, folder, method="open", protocols=["camera"], close="winding")
    for row in table.pairs("camera"):
        assert row.solid is False and row.closed == "winding" and row.iou is not None and row.iou > 0.95
    count = len(release.split("test"))
    assert table.settings.close == "winding"
    assert [mark.words for mark in table.marks] == [f"{count} of {count} open, closed by winding"]
    assert table.warnings[0].endswith("made solid by --close winding")
    assert space_table([table]).groups["camera"][0][0] == "open (closed: winding)"
    table.write(tmp_path / "scores")
    assert recheck(release, tmp_path / "scores" / "scores.json", folder) == []
    assert score(release, folder, method="open", protocols=["camera"]).averages("camera")[OVERALL].iou is None
    monkeypatch.setattr(solid, "MOST_STEPS", 10_000)
    (reason, *_) = {found.reason for found in score(release, folder, method="open", close="winding").failures}
    assert "faces across each other; simplify the mesh" in reason
    with raises(SettingsError, "settings.wrong-value", "--close hull: choose winding or poisson"):
        score(release, folder, method="open", close="hull")
