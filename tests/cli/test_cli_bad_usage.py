"""Wrong words on the command line and in benchmark.yaml: one clear line, and nothing is changed."""

from pathlib import Path

import pytest
from command_lines import ONE, Command, check_line
from small_benchmark import hashes

pytestmark = pytest.mark.xdist_group("commands")

BAD_USAGE = {
    "no file": (["build", "-c", "none.yaml"], "none.yaml: no such file|kinectbench init"),
    "unknown section": (["build", "--set", "fusoin.voxel_size_m=0.01"], "fusoin|did you mean 'fusion'?"),
    "unknown key": (["build", "--set", "fusion.voxel_size=0.01"], "voxel_size_m"),
    "wrong type": (["build", "--set", "views.count=many"], "views.count|a whole number from 1 to 1000"),
    "out of range": (["build", "--set", "views.count=0"], "views.count|from 1 to 1000"),
    "no equals sign": (["build", "--set", "views.count"], "section.key=value"),
    "unknown recording": (["build", "chiar"], "no recording 'chiar'|did you mean 'chair'?"),
    "unknown recording to set": (["build", "--set", "recordings.chiar.split=test"], "did you mean 'chair'?"),
    "jobs 0": (["build", "--jobs", "0"], "--jobs 0: wanted a value greater than or equal to 1|build --help"),
    "jobs many": (["build", "--jobs", "many"], "--jobs many: wanted a valid integer;|build --help"),
    "a limit that is no number": (["build", "--time-limit", "nan"], "--time-limit nan: wanted|build --help"),
    "speed": (["record", "new", "--speed", "fast"], "--speed fast: wanted a valid number;|record --help"),
    "no speed": (["record", "new", "--speed", "0"], "--speed 0: wanted a value greater than|record --help"),
    "port": (["record", "new", "--port", "99999"], "--port 99999: wanted a value less than|record --help"),
    "unknown option": (["build", "--nope"], "--nope|build --help"),
    "unknown command": (["biuld"], "'biuld'|build|--help"),
    "no argument": (["check"], "Missing argument|check --help"),
    "method without predictions": (
        ["score", "--method", "mine"],
        "--method applies to predictions|kinectbench score PREDICTIONS",
    ),
    "missing without predictions": (["score", "--missing", "empty"], "--missing applies to predictions"),
    "unknown baseline": (["baseline", "hul"], "no baseline 'hul'|hull"),
    "unknown protocol": (["score", "predictions", "--protocol", "papre"], "no protocol 'papre'|paper"),
    "unknown way with missing": (["score", "predictions", "--missing", "zero"], "--missing zero|empty"),
    "compare no scores": (["compare", "none.json"], "none.json: no such file or folder"),
    "report no scores": (["report", "--scores", "none.json"], "none.json: no such file or folder"),
    "simulate nothing": (["simulate"], "OUT|--samples"),
    "simulate samples of a seed": (["simulate", "--samples", "new", "--seed", "1"], "--samples|leave out"),
    "simulate a set demo": (["simulate", "--demo", "new", "--set", "seed=1"], "--demo|leave out"),
    "simulate sheets and a recording": (["simulate", "new", "--contact-sheets", "sheets"], "leave out OUT"),
    "simulate two sets": (["simulate", "--demo", "new", "--contact-sheets", "sheets"], "leave out"),
    "simulate no furniture": (["simulate", "new", "--object", "chiar:seed=1"], "chiar|chair"),
    "simulate over a recording": (["simulate", "recordings"], "recordings: exists"),
    "init of no folder": (["init", "none"], "none: no such folder"),
    "init over a file": (["init", "."], "benchmark.yaml: is there already|--force"),
}


@pytest.mark.parametrize("name", BAD_USAGE)
def test_wrong_usage(command: Command, one: Path, name: str) -> None:
    arguments, words = BAD_USAGE[name]
    before = hashes(one)
    if arguments[0] == "score" and len(arguments) > 1:
        (one / "predictions" / "chair").mkdir(parents=True)
    check_line(command(one, *arguments), 2, words)
    after = {name: digest for name, digest in hashes(one).items() if not name.startswith("benchmark/")}
    assert {name: after.get(name) for name in before} == before


BAD_FILES = {
    "unknown key": (ONE + "veiws: {count: 3}\n", "benchmark.yaml:7|veiws|did you mean 'views'?"),
    "unknown key deep": (
        ONE.replace("count: 3", "cuont: 3"),
        "benchmark.yaml:5|views.cuont|did you mean 'count'?",
    ),
    "not YAML": (ONE + "views: {count: [\n", "benchmark.yaml:"),
    "empty": ("", "benchmark.yaml: holds no settings"),
    "two recordings with one id": (
        ONE.replace("fusion:", "  - {id: chair, path: recordings/b, category: chair}\nfusion:"),
        "benchmark.yaml:4|two recordings have the id 'chair'",
    ),
    "an object in two splits": (
        ONE.replace("fusion:", "  - {id: b, object: chair, split: train, path: b, category: chair}\nfusion:"),
        "benchmark.yaml:4|object 'chair' is in two splits: 'test' (chair) and 'train' (b)",
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_wrong_benchmark_file(command: Command, one: Path, name: str) -> None:
    text, words = BAD_FILES[name]
    (one / "benchmark.yaml").write_text(text)
    before = hashes(one)
    check_line(command(one, "build"), 2, words)
    assert hashes(one) == before


def test_init_where_nothing_is(command: Command, tmp_path: Path) -> None:
    run = command(tmp_path, "init", ".")
    assert run.status in (1, 2) and len(run.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_table_is_data_that_cannot_be_used(command: Command, one: Path) -> None:
    before = hashes(one)
    check_line(command(one, "compare", "benchmark.yaml"), 1, "benchmark.yaml: not valid JSON")
    assert hashes(one) == before
