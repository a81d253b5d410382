"""Of several warnings of a recording the one to see to first is shown; the rest on demand."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run, copied
from typed import model_of

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.engine.summary import _to_do_first

pytestmark = pytest.mark.xdist_group("commands")
Command = Callable[..., Run]


def test_the_first_of_several_warnings_and_how_many_more(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    changed = ("--set", "views.seed=3", "--jobs", "1")
    said = json.loads(command(root, "build", "table", *changed, "--json").out)[0]
    assert len(said["warnings"]) > 2 and said["first"] in said["warnings"]
    short = command(root, "build", "table", *changed, "--force").err.splitlines()
    assert short[0] == f"table: do this first: {said['first']}"
    more = len(said["warnings"]) - 1
    line = "kinectbench build table --set views.seed=3 -v"
    assert short[1].startswith(f"table: note: {more} more warnings: shown by `{line}`")
    # What is to be done stays to be done: a run that finds all up to date says so, too.
    assert command(root, "build", "table", *changed).err.splitlines()[:2] == short[:2]
    whole = command(root, "build", "table", *changed, "--force", "-v").err.splitlines()
    assert [f"table: warning: {line}" for line in said["warnings"]] == whole[: more + 1]


def test_a_build_says_what_a_release_leaves_out(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b")
    assert "left out of a release" not in command(root, "build", "--jobs", "1").out
    strict = ("build", "table", "--jobs", "1", "--set", "publish.gate.min_estimated_iou=1")
    shown = next(line for line in command(root, *strict).out.splitlines() if "left out of" in line)
    reason = json.loads(command(root, *strict, "--json").out)[0]["left_out_of_release"]
    assert shown == f"table: would be left out of a release: {reason}"
    assert "less than publish.gate.min_estimated_iou: 1; mend it, or accept it" in reason


@pytest.mark.parametrize("words", [("segment",), ("segment", "--suggest"), ("track",), ("ingest",)])
def test_the_note_names_a_command_that_shows_all(
    command: Command, small: Path, tmp_path: Path, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    from kinectbench.engine import summary

    def figures(*_: object) -> summary.RecordingSummary:
        return model_of(
            summary.RecordingSummary,
            recording="table",
            warnings=("one", "two"),
            first="one",
            error=None,
            made=(),
        )

    root = copied(small, tmp_path / "b")
    (root / "benchmark.yaml").rename(root / "other one.yaml")
    monkeypatch.setattr(summary, "summary", figures)
    monkeypatch.setattr("kinectbench.cli.console.summary_table", lambda *_: "")
    monkeypatch.setattr("kinectbench.cli.console.object_lines", lambda *_, **__: None)
    given = ("table", "--config", "other one.yaml", "--force", "--jobs", "1")
    err = command(root, words[0], *given, *words[1:]).err
    assert "table: note: 1 more warning: shown by `kinectbench " in err
    line = shlex.split(err.split("`kinectbench ")[1].split("`")[0])
    assert line == [*words, "table", "--config", "other one.yaml", "-v"]
    shown = command(root, *line).err
    assert "table: warning: one\ntable: warning: two" in shown and "No such option" not in shown


def test_what_makes_the_rest_wrong_comes_first() -> None:
    """Lengths before poses, poses before the floor, that before what nobody saw."""
    sequence = model_of(CameraFile, doubts=("lengths",), warnings=("gaps",))
    health = model_of(TrajectoryHealth, grade="not good", verdict="not good: 12 mm", warnings=())
    quality = model_of(
        QualityFile,
        doubts=("another floor",),
        frontiers=(),
        warnings=("another floor", "the trajectory is not good: 12 mm"),
    )
    assert _to_do_first(sequence, health, quality, None) == "lengths"
    plain = model_of(CameraFile, doubts=(), warnings=("gaps",))
    assert _to_do_first(plain, health, quality, None) == "the trajectory is not good: 12 mm"
    good = model_of(TrajectoryHealth, grade="good", verdict="good", warnings=())
    assert _to_do_first(plain, good, quality, None) == "another floor"
    nothing = model_of(QualityFile, doubts=(), frontiers=(), warnings=())
    assert _to_do_first(plain, good, nothing, None) == "gaps"
    assert _to_do_first(None, None, None, None) is None
