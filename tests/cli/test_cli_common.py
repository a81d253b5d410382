"""The common options, the groups of `kinectbench --help`, and what a shell completes."""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from kinectbench.cli import console, score
from kinectbench.cli.common import Common, takes
from kinectbench.cli.main import PANELS
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.scoring.compare import compare

YAML = """\
name: three
recordings:
  - {id: chair_01, path: a, category: chair}
  - {id: chair_02, path: b, category: chair}
  - {id: table_01, path: c, category: table}
"""


def app_of(*names: str) -> tuple[typer.Typer, list[tuple[Common, str]]]:
    """A command that offers these common options, and what it was called with; it ends with status 3."""
    seen: list[tuple[Common, str]] = []

    @takes(*names)
    def command(common: Common, word: Annotated[str, typer.Option(help="its own")] = "none") -> int:
        """What it does."""
        seen.append((common, word))
        return 3

    app = typer.Typer()
    app.command()(command)
    return app, seen


def test_a_command_gets_its_options_as_one_value() -> None:
    app, seen = app_of("config", "overrides", "jobs", "wait", "as_json")
    given = [
        "--word",
        "x",
        "--config",
        "a/b.yaml",
        "--set",
        "k=1",
        "--set",
        "m=2",
        "-j",
        "4",
        "--no-wait",
        "--json",
    ]
    assert CliRunner().invoke(app, given).exit_code == 3
    common = Common(None, Path("a/b.yaml"), ["k=1", "m=2"], 4, False, False, True)
    assert seen == [(common, "x")]
    assert (common.workers, common.root, common.beside("scores")) == (4, Path("a"), Path("a/scores"))
    assert Common(benchmark=Path("far/benchmark")).beside("scores") == Path("scores")


def test_an_option_that_is_not_offered_is_refused_and_has_its_default() -> None:
    app, seen = app_of("as_json")
    assert CliRunner().invoke(app, ["--jobs", "2"]).exit_code == 2 and seen == []
    assert CliRunner().invoke(app, []).exit_code == 3 and seen == [(Common(), "none")]
    shown = CliRunner().invoke(app, ["--help"]).output
    assert "--json" in shown and "--word" in shown and "What it does." in shown and "--jobs" not in shown


def test_an_unknown_common_option_is_a_mistake_of_ours() -> None:
    with pytest.raises(AssertionError, match="cofig"):
        takes("cofig")


def test_settings_are_read_once(tmp_path: Path) -> None:
    (tmp_path / "benchmark.yaml").write_text(YAML)
    common = Common(config=tmp_path / "benchmark.yaml")
    assert [recording.id for recording in common.settings.recordings] == ["chair_01", "chair_02", "table_01"]
    (tmp_path / "benchmark.yaml").unlink()
    assert len(common.settings.recordings) == 3


# The command by its name, as the file in .venv/bin calls it.
CALL = 'import sys; sys.argv[0] = "kinectbench"; import kinectbench.cli.main as m; m.main()'


def kinectbench(folder: Path, *arguments: str, **variables: str) -> str:
    """What the command prints where it is called by its name, as from a shell."""
    result = subprocess.run(
        [sys.executable, "-c", CALL, *arguments],
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stderr == ""
    return result.stdout


def test_help_groups_the_commands_in_the_order_of_use(tmp_path: Path) -> None:
    lines = [line.strip("│╭─╮ ") for line in kinectbench(tmp_path, "--help").splitlines()]
    heads = [line.split()[0] if line not in PANELS else line for line in lines if line]
    expected = [head for panel, commands in PANELS.items() for head in (panel, *commands)]
    assert [head for head in heads if head in expected] == expected


def test_the_page_lists_the_same_groups() -> None:
    lines = (Path(__file__).parents[2] / "docs/commands.md").read_text().splitlines()
    for panel, commands in PANELS.items():
        start = lines.index(f"| {panel.lower()} | |")
        cells = [line.split("|")[1] for line in lines[start + 2 : lines.index("", start)]]
        named = [name for cell in cells for name in re.findall(r"`([a-z-]+)`", cell)]
        assert named == list(commands), panel


def completed(folder: Path, line: str) -> list[str]:
    """What bash offers at the end of a line."""
    position = len(line.split(" ")) - 1
    variables = {
        "_KINECTBENCH_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(position),
    }
    return kinectbench(folder, **variables).split()


def test_a_shell_completes_commands_options_recordings_and_baselines(tmp_path: Path) -> None:
    (tmp_path / "benchmark.yaml").write_text(YAML)
    assert completed(tmp_path, "kinectbench bu") == ["build"]
    assert completed(tmp_path, "kinectbench publish --arch") == ["--archives", "--archives-to"]
    assert completed(tmp_path, "kinectbench track ch") == ["chair_01", "chair_02"]
    assert completed(tmp_path, "kinectbench report ") == ["chair_01", "chair_02", "table_01"]
    assert completed(tmp_path, "kinectbench baseline m") == ["mirror", "mean-shape"]


def test_completion_says_nothing_where_settings_cannot_be_read(tmp_path: Path) -> None:
    assert completed(tmp_path, "kinectbench build ch") == []
    (tmp_path / "benchmark.yaml").write_text("name: [")
    assert completed(tmp_path, "kinectbench build ch") == []
    (tmp_path / "other.yaml").write_text(YAML)
    assert completed(tmp_path, "kinectbench build --config other.yaml ta") == ["table_01"]


def test_completion_is_shown_for_bash(tmp_path: Path) -> None:
    """The script that `--install-completion` installs, run by bash itself."""
    variables = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    script = kinectbench(tmp_path, "--show-completion", "bash", **variables)
    assert "_KINECTBENCH_COMPLETE=complete_bash" in script
    command = tmp_path / "kinectbench"
    command.write_text(f"#!/bin/sh\nexec {sys.executable} -c '{CALL}' \"$@\"\n")
    command.chmod(0o755)
    asked = (
        f"{script}\nCOMP_WORDS=(kinectbench ver); COMP_CWORD=1; _kinectbench_completion {command}\n"
        'echo "${COMPREPLY[@]}"'
    )
    found = subprocess.run(["bash", "-c", asked], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (found.stdout, found.stderr) == ("verify\n", "")


def test_defaults_that_the_command_line_repeats_are_those_of_scoring() -> None:
    """It spells them out: their modules are imported late, for a fast --help."""
    shown, own = (inspect.signature(function).parameters for function in (score.compare_command, compare))
    assert all(shown[name].default == own[name].default for name in ("metric", "protocol"))
    assert inspect.signature(score.score_command).parameters["upsampling"].default == HALF_PIXEL


def test_a_message_that_quotes_without_end_is_cut_in_its_middle() -> None:
    line = console.one_line(f"a.npz: {'x' * 10_000}; write it again")
    assert len(line) <= console.LONGEST and line.startswith("a.npz: xx") and line.endswith("; write it again")
