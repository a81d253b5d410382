"""A folder of predictions belongs to one run, whatever was there, however it was stopped or changed since."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from raising import raises

from kinectbench.core.artefacts.method import MethodFile, TrainingFile, TrainingRow
from kinectbench.core.errors import SettingsError
from kinectbench.networks import predict as predicting
from kinectbench.networks.config import read_config
from kinectbench.networks.registry import make_network
from kinectbench.networks.trained import Trained
from kinectbench.release.release import Release


@dataclass
class Predicting:
    """`predict` with a network of one value everywhere; what it said, and how often it was asked."""

    release: Release
    trained: Trained
    patch: pytest.MonkeyPatch
    said: list[str] = field(default_factory=list)
    asked: int = 0

    def run(self, out: Path, value: float, *, stop_after: int = 99, threshold: float | None = None) -> None:
        """Predict `value` with weights of its own; a run that is stopped raises nothing."""
        left = stop_after
        self.said.clear()
        self.asked = 0

        def answer(*_: object) -> NDArray[np.float16]:
            nonlocal left
            if left == 0:
                raise KeyboardInterrupt
            left, self.asked = left - 1, self.asked + 1
            return np.full((64, 64, 64), value, np.float16)

        self.patch.setattr(predicting, "completed", answer)
        method = replace(self.trained, weights_sha256=f"{round(10 * value):064x}")
        try:
            predicting.predict(method, self.release, out, threshold=threshold, say=self.said.append)
        except KeyboardInterrupt:
            assert stop_after < 99


@pytest.fixture
def network(learning: Release, tiny: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> Predicting:
    config = read_config(tiny())
    training = TrainingFile(name="tiny", config_sha256=config.sha256, parameter_count=1)
    trained = Trained(config, make_network(config.network).eval(), "0" * 64, training)
    return Predicting(learning, trained, monkeypatch)


def values(out: Path) -> list[float]:
    """The value that each prediction has everywhere, rounded."""
    found = []
    for path in sorted((out / "tiny").rglob("*.npz")):
        with np.load(path) as arrays:
            found.append(round(float(arrays["prediction"].max()), 1))
    return found


def test_another_run_removes_what_it_did_not_write(network: Predicting, tmp_path: Path) -> None:
    """Stopped in the middle and run again all is its own; the first run back again begins anew, too."""
    network.run(tmp_path, 0.9)
    network.run(tmp_path, 0.1, stop_after=1)
    (line,) = network.said
    assert "removes 3 predictions of another run (other weights); --out keeps both" in line
    assert set(values(tmp_path)) <= {0.1} and not (tmp_path / "tiny" / "method.json").exists()
    network.run(tmp_path, 0.1)
    assert values(tmp_path) == [0.1] * 3 and not network.said
    told = MethodFile.read(tmp_path / "tiny")
    assert told.files is not None and len(told.files) == 3 and told.run_sha256
    network.run(tmp_path, 0.9, stop_after=2)
    network.run(tmp_path, 0.9)
    assert values(tmp_path) == [0.9] * 3
    hidden = {path.name for path in (tmp_path / "tiny").iterdir()} - {"chair_02", "chair_03"}
    assert hidden == {"method.json", ".lock"}


def test_another_threshold_is_another_run(network: Predicting, tmp_path: Path) -> None:
    network.run(tmp_path, 0.9, stop_after=2)
    network.run(tmp_path, 0.9, threshold=0.4)
    assert network.asked == 3 and "(another --threshold)" in network.said[0]
    sizes = {np.load(path)["prediction"].shape for path in (tmp_path / "tiny").rglob("*.npz")}
    assert sizes == {(256, 256, 32)}


@pytest.mark.parametrize("key", ["torch", "hardware", "version"])
def test_what_rounds_otherwise_is_another_run(network: Predicting, tmp_path: Path, key: str) -> None:
    network.run(tmp_path, 0.9, stop_after=2)
    path = tmp_path / "tiny" / "unfinished.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: "another"}))
    journal = path.with_name(".predicted.jsonl")
    journal.write_text(journal.read_text().replace('"run_sha256":"', '"run_sha256":"0')[:-1])
    network.run(tmp_path, 0.9)
    assert network.asked == 3 and "removes" in network.said[0] and key.split("_")[0] in network.said[0]


@pytest.mark.parametrize("stopped", [False, True])
def test_a_file_that_changed_since_is_predicted_again(
    network: Predicting, tmp_path: Path, stopped: bool
) -> None:
    """By hand, by a copy from another folder, or away; the others are left as they are."""
    network.run(tmp_path, 0.9, stop_after=2 if stopped else 99)
    files = sorted((tmp_path / "tiny").rglob("*.npz"))
    np.savez(files[0], prediction=np.full((64, 64, 64), 0.3, np.float16))
    kept = {path: path.stat().st_mtime_ns for path in files[1:]}
    network.run(tmp_path, 0.9)
    assert values(tmp_path) == [0.9] * 3 and network.asked == (2 if stopped else 1)
    assert "removes 1 prediction that this run did not write, or that changed since" in network.said[0]
    assert all(path.stat().st_mtime_ns == at for path, at in kept.items())
    network.run(tmp_path, 0.9)
    assert network.asked == 0 and not network.said


def test_the_networks_own_threshold_goes_with_its_predictions(network: Predicting, tmp_path: Path) -> None:
    """That of the weights that are there; bits have none. It is no part of what decides the bytes."""
    rows = [(10, 0.3), (20, 0.25), (25, None), (30, 0.4)]
    course = tuple(TrainingRow(step=step, epoch=1.0, loss=1.0, threshold=p) for step, p in rows)
    training = network.trained.training.model_copy(update={"rows": course, "weights_step": 25})
    network.run(tmp_path, 0.9)
    before = MethodFile.read(tmp_path / "tiny")
    assert before.threshold is None and before.seconds_per_view is not None
    network.trained = replace(network.trained, training=training)
    network.run(tmp_path, 0.9)
    after = MethodFile.read(tmp_path / "tiny")
    assert network.asked == 0 and after.threshold == 0.25 == training.threshold
    assert after.seconds_per_view == before.seconds_per_view and after.files == before.files
    network.run(tmp_path, 0.9, threshold=0.4)
    assert MethodFile.read(tmp_path / "tiny").threshold is None


def test_a_journal_that_is_damaged_only_costs_time(network: Predicting, tmp_path: Path) -> None:
    network.run(tmp_path, 0.9, stop_after=2)
    journal = tmp_path / "tiny" / ".predicted.jsonl"
    journal.write_bytes(journal.read_bytes()[:-9] + b"\n\xff")
    network.run(tmp_path, 0.9)
    assert values(tmp_path) == [0.9] * 3 and network.asked == 3


def test_predictions_of_an_older_version_are_removed(network: Predicting, tmp_path: Path) -> None:
    """Its method.json has no fingerprint and no files, but says that `predict` wrote it."""
    network.run(tmp_path, 0.9)
    path = tmp_path / "tiny" / "method.json"
    older = {k: v for k, v in json.loads(path.read_text()).items() if k not in ("run_sha256", "files")}
    path.write_text(json.dumps(older))
    network.run(tmp_path, 0.1, stop_after=0)
    assert values(tmp_path) == [] and "removes 3 predictions" in network.said[0]


def test_what_is_not_predicts_is_left(network: Predicting, tmp_path: Path) -> None:
    """Somebody's own predictions of the same name, even with a method.json; a link, and names that climb."""
    mine = tmp_path / "mine" / "tiny"
    (mine / "chair_03").mkdir(parents=True)
    (mine / "chair_03" / "000.npz").write_bytes(b"mine")
    (mine / "method.json").write_text(json.dumps({"name": "tiny"}))
    with raises(SettingsError, "settings.other-content", match="`predict`"):
        network.run(tmp_path / "mine", 0.9)
    network.run(tmp_path, 0.9)
    method = MethodFile.read(tmp_path / "tiny")
    names = dict.fromkeys(["../mine/tiny/chair_03/000.npz", "unfinished.json"], "blake3:" + "0" * 64)
    method.model_copy(update={"files": names, "run_sha256": "0" * 64}).write(tmp_path / "tiny")
    network.run(tmp_path, 0.1)
    assert values(tmp_path) == [0.1] * 3
    (tmp_path / "tiny" / "chair_03").rename(tmp_path / "elsewhere")
    (tmp_path / "tiny" / "chair_03").symlink_to(tmp_path / "elsewhere")
    with raises(SettingsError, "settings.other-content", match="chair_03"):
        network.run(tmp_path, 0.9)
    assert (mine / "chair_03" / "000.npz").read_bytes() == b"mine"
    assert len([*(tmp_path / "elsewhere").iterdir()]) == 2
