"""What method.json declares is held against what can be scored, before anything is counted."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises

from kinectbench.core.artefacts.method import MethodFile, is_misspelt
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.errors import PredictionError, SettingsError
from kinectbench.release.release import Release
from kinectbench.scoring.api import Scorer
from kinectbench.scoring.method_json import SUPPORTED, _unknown_keys
from kinectbench.scoring.prediction_file import blake3_of
from kinectbench.scoring.predictions import check, find_predictions
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score, score_methods


def folder_of(release: Release, folder: Path, method: object = None) -> Path:
    """Half of each cube for every test pair, and a method.json."""
    grid = np.zeros((4, 4, 4), bool)
    grid[:2] = True
    for target in release.split("test"):
        path = folder / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, grid)
    if method is not None:
        (folder / "method.json").write_text(json.dumps(method), encoding="utf-8")
    return folder


def scored(release: Release, folder: Path) -> ScoreTable:
    return score(release, folder, method="mine", protocols=["known"], surface=False)


def by_diagonal(z: float, shift: float = 0, rows: bool = False) -> list[list[float]]:
    """A 4 x 4 matrix that multiplies z, and shifts along x; for row vectors or columns."""
    T = np.diag([1.0, 1.0, z, 1.0])
    T[(3, 0) if rows else (0, 3)] = shift
    return [[float(value) for value in row] for row in T]


EYE = by_diagonal(1)
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "points": ({"form": "points"}, "'form' 'points' is not supported yet (supported: voxels, mesh)"),
    "sdf": ({"form": "sdf"}, "'form' 'sdf' is not supported yet"),
    "scale": ({"scale": "free"}, "'scale' 'free' is not supported yet (supported: metric)"),
    "hypotheses": ({"hypotheses": 5}, "'hypotheses' 5 is not supported yet (supported: 1)"),
    "unit": ({"unit": "mm"}, "'unit' 'mm' is not supported yet (supported: m)"),
    "axes": ({"axes": "opengl"}, "'axes' 'opengl' is not supported yet (supported: cv)"),
    "matrix": ({"T_camera_prediction": {"a/000": EYE}}, "'T_camera_prediction' is not supported yet"),
    "one number": ({"T_camera_prediction": {"a/000": [[1]]}}, "a/000': must be 4 x 4 finite numbers"),
    "no matrices": ({"T_camera_prediction": [EYE]}, "'T_camera_prediction': Input should be an object"),
    "texts": ({"T_camera_prediction": {"a/000": [["1"] * 4] * 4}}, "must be 4 x 4 finite numbers"),
    "rows": (
        {"T_camera_prediction": {"a/000": by_diagonal(1, shift=9, rows=True)}},
        "for row vectors: transpose",
    ),
    "a mirror": ({"T_camera_prediction": {"a/000": by_diagonal(-1)}}, "it mirrors the shape"),
    "flat": ({"T_camera_prediction": {"a/000": by_diagonal(0)}}, "it flattens the shape"),
    "two scales": ({"T_camera_prediction": {"a/000": by_diagonal(2)}}, "or scales its axes differently"),
    "a large scale": ({"T_camera_prediction": {"a/000": by_diagonal(1e9)}}, "its scale is not within 1e-06"),
    "far": ({"T_camera_prediction": {"a/000": by_diagonal(1, shift=1500)}}, "more than 100 m; write metres"),
    "an unknown size": ({"unit": "free"}, "'unit': 'free' leaves the size unknown: add 'scale': 'free', or"),
    "no hypothesis": ({"hypotheses": 0}, "'hypotheses': Input should be greater than or equal to 1"),
    "many hypotheses": ({"hypotheses": 101}, "'hypotheses': Input should be less than or equal to 100"),
    "a negative time": ({"seconds_per_view": -1.0}, "'seconds_per_view': Input should be greater than or"),
    "a probability of 3": ({"threshold": 3.0}, "'threshold': Input should be less than or equal to 1"),
    "two": ({"form": "points", "unit": "mm"}, "(supported: voxels, mesh); 'unit' 'mm' is not"),
    "advice": ({"form": "points"}, "with 'frame': 'camera' it is"),
    "a typo": ({"fram": "camera"}, "'fram': no such key; did you mean 'frame'?"),
    "capitals": ({"Frame": "camera"}, "'Frame': no such key; did you mean 'frame'?"),
    "a plural": ({"hypothesis": 5}, "'hypothesis': no such key; did you mean 'hypotheses'?"),
    "no such word": ({"frame": "world"}, "'frame': 'world' is none of grid, camera"),
    "thresholds": ({"thresholds": {"chair": 0.3}}, "did you mean 'threshold'?"),
    "a threshold between": (
        {"threshold": 0.33},
        "'threshold' 0.33 is not supported yet",
    ),
    "a type": ({"hypotheses": "5"}, "'hypotheses': Input should be a valid integer"),
    "no name": ({"name": 7}, "'name': Input should be a valid string"),
    "many keys": ({f"key {n}": n for n in range(5000)}, "5000 keys that are not known: at most 200"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_not_supported_is_refused_before_anything_is_counted(
    kind: str, release: Release, tmp_path: Path
) -> None:
    content, words = REFUSED[kind]
    folder = folder_of(release, tmp_path / "all" / "mine", {"name": "net"} | content)
    folder_of(release, tmp_path / "all" / "before", {"name": "fine"})
    for look in (lambda: scored(release, folder), lambda: check(release, folder),
                 lambda: score_methods(release, tmp_path / "all", tmp_path / "out")):  # fmt: skip
        with pytest.raises(PredictionError) as caught:
            look()
        assert f"{folder}/method.json: " in str(caught.value) and words in str(caught.value)
        assert len(str(caught.value)) < 400 and str(caught.value).isprintable()
    assert not (tmp_path / "out").exists()


def test_what_is_supported_is_declared_in_words_that_are() -> None:
    assert SUPPORTED.keys() <= MethodFile.model_fields.keys()
    MethodFile(name="net", **{key: values[-1] for key, values in SUPPORTED.items()})


def test_a_key_that_is_nobodys_is_named(release: Release, tmp_path: Path) -> None:
    content = {"name": "net", "frame": "grid", "paper": "https://…", "training_time_h": 7, "x\x1b[2J": 1}
    table = scored(release, folder_of(release, tmp_path, content))
    line = "method.json: not known, and not looked at: paper, training_time_h, x?[2J"
    assert line in table.warnings and table.complete


@pytest.mark.parametrize(
    ("key", "value", "meant"),
    [("from", "ShapeNet", "form"), ("init", "random", "unit"), ("file", "net.py", "files"),
     ("input", ["depth"], "inputs"), ("axis", 1, "axes"), ("settings2", {"lr": 1}, "settings"),
     ("frames", 50, "frame"), ("scales", [32, 64], "scale"), ("names", ["a"], "name"),
     ("uint", "8", "unit"), ("hardwares", "x", "hardware"), ("trainings", {}, "training")],
)  # fmt: skip
def test_an_honest_key_near_a_known_one_is_told_and_scored(key: str, value: object, meant: str) -> None:
    method = MethodFile.parse(json.dumps({"name": "net", key: value}), "method.json")
    assert list(_unknown_keys(method)) == [f"not known, and not looked at: {key} (did you mean {meant}?)"]


@pytest.mark.parametrize(
    ("key", "value"),
    [("fram", "camera"), ("FRAME", 1), ("from", "mesh"), ("Unit", 5), ("unti", "mm"), ("axis", "opengl"),
     ("scael", "free"), ("hypothesis", 5), ("treshold", 0.4), ("T_camera_predicton", {}), ("a_xes", 0)],
)  # fmt: skip
def test_a_key_that_is_meant_for_one_that_decides_the_score_is_refused(key: str, value: object) -> None:
    with raises(PredictionError, "prediction.malformed", match="such key"):
        MethodFile.parse(json.dumps({"name": "net", key: value}), "method.json")


@pytest.mark.parametrize(
    ("name", "known", "misspelt"),
    [("axis", "axes", True), ("from", "form", True), ("paramter_cuont", "parameter_count", True),
     ("parameterCount", "parameter_count", True), ("T-camera-prediction", "T_camera_prediction", True),
     ("format", "form", False), ("date", "name", False), ("size", "scale", False), ("", "name", False),
     ("training_time", "training", False), ("framework", "frame", False), ("e" * 10**6, "scale", False)],
)  # fmt: skip
def test_a_slip_or_two(name: str, known: str, misspelt: bool) -> None:
    assert is_misspelt(name, known) == misspelt


def test_large_declarations_cost_little(release: Release, tmp_path: Path) -> None:
    content = {"name": "net", "training": {"notes": [["x"] * 400_000]}} | {
        "k" * 10**5 + str(n): 0 for n in range(99)
    }
    folder = folder_of(release, tmp_path, content)
    started = time.process_time()
    assert find_predictions(folder, release.targets).method is not None
    assert time.process_time() - started < 5
    (folder / "method.json").write_bytes(b" " * (33 << 20))
    with raises(PredictionError, "prediction.malformed", match="33554432"):
        find_predictions(folder, release.targets)


def test_a_form_that_the_files_do_not_have(release: Release, tmp_path: Path) -> None:
    table = scored(release, folder_of(release, tmp_path, {"name": "net", "form": "mesh"}))
    assert len(table.failures) == 4 and not table.complete
    assert "chair_01/000.npy: method.json says 'form': 'mesh', which no .npy is" in table.failures[0].reason


def test_predictions_for_another_release_are_told(release: Release, tmp_path: Path) -> None:
    folder = folder_of(release, tmp_path, {"name": "net", "benchmark_sha256": "0" * 64})
    (line,) = check(release, folder)
    assert line.startswith("method.json: the predictions are for another release (00000000…, this is ")
    assert line in scored(release, folder).warnings


def test_what_predict_has_not_completed_is_told(release: Release, tmp_path: Path) -> None:
    folder = folder_of(release, tmp_path)
    (folder / "unfinished.json").write_text("{")
    line = "unfinished.json: `predict` has not completed these predictions; run it again"
    assert check(release, folder) == [line] and line in scored(release, folder).warnings


@pytest.mark.parametrize("validation", [False, True])
def test_a_methods_own_threshold_is_that_of_its_scores(
    release: Release, tmp_path: Path, validation: bool
) -> None:
    """Of the categories without validation predictions; table, marks, recheck and `Scorer` agree."""
    folder = folder_of(release, tmp_path / "mine", {"name": "net", "threshold": 0.35})
    chairs = [target for target in release.split("validation") if target.category == "chair"]
    part = Release(release.folder, (*release.split("test"), *chairs), release.metadata)
    scorer = Scorer(release.folder, method="mine", own_threshold=0.35, surface=False)
    for target in chairs if validation else ():
        (folder / target.recording).mkdir(exist_ok=True)
        np.save(folder / f"{target.name}.npy", np.full((4, 4, 4), 0.7, np.float32))
    frozen = {"save_thresholds": tmp_path / "frozen.json"} if validation else {}
    (table,) = score_methods(part, folder, tmp_path / "out", surface=False, **frozen)  # type: ignore[arg-type]
    searched = {"chair": "validation"} if validation else {"chair": "method"}
    assert table.threshold_source_by_category == searched | {"table": "method"}
    assert table.threshold_source == searched["chair"] and table.thresholds["table"] == 0.35
    words = "threshold the method's own, 0.35: table" if validation else "thresholds the method's own, 0.35"
    assert [mark.words for mark in table.marks] == [words]
    assert any("is the method's own, 0.35" in line for line in table.warnings)
    assert not recheck(part, tmp_path / "out" / "scores.json", folder)
    assert table.threshold_objects is None  # nobody can tell on which the method's own was found
    if validation:
        # The file serves for the same release, and says as little of the objects.
        again = score(part, folder, method="mine", thresholds_file=frozen["save_thresholds"], surface=False)
        assert again.rows == table.rows and again.threshold_objects is None
        assert [mark.kind for mark in again.marks] == ["thresholds-unchecked"]
        assert set(json.loads(frozen["save_thresholds"].read_text())["thresholds"]) == {"chair", "table"}
    else:
        for target in release.split("test"):
            scorer.update(target.name, np.load(folder / f"{target.name}.npy"))
        assert scorer.result().marks == table.marks
        (folder / "method.json").unlink()
        assert recheck(part, tmp_path / "out" / "scores.json", folder)
        with raises(SettingsError, "settings.wrong-value", match=r"0\.33.*0\.1"):
            Scorer(release.folder, own_threshold=0.33)


def test_files_that_are_not_the_runs_are_told(release: Release, tmp_path: Path) -> None:
    """Its table names the run; a recheck of the same files finds the same."""
    folder = folder_of(release, tmp_path / "mine")
    names = [f"{target.name}.npy" for target in release.split("test")]
    files = {name: blake3_of((folder / name).read_bytes()) for name in names}
    method = {"name": "net", "run_sha256": "a" * 64, "files": files}
    (folder / "method.json").write_text(json.dumps(method))
    (table,) = score_methods(release, folder, tmp_path / "out", surface=False)
    assert table.run_sha256 == "a" * 64 and not any("not what its run" in line for line in table.warnings)
    assert not check(release, folder)
    assert not recheck(release, tmp_path / "out" / "scores.json", folder)
    np.save(folder / "chair_01" / "001.npy", np.ones((4, 4, 4), bool))
    words = "chair_01/001.npy: not what its run of `predict` wrote"
    assert [line.startswith(words) for line in check(release, folder)] == [True]
    assert (
        "method.json: 1 of 4 files is not what its run of `predict` wrote, such as chair_01/001.npy: changed "
        "since, or of another run; predict again"
    ) in scored(release, folder).warnings
