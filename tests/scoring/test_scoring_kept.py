"""What lies beside the scores of an earlier run is counted again in a few pairs before it is believed."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from small_benchmark import Run
from typed import noted

from kinectbench.core.artefacts.counted import JOURNAL
from kinectbench.core.errors import StorageError
from kinectbench.release.release import Release
from kinectbench.scoring import pair_result
from kinectbench.scoring.baselines.in_grids import comparison_baselines
from kinectbench.scoring.pair_result import CHECKED_SHARE, LEAST_CHECKED, PairJob, count_job, drawn
from kinectbench.scoring.score import score

Command = Callable[..., Run]
HALF = np.full((16, 16, 16), 0.5, np.float32)


@pytest.fixture(scope="module")
def predictions(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half everywhere, of each pair."""
    folder: Path = tmp_path_factory.mktemp("kept") / "half"
    for target in release.targets:
        path = folder / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, HALF)
    return folder


@pytest.fixture
def journal(release: Release, predictions: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a run without surface metrics leaves that is stopped before its last pair."""
    counted: list[str] = []

    def stopped(job: PairJob) -> object:
        if len(counted) == len(release.targets) - 1:
            raise KeyboardInterrupt
        counted.append(job.target.name)
        return count_job(job)

    monkeypatch.setattr("kinectbench.scoring.rounds.count_job", stopped)
    with pytest.raises(KeyboardInterrupt):
        score(release, predictions, method="half", surface=False, resume_in=tmp_path / "scores")
    monkeypatch.undo()
    return tmp_path / "scores" / JOURNAL


def forge(journal: Path) -> None:
    """Every prediction hits all that is occupied, and nothing else."""
    lines = []
    for line in journal.read_text(encoding="utf-8").splitlines():
        said = json.loads(line)
        tally = said["result"]["tally"]
        tally["above"] = [[n if code % 2 else 0 for code, n in enumerate(tally["voxels"])]] * 17
        lines.append(json.dumps(said, sort_keys=True, separators=(",", ":")))
    journal.write_text("\n".join([*lines, ""]), encoding="utf-8")


def test_a_sound_journal_is_used(
    release: Release, predictions: Path, journal: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    again: list[object] = []
    monkeypatch.setattr(pair_result, "count", noted(pair_result.count, again))
    kept = score(release, predictions, method="half", surface=False, resume_in=journal.parent)
    assert len(again) == 1 + LEAST_CHECKED and not journal.exists()
    assert kept.text() == score(release, predictions, method="half", surface=False).text()


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_forged_journal_is_refused(release: Release, predictions: Path, journal: Path, jobs: int) -> None:
    forge(journal)
    with raises(StorageError, "storage.other-content", match="(chair|table)_0[0-9]/00[01]"):
        score(release, predictions, method="half", surface=False, jobs=jobs, resume_in=journal.parent)
    assert journal.is_file()


def test_a_forged_journal_gets_one_line(
    release: Release, predictions: Path, journal: Path, command: Command
) -> None:
    forge(journal)
    said = command(
        journal.parents[1], "score", str(predictions), "--benchmark", str(release.folder), "--no-surface",
        "--no-baselines", "--no-gallery", "--jobs", "1",
    )  # fmt: skip
    assert said.status == 1 and said.err.count("error: ") == 1 and "score again" in said.err
    assert not (journal.parent / "scores.json").exists()


def test_rows_of_other_inputs_are_left_alone(release: Release, predictions: Path, journal: Path) -> None:
    """A journal of other predictions, forged or not, decides nothing."""
    forge(journal)
    others = Path(shutil.copytree(predictions, journal.parents[1] / "others"))
    for path in others.rglob("*.npy"):
        np.save(path, HALF * 0.5)
    found = score(release, others, method="half", surface=False, resume_in=journal.parent)
    assert found.text() == score(release, others, method="half", surface=False).text()


def test_who_is_drawn() -> None:
    names = [f"chair/{n:03d}" for n in range(1000)]
    assert len(drawn(names, "a")) == CHECKED_SHARE * 1000 and drawn(names, "a") < set(names)
    assert drawn(names, "a") == drawn(names[::-1], "a") != drawn(names, "b")
    assert len(drawn(names[:20], "a")) == LEAST_CHECKED and drawn([], "a") == set()


@pytest.mark.parametrize("what", ["iou", "base rate"])
def test_forged_baselines_are_made_anew(release: Release, tmp_path: Path, what: str) -> None:
    without = ("hull", "carved-hull", "mirror", "silhouette", "mean-shape", "nearest", "base-rate")
    first = comparison_baselines(release, tmp_path, protocols=("paper",), without=without)
    path = tmp_path / "baselines/partial/scores.json"
    honest = path.read_bytes()
    worse, said = tmp_path / "worse", json.loads(honest)
    # A table that adds up: that of other predictions, under the name of the baseline.
    for target in release.targets:
        file = worse / target.recording / f"{target.view}.npy"
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, HALF * 0)
    forged = score(release, worse, method="partial", protocols=["paper"], surface=False)
    update = {"baseline": True, "settings": first[0].settings}
    forged.model_copy(update=update).write(path.parent)
    if what == "base rate":
        path.write_bytes(honest.replace(json.dumps(said["rows"][0]["base_rate_ce"]).encode(), b"0.5"))
    again = comparison_baselines(release, tmp_path, protocols=("paper",), without=without)
    assert [table.text() for table in again] == [table.text() for table in first]
    assert path.read_bytes() == honest
