"""What people who train use: the same numbers from memory as from files, and an example that runs."""

import os
import pickle
import runpy
import subprocess
import sys
from inspect import signature
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from raising import raises
from slow import slow
from synthetic_release import RECORDINGS, publish_synthetic

import kinectbench
from kinectbench.cli import score as commands_score
from kinectbench.core.errors import PredictionError, SettingsError
from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.compare import compare as compare_tables
from kinectbench.scoring.protocols import PRIMARY
from kinectbench.scoring.request import Request
from kinectbench.scoring.score import score, score_methods

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_dataset(release: Release) -> None:
    dataset = kinectbench.load(release.folder)
    assert len(dataset) == len(release.targets) == 7 and len(dataset.split("train")) == 0
    there = {name: len(dataset.split(name)) for name in ("validation", "test")}
    told = ", ".join(f"{there[name]} {name}" for name in ("validation", "test"))
    assert repr(dataset) == f"<Dataset {release.metadata.name}: 7 pairs ({told})>"
    assert repr(dataset.split("train")).endswith(": 0 pairs>")
    item = dataset.split("test")[1]
    pair = read_pair(release.folder / "pairs" / "chair_01" / "001.npz")
    assert item["pair_id"] == "chair_01/001"
    for name in ("partial", "full", "known"):
        np.testing.assert_array_equal(item[name], unpack(getattr(pair, name)))
    assert item["meta"]["unknown_share"] == (item["full"] & ~item["known"]).sum() / item["full"].sum() > 0
    assert item["meta"]["category"] == "chair" and item["meta"]["voxel_size_m"] == pair.voxel_size_m
    assert [one["pair_id"] for one in dataset.split("validation")] == [
        t.name for t in release.split("validation")
    ]
    with raises(SettingsError, "settings.wrong-value", match="'val'"):
        dataset.split("val")


def test_scorer_gives_what_files_give(release: Release, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    dataset = kinectbench.load(release.folder)
    scorer = kinectbench.Scorer(dataset, method="mine", protocols=["known"])
    for split in ("validation", "test"):
        for item in dataset.split(split):
            y = (0.6 * item["full"][::8, ::8, ::8] + 0.4 * rng.random((32, 32, 32))).astype(np.float32)
            scorer.update(item["pair_id"], np.asfortranarray(y))
            recording, _, view = item["pair_id"].partition("/")
            (tmp_path / recording).mkdir(exist_ok=True)
            np.save(tmp_path / recording / f"{view}.npy", y)
    expected = score(release, tmp_path, method="mine", protocols=["known"]).json_value()
    found = scorer.result().json_value()
    assert found.pop("hashes").keys() == expected.pop("hashes").keys()
    assert found == expected


@pytest.mark.parametrize("missing", ["error", "empty"])
def test_scorer_gives_what_files_give_where_a_category_has_no_validation(
    tmp_path: Path, missing: str
) -> None:
    """To the byte, also where a pair is missing; the threshold of tables is that of chairs."""
    folder = publish_synthetic(tmp_path, tuple(one for one in RECORDINGS if one[0] != "table_02")).folder
    release, rng = open_release(folder), np.random.default_rng(0)
    assert {target.category for target in release.split("validation")} == {"chair"}
    scorer = kinectbench.Scorer(folder, method="mine", missing=missing, surface=False)
    for target in (*release.split("validation"), *release.split("test")):
        if target.name not in ("chair_03/001", "chair_01/001"):
            y = rng.random((8, 8, 8)).astype(np.float32)
            scorer.update(target.name, y)
            path = tmp_path / "mine" / target.recording / f"{target.view}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, y)
    (by_files,) = score_methods(release, tmp_path / "mine", tmp_path / "out", missing=missing, surface=False)
    in_memory = scorer.result()
    assert by_files.threshold_source_by_category == {"chair": "validation", "table": "pooled"}
    # An array has no file whose bytes could be hashed.
    assert in_memory.hashes.keys() == by_files.hashes.keys()
    in_memory.model_copy(update={"hashes": by_files.hashes}).write(tmp_path / "memory")
    for name in ("scores.json", "scores.csv"):
        assert (tmp_path / "memory" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


def test_an_option_has_one_default() -> None:
    """The command, the request behind it and the scorer count alike unless they are told otherwise."""
    ways = (commands_score.score_command, Request, kinectbench.Scorer)
    for name in ("surface", "upsampling", "missing", "thresholds_file"):
        defaults = [
            parameters[name].default for way in ways if name in (parameters := signature(way).parameters)
        ]
        assert len(defaults) >= 2 and all(default == defaults[0] for default in defaults), name
    assert signature(compare_tables).parameters["protocol"].default == PRIMARY
    assert signature(commands_score.compare_command).parameters["protocol"].default == PRIMARY


def test_scorer_refuses(release: Release) -> None:
    scorer = kinectbench.Scorer(release.folder)
    grid = np.zeros((4, 4, 4), bool)
    with raises(PredictionError, "prediction.unknown-pair", match="chair_01/7"):
        scorer.update("chair_01/7", grid)
    with raises(PredictionError, "prediction.malformed", match="chair_01/000: dtype float64"):
        scorer.update("chair_01/000", grid.astype(float))
    with raises(PredictionError, "prediction.bad-values", match=r"chair_01/000.*\(0.*0\)"):
        scorer.update("chair_01/000", np.full((4, 4, 4), np.nan, np.float32))
    scorer.update("chair_01/000", grid)
    with raises(PredictionError, "prediction.order"):
        scorer.update("chair_03/000", grid)
    table = scorer.result()
    assert not table.complete and len(table.failures) == 3 and table.overall is None
    with raises(SettingsError, "settings.wrong-value", match="'all'"):
        kinectbench.Scorer(release.folder, protocols=["all"])


def test_a_refused_test_pair_fixes_no_thresholds(release: Release) -> None:
    scorer = kinectbench.Scorer(release.folder, surface=False)
    with raises(PredictionError, "prediction.bad-values"):
        scorer.update("chair_01/000", np.full((4, 4, 4), np.nan, np.float32))
    scorer.update(release.split("validation")[0].name, np.zeros((4, 4, 4), bool))


class StandIn:
    """What `kinectbench.load` uses of torch's Dataset."""

    def __getitem__(self, index: int) -> None:
        raise NotImplementedError("the stand-in's")


def assert_torch_dataset(dataset: kinectbench.Dataset, torch_dataset: type, release: Release) -> None:
    assert isinstance(dataset, torch_dataset) and isinstance(dataset, kinectbench.Dataset)
    test = dataset.split("test")
    assert isinstance(test, torch_dataset) and len(test) == 4
    again: kinectbench.Dataset = pickle.loads(pickle.dumps(test))  # what a DataLoader's workers get
    assert isinstance(again, torch_dataset) and again.targets == test.targets
    item = again[1]
    assert item["pair_id"] == "chair_01/001" and item["full"].shape == (256, 256, 256)


def test_a_torch_dataset_where_torch_is_stood_in_for(
    release: Release, monkeypatch: pytest.MonkeyPatch
) -> None:
    modules = {name: ModuleType(name) for name in ("torch", "torch.utils", "torch.utils.data")}
    modules["torch.utils.data"].Dataset = StandIn  # type: ignore[attr-defined]
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    assert_torch_dataset(kinectbench.load(release.folder), StandIn, release)


@pytest.mark.filterwarnings("ignore:This DataLoader will create")  # machines with one core
def test_torch_itself_reads_it_in_parallel(release: Release) -> None:
    data = pytest.importorskip("torch.utils.data")
    dataset = kinectbench.load(release.folder)
    assert_torch_dataset(dataset, data.Dataset, release)
    items = [*data.DataLoader(dataset.split("test"), batch_size=None, num_workers=2)]
    assert [item["pair_id"] for item in items] == [target.name for target in release.split("test")]
    assert tuple(items[0]["partial"].shape) == (64, 64, 64)


def test_importing_the_package_is_light() -> None:
    code = "import sys, kinectbench; assert 'numpy' not in sys.modules; kinectbench.Scorer"
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'lod'"):
        _ = kinectbench.lod


def test_the_package_lists_its_names() -> None:
    assert {"Dataset", "Scorer", "load", "__version__"} <= {*dir(kinectbench)}


@pytest.mark.parametrize("name", ["train.py", "train_torch.py"])
def test_the_example_says_that_there_is_nothing_to_learn_from(
    release: Release, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if "torch" in name:
        pytest.importorskip("torch")
    only_test = kinectbench.load(release.folder).split("test")
    monkeypatch.setattr(kinectbench, "load", lambda path: only_test, raising=False)
    monkeypatch.setattr(sys, "argv", [name, str(release.folder)])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert "no train or validation pairs in this release; make some: kinectbench" in capsys.readouterr().err


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release of four pairs: three to learn from, one to test with."""
    wanted = tuple(one for one in RECORDINGS if one[0] in ("chair_02", "chair_03", "table_02"))
    return publish_synthetic(tmp_path_factory.mktemp("few"), wanted).folder


@pytest.mark.parametrize(
    ("name", "options"),
    [("train.py", []), slow("train_torch.py", [])],
)
def test_the_example_runs_and_learns(few: Path, name: str, options: list[str]) -> None:
    if "torch" in name:
        pytest.importorskip("torch")
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), str(few), "--epochs", "2", *options],
        env=os.environ | {"OMP_NUM_THREADS": "1"},  # threads that wait for each other take time, too
        capture_output=True,
        text=True,
        check=True,
    )
    assert_learnt(done.stdout)


def assert_learnt(lines: str) -> None:
    """Two epochs, the second better."""
    losses = [float(line.split(", CE ")[1].split()[0]) for line in lines.splitlines()]
    assert len(losses) == 2 and losses[1] < losses[0] < 0.7


def test_the_example_of_a_network_learns(
    few: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In this process, where torch is imported already."""
    torch = pytest.importorskip("torch")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # threads that wait for each other take time, too
    try:
        monkeypatch.setattr(sys, "argv", ["train_torch.py", str(few), "--epochs", "2", "--workers", "0"])
        runpy.run_path(str(EXAMPLES / "train_torch.py"), run_name="__main__")
    finally:
        torch.set_num_threads(threads)
    assert_learnt(capsys.readouterr().out)


def test_the_old_import_path_has_the_same_names() -> None:
    """`kinectbench.api`, in a fresh interpreter in each of the ways it was imported."""
    for statement in (
        "from kinectbench.api import Dataset, Scorer, load",
        "import kinectbench.api; Dataset, Scorer, load = (getattr(kinectbench.api, n) for n in NAMES)",
        "from kinectbench import api; Dataset, Scorer, load = (getattr(api, n) for n in NAMES)",
    ):
        code = (
            f"NAMES = ('Dataset', 'Scorer', 'load')\n{statement}\n"
            "import sys; assert 'kinectbench.cli' not in sys.modules\n"
            "from kinectbench.scoring import api as new\n"
            "assert (Dataset, Scorer, load) == (new.Dataset, new.Scorer, new.load)\n"
        )
        subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError):
        _ = kinectbench.api.nothing
