"""Predictions of a trained network: ordinary files that are checked and scored, and what is said of them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from small_benchmark import Run
from synthetic_release import Recordings, publish_synthetic

from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.core.storage import sha256_file
from kinectbench.core.voxels.resample import upsampled_planes
from kinectbench.networks import predict as predicting
from kinectbench.networks.trained import open_trained
from kinectbench.networks.validate import completed
from kinectbench.networks.weights import read_weights, write_weights
from kinectbench.release.release import Release

Command = Callable[..., Run]


def test_predictions_are_ordinary_ones(
    command: Command, trained: Path, learning: Release, tmp_path: Path
) -> None:
    benchmark = str(learning.folder)
    made = command(tmp_path, "predict", str(trained), benchmark, "--device", "cpu")
    assert (made.status, made.out, made.err) == (0, "wrote predictions/tiny\n", "")
    with np.load(tmp_path / "predictions" / "tiny" / "chair_03" / "001.npz") as arrays:
        assert arrays.files == ["prediction"]
        assert (arrays["prediction"].shape, arrays["prediction"].dtype) == ((64, 64, 64), np.float16)
    checked = command(tmp_path, "check", "predictions/tiny", "--benchmark", benchmark)
    assert (checked.status, checked.err) == (0, "")
    scored = command(
        tmp_path, "score", "predictions", "--benchmark", benchmark, "--no-surface", "--no-baselines"
    )
    # After two steps it has learnt nothing yet.
    full = "tiny: warning: 2 of 2 predictions fill the whole cube at their threshold, such as chair_03/000\n"
    assert (scored.status, scored.err) == (0, full), scored.err

    told = json.loads((tmp_path / "predictions" / "tiny" / "method.json").read_text())
    training = json.loads((trained / "training.json").read_text())
    assert told["name"] == "tiny" and told["parameter_count"] == training["parameter_count"]
    assert told["settings"]["weights_sha256"] == sha256_file(trained / "weights.npz")
    assert told["settings"]["config_sha256"] == training["config_sha256"]
    assert told["training"]["benchmark_sha256"] == learning.benchmark_sha256
    assert told["seconds_per_view"] > 0 and told["peak_memory_mb"] > 1


def test_bits_are_probabilities_above_the_threshold(
    command: Command, trained: Path, learning: Release, tmp_path: Path
) -> None:
    arguments = ("predict", str(trained), str(learning.folder), "--device", "cpu", "--out")
    assert command(tmp_path, *arguments, "plain").status == 0
    assert command(tmp_path, *arguments, "bits", "--threshold", "0.4").status == 0
    name = Path("tiny") / "chair_03" / "000.npz"
    with np.load(tmp_path / "plain" / name) as plain, np.load(tmp_path / "bits" / name) as bits:
        full = np.stack([plane.copy() for plane in upsampled_planes(plain["prediction"])])
        packed = bits["prediction"]
    assert (packed.shape, packed.dtype) == ((256, 256, 32), np.uint8)
    assert (np.unpackbits(packed, axis=-1).astype(bool) == (full > 0.4)).all()
    checked = command(tmp_path, "check", "bits", "--benchmark", str(learning.folder))
    assert checked.status == 0 and "error" not in checked.err, checked.err


@pytest.mark.parametrize("threshold", [None, 0.4])
def test_what_was_stopped_goes_on(
    trained: Path,
    learning: Release,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    threshold: float | None,
) -> None:
    """With the same settings nothing is predicted twice, and with others all is."""
    method, whole, stopped = open_trained(trained), tmp_path / "whole", tmp_path / "stopped"
    predicting.predict(method, learning, whole, threshold=0.4)
    calls = []

    def completed_once(*arguments: object) -> object:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return completed(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(predicting, "completed", completed_once)
    with pytest.raises(KeyboardInterrupt):
        predicting.predict(method, learning, stopped, threshold=0.4)
    assert not (stopped / "tiny" / "method.json").exists()
    predicting.predict(method, learning, stopped, threshold=threshold)
    count = sum(len(learning.split(split)) for split in predicting.SPLITS)
    assert len(calls) - 2 == (count if threshold is None else count - 1)
    assert (stopped / "tiny" / "method.json").exists()
    files = {path.relative_to(whole) for path in whole.rglob("*") if path.is_file()}
    assert {path.relative_to(stopped) for path in stopped.rglob("*") if path.is_file()} == files
    same = [
        (whole / path).read_bytes() == (stopped / path).read_bytes()
        for path in files
        if path.suffix == ".npz"
    ]
    assert all(same) if threshold else not any(same)


def test_what_is_there_of_another_release_is_not_mixed_with_it(
    trained: Path, learning: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even where the run that left it was stopped, nor where it is somebody's own."""
    method = open_trained(trained)
    monkeypatch.setattr(predicting, "completed", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        predicting.predict(method, learning, tmp_path)
    path = tmp_path / "tiny" / "unfinished.json"
    path.write_text(path.read_text().replace(learning.benchmark_sha256, "0" * 64))
    with raises(SettingsError, "settings.other-content", match="predictions"):
        predicting.predict(method, learning, tmp_path)
    path.unlink()
    (tmp_path / "tiny" / "mine.npz").write_bytes(b"")
    with raises(SettingsError, "settings.other-content", match="`predict`"):
        predicting.predict(method, learning, tmp_path)
    assert (tmp_path / "tiny" / "mine.npz").exists()


def test_other_weights_are_told_and_a_file_in_the_way_too(
    command: Command, trained: Path, learning: Release, tmp_path: Path
) -> None:
    shutil.copytree(trained, tmp_path / "other")
    arrays = read_weights(tmp_path / "other" / "weights.npz")
    name = next(iter(arrays))
    write_weights(arrays | {name: arrays[name] + 1}, tmp_path / "other" / "weights.npz")
    benchmark = str(learning.folder)
    assert command(tmp_path, "predict", str(trained), benchmark, "--device", "cpu").err == ""
    told = command(tmp_path, "predict", "other", benchmark, "--device", "cpu")
    assert told.status == 0
    assert "predictions/tiny: removes 3 predictions of another run (other weights); --out" in told.err
    (tmp_path / "file").write_bytes(b"")
    refused = command(tmp_path, "predict", str(trained), benchmark, "--out", "file")
    assert refused.status == 1 and "a parent of it is a file; choose another folder" in refused.err


def test_the_same_network_predicts_the_same_bytes(
    command: Command, trained: Path, learning: Release, tmp_path: Path
) -> None:
    for out in ("one", "two"):
        made = command(
            tmp_path, "predict", str(trained), str(learning.folder), "--device", "cpu", "--out", out
        )
        assert made.status == 0
    files = sorted((tmp_path / "one").rglob("*.npz"))
    assert len(files) == 3
    for file in files:
        assert file.read_bytes() == (tmp_path / "two" / file.relative_to(tmp_path / "one")).read_bytes()


def test_weights_come_back_as_they_were(tmp_path: Path) -> None:
    arrays = {
        "a.b": np.arange(6, dtype=np.float32).reshape(2, 3),
        "n": np.asarray(3),
        "half": np.ones(4, np.float16),
    }
    for name in ("one", "two"):
        write_weights(arrays, tmp_path / name)
    found = read_weights(tmp_path / "one")
    assert list(found) == list(arrays)
    assert all((found[k] == arrays[k]).all() and found[k].dtype == arrays[k].dtype for k in arrays)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_half_precision_weights_are_read(trained: Path, tmp_path: Path) -> None:
    shutil.copytree(trained, tmp_path / "run")
    arrays = read_weights(trained / "weights.npz")
    write_weights({k: v.astype(np.float16) for k, v in arrays.items()}, tmp_path / "run" / "weights.npz")
    values = dict(open_trained(tmp_path / "run").network.named_parameters())
    for name, array in arrays.items():
        np.testing.assert_allclose(values[name].detach().numpy(), array, rtol=1e-3, atol=1e-6)


BAD_WEIGHTS = {
    "missing": (None, "missing; train the method again"),
    "damaged": (lambda arrays: b"PK\3\4", "cannot be read as weights"),
    "a shape": (lambda arrays: arrays | {"down.0.bias": np.zeros(3, np.float32)}, r"'down.0.bias' is \(3,\)"),
    "a name": (lambda arrays: arrays | {"more": np.zeros(3, np.float32)}, "'more' is in no such network"),
    "not a number": (
        lambda arrays: arrays | {"down.0.bias": np.full(4, np.nan, np.float32)},
        "'down.0.bias' holds what are no finite numbers",
    ),
    "text": (lambda arrays: arrays | {"down.0.bias": np.array(["a"] * 4)}, "'down.0.bias' holds"),
}


@pytest.mark.parametrize("name", BAD_WEIGHTS)
def test_weights_that_do_not_fit_are_told(trained: Path, tmp_path: Path, name: str) -> None:
    change, words = BAD_WEIGHTS[name]
    shutil.copytree(trained, tmp_path / "run")
    path = tmp_path / "run" / "weights.npz"
    changed = change(read_weights(path)) if change else None
    path.unlink()
    if isinstance(changed, bytes):
        path.write_bytes(changed)
    elif changed is not None:
        write_weights(changed, path)
    with raises(StorageError, "storage.damaged", match=words) as error:
        open_trained(tmp_path / "run")
    assert str(path) in str(error.value)


def test_what_makes_scores_unfair_is_told(
    command: Command, trained: Path, learning: Release, tmp_path: Path
) -> None:
    """Test objects that were learnt from, and another framing; method.json keeps it."""
    recordings: Recordings = (("chair_01", "chair", "chair_a", "test", 1),)
    other = publish_synthetic(tmp_path / "other", recordings).folder
    run = shutil.copytree(trained, tmp_path / "run")
    training = json.loads((run / "training.json").read_text())
    assert training["objects"] == ["chair_a", "table_a"] and training["framings"] == ["object"]
    (run / "training.json").write_text(json.dumps(training | {"framings": ["view"]}))
    made = command(tmp_path, "predict", str(run), str(other), "--device", "cpu")
    assert made.status == 0
    assert "tiny: learnt from 1 of the test objects, such as chair_a: no fair scores" in made.err
    assert "tiny: learnt in framing view, and predicts in framing object" in made.err
    told = json.loads((tmp_path / "predictions" / "tiny" / "method.json").read_text())
    assert len(told["training"]["notes"]) == 2


def test_a_folder_holds_predictions_for_one_release_from_one_run(
    command: Command, trained: Path, learning: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert command(tmp_path, "predict", str(trained), str(learning.folder), "--device", "cpu").status == 0
    said = tmp_path / "predictions" / "tiny" / "method.json"
    assert json.loads(said.read_text())["benchmark_sha256"] == learning.benchmark_sha256
    recordings: Recordings = (("chair_07", "chair", "chair_g", "test", 1),)
    other = publish_synthetic(tmp_path / "other", recordings).folder
    refused = command(tmp_path, "predict", str(trained), str(other), "--device", "cpu")
    assert refused.status == 2 and "holds predictions for another release" in refused.err
    monkeypatch.setattr(predicting, "completed", stopped)
    again = ("predict", str(trained), str(learning.folder), "--device", "cpu")
    assert command(tmp_path, *again).status == 0 and said.exists()  # all is there: nothing is predicted
    assert command(tmp_path, *again, "--threshold", "0.5").status == 1
    assert not said.exists()


def stopped(*arguments: object) -> None:
    raise StorageError("the disk is full")
