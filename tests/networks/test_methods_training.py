"""Training: its course depends on the settings alone, however often it is stopped."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises
from slow import slow
from small_method import TINY
from synthetic_release import Recordings, publish_synthetic

from kinectbench.core.artefacts.method import TrainingFile, TrainingRow
from kinectbench.core.errors import ReleaseError, SettingsError, StorageError
from kinectbench.core.voxels.pair_file import pack
from kinectbench.networks import train as training
from kinectbench.networks import validate
from kinectbench.networks.config import read_config
from kinectbench.networks.data import PairFile, pairs_of_step, steps_in_all, validation_pairs
from kinectbench.networks.network import Network
from kinectbench.networks.predict import method_of, run_of
from kinectbench.networks.trained import open_trained
from kinectbench.networks.validate import validation_iou
from kinectbench.networks.weights import arrays_of_network, write_weights
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.truth import PackedTruth

Tiny = Callable[..., Path]


class Killed(BaseException):
    """As if the process ended: nothing is saved any more."""


def run(
    tiny: Path, release: Release, folder: Path, stop: tuple[int, type[BaseException]] | None = None
) -> None:
    def progress(done: int, total: int) -> None:
        assert total == 5
        if stop and done == stop[0]:
            raise stop[1]

    training.train(read_config(tiny), [release], folder, device="cpu", progress=progress)


def made(folder: Path) -> tuple[bytes, list[TrainingRow], bytes]:
    """What must not depend on how the training was stopped."""
    rows = json.loads((folder / "training.json").read_text())["rows"]
    curves = (folder / "curves.png").read_bytes()
    return (folder / "weights.npz").read_bytes(), [TrainingRow.model_validate(row) for row in rows], curves


@pytest.fixture(scope="module")
def whole(learning: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that nothing stopped."""
    root = tmp_path_factory.mktemp("whole")
    (root / "tiny.yaml").write_text(TINY)
    run(root / "tiny.yaml", learning, root / "run")
    return root / "run"


def test_a_training_leaves_what_it_is_known_by(whole: Path) -> None:
    _, rows, curves = made(whole)
    assert [row.step for row in rows] == [2, 4, 5]
    assert all(row.validation_iou is not None and row.threshold is not None for row in rows)
    assert rows[-1].loss < rows[0].loss
    assert curves.startswith(b"\x89PNG")
    assert read_config(whole / "config.yaml").name == "tiny"
    told = json.loads((whole / "training.json").read_text())
    assert (told["steps"], told["steps_in_all"], told["pairs"]) == (5, 5, 5)
    with np.load(whole / "weights.npz") as arrays:
        assert sum(arrays[name].size for name in arrays.files) == told["parameter_count"]


@pytest.mark.parametrize("step", [slow(1), 2, slow(3)])
def test_an_interrupted_training_goes_on_the_same_course(
    whole: Path, learning: Release, tiny: Tiny, tmp_path: Path, step: int
) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tiny(), learning, tmp_path / "run", (step, KeyboardInterrupt))
    assert json.loads((tmp_path / "run" / "training.json").read_text())["steps"] == step
    run(tiny(), learning, tmp_path / "run")
    assert made(tmp_path / "run") == made(whole)


def test_a_killed_training_goes_on_from_its_checkpoint(
    whole: Path, learning: Release, tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps after the last checkpoint are done again, and come out the same."""
    monkeypatch.setattr(training, "SAVE_EVERY_S", 0.0)
    with pytest.raises(Killed):
        run(tiny(), learning, tmp_path / "run", (4, Killed))
    assert json.loads((tmp_path / "run" / "training.json").read_text())["steps"] == 3
    run(tiny(), learning, tmp_path / "run")
    assert made(tmp_path / "run") == made(whole)


def test_minutes_stop_a_training_and_it_goes_on(
    whole: Path, learning: Release, tiny: Tiny, tmp_path: Path
) -> None:
    for expected in (1, 2):
        state = training.train(read_config(tiny()), [learning], tmp_path / "run", minutes=0, device="cpu")
        assert state.step == expected
    run(tiny(), learning, tmp_path / "run")
    assert made(tmp_path / "run") == made(whole)


def test_a_training_that_is_done_is_not_done_again(whole: Path, learning: Release, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "run")
    before = (tmp_path / "run" / "checkpoint.pt").stat().st_mtime_ns
    state = training.train(read_config(whole / "config.yaml"), [learning], tmp_path / "run", device="cpu")
    assert state.step == 5
    assert (tmp_path / "run" / "checkpoint.pt").stat().st_mtime_ns == before


def test_the_best_weights_are_kept(
    learning: Release, tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of the second of three looks, whatever comes afterwards, also where it was stopped or killed."""
    ious = {2: 0.2, 4: 0.6, 5: 0.4}
    arrays: dict[int, dict[str, np.ndarray]] = {}
    looks: list[int] = []

    def look(network: Network, *_: object) -> tuple[float, float]:
        looks.append([2, 4, 5][len(looks)])
        arrays[looks[-1]] = {name: values.copy() for name, values in arrays_of_network(network).items()}
        return ious[looks[-1]], 0.5

    monkeypatch.setattr(training, "validation_iou", look)
    config = tiny(("validation_pairs: 1", "validation_pairs: 1, keep: best"))
    run(config, learning, tmp_path / "run")
    looks.clear()
    with pytest.raises(Killed):
        run(config, learning, tmp_path / "killed", (4, Killed))
    looks.clear()
    with pytest.raises(KeyboardInterrupt):
        run(config, learning, tmp_path / "parts", (4, KeyboardInterrupt))
    run(config, learning, tmp_path / "parts")
    write_weights(arrays[4], tmp_path / "wanted.npz")
    write_weights(arrays[5], tmp_path / "last.npz")
    wanted = (tmp_path / "wanted.npz").read_bytes()
    assert wanted != (tmp_path / "last.npz").read_bytes()
    for name in ("run", "parts", "killed"):
        assert TrainingFile.read(tmp_path / name).weights_step == 4
        assert (tmp_path / name / "weights.npz").read_bytes() == wanted


MORE_NETWORKS = {
    "3d-recgan++, both optimisers": """\
name: gan
network: {kind: 3d-recgan++, channel_divisor: 32, output_cells: 64}
adversarial: {beta: 0.2}
training: {batch: 2, epochs: 1.2, learning_rate: 1.0e-3, validation_pairs: 0}
""",
    "3d-recae, tiles and a cosine": """\
name: tiles
network: {kind: 3d-recae, channel_divisor: 32, output_cells: 128}
loss: {unknown: mask, tile_cells: 32}
training: {batch: 2, epochs: 1.2, learning_rate: 1.0e-3, schedule: cosine, validation_pairs: 0}
""",
}


@pytest.mark.parametrize(
    "name", [name if name.startswith("3d-recgan++") else slow(name) for name in MORE_NETWORKS]
)
def test_other_networks_go_on_the_same_course(learning: Release, tmp_path: Path, name: str) -> None:
    (tmp_path / "config.yaml").write_text(MORE_NETWORKS[name])
    config = read_config(tmp_path / "config.yaml")

    def stop(done: int, total: int) -> None:
        assert total == 3
        if done == 1:
            raise KeyboardInterrupt

    training.train(config, [learning], tmp_path / "whole", device="cpu")
    with pytest.raises(KeyboardInterrupt):
        training.train(config, [learning], tmp_path / "parts", device="cpu", progress=stop)
    training.train(config, [learning], tmp_path / "parts", device="cpu")
    assert made(tmp_path / "parts") == made(tmp_path / "whole")


def test_a_folder_of_other_settings_is_refused(
    whole: Path, learning: Release, tiny: Tiny, tmp_path: Path
) -> None:
    shutil.copytree(whole, tmp_path / "run")
    with raises(SettingsError, "settings.other-content", match=r"training\.seed 0 there, 1"):
        run(tiny(("batch: 2", "batch: 2, seed: 1")), learning, tmp_path / "run")
    assert made(tmp_path / "run") == made(whole)


def test_a_folder_of_another_release_is_refused(
    whole: Path, learning: Release, release: Release, tmp_path: Path
) -> None:
    from dataclasses import replace

    shutil.copytree(whole, tmp_path / "run")
    other = replace(learning, metadata=release.metadata)
    with raises(SettingsError, "settings.other-content", match="was trained on another release"):
        training.train(read_config(whole / "config.yaml"), [other], tmp_path / "run", device="cpu")


@pytest.mark.parametrize("content", [b"", b"PK\3\4 no archive", b"\x80\x04cos\nsystem\n"])
def test_a_damaged_checkpoint_is_told(whole: Path, learning: Release, tmp_path: Path, content: bytes) -> None:
    shutil.copytree(whole, tmp_path / "run")
    (tmp_path / "run" / "checkpoint.pt").write_bytes(content)
    with raises(StorageError, "storage.damaged", match="checkpoint.pt: cannot"):
        training.train(read_config(whole / "config.yaml"), [learning], tmp_path / "run", device="cpu")


def test_a_release_without_training_pairs_is_told(release: Release, tiny: Tiny, tmp_path: Path) -> None:
    with raises(ReleaseError, "release.no-pairs"):
        training.train(read_config(tiny()), [release], tmp_path / "run", device="cpu")


def test_no_release_is_refused(tiny: Tiny, tmp_path: Path) -> None:
    with raises(ReleaseError, "release.no-pairs", match="no release to train on"):
        training.train(read_config(tiny()), [], tmp_path / "run", device="cpu")


def test_every_epoch_sees_every_pair_once() -> None:
    seen = [index for step in range(10) for index in pairs_of_step(step, 5, 3, seed=7)]
    assert all(sorted(seen[5 * epoch : 5 * epoch + 5]) == [0, 1, 2, 3, 4] for epoch in range(6))
    assert len({tuple(seen[5 * epoch : 5 * epoch + 5]) for epoch in range(6)}) > 1
    assert pairs_of_step(4, 5, 3, seed=7) == seen[12:15]


def test_steps_cover_all_epochs(tiny: Tiny) -> None:
    config = read_config(tiny())
    assert [steps_in_all(pairs, config) for pairs in (1, 4, 5)] == [1, 4, 5]


def test_validation_pairs_are_spread(learning: Release) -> None:
    only = learning.folder / "pairs/chair_02/000.npz"
    assert [pair.path for pair in validation_pairs([learning], 9)] == [only]
    assert [pair.path for pair in validation_pairs([learning, learning], 2)] == [only, only]
    assert validation_pairs([learning], 0) == ()


@pytest.fixture(scope="module")
def more(tmp_path_factory: pytest.TempPathFactory) -> Release:
    """Another release, with objects of its own; one of its test objects is learnt from elsewhere."""
    recordings: Recordings = (
        ("table_09", "table", "table_i", "train", 2),
        ("chair_09", "chair", "chair_i", "validation", 1),
        ("chair_08", "chair", "chair_a", "test", 1),
    )
    return open_release(publish_synthetic(tmp_path_factory.mktemp("more"), recordings).folder)


def test_several_releases_are_learnt_from(
    tiny: Tiny, learning: Release, more: Release, tmp_path: Path
) -> None:
    config = read_config(tiny(("batch: 2", "batch: 2, leave_out: [chair_a]")))
    training.train(config, [learning, more], tmp_path / "run", device="cpu")
    told = TrainingFile.read(tmp_path / "run")
    assert (told.pairs, told.objects) == (4, ("table_a", "table_i"))
    assert told.further_benchmarks_sha256 == (more.benchmark_sha256,)
    with raises(SettingsError, "settings.other-content", match="trained on another release"):
        training.train(config, [learning], tmp_path / "run", device="cpu")


def test_what_is_tested_on_is_not_learnt_from(
    tiny: Tiny, learning: Release, more: Release, tmp_path: Path
) -> None:
    with raises(ReleaseError, "release.overlap", match="chair_a"):
        training.train(read_config(tiny()), [learning, more], tmp_path / "run", device="cpu")
    with raises(ReleaseError, "release.overlap", match="same release"):
        training.train(read_config(tiny()), [learning, learning], tmp_path / "run", device="cpu")


def test_one_category_alone_is_learnt_from(
    tiny: Tiny, learning: Release, more: Release, tmp_path: Path
) -> None:
    """Its pairs alone; the name of the method, its files and its notes say so."""
    config = read_config(tiny()).of_category("table")
    training.train(config, [learning], tmp_path / "run", device="cpu")
    wanted = {t.object for t in learning.split("train") if t.category == "table"}
    told = TrainingFile.read(tmp_path / "run")
    assert (told.name, told.objects) == ("tiny-table", tuple(sorted(wanted)))
    made = open_trained(tmp_path / "run")
    assert made.config.training.category == "table" and made.config.of_category("table") == made.config
    run_of_it = run_of(made, learning, None, "packed")
    method = method_of(made, learning, run_of_it, [])
    assert (
        method.name == "tiny-table" and (method.settings or {})["config"]["training"]["category"] == "table"
    )
    others = {target.category for target in learning.split("test")} - {"table"}
    assert any(
        line == f"learnt from table alone, and predicts {', '.join(sorted(others))}"
        for line in ((method.training or {})["notes"])
    )
    assert {pair.path for pair in validation_pairs([learning, more], 9, "chair")} == {
        release.pair_path(target)
        for release in (learning, more)
        for target in release.split("validation")
        if target.category == "chair"
    }
    with raises(ReleaseError, "release.no-pairs", match=r"no training pairs of category 'tabel'; .*'table'"):
        training.train(read_config(tiny()).of_category("tabel"), [learning], tmp_path / "no", device="cpu")
    assert not (tmp_path / "no").exists()
    with raises(SettingsError, "settings.wrong-value", match="--category"):
        config.of_category("../chair")


@pytest.mark.parametrize("failing", [slow(1), 3])
def test_a_look_that_failed_is_taken_again(
    whole: Path, learning: Release, tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    """At whatever step it fails, the course is the same afterwards; the last step's is no exception."""
    looked, calls = validation_iou, iter(range(1, 100))

    def fails(*arguments: object) -> tuple[float, float]:
        if next(calls) == failing:
            raise ReleaseError("a pair is gone")
        return looked(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(training, "validation_iou", fails)
    with raises(ReleaseError, "release.damaged", match="pair is"):
        run(tiny(), learning, tmp_path / "run")
    monkeypatch.setattr(training, "validation_iou", looked)
    run(tiny(), learning, tmp_path / "run")
    assert made(tmp_path / "run") == made(whole)


def test_a_pair_of_which_nothing_is_known_chooses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in scores: it is left out; where all are such pairs, they count as they did."""
    grid = np.zeros((256, 256, 256), bool)
    full = grid.copy()
    full[100:150, 100:150, 100:150] = True
    wrong = np.roll(full, 40, axis=0)
    packed = {"known": pack(~full & ~wrong), "seen": pack(~grid)}

    def truth(path: Path, _: str) -> PackedTruth:
        return PackedTruth(pack(full), packed[path.name], pack(grid), 0.004, 0.0)

    monkeypatch.setattr(validate, "read_parts", lambda *_: (pack(grid[:64, :64, :64]),))
    monkeypatch.setattr(validate, "read_packed_truth", truth)
    monkeypatch.setattr(validate, "completed", lambda *_: wrong)
    network: Any = None
    config: Any = None

    def found(*names: str) -> float:
        return validation_iou(network, [PairFile(Path(name), "") for name in names], config, "cpu")[0]

    assert found("known", "seen") == found("seen") < 0.2 and found("known") in (0.0, 1.0)
