"""What the README says to type runs as it stands, in an empty folder."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run

README = Path(__file__).resolve().parents[2] / "README.md"
SMALL = ("--set", "sensor.width=160", "--set", "sensor.height=120")


def commands_of(section: str) -> list[list[str]]:
    """The commands of a section's first block, without `kinectbench`."""
    text = README.read_text(encoding="utf-8").partition(f"## {section}\n")[2]
    block = re.findall(r"```\n(.*?)```", text, re.DOTALL)[0]
    lines = [shlex.split(line, comments=True) for line in block.splitlines()]
    assert lines and all(words[0] == "kinectbench" for words in lines)
    return [words[1:] for words in lines]


def test_the_first_commands_need_nothing_but_the_package(command: Callable[..., Run], tmp_path: Path) -> None:
    """A smaller recording than the README's; `build` then knows it by its benchmark.yaml."""
    simulated, inspected, written, built, *_ = commands_of("Make a benchmark")
    assert (simulated[0], built) == ("simulate", ["build"])
    for words in ([*simulated, *SMALL], inspected, written):
        run = command(tmp_path, *words)
        assert run.status == 0, run
    assert Path(simulated[1]).name in (tmp_path / "benchmark.yaml").read_text()


@pytest.mark.slow
def test_a_benchmark_is_made_and_published(command: Callable[..., Run], tmp_path: Path) -> None:
    for words in commands_of("Make a benchmark"):
        run = command(tmp_path, *words)
        assert run.status == 0, run
    assert (tmp_path / "benchmark/benchmark.json").is_file()
