"""Scores that no release may change unnoticed, the published schema, and resuming."""

import json
from dataclasses import fields
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from docs_schemas import scores_schema
from sklearn.metrics import log_loss, precision_score, recall_score
from typed import present

from kinectbench.core.artefacts.counted import JOURNAL, PairResult
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.release.release import Release
from kinectbench.scoring import pair_result
from kinectbench.scoring.pair_result import LEAST_CHECKED, PairJob, count_job
from kinectbench.scoring.score import score, score_methods
from kinectbench.scoring.thresholds import read_thresholds

SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "scores.schema.json").read_text())
FROZEN = Path(__file__).parent / "frozen_scores.json"
TOLERANCE = 1e-9


@pytest.fixture(scope="module")
def method(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A blurred and shifted truth at 64^3 (chairs) and 256^3 (tables): computed, not drawn."""
    folder = tmp_path_factory.mktemp("frozen") / "shifted"
    for target in release.targets:
        full = unpack(read_pair(release.pair_path(target)).full)
        moved = np.roll(full, (2, -3, 4), axis=(0, 1, 2))
        if target.category == "chair":
            y = 0.1 + 0.8 * moved.reshape(64, 4, 64, 4, 64, 4).mean(axis=(1, 3, 5))
        else:
            y = np.where(moved, 0.7, 0.2) - 0.1 * (np.arange(256) / 256)
        path = folder / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, y.astype(np.float32))
    return folder


@pytest.fixture(scope="module")
def table(release: Release, method: Path) -> ScoreTable:
    return score(release, method, method="shifted")


def test_frozen_scores(table: ScoreTable) -> None:
    """Written by this test's own table; to change it is to change what published scores mean."""
    names = [f.name for f in fields(table.rows[0])]
    found = [{name: getattr(row, name) for name in names} for row in table.rows]
    frozen = json.loads(FROZEN.read_text())
    assert dict(table.thresholds) == frozen["thresholds"]
    assert len(found) == len(frozen["rows"])
    for row, expected in zip(found, frozen["rows"], strict=True):
        for name, value in expected.items():
            same = value if isinstance(value, str) else pytest.approx(value, abs=TOLERANCE, rel=TOLERANCE)
            assert row[name] == same, (row["recording"], row["view"], row["protocol"], name)
    assert table.overall is not None
    for protocol, expected in frozen["overall_iou"].items():
        assert table.overall[protocol]["iou"] == pytest.approx(expected, abs=TOLERANCE)


def test_the_schema_holds(table: ScoreTable, release: Release, tmp_path: Path) -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    content = json.loads(table.text())
    jsonschema.validate(content, SCHEMA)
    assert scores_schema() == SCHEMA  # else: python scripts/docs_schemas.py
    # These predictions are of no run of `predict`, and few enough for their rows to be in the file.
    absent = ("run_sha256", "rows_file")
    assert [key for key in SCHEMA["properties"] if key not in absent] == list(content)
    assert list(SCHEMA["$defs"]["ScoreRow"]["properties"]) == list(content["rows"][0])
    (tmp_path / "chair_01").mkdir()
    failed = score(release, tmp_path, method="nothing", surface=False)
    jsonschema.validate(json.loads(failed.text()), SCHEMA)
    content["rows"][0]["iou"] = 1.5
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content, SCHEMA)


def test_ceilings_and_quality(table: ScoreTable) -> None:
    chair = [row for row in table.rows if row.category == "chair"]
    board = [row for row in table.rows if row.category == "table"]
    assert {row.cells for row in chair} == {64} and {row.cells for row in board} == {256}
    assert all(0.95 < row.ceiling_iou < 1 and present(row.iou) < row.ceiling_iou for row in chair)
    assert all(row.ceiling_iou == 1 for row in board)
    assert table.by_category is not None
    chairs = table.by_category["known"]["chair"]
    assert chairs["truth_repeatability_iou"] == pytest.approx(0.93) and chairs["truth_estimated_iou"] is None
    assert chairs["intervals"]["iou"] is None  # two objects
    worst = table.extremes["known"].worst[0]
    assert worst.iou == min(present(row.iou) for row in table.rows if row.protocol == "known")
    assert table.notes == ("no intervals with fewer than 3 objects in a category: chair (2), table (1)",)


def test_scikit_learn_agrees(table: ScoreTable, release: Release, method: Path) -> None:
    row = next(r for r in table.rows if (r.recording, r.protocol) == ("table_01", "known"))
    pair = read_pair(release.folder / "pairs" / row.recording / f"{row.view}.npz")
    known, full = unpack(pair.known), unpack(pair.full)
    y = np.load(method / row.recording / f"{row.view}.npy").astype(np.float64)[known]
    # Voxels that are alike are given once, with their number as weight: the same sums.
    values, which = np.unique(y, return_inverse=True)
    counts = np.bincount(2 * which + full[known], minlength=2 * len(values))
    y, truth = np.repeat(values, 2), np.tile([False, True], len(values))
    above, weights = y > row.threshold, {"sample_weight": counts}
    assert counts.sum() == known.sum()
    assert row.precision == pytest.approx(precision_score(truth, above, **weights), abs=1e-12)
    assert row.recall == pytest.approx(recall_score(truth, above, **weights), abs=1e-12)
    assert row.ce == pytest.approx(log_loss(truth, y, **weights), abs=1e-9)


def test_a_killed_run_resumes(
    release: Release, method: Path, table: ScoreTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted: list[str] = []

    def dies_after_five(job: PairJob) -> PairResult | str:
        if len(counted) == 5:
            raise KeyboardInterrupt
        counted.append(job.target.name)
        return count_job(job)

    monkeypatch.setattr("kinectbench.scoring.rounds.count_job", dies_after_five)
    with pytest.raises(KeyboardInterrupt):
        score(release, method, method="shifted", resume_in=tmp_path)
    assert len((tmp_path / JOURNAL).read_text().splitlines()) == 5
    with (tmp_path / JOURNAL).open("a") as file:
        file.write('{"pair": "chair_01/000", "key"')  # cut off in the middle of a line
    monkeypatch.undo()

    again: list[str] = []
    plain_count = pair_result.count

    def noted(*arguments: object) -> PairResult:
        again.append("counted")
        return plain_count(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(pair_result, "count", noted)
    resumed = score(release, method, method="shifted", resume_in=tmp_path)
    assert len(again) == len(release.targets) - 5 + LEAST_CHECKED
    assert resumed.text() == table.text()
    assert not (tmp_path / JOURNAL).exists()


def test_thresholds_are_frozen_and_used_again(release: Release, method: Path, tmp_path: Path) -> None:
    path = tmp_path / "thresholds.json"
    (first,) = score_methods(
        release, method, tmp_path / "a", protocols=["known"], surface=False, save_thresholds=path
    )
    (again,) = score_methods(
        release, method, tmp_path / "b", protocols=["known"], surface=False, thresholds_file=path
    )
    assert again.rows == first.rows and again.threshold_source.startswith("file:")
    assert json.loads(path.read_text())["objects"] == ["val_chair", "val_table"]
    assert read_thresholds(path, ["chair"], frozenset({"other"})).of["chair"] == first.thresholds["chair"]
    assert ScoreTable.read(tmp_path / "a").rows == first.rows


def test_corner_aligned_by_name(release: Release, method: Path, table: ScoreTable) -> None:
    other = score(
        release, method, method="shifted", protocols=["paper"], upsampling="corner-aligned", surface=False
    )
    assert "corner-aligned" in (other.settings.upsampling or "")
    rows = [row for row in table.rows if row.protocol == "paper"]
    for mine, corner in zip(rows, other.rows, strict=True):
        assert (mine.iou == corner.iou) == (mine.cells == 256)
