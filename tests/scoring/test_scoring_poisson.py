"""Open meshes and points with normals become solids by Poisson reconstruction."""

import json
from pathlib import Path

import analytic_release
import numpy as np
import pytest
import trimesh
from raising import raises
from typed import present

from kinectbench.core.artefacts.scores import OVERALL
from kinectbench.core.errors import PredictionError, SettingsError
from kinectbench.core.geometry import Grid
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.release.release import open_release
from kinectbench.report.space_table import space_table
from kinectbench.scoring.camera import solid
from kinectbench.scoring.camera.solid import solid_in, to_be_closed
from kinectbench.scoring.camera.surface import surface_of
from kinectbench.scoring.camera.truth import SpaceTruth, space_truth
from kinectbench.scoring.camera_shape import CameraShape, write_shape
from kinectbench.scoring.closed_mesh import closed_mesh
from kinectbench.scoring.score import score

NONE = np.zeros((0, 3), np.int64)
GRID = Grid((256,) * 3, 0.003, np.eye(4))
# The IoU of what is closed with the whole ball: 0.996 and 0.957 at 128 cells (docs/evidence/scoring.md).
LEAST = {0.2: 0.985, 0.5: 0.94}


def ball() -> trimesh.Trimesh:
    """Of a radius of 0.3 m, in the middle of the grid."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.3)
    return mesh.apply_translation([0.384] * 3)


def nothing() -> SpaceTruth:
    """The truth of a view without anything in it."""
    empty = np.zeros((256, 256, 32), np.uint8)
    return space_truth(empty, empty, empty, np.eye(4), 0.003)


@pytest.mark.parametrize("lost", LEAST)
@pytest.mark.parametrize("form", ["mesh", "inside out", "points"])
def test_a_ball_that_lacks_a_part_is_whole_again(form: str, lost: float) -> None:
    whole = ball()
    height = whole.triangles_center[:, 2]
    faces = np.asarray(whole.faces[height > np.quantile(height, lost)], np.int64)
    shape = CameraShape("mesh", np.asarray(whole.vertices), faces[:, ::-1] if form == "inside out" else faces)
    surface = surface_of(shape)
    if form == "points":
        shape = CameraShape("points", surface.points_m[::3], NONE, 5 * present(surface.normals)[::3])
        surface = surface_of(shape)
    made, again = (present(to_be_closed(shape, surface, "poisson")) for _ in range(2))
    assert made.points_m.tobytes() == again.points_m.tobytes() and (made.faces == again.faces).all()
    mesh = closed_mesh(made)
    assert mesh is not None
    found = unpack(present(solid_in(nothing(), made, mesh, np.eye(4))).cells)
    true = unpack(voxelize_solid(np.asarray(whole.vertices), whole.faces.astype(np.int32), GRID))
    assert (found & true).sum() / (found | true).sum() > LEAST[lost]


@pytest.mark.parametrize("normals", [None, np.zeros((50, 3)), np.ones((50, 3))])
def test_points_without_normals_or_at_one_place_have_no_inside(normals: np.ndarray | None) -> None:
    # The library itself ends the process at points that are all the same.
    points = np.ones((50, 3)) if normals is not None and normals.any() else np.eye(3)[np.arange(50) % 3]
    shape = CameraShape("points", points, NONE, normals)
    assert to_be_closed(shape, surface_of(shape), "poisson") is None


def test_a_soup_takes_bounded_time(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = np.random.default_rng(0).random((60_000, 3))
    soup = CameraShape("mesh", corners, np.arange(60_000).reshape(-1, 3))
    made = present(to_be_closed(soup, surface_of(soup), "poisson"))
    # Cells of 1/64 of the shape have at most so many; it stays open, and counts as one that winding closes.
    assert len(made.faces) < 64**3 and closed_mesh(made) is None
    monkeypatch.setattr(solid, "MOST_STEPS", 10_000)
    with raises(PredictionError, "prediction.too-large"):
        solid_in(nothing(), made, None, np.eye(4), "poisson")


def test_points_with_normals_are_scored_as_solids(
    analytic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    release, folder = open_release(analytic / "benchmark"), tmp_path / "cloud"
    views = release.split("test")
    for number, target in enumerate(views):
        surface = surface_of(
            analytic_release.true_in_camera(target.recording, target.category, target.view)
        ).thinned(5000)
        normals = surface.normals if number else None
        write_shape(CameraShape("points", surface.points_m, NONE, normals), folder / target.name)
    declared = {"name": "cloud", "frame": "camera", "form": "points"}
    (folder / "method.json").write_text(json.dumps(declared))
    table = score(release, folder, method="cloud", protocols=["camera"], close="poisson")
    by_view = {row.pair: row for row in table.pairs("camera")}
    first = by_view.pop(views[0].name)
    assert first.closed is None and first.iou is None
    for row in by_view.values():
        assert row.solid is False and row.closed == "poisson" and row.iou is not None and row.iou > 0.9
    count = len(views)
    assert table.settings.close == "poisson" and not table.failures
    assert [mark.words for mark in table.marks] == [f"{count - 1} of {count} open, closed by poisson"]
    without, closed = table.warnings[:2]
    assert views[0].name in without and without.endswith("; --close poisson needs normals")
    assert closed.endswith("made solid by --close poisson")
    assert space_table([table]).groups["camera"][0][0] == "cloud (closed: poisson)"
    # Points stay without an inside by winding numbers.
    by_winding = score(release, folder, method="cloud", protocols=["camera"], close="winding")
    assert by_winding.averages("camera")[OVERALL].iou is None and not by_winding.marks
    monkeypatch.setattr("kinectbench.core.extras.find_spec", lambda name: None)
    with raises(SettingsError, "settings.no-package", r"--close poisson: .*kinectbench\[build\]"):
        score(release, folder, method="cloud", close="poisson")
