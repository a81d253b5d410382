"""benchmarks/run.py: its list, how it runs a benchmark, and how it compares figures with stored ones."""

import json
from pathlib import Path

import pytest
import run as runner

DOCUMENT = Path(runner.ROOT).parent / "docs" / "evidence" / "benchmarks.md"
SCRIPT = '''"""A benchmark of two figures."""

from figures import arguments, at_least, run, stated

if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("--speed", type=float, default=5.0)
    options = parser.parse_args()
    run(options, lambda: [at_least("times as fast", options.speed, 2), stated("IoU", 0.9)])
'''
STORED = {"times as fast": {"value": 5.0, "tolerance": 1.0}, "IoU": {"value": 0.9, "tolerance": 0.001}}


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A room of one benchmark, with baselines."""
    (tmp_path / "small.py").write_text(SCRIPT, encoding="utf-8")
    path = tmp_path / "baselines.json"
    path.write_text(json.dumps({"small": {"options": [], "figures": STORED}}), encoding="utf-8")
    monkeypatch.setattr(runner, "ROOMS", {"speed": tmp_path})
    monkeypatch.setattr(runner, "BASELINES", path)
    return path


def figure(value: float, bar: str | None = None) -> dict[str, object]:
    return {"name": "f", "value": value, "bar": bar}


@pytest.mark.parametrize(
    ("value", "bar", "differs"),
    [(5.5, None, False), (6.5, None, True), (3.5, None, True), (9.0, ">= 2", False), (3.5, ">= 2", True),
     (1.0, "<= 9", False), (6.5, "<= 9", True)],
)  # fmt: skip
def test_a_figure_differs_by_more_than_its_tolerance_and_is_not_better(
    value: float, bar: str | None, differs: bool
) -> None:
    lines = runner.compared([figure(value, bar)], {"f": {"value": 5.0, "tolerance": 1.0}})
    assert lines == ([f"f: {value:g}; stored is 5 ± 1"] if differs else [])


def test_a_stored_figure_that_is_missing_is_named() -> None:
    lines = runner.compared([], {"f": {"value": 5.0, "tolerance": 1.0}})
    assert lines == ["f: not measured any more; stored is 5"]


def test_a_benchmark_is_run_as_stored_and_compared(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert runner.main(["--stored"]) == 0
    small.write_text(small.read_text("utf-8").replace("0.9", "0.8"), encoding="utf-8")
    assert runner.main(["small"]) == 1
    assert capsys.readouterr().err == "small: IoU: 0.9; stored is 0.8 ± 0.001\n"
    assert runner.main(["--store", "small"]) == 0 and runner.main(["small"]) == 0


def test_a_missed_bar_is_a_status_and_own_options_are_not_compared(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert runner.main(["small", "--speed", "3.5"]) == 0
    assert runner.main(["small", "--speed", "1"]) == 1
    assert capsys.readouterr().err == "small: ended with status 1\n"


@pytest.mark.parametrize("words", [["nothing"], ["known", "kills", "cabinett"], ["--store", "kills"]])
def test_a_wrong_name_is_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        runner.main(words)
    assert len([line for line in capsys.readouterr().err.splitlines() if "error" in line]) == 1


def test_every_benchmark_is_listed_and_documented(capsys: pytest.CaptureFixture[str]) -> None:
    """A reader finds each in the list and in docs/evidence/benchmarks.md; there are few enough to read."""
    assert runner.main([]) == 0
    listed, text = capsys.readouterr().out, DOCUMENT.read_text(encoding="utf-8")
    names = runner.scripts()
    assert 10 < len(names) <= 20
    assert [name for name in names if f"  {name} " not in listed or f"| `{name}" not in text] == []


def test_baselines_are_of_benchmarks_and_have_tolerances() -> None:
    stored = runner.baselines()
    assert len(stored) >= 3 and set(stored) <= set(runner.scripts())
    for one in stored.values():
        assert set(one) == {"options", "figures"} and one["figures"]
        assert all(set(row) == {"value", "tolerance"} for row in one["figures"].values())
