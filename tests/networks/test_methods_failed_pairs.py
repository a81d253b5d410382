"""One pair without a prediction does not end `predict`: the others are done, and its line names it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises
from small_benchmark import Run

import kinectbench.networks.predict as predicting
from kinectbench.core.errors import PredictionError
from kinectbench.networks.trained import open_trained
from kinectbench.networks.validate import completed
from kinectbench.release.release import Release

Command = Callable[..., Run]
FAILED = "the output of network 'tiny': nan at (0, 0, 0)"


def fail_at(monkeypatch: pytest.MonkeyPatch, *numbers: int) -> None:
    """Let the network's outputs of these calls, from 0 on, be no numbers."""
    calls = list[int]()

    def fails(*arguments: Any) -> np.ndarray:
        calls.append(len(calls))
        if calls[-1] in numbers:
            raise PredictionError(FAILED, what="bad-values")
        return completed(*arguments)

    monkeypatch.setattr(predicting, "completed", fails)


def test_the_other_pairs_are_predicted_and_the_next_run_tries_again(
    command: Command, trained: Path, learning: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    predict = ("predict", str(trained), str(learning.folder), "--device", "cpu")
    fail_at(monkeypatch, 1)
    made = command(tmp_path, *predict)
    view = learning.split("test")[0].name
    assert (made.status, made.err) == (3, f"tiny: error: {view}: {FAILED}\n")
    folder = tmp_path / "predictions" / "tiny"
    assert len(list(folder.rglob("*.npz"))) == 2 and not (folder / f"{view}.npz").exists()
    assert len(json.loads((folder / "method.json").read_text())["files"]) == 2
    assert command(tmp_path, *predict).status == 0  # one pair alone was left
    assert (folder / f"{view}.npz").exists()


def test_scores_without_files_name_the_pair(
    command: Command, trained: Path, learning: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail_at(monkeypatch, 2)
    scored = command(
        *(tmp_path, "predict", str(trained), str(learning.folder), "--device", "cpu"),
        *("--score", "--no-surface"),
    )
    view = learning.split("test")[1].name
    assert scored.status == 3 and f"tiny: error: {view}: {FAILED}\n" in scored.err
    table = json.loads((tmp_path / "scores" / "scores.json").read_text())
    (failure,) = table["failures"]
    assert failure["reason"] == f"{view}: {FAILED}"


@pytest.mark.parametrize("more", [(), ("--score",)])
def test_no_pair_at_all_is_an_error(
    command: Command,
    trained: Path,
    learning: Release,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    more: tuple[str, ...],
) -> None:
    fail_at(monkeypatch, 0, 1, 2)
    made = command(tmp_path, "predict", str(trained), str(learning.folder), "--device", "cpu", *more)
    assert made.status == 1 and FAILED in made.err
    assert not list(tmp_path.rglob("method.json")) and not list(tmp_path.rglob("scores.json"))


def test_in_python_the_error_is_raised_unless_it_is_asked_for(
    trained: Path, learning: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail_at(monkeypatch, 0)
    with raises(PredictionError, "prediction.bad-values"):
        predicting.predict(open_trained(trained), learning, tmp_path)
