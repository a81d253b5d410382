"""The command line as its users meet it: help, JSON, exit statuses, the whole way from init to the page."""

import io
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bounds import children_within
from small_benchmark import Run, copied, hashes, leftovers, make_benchmark, run

from kinectbench.cli.console import SafeConsole
from kinectbench.cli.main import PANELS
from kinectbench.cli.score_tables import score_table
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.release.release import Release

pytestmark = pytest.mark.xdist_group("commands")

Command = Callable[..., Run]
SMALL_IMAGES = ("--set", "sensor.width=160", "--set", "sensor.height=120")
# Scores without what most tests do not look at.
PLAIN = ("--no-surface", "--no-baselines")
METHODS = ("empty", "hull")
COMMANDS = [name for commands in PANELS.values() for name in commands]


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_help_of_every_command(command: Command, tmp_path: Path, name: str) -> None:
    result = command(tmp_path, *name.split(), "--help")
    assert result.status == 0 and result.err == ""
    assert f"kinectbench {name}".strip() in result.out


def test_help_is_fast_and_imports_nothing_heavy(tmp_path: Path) -> None:
    code = (
        "import sys; sys.argv = ['kinectbench', 'score', '--help']\n"
        "import kinectbench.cli.main\n"
        "try: kinectbench.cli.main.main()\n"
        "except SystemExit: print(sorted({'open3d', 'cv2', 'numba', 'trimesh', 'scipy'} & set(sys.modules)))"
    )
    with children_within(2.5):  # idle 1.5
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


def test_what_finds_all_up_to_date_imports_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "import kinectbench.engine.parallel, kinectbench.engine.summary\n"
        "from kinectbench.stages.ingest.readers import name_suffixes\n"
        "name_suffixes()\n"  # the readers of all formats
        "print(sorted({'open3d', 'cv2', 'numba', 'trimesh', 'scipy'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


def test_no_command_shows_the_help(command: Command, tmp_path: Path) -> None:
    result = command(tmp_path)
    assert result.status == 2 and "Usage" in result.out + result.err and "build" in result.out + result.err


def test_version(command: Command, tmp_path: Path) -> None:
    assert command(tmp_path, "--version").out.startswith("kinectbench 0.")


def test_json_stands_alone_on_standard_output(small: Path) -> None:
    result = run(small, "build", "--json", "--jobs", "2")
    rows = json.loads(result.out, parse_constant=lambda word: pytest.fail(word))
    assert result.status == 0 and result.err == ""
    assert [row["recording"] for row in rows] == ["chair", "table"]
    assert all(row["made"] == [] and len(row["current"]) == 6 and row["error"] is None for row in rows)
    assert all(row["frames"] == 24 and row["pairs"] == 3 for row in rows)


def test_ids_choose_recordings(command: Command, small: Path) -> None:
    result = command(small, "build", "table", "--json")
    assert [row["recording"] for row in json.loads(result.out)] == ["table"]


# --- from recordings to a page ------------------------------------------------------------------------


def test_simulate_init_build_publish_score(command: Command, tmp_path: Path) -> None:
    """The way of a newcomer, with nothing but commands."""
    for name in ("chair:seed=1", "table:seed=1"):
        path = tmp_path / "recordings" / name.split(":")[0]
        simulate = ("simulate", str(path), "--object", name, "--frames", "12", *SMALL_IMAGES)
        assert command(tmp_path, *simulate).status == 0
    found = command(tmp_path, "init", ".")
    assert found.status == 0 and "2 recordings" in found.out
    text = (tmp_path / "benchmark.yaml").read_text()
    assert "recordings/chair" in text and "recordings/table" in text
    coarse = [
        "--set",
        "fusion.voxel_size_m=0.015",
        "--set",
        "fusion.scene_voxel_size_m=0.03",
        "--set",
        "views.count=2",
        "--set",
        "license=CC0-1.0",
    ]
    built = command(tmp_path, "build", "--jobs", "1", *coarse)
    assert built.status == 0, built.err
    published = command(tmp_path, "publish", "--allow-poor", "--json", *coarse)
    assert json.loads(published.out)["pairs"] == 4
    assert command(tmp_path, "verify").status == 0


@pytest.fixture(scope="module")
def scored(small: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark with predictions of all baselines, and nothing published by hand."""
    root = copied(small, tmp_path_factory.mktemp("scored") / "b")
    made = run(root, "baseline", *METHODS, "--jobs", "1")
    assert made.status == 0, made.err
    return root


def test_score_publishes_first_and_writes_the_page(command: Command, scored: Path, tmp_path: Path) -> None:
    root = copied(scored, tmp_path / "b", "benchmark.yaml", "recordings", "build", "predictions")
    result = command(root, "score", "predictions", "--jobs", "1", "--json", *PLAIN)
    assert result.status == 0, result.err
    assert sorted(entry["method"] for entry in json.loads(result.out)) == sorted(METHODS)
    assert (root / "benchmark" / "targets.csv").is_file()
    assert all((root / "scores" / name / "scores.csv").is_file() for name in METHODS)
    page = (root / "scores" / "index.html").read_text()
    assert all(name in page for name in ("chair", "table", *METHODS))
    stamp = (root / "benchmark" / "benchmark.json").stat().st_mtime_ns
    assert command(root, "score", "predictions/hull", "--jobs", "1", *PLAIN).status == 0
    assert (root / "benchmark" / "benchmark.json").stat().st_mtime_ns == stamp, "published again for nothing"


def test_a_release_that_is_there_is_used_as_it_is(command: Command, scored: Path, tmp_path: Path) -> None:
    """Only `publish` writes over a release: the others say which one they use, if it is not today's."""
    root = copied(scored, tmp_path / "b", "benchmark.yaml", "recordings", "build", "predictions")
    assert command(root, "publish", "chair").status == 0
    before = hashes(root / "benchmark")
    told = command(root, "export", "out", "--json")
    assert told.status == 0, told.err
    pairs = json.loads(told.out)["pairs"]
    said = (
        f"note: benchmark: used as it was published, {pairs} pairs of 1 recording; settings or what is built"
    )
    assert told.err.startswith(said) and told.err.endswith("`kinectbench publish` publishes it again\n")
    shutil.rmtree(root / "build/table")  # nor is anything built
    for words in (("check", "predictions/hull"), ("score", "predictions/hull", "--jobs", "1", *PLAIN)):
        assert "used as it was published" in command(root, *words, "--set", "fusion.voxel_size_m=0.02").err
    assert command(root, "baseline", "empty").status == 0 and not (root / "build/table").exists()
    assert hashes(root / "benchmark") == before
    assert command(root, "publish").status == 0 and hashes(root / "benchmark") != before
    assert command(root, "export", "out", "--json").err == ""
    (root / "benchmark/benchmark.json").write_text("{}")
    unread = command(root, "check", "predictions/hull")
    assert (unread.status, unread.err.count("\n")) == (1, 1) and "benchmark/benchmark.json" in unread.err


def test_scores_of_another_benchmark_are_left_out_of_the_page(
    command: Command, scored: Path, tmp_path: Path
) -> None:
    root = copied(scored, tmp_path / "b")
    old = ("score", "predictions/hull", "--method", "old-hull", "--jobs", "1", *PLAIN)
    assert command(root, *old).status == 0
    (root / "scores" / "old").mkdir()
    (root / "scores" / "scores.json").rename(root / "scores" / "old" / "scores.json")
    with (root / "benchmark.yaml").open("a") as file:
        file.write("license: CC0-1.0\n")
    assert command(root, "publish").status == 0
    result = command(root, "score", "predictions/empty", "--jobs", "1", *PLAIN)
    assert result.status == 0
    assert "scores/old/scores.json: scores of another benchmark, left out" in result.err
    page = (root / "scores" / "index.html").read_text()
    assert "old-hull" not in page and "empty" in page
    assert "old/scores.json" in command(root, "report").err
    assert "old-hull" not in (root / "scores" / "index.html").read_text()


def test_report_of_what_is_half_built(command: Command, tmp_path: Path, small: Path) -> None:
    root = copied(small, tmp_path / "b", "benchmark.yaml", "build/chair")
    result = command(root, "report")
    assert result.status == 1 and "recordings/table: no such recording" in result.err
    assert "chair" in (root / "scores" / "index.html").read_text()


# --- predictions --------------------------------------------------------------------------------------


def predict(folder: Path, release: Release, grid: np.ndarray | None = None) -> Path:
    """One method's predictions: the same grid for each pair."""
    grid = np.full((8, 8, 8), 0.25, np.float32) if grid is None else grid
    for target in release.targets:
        path = folder / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, grid)
    return folder


FIRST = "chair_01/000"


def spoil_with(array: np.ndarray) -> Callable[[Path], None]:
    return lambda path: np.save(path, array)


def remove(path: Path) -> None:
    path.unlink()


def remove_first(method: Path) -> None:
    remove(method / f"{FIRST}.npy")


def pickle_in_npz(path: Path) -> None:
    remove(path)
    np.savez(path.with_suffix(".npz"), np.array([{"a": 1}], dtype=object))


def both_kinds(path: Path) -> None:
    np.savez(path.with_suffix(".npz"), np.zeros((8, 8, 8), bool))


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:500])


NAN = np.full((8, 8, 8), np.nan, np.float32)
# What is done to the file of a pair, and what its line says after the pair's name.
BAD_PREDICTIONS = (
    (
        (remove, ": no prediction; expected {}.npy"),
        (spoil_with(np.zeros((8, 8, 9), np.float32)), ".npy: shape (8, 8, 9): it must be"),
        (spoil_with(NAN), ".npy: nan at (0, 0, 0): every value must be in [0, 1]"),
        (spoil_with(np.full((8, 8, 8), 1.5, np.float32)), ".npy: 1.5 at (0, 0, 0): every value"),
    ),
    (
        (spoil_with(np.zeros((8, 8, 8), np.int64)), ".npy: dtype int64 is not accepted"),
        (pickle_in_npz, ".npz: "),
        (both_kinds, ": both .npy and .npz are there; keep one"),
        (cut_short, ".npy: cut short"),
    ),
)


@pytest.mark.parametrize("bad", BAD_PREDICTIONS)
def test_bad_predictions(
    command: Command, release: Release, tmp_path: Path, bad: tuple[tuple[Callable[[Path], None], str], ...]
) -> None:
    method = predict(tmp_path / "mine", release)
    pairs = [f"{target.recording}/{target.view}" for target in release.targets][: len(bad)]
    for pair, (spoil, _) in zip(pairs, bad, strict=True):
        spoil(method / f"{pair}.npy")
    of = ("mine", "--benchmark", str(release.folder), "--jobs", "1")
    for arguments in (["score", *of, *PLAIN], ["check", *of]):
        result = command(tmp_path, *arguments)
        errors = [line for line in result.err.splitlines() if "error: " in line]
        assert result.status == 3, result
        assert len(errors) == len(bad) and "Traceback" not in result.err, errors
        for pair, (_, words) in zip(pairs, bad, strict=True):
            assert any(pair + words.format(pair) in line for line in errors), (pair, errors)
    table = json.loads((tmp_path / "scores" / "scores.json").read_text())
    assert table["overall"] is None and len(table["failures"]) == len(bad)


def test_missing_predictions_may_count_as_empty(command: Command, release: Release, tmp_path: Path) -> None:
    remove_first(predict(tmp_path / "mine", release))
    score = ["score", "mine", "--benchmark", str(release.folder), "--jobs", "1", *PLAIN]
    assert command(tmp_path, *score, "--missing", "empty").status == 0
    assert json.loads((tmp_path / "scores" / "scores.json").read_text())["overall"] is not None


def test_a_name_is_no_markup(command: Command, release: Release, tmp_path: Path) -> None:
    """Of a file, of a method on the command line, and of a method in somebody's table of scores."""
    remove_first(predict(tmp_path / "mine", release))
    evil = "[red]x[bold]"
    (tmp_path / "mine" / f"{evil}.npy").touch()
    arguments = ("score", "mine", "--benchmark", str(release.folder), "--jobs", "1", *PLAIN)
    result = command(tmp_path, *arguments)
    assert result.status == 3 and f"{evil}.npy: answers no target" in result.err
    assert f"'{evil}': no name for a method" in command(tmp_path, *arguments, "--method", evil).err
    table = ScoreTable.read(tmp_path / "scores").model_copy(update={"method": evil})
    shown = io.StringIO()
    SafeConsole(file=shown, width=160).print(score_table([table]))
    assert evil in shown.getvalue()


@pytest.mark.parametrize("make", [None, "empty", "stranger"])
def test_no_predictions_at_all(command: Command, release: Release, tmp_path: Path, make: str | None) -> None:
    if make:
        (tmp_path / "mine" / ("" if make == "empty" else "of_another_benchmark")).mkdir(parents=True)
    begins = "no " if make else "there is no such folder; "
    for name in ("score", "check"):
        result = command(tmp_path, name, "mine", "--benchmark", str(release.folder), "--jobs", "1")
        assert result.status == 1
        assert len(result.err.splitlines()) == 1 and result.err.startswith(f"error: mine: {begins}")


def test_a_benchmark_that_is_none(command: Command, tmp_path: Path) -> None:
    for name in ("score", "check"):
        result = command(tmp_path, name, "mine", "--benchmark", "nowhere")
        assert result.status == 1 and result.err.startswith("error: nowhere"), result


def test_several_methods_and_one(command: Command, scored: Path, tmp_path: Path) -> None:
    """What a method scores does not depend on the others."""
    for predictions, out in (("predictions", "all"), ("predictions/hull", "one")):
        score = ["score", str(scored / predictions), "--benchmark", str(scored / "benchmark"), "--out", out]
        assert command(tmp_path, *score, "--jobs", "1", "--no-baselines").status == 0
    alone = (tmp_path / "one" / "scores.json").read_bytes()
    assert (tmp_path / "all" / "hull" / "scores.json").read_bytes() == alone


def test_baselines_are_scored_without_predictions(command: Command, scored: Path, tmp_path: Path) -> None:
    """The rows of their written predictions, as methods of their own on the page."""
    of = ["--benchmark", str(scored / "benchmark"), "--jobs", "1", "--no-surface"]
    assert command(tmp_path, "score", *of, "--out", "memory", "--json").status == 0
    files = ("score", str(scored / "predictions"), *of, "--no-baselines", "--out", "files")
    assert command(tmp_path, *files).status == 0
    for name in METHODS:
        rows = [(tmp_path / out / name / "scores.csv").read_bytes() for out in ("memory", "files")]
        assert rows[0] == rows[1]
    assert not (tmp_path / "predictions").exists() and not (tmp_path / "memory" / "baselines").exists()
    page = (tmp_path / "memory" / "index.html").read_text()
    assert "silhouette" in page
    # What holds for all of them stands once, above each table.
    above = [line for line in page.splitlines() if '<p class="note">Every row:' in line]
    assert len(above) == 5  # protocols
    assert all('Every row:  <span class="badge plain">baseline</span>' in line for line in above)
    assert all(f'{name} <span class="badge plain">baseline</span>' not in page for name in METHODS)


def test_the_baselines_stand_beside_a_method(command: Command, release: Release, tmp_path: Path) -> None:
    predict(tmp_path / "mine", release)
    score = ["score", "mine", "--benchmark", str(release.folder), "--jobs", "1", "--no-surface"]
    shown = command(tmp_path, *score)
    alone = (tmp_path / "scores" / "scores.json").read_bytes()
    page = (tmp_path / "scores" / "index.html").read_text()
    assert shown.status == 0 and "hull (baseline)" in shown.out and "mine (baseline)" not in shown.out
    assert page.count(">baseline</span>") == 3 * 7  # protocols, baselines
    assert "kinectbench build" not in page and "score predictions/ --benchmark benchmark/" in page
    assert "min_containment" in page  # the release's own settings
    hidden = command(tmp_path, *score, "--no-baselines")
    assert hidden.status == 0 and "(baseline)" not in hidden.out
    assert ">baseline</span>" not in (tmp_path / "scores" / "index.html").read_text()
    assert (tmp_path / "scores" / "scores.json").read_bytes() == alone
    compared = command(tmp_path, "compare", "scores", "scores/baselines/hull")
    assert compared.status == 0 and "mine - hull " in compared.out and "hull (baseline) " in compared.out
    as_json = json.loads(command(tmp_path, "compare", "scores", "scores/baselines/hull", "--json").out)
    assert as_json["methods"] == ["mine", "hull"]
    page_of = ["report", "--benchmark", str(release.folder), "--scores", "scores/scores.json"]
    assert command(tmp_path, *page_of).status == 0
    assert (tmp_path / "scores" / "index.html").read_text() == page


def test_verify_names_what_is_damaged(command: Command, scored: Path, tmp_path: Path) -> None:
    root = copied(scored, tmp_path / "b", "benchmark")
    assert command(root, "verify").status == 0
    path = root / "benchmark" / "pairs" / "chair" / "000.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    result = command(root, "verify")
    assert result.status == 1
    assert all("pairs/chair/000.npz" in line for line in result.err.splitlines()) and result.err
    assert json.loads(command(root, "verify", "--json").out)


def test_nothing_is_left_behind(scored: Path) -> None:
    assert leftovers(scored) == []


@pytest.mark.slow  # test_resume.py builds a second time as well, test_release_alone.py predicts
def test_the_same_recordings_make_the_same_benchmark(command: Command, scored: Path, tmp_path: Path) -> None:
    """Simulated, built, published, predicted and scored twice, in two folders: the same bytes."""
    root = make_benchmark(tmp_path / "again")
    assert run(root, "baseline", *METHODS, "--jobs", "2").status == 0
    for made in ("recordings", "build", "benchmark", "predictions"):
        assert hashes(root / made) == hashes(scored / made), made
