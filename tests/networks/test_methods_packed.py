"""`predict` packs what is at 256^3, predicts one split alone, and scores without leaving files."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from slow import slow
from small_benchmark import Run
from small_method import TINY
from synthetic_release import publish_synthetic

from kinectbench.networks.config import read_config
from kinectbench.networks.train import train
from kinectbench.release.release import Release
from kinectbench.scoring.prediction_file import load_prediction

Command = Callable[..., Run]
CHAIR = Path("tiny") / "chair_03" / "000.npz"
SCORE = ("--no-surface", "--no-baselines")


@pytest.fixture(scope="module")
def fine(learning: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network of 256^3 that has learnt for two steps."""
    root = tmp_path_factory.mktemp("fine")
    text = TINY.replace("output_cells: 64", "output_cells: 256").replace("epochs: 2", "epochs: 0.5")
    (root / "tiny.yaml").write_text(text)
    train(read_config(root / "tiny.yaml"), [learning], root / "run", device="cpu")
    return root / "run"


def told(folder: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((folder / "tiny" / "method.json").read_text())
    return found


def test_probabilities_are_packed_unless_asked_for_whole(
    command: Command, fine: Path, learning: Release, tmp_path: Path
) -> None:
    benchmark = str(learning.folder)
    predict = ("predict", str(fine), benchmark, "--device", "cpu", "--out")
    assert command(tmp_path, *predict, "packed").status == 0
    assert command(tmp_path, *predict, "whole", "--precision", "float16").status == 0
    with np.load(tmp_path / "packed" / CHAIR) as arrays:
        assert set(arrays.files) == {"codes", "levels"}
        values = arrays["levels"][arrays["codes"]]
    with np.load(tmp_path / "whole" / CHAIR) as arrays:
        assert arrays.files == ["prediction"] and arrays["prediction"].dtype == np.float16
    np.testing.assert_array_equal(load_prediction(tmp_path / "packed" / CHAIR), values)
    settings = [told(tmp_path / name)["settings"] for name in ("packed", "whole")]
    assert [of["precision"] for of in settings] == ["packed", None]  # type: ignore[index]
    tables = []
    for name in ("packed", "whole"):
        assert command(tmp_path, "check", name, "--benchmark", benchmark).err == ""
        words = ("score", name, "--benchmark", benchmark, *SCORE, "--out", f"s{name}")
        assert command(tmp_path, *words).status == 0
        tables.append(json.loads((tmp_path / f"s{name}" / "scores.json").read_text()))
    for ours, theirs in zip(tables[0]["rows"], tables[1]["rows"], strict=True):
        assert {key for key in ours if ours[key] != theirs[key]} <= {"ce"}
        assert abs(ours["ce"] / theirs["ce"] - 1) < 1e-3
    again = command(tmp_path, *predict, "whole")
    assert "removes 3 predictions of another run (another --precision); --out keeps both" in again.err


def test_one_split_alone_and_then_the_other(
    command: Command, fine: Path, learning: Release, tmp_path: Path
) -> None:
    """What the same run wrote of the other split stays, and stays listed."""
    predict = ("predict", str(fine), str(learning.folder), "--device", "cpu")
    assert command(tmp_path, *predict, "--split", "test").status == 0
    folder = tmp_path / "predictions"
    assert {path.parent.name for path in folder.rglob("*.npz")} == {"chair_03"}
    assert set(told(folder)["files"]) == {"chair_03/000.npz", "chair_03/001.npz"}  # type: ignore[call-overload]
    written = (folder / CHAIR).stat().st_mtime_ns
    assert command(tmp_path, *predict, "--split", "validation").err == ""
    assert len(told(folder)["files"]) == 3  # type: ignore[arg-type]
    assert command(tmp_path, *predict, "--split", "test").err == ""
    assert command(tmp_path, *predict).err == ""
    assert len(told(folder)["files"]) == 3 and (folder / CHAIR).stat().st_mtime_ns == written  # type: ignore[arg-type]
    checked = command(tmp_path, "check", "predictions", "--benchmark", str(learning.folder))
    assert (checked.status, checked.err) == (0, "")


@pytest.mark.parametrize(
    "more", [(), slow(("--threshold", "0.4")), slow(("--precision", "float16", "--split", "test"))]
)
def test_scores_without_files_are_those_with_them(
    command: Command, fine: Path, learning: Release, tmp_path: Path, more: tuple[str, ...]
) -> None:
    benchmark = str(learning.folder)
    predict = ("predict", str(fine), benchmark, "--device", "cpu", *more)
    made = command(tmp_path, *predict, "--score", "--no-surface", "--out", "at_once")
    assert made.status == 0 and not (tmp_path / "predictions").exists()
    assert not [*(tmp_path / "at_once").glob("**/chair_03")]
    assert command(tmp_path, *predict).status == 0
    words = ("score", "predictions/tiny", "--benchmark", benchmark, "--no-surface", "--out", "later")
    assert command(tmp_path, *words).status == 0
    at_once, later = (
        json.loads((tmp_path / name / "scores.json").read_text()) for name in ("at_once", "later")
    )
    assert {key for key in later if at_once[key] != later[key]} == {"hashes"}
    assert all(of["prediction"] is None for of in at_once["hashes"].values())
    names = {path.relative_to(tmp_path / "later") for path in (tmp_path / "later").rglob("*.*")}
    assert {path.relative_to(tmp_path / "at_once") for path in (tmp_path / "at_once").rglob("*.*")} == names
    cells = [np.load(tmp_path / name / "gallery.npz")["cells"] for name in ("at_once", "later")]
    np.testing.assert_array_equal(*cells)


WRONG = {
    "precision": (("--precision", "float64"), "'float64': choose packed or float16"),
    "split": (("--split", "train"), "'train': choose validation or test"),
    "nothing to score": (("--score", "--split", "validation"), "scores are of the test split"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_words_are_told(command: Command, tmp_path: Path, name: str) -> None:
    options, words = WRONG[name]
    result = command(tmp_path, "predict", "nowhere", ".", *options)
    assert (result.status, result.err.count("\n")) == (2, 1) and words in result.err, result
    assert list(tmp_path.iterdir()) == []


def test_a_split_without_pairs_is_told_and_nothing_is_written(
    command: Command, fine: Path, tmp_path: Path
) -> None:
    """Else `predict` writes a method.json without a prediction, and ends with status 0."""
    folder = publish_synthetic(tmp_path / "b", (("chair_01", "chair", "other", "test", 1),)).folder
    (tmp_path / "here").mkdir()
    words = ("predict", str(fine), str(folder), "--device", "cpu", "--split", "validation")
    result = command(tmp_path / "here", *words)
    assert (result.status, result.err.count("\n")) == (2, 1), result
    assert "no pair of the validation split; its pairs are of test" in result.err
    assert list((tmp_path / "here").iterdir()) == []
