"""Predictions in cells stand beside those in the camera frame: under `camera` they are solids in space."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_benchmark import run_here

from kinectbench.core.artefacts.scores import OVERALL
from kinectbench.core.errors import SettingsError
from kinectbench.core.geometry import invert_rigid
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.baselines.in_grids import comparison_baselines, score_baselines
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.camera_shape import occupancy_shape, write_shape
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score, score_methods
from kinectbench.scoring.truth import read_parts

NAMES = ("carved-hull", "empty")
OTHERS = ("mirror", "silhouette", "carved-hull", "partial")


@pytest.fixture(scope="module")
def published(analytic: Path) -> Release:
    """Two test pairs, and those of validation."""
    release = open_release(analytic / "benchmark")
    kept = {*release.split("test")[:2], *release.split("validation")[:1]}
    return Release(release.folder, tuple(t for t in release.targets if t in kept), release.metadata)


@pytest.fixture(scope="module")
def written(published: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grids")
    write_baselines(published, folder, NAMES)
    return folder


def test_a_grid_is_the_same_solid_under_both_kinds_of_protocol(published: Release, written: Path) -> None:
    folder = written / "carved-hull"
    grid = score(published, folder, method="hull", protocols=["known", "occluded"], surface=False)
    space = score(published, folder, method="hull", protocols=["camera"])
    assert space.complete and space.thresholds == grid.thresholds
    assert space.threshold_source == grid.threshold_source
    for protocol, heading in (("known", "camera"), ("occluded", "camera-occluded")):
        for one, other in zip(grid.pairs(protocol), space.pairs(heading), strict=True):
            assert other.iou == pytest.approx(one.iou, abs=1e-12) and other.cells == one.cells
            assert other.solid and other.chamfer_l1_m is not None and other.ce is None


def test_a_grid_has_the_figures_of_the_same_cells_in_the_camera_frame(
    published: Release, written: Path, tmp_path: Path
) -> None:
    """What a user of `frame: camera` would write of the same cells."""
    space = score(published, written / "carved-hull", method="hull", protocols=["camera"])
    (tmp_path / "method.json").write_text('{"name": "hull", "frame": "camera"}')
    for target in published.split("test"):
        cells = load_prediction(written / "carved-hull" / f"{target.name}.npz")
        names = ("T_world_grid", "T_world_camera", "voxel_size_m")
        T_grid, T_camera, size = read_parts(published.pair_path(target), target.sha256, names)
        shape = occupancy_shape(cells > 0.5, invert_rigid(T_camera) @ T_grid, float(size))
        write_shape(shape, tmp_path / target.name)
    camera = score(published, tmp_path, method="hull", protocols=["camera"])
    for one, other in zip(space.rows, camera.rows, strict=True):
        assert (one.pair, one.heading) == (other.pair, other.heading)
        # Coordinates that differ by rounding draw other samples: of 20,000 distances that spread as much as
        # their mean leave 1 / sqrt(20,000) = .7 % of it. Of a part there are fewer: two draws of the occluded
        # one were 5 % apart, of the visible one (1.6 mm) 3 %.
        share = 0.015 if one.heading == "camera" else 0.1
        assert one.chamfer_l1_m == pytest.approx(other.chamfer_l1_m, rel=share)
        assert one.iou == pytest.approx(other.iou, abs=1e-4)


def test_baselines_in_space_are_what_their_files_give(
    published: Release, written: Path, tmp_path: Path
) -> None:
    made = {table.method: table for table in score_baselines(published, tmp_path, protocols=["camera"])}
    assert "base-rate" not in made  # a constant has no surface
    files = {t.method: t for t in score_methods(published, written, tmp_path / "s", protocols=["camera"])}
    for name, table in files.items():
        assert made[name].rows == table.rows and made[name].thresholds == table.thresholds
        assert read_table(tmp_path / name / "scores.json").rows == table.rows
        assert recheck(published, tmp_path / "s" / name / "scores.json", written) == []
    assert made["empty"].averages("camera")[OVERALL].f_score_20mm == 0


def test_baselines_beside_are_kept_and_checked(published: Release, tmp_path: Path) -> None:
    found = comparison_baselines(published, tmp_path, protocols=["camera", "aligned"], without=OTHERS)
    assert all(table.baseline and table.settings.protocols == ("camera",) for table in found)
    path = tmp_path / "baselines" / "hull+camera" / "scores.json"
    kept = read_table(path)
    made = path.stat().st_mtime_ns
    assert comparison_baselines(published, tmp_path, protocols=["camera"], without=OTHERS) == found
    assert path.stat().st_mtime_ns == made
    rows = tuple(replace(row, chamfer_l1_m=0.001) if row.heading == "camera" else row for row in kept.rows)
    kept.model_copy(update={"rows": rows, "by_category": None, "overall": None}).write(path.parent)
    again = comparison_baselines(published, tmp_path, protocols=["camera"], without=OTHERS)
    assert again == found and read_table(path).rows == kept.rows


def test_protocols_of_both_kinds_are_asked_for_one_after_the_other(published: Release, written: Path) -> None:
    folder = written / "carved-hull"
    with pytest.raises(SettingsError, match="--protocol camera and known: surfaces in space and cells"):
        score(published, folder, method="hull", protocols=["known", "camera"])
    with pytest.raises(SettingsError, match="--upsampling corner-aligned: under camera it is half-pixel"):
        score(published, folder, method="hull", protocols=["camera"], upsampling="corner-aligned")


def test_missing_grids_are_named_or_empty(published: Release, written: Path, tmp_path: Path) -> None:
    target = published.split("test")[0]
    path = tmp_path / f"{target.name}.npy"
    path.parent.mkdir(parents=True)
    np.save(path, np.zeros((16, 16, 16), np.float32))
    found = score(published, tmp_path, method="net", protocols=["camera"])
    assert len(found.failures) == 1 and not found.complete
    found = score(published, tmp_path, method="net", protocols=["camera"], missing="empty")
    assert found.complete and len(found.missing_as_empty) == 1
    assert {row.iou for row in found.pairs("camera")} == {0.0}


def test_the_command_shows_baselines_in_the_same_table(
    analytic: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    release = open_release(analytic / "benchmark")
    write_baselines(release, tmp_path / "p", ["hull"])
    arguments = ["score", str(tmp_path / "p"), "--protocol", "camera", "--benchmark"]
    arguments += [str(analytic / "benchmark"), "--out", str(tmp_path / "s"), "--jobs", "1"]
    done = run_here(monkeypatch, capsys, tmp_path, *arguments)
    assert done.status == 0, done.err
    assert "carved-hull" in done.out and "Chamfer L1, m" in done.out
    assert "carved-hull" in (tmp_path / "s" / "index.html").read_text()
