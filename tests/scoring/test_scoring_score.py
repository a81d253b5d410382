"""A whole submission against a release: tables, averages, failures, workers."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from raising import raises
from rich.console import Console
from typed import present

from kinectbench.cli.score_tables import score_table
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.errors import PredictionError, ReleaseError, SettingsError
from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.release.release import Release, Target, open_release
from kinectbench.scoring import score as score_module
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.published import CATEGORIES, LABEL, REAL
from kinectbench.scoring.score import score

Predict = Callable[[Target, NDArray[np.bool_]], NDArray[Any]]


def write_method(
    release: Release, folder: Path, predict: Predict, splits: tuple[str, ...] = ("test", "validation")
) -> Path:
    for target in release.targets:
        if target.split in splits:
            path = folder / target.recording / f"{target.view}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, predict(target, unpack(read_pair(release.pair_path(target)).full)))
    return folder


def soft(target: Target, full: NDArray[np.bool_]) -> NDArray[Any]:
    """0.62 in the truth, 0.22 around it, shifted by three cells; chairs alone have 0.38 in a slab."""
    y = np.where(np.roll(full, 3, axis=0), np.float16(0.62), np.float16(0.22))
    if target.category == "chair":
        y[:, :30] = 0.38
    return y


@pytest.fixture(scope="module")
def method(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_method(release, tmp_path_factory.mktemp("predictions") / "soft", soft)


@pytest.fixture(scope="module")
def table(release: Release, method: Path) -> ScoreTable:
    return score(release, method, method="soft")


def test_rows_against_plain_numpy(release: Release, method: Path, table: ScoreTable) -> None:
    assert table.complete and table.threshold_source == "validation" and not table.warnings
    assert table.thresholds == {"chair": 0.4, "table": 0.25}  # the lowest that leaves out 0.38, and 0.22
    assert len(table.rows) == 3 * 4
    for row in table.rows:
        pair = read_pair(release.folder / "pairs" / row.recording / f"{row.view}.npz")
        full, known, seen = unpack(pair.full), unpack(pair.known), unpack(pair.seen)
        mask = {"paper": np.ones_like(known), "known": known, "occluded": known & ~seen}[row.protocol]
        y = np.load(method / row.recording / f"{row.view}.npy")[mask].astype(np.float64)
        truth, above, count = full[mask], y > row.threshold, np.count_nonzero
        hit = count(above & truth)
        assert row.iou == pytest.approx(hit / count(above | truth), abs=1e-12)
        assert row.precision == pytest.approx(hit / count(above), abs=1e-12)
        assert row.recall == pytest.approx(hit / count(truth), abs=1e-12)
        assert row.ce == pytest.approx(-np.log(np.where(truth, y, 1 - y)).mean(), abs=1e-10)
        assert row.coverage_voxels == pytest.approx(mask.mean())
        assert row.coverage_shape == pytest.approx(count(truth) / count(full))
        rate = table.base_rate[row.category].value
        assert row.base_rate_ce == pytest.approx(
            -truth.mean() * np.log(rate) - (1 - truth.mean()) * np.log(1 - rate)
        )


def test_averages(table: ScoreTable) -> None:
    assert table.by_category is not None and table.overall is not None
    iou = {(r.protocol, r.recording, r.view): r.iou for r in table.rows}
    for protocol in ("paper", "known", "occluded"):
        red = [present(iou[protocol, "chair_01", view]) for view in ("000", "001")]
        blue = present(iou[protocol, "chair_02", "000"])
        # paper: three pairs alike; the others: two objects alike
        expected = float(np.mean([*red, blue] if protocol == "paper" else [np.mean(red), blue]))
        chair = table.by_category[protocol]["chair"]
        assert chair["iou"] == pytest.approx(expected, abs=1e-12)
        assert (chair["pairs"], chair["objects"], chair["base_rate_source"]) == (3, 2, "validation")
        macro = (expected + present(iou[protocol, "table_01", "000"])) / 2
        assert table.overall[protocol]["iou"] == pytest.approx(macro, abs=1e-12)
        assert table.overall[protocol]["pairs"] == 4
    assert table.by_category["paper"]["table"]["coverage_voxels"] == 1
    assert table.by_category["known"]["table"]["coverage_voxels"] < 1


def test_files(release: Release, table: ScoreTable, tmp_path: Path) -> None:
    table.write(tmp_path / "scores")
    content = json.loads((tmp_path / "scores" / "scores.json").read_text())
    assert content["benchmark_sha256"] == release.benchmark_sha256
    assert content["method"] == "soft" and len(content["rows"]) == 12
    assert content["truth_quality"]["chair_01"] == {"repeatability_iou": 0.93}
    assert ScoreTable.read(tmp_path / "scores").truth_quality["chair_01"].repeatability_iou == 0.93
    assert str(release.folder) not in json.dumps(content) and "tmp" not in json.dumps(content)
    with (tmp_path / "scores" / "scores.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [float(line["iou"]) for line in lines] == [row.iou for row in table.rows]
    assert sorted(path.name for path in (tmp_path / "scores").iterdir()) == ["scores.csv", "scores.json"]


@pytest.mark.slow  # test_release_alone.py says so of the command
def test_any_number_of_workers(release: Release, method: Path, table: ScoreTable) -> None:
    assert score(release, method, method="soft", jobs=2).text() == table.text()


def test_without_validation_predictions(release: Release, tmp_path: Path) -> None:
    write_method(release, tmp_path, lambda target, full: full[::8, ::8, ::8], ("test",))
    progress: list[tuple[int, int]] = []
    table = score(release, tmp_path, method="low", progress=lambda *done: progress.append(done))
    assert table.complete and table.threshold_source == "fixed"
    assert table.warnings == ("threshold fixed at 0.5: no prediction for the validation split was supplied",)
    assert progress == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert all(present(row.iou) > 0.6 for row in table.rows if row.protocol == "paper")


def test_failures(release: Release, tmp_path: Path) -> None:
    write_method(release, tmp_path, lambda target, full: full[::8, ::8, ::8])
    (tmp_path / "chair_01" / "000.npy").write_bytes(b"")
    (tmp_path / "chair_02" / "000.npy").unlink()
    table = score(release, tmp_path, method="part", protocols=["known"])
    assert not table.complete and table.by_category is None and table.overall is None
    assert [failure.json_value() for failure in table.failures] == [
        {"recording": "chair_01", "view": "000", "reason": "chair_01/000.npy: the file is empty"},
        {
            "recording": "chair_02",
            "view": "000",
            "reason": "chair_02/000: no prediction; expected chair_02/000.npy, .npz, .ply or .obj",
        },
    ]
    assert [(row.recording, row.view) for row in table.rows] == [("chair_01", "001"), ("table_01", "000")]
    assert table.warnings[-1].startswith("incomplete: 2 predictions")
    json.loads(table.text())
    allowed = score(release, tmp_path, method="part", missing="empty", protocols=["known"])
    assert [failure.recording for failure in allowed.failures] == ["chair_01"]
    assert allowed.settings.missing == "empty"
    assert [row.iou for row in allowed.rows if row.recording == "chair_02"] == [0.0]


def test_threshold_file(release: Release, method: Path, tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    path.write_text('{"thresholds": {"chair": 0.1, "table": 0.9}}')
    table = score(release, method, method="soft", protocols=["paper"], thresholds_file=path)
    assert table.thresholds == {"chair": 0.1, "table": 0.9}
    assert table.threshold_source.startswith("file:")
    assert [row.recall for row in table.rows] == [1, 1, 1, 0]


def test_refusals(release: Release, method: Path, tmp_path: Path) -> None:
    with raises(SettingsError, "settings.wrong-value", match="'all'"):
        score(release, method, method="x", protocols=["all"])
    with raises(PredictionError, "prediction.no-folder"):
        score(release, tmp_path / "none", method="x")
    train = tuple(t for t in release.targets if t.split != "test")
    with raises(ReleaseError, "release.no-pairs"):
        score(Release(release.folder, train, release.metadata), method, method="x")
    shared = tuple(
        Target(t.recording, "same", t.view, "chair", t.split, t.file, t.sha256) for t in release.targets
    )
    with raises(ReleaseError, "release.object-in-two-splits"):
        score(Release(release.folder, shared, release.metadata), method, method="x")


def test_changed_truth_is_never_scored(release: Release, method: Path) -> None:
    first, *rest = release.targets
    wrong = Target(**{**first.__dict__, "sha256": "0" * 64})
    with raises(ReleaseError, "release.changed"):
        score(Release(release.folder, (wrong, *rest), release.metadata), method, method="x")


def test_base_rates(release: Release) -> None:
    rates = base_rates(release)
    shares = [
        unpack(read_pair(release.pair_path(t)).full).mean()
        for t in release.split("validation")
        if t.category == "chair"
    ]
    assert rates["chair"].value == pytest.approx(np.mean(shares), abs=1e-12)
    assert rates["chair"].source == "validation"
    test_only = base_rates(Release(release.folder, release.split("test"), release.metadata))
    assert test_only["table"].source == "test (oracle)"


def test_terminal_table(table: ScoreTable, release: Release, tmp_path: Path) -> None:
    (tmp_path / "chair_01").mkdir()
    failed = score(release, tmp_path, method="nothing")
    console = Console(width=250, record=True, file=(tmp_path / "out").open("w"))
    console.print(score_table([table, failed], published=True))
    console.file.close()
    text = console.export_text()
    assert table.by_category is not None
    chair = table.by_category["known"]["chair"]
    assert f"{chair['iou']:.3f} / {chair['ce']:.3f}" in text
    assert "nothing: 4 predictions failed" in text and "0.208 / 0.153" in text and text.count(LABEL) == 1
    # Under no category: what failed may be of any.
    (line,) = (line for line in text.splitlines() if "4 predictions failed" in line)
    assert not any(cell.strip() for cell in line.split("│")[2:])


def test_published_scores_stand_only_beside_their_categories(table: ScoreTable) -> None:
    strange = table.model_copy(update={"thresholds": {"lamp": 0.5}, "by_category": {}, "overall": {}})
    assert list(map(str, score_table([strange], published=True).columns[0].cells)) == ["soft"]


def test_published_scores() -> None:
    assert CATEGORIES == ("bench", "chair", "couch", "table")
    assert {entry.method: entry.iou[2] for entry in REAL.rows} == {
        "3D-RecGAN++": 0.540, "3D-RecAE": 0.538, "3D-EPN": 0.508, "Varley et al.": 0.433, "Han et al.": 0.235
    }  # fmt: skip


def test_opened_release_is_the_published_one(release: Release) -> None:
    assert open_release(release.folder) == release


def test_more_rows_than_a_table_may_have_are_refused_before_they_are_counted(
    release: Release, method: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(score_module, "MOST_ROWS", 2)
    with raises(SettingsError, "settings.too-large", match=r"3.*2"):
        score(release, method, method="a", resume_in=tmp_path)
    assert list(tmp_path.iterdir()) == []
