"""A folder of predictions in the camera frame becomes a table; what it cannot have is said."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import analytic_release
import numpy as np
import pytest
from raising import raises
from small_benchmark import run_here
from typed import present

from kinectbench.core.artefacts.scores import OVERALL, ScoreTable
from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.core.geometry import invert_rigid
from kinectbench.release.release import Release, Target, open_release
from kinectbench.scoring.camera import score_camera_method as score_module
from kinectbench.scoring.camera.score_view import asked_rows
from kinectbench.scoring.camera_shape import CameraShape, write_shape
from kinectbench.scoring.compare import compare
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score, score_methods


@pytest.fixture(scope="module")
def published(analytic: Path) -> Release:
    return open_release(analytic / "benchmark")


def true_shape(target: Target) -> CameraShape:
    return analytic_release.true_in_camera(target.recording, target.category, target.view)


def declare(folder: Path, **keys: Any) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "method.json").write_text(json.dumps({"name": folder.name, "frame": "camera"} | keys))


def write_all(published: Release, folder: Path, moved_m: float = 0.0, **keys: Any) -> Path:
    """The truth of each test view, moved away from the camera."""
    declare(folder, **keys)
    for target in published.split("test"):
        shape = true_shape(target)
        moved = CameraShape("mesh", shape.points_m + np.array([0, 0, moved_m]), shape.faces)
        write_shape(moved, folder / target.recording / target.view)
    return folder


@pytest.fixture(scope="module")
def folder(published: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_all(published, tmp_path_factory.mktemp("predictions") / "true")


@pytest.fixture(scope="module")
def table(published: Release, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> ScoreTable:
    out = tmp_path_factory.mktemp("scores")
    score_methods(published, folder, out, protocols=["camera"])
    return read_table(out / "scores.json")


def test_the_truth_in_the_camera_frame_is_nearly_perfect(published: Release, table: ScoreTable) -> None:
    assert table.complete and not table.warnings and not table.marks
    assert len(table.rows) == 3 * len(published.split("test"))
    assert {row.heading for row in table.rows} == {"camera", "camera-visible", "camera-occluded"}
    for row in table.pairs("camera"):
        assert row.iou is not None and row.iou > 0.98 and row.solid
        assert row.chamfer_l1_m is not None and row.chamfer_l1_m < 0.002
        assert row.f_score_5mm == 1 and row.predicted_unknown_share == 0 and row.chamfer_mm is None
    overall = table.averages("camera")[OVERALL]
    assert overall.f_score_5mm == 1 and overall.iou is not None and overall.normal_consistency is not None
    assert table.csv().splitlines()[0].count("chamfer_l1_m") == 1
    cells = next(csv.DictReader(io.StringIO(table.csv())))
    assert json.loads(cells["as_papers"]).keys() >= {"octmae_chamfer_l1_mm"}


def test_the_iou_is_that_of_the_grid_protocol(published: Release, table: ScoreTable, tmp_path: Path) -> None:
    """The same meshes in the grid's frame, scored under `known`."""
    from kinectbench.scoring.truth import read_parts

    for target in published.split("test"):
        T_world_grid, T_world_camera = read_parts(
            published.pair_path(target), target.sha256, ("T_world_grid", "T_world_camera")
        )
        moved = true_shape(target).transformed(invert_rigid(T_world_grid) @ T_world_camera)
        write_shape(moved, tmp_path / target.recording / target.view)
    grid = score(published, tmp_path, method="grid", protocols=["known", "occluded"], surface=False)
    for protocol, heading in (("known", "camera"), ("occluded", "camera-occluded")):
        for one, other in zip(grid.pairs(protocol), table.pairs(heading), strict=True):
            assert one.pair == other.pair and one.iou is not None and other.iou is not None
            assert other.iou == pytest.approx(one.iou, abs=0.005)
            assert other.unknown_share == one.unknown_share
            assert other.coverage_shape == pytest.approx(one.coverage_shape)


def test_a_table_is_compared_and_rechecked(
    published: Release, folder: Path, tmp_path: Path, table: ScoreTable
) -> None:
    far = write_all(published, tmp_path / "far", 0.02)
    score_methods(published, far, tmp_path / "scores", protocols=["camera"])
    other = read_table(tmp_path / "scores" / "scores.json")
    found = compare([table, other], "chamfer_l1_m", "camera-visible")
    assert found.means["all"]["true"] < found.means["all"]["far"]
    table.write(tmp_path / "true")
    assert recheck(published, tmp_path / "true" / "scores.json", folder) == []
    assert read_table(tmp_path / "true" / "scores.json").standing.startswith("verified")


def test_open_meshes_have_no_iou_and_the_table_says_so(published: Release, tmp_path: Path) -> None:
    folder = write_all(published, tmp_path / "open")
    target = published.split("test")[0]
    shape = true_shape(target)
    write_shape(CameraShape("mesh", shape.points_m, shape.faces[1:]), folder / target.name)
    found = score(published, folder, method="open", protocols=["camera"])
    assert found.complete and found.pairs("camera")[0].iou is None and found.pairs("camera")[0].solid is False
    assert found.averages("camera")[OVERALL].iou is None
    assert found.averages("camera")[OVERALL].chamfer_l1_m is not None
    count, why = len(published.split("test")), f"3 of {len(shape.faces) * 3 // 2} edges with one face: holes"
    assert found.warnings == (
        f"1 of {count} predictions are open meshes or points, such as {target.name} ({why}): they have no "
        "inside, so they have metrics of surfaces alone",
    )


def test_what_cannot_be_scored_is_named(published: Release, tmp_path: Path) -> None:
    folder = write_all(published, tmp_path / "net")
    first, second, *_ = published.split("test")
    (folder / f"{first.name}.ply").unlink()
    (folder / f"{second.name}.ply").write_bytes(b"no mesh")
    (folder / "stray.txt").write_text("")
    found = score(published, folder, method="net", protocols=["camera"])
    assert not found.complete and found.overall is None
    assert [failure.reason.split(":")[0] for failure in found.failures] == [first.name, f"{second.name}.ply"]
    assert any(line.startswith("stray.txt") for line in found.warnings)
    (folder / f"{second.name}.ply").unlink()
    empty = score(published, folder, method="net", protocols=["camera"], missing="empty")
    assert empty.complete and empty.missing_as_empty == (first.name, second.name)
    worst = next(row for row in empty.pairs("camera") if row.pair == first.name)
    assert worst.f_score_20mm == 0 and worst.cells == 0 and worst.solid is None
    assert worst.iou == worst.precision == worst.recall == 0
    assert "2 of" in empty.marks[0].words


def test_protocols_of_the_other_frame_are_refused(published: Release, folder: Path, tmp_path: Path) -> None:
    with raises(SettingsError, "settings.wrong-value", match="--protocol known"):
        score(published, folder, method="true", protocols=["known"])
    declare(tmp_path / "free", scale="free")
    with raises(SettingsError, "settings.wrong-value", match="free are of free size"):
        score(published, tmp_path / "free", method="free", protocols=["camera"])


def test_more_rows_than_can_be_read_are_refused_before_they_are_scored(
    published: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    views = len(published.split("test"))
    monkeypatch.setattr(score_module, "MOST_ROWS_IN_SPACE", 12 * views)
    score_module.refuse_many_rows(views, asked_rows(["camera", "aligned"], "metric"))
    declare(tmp_path / "several", hypotheses=3)
    declare(tmp_path / "grid", frame="grid")
    for name, rows in (("several", 36), ("grid", 12)):
        monkeypatch.setattr(score_module, "MOST_ROWS_IN_SPACE", 12 * views - 1)
        with raises(SettingsError, "settings.too-large", match=f"{views} views with {rows} rows each"):
            score(published, tmp_path / name, method=name, protocols=["camera", "aligned"], missing="empty")


def test_several_hypotheses_have_the_first_the_best_and_the_mean(published: Release, tmp_path: Path) -> None:
    """The second of three is right; k is in the heading, and the main row is the first's."""
    folder = tmp_path / "sampled"
    declare(folder, hypotheses=3)
    for target in published.split("test"):
        shape = true_shape(target)
        for k, moved_m in enumerate((0.03, 0.0, 0.06)):
            moved = CameraShape("mesh", shape.points_m + np.array([0, 0, moved_m]), shape.faces)
            write_shape(moved, folder / target.recording / f"{target.view}.{k}")
    table = score(published, folder, method="sampled", protocols=["camera"])
    table.write(tmp_path / "scores")
    table = read_table(tmp_path / "scores" / "scores.json")
    whole = [table.pairs(heading) for heading in ("camera", "camera-best-of-3", "camera-mean-of-3")]
    assert {len(rows) for rows in whole} == {len(published.split("test"))}
    for first, best, mean in zip(*whole, strict=True):
        assert first.hypotheses is None and best.hypotheses is not None and best.hypotheses.k == 3
        assert best.chamfer_l1_m is not None and best.chamfer_l1_m < 0.002 < 0.01 < first.chamfer_l1_m
        assert best.iou > 0.98 and mean.chamfer_l1_m > first.chamfer_l1_m
    assert "camera-occluded-best-of-3" in present(table.by_category)
    target = published.split("test")[0]
    (folder / f"{target.name}.1.ply").unlink()
    found = score(published, folder, method="sampled", protocols=["camera"], missing="empty")
    assert [failure.reason.split(":")[0] for failure in found.failures] == [f"{target.name}.1"]


def test_aligned_rows_are_read_again_and_averaged_by_kind(
    published: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shapes of free size, moved and doubled; the rows come back from scores.json and from rows.npz."""
    folder = tmp_path / "free"
    declare(folder, scale="free", unit="free")
    for target in published.split("test"):
        shape = true_shape(target)
        write_shape(
            CameraShape("mesh", 2 * shape.points_m + np.array([1.0, 0, 0]), shape.faces),
            folder / target.recording / target.view,
        )
    table = score(published, folder, method="free", jobs=2)
    assert set(table.by_category or {}) == {
        f"aligned-{kind}{part}" for kind in ("t+s", "R+t+s") for part in ("", "-visible", "-occluded")
    }
    for row in table.pairs("aligned-t+s"):
        assert row.alignment is not None and row.alignment.ok and row.alignment.rotation_deg == 0
        assert row.alignment.scale == pytest.approx(0.5, rel=0.01)
        assert row.chamfer_l1_m is not None and row.chamfer_l1_m < 0.003
    table.write(tmp_path / "json")
    assert read_table(tmp_path / "json" / "scores.json").rows == table.rows
    monkeypatch.setattr("kinectbench.core.artefacts.score_columns.ROWS_IN_JSON", 3)
    table.write(tmp_path / "npz")
    assert (tmp_path / "npz" / "rows.npz").is_file()
    assert read_table(tmp_path / "npz" / "scores.json").rows == table.rows


def test_an_edited_row_is_refused(table: ScoreTable, tmp_path: Path) -> None:
    table.write(tmp_path)
    content = json.loads((tmp_path / "scores.json").read_text())
    content["rows"][0]["part"] = "visible"
    (tmp_path / "scores.json").write_text(json.dumps(content))
    with raises(StorageError, "storage.damaged", match=r"stands there twice|of different pairs"):
        read_table(tmp_path / "scores.json")
    content["rows"][0] |= {"part": "whole", "chamfer_l1_m": 1e-5}
    (tmp_path / "scores.json").write_text(json.dumps(content))
    with raises(StorageError, "storage.damaged", match="'by_category"):
        read_table(tmp_path / "scores.json")


def test_the_command_prints_a_table_and_makes_a_page(
    analytic: Path,
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "scores"
    arguments = ["score", str(folder), "--benchmark", str(analytic / "benchmark"), "--out", str(out)]
    done = run_here(monkeypatch, capsys, tmp_path, *arguments, "--jobs", "1")
    shown = done.out
    assert done.status == 0, done.err
    assert "Chamfer L1, m" in shown and "aligned-R+t+s" in shown and "camera-occluded" not in shown
    assert "Chamfer L1, m" in (out / "index.html").read_text()


def test_a_method_that_a_protocol_does_not_fit_is_left_out_of_several(
    analytic: Path,
    published: Release,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The others are scored; a line, the table and the page say which one is not, and why."""
    write_all(published, tmp_path / "methods" / "metric")
    write_all(published, tmp_path / "methods" / "free", scale="free")
    out, benchmark = tmp_path / "scores", str(analytic / "benchmark")
    arguments = ["--benchmark", benchmark, "--out", str(out), "--jobs", "1", "--no-baselines"]
    camera = ["score", str(tmp_path / "methods"), "--protocol", "camera", *arguments]
    done = run_here(monkeypatch, capsys, tmp_path, *camera)
    reason = "the predictions of free are of free size"
    assert done.status == 3 and f"free: error: --protocol camera: {reason}" in " ".join(done.err.split())
    count = len(published.split("test"))
    assert f"free: {count} views failed: --protocol camera: {reason}" in " ".join(done.out.split())
    assert read_table(out / "metric" / "scores.json").complete
    page = (out / "index.html").read_text()
    assert f"free: {count} views failed: --protocol camera" in page
    assert [failure.view for failure in read_table(out / "free" / "scores.json").failures] != []
    done = run_here(monkeypatch, capsys, tmp_path, "score", str(tmp_path / "methods"), *arguments)
    assert done.status == 0, done.err
    assert run_here(monkeypatch, capsys, tmp_path, *camera).status == 3
    assert read_table(out / "free" / "scores.json").settings.protocols == ("aligned",)
    done = run_here(monkeypatch, capsys, tmp_path, *camera[:2], "--protocol", "known", *arguments)
    assert done.status == 2 and "which is scored under camera" in " ".join(done.err.split())
