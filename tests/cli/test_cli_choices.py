"""A choice that leaves nothing to do is one line and a failing status, and nothing is written."""

from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run
from synthetic_release import publish_synthetic

WRONG = {
    "baseline": (["baseline", "hull"], "no pair of the test or validation split; its pairs are of train"),
    "report": (["report", "chair_01"], "report chair_01: with --benchmark the page is of the whole release"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_choice_of_nothing_is_told(command: Callable[..., Run], tmp_path: Path, name: str) -> None:
    words, says = WRONG[name]
    folder = publish_synthetic(tmp_path / "b", (("chair_01", "chair", "chair_a", "train", 1),)).folder
    (tmp_path / "here").mkdir()
    result = command(tmp_path / "here", *words, "--benchmark", str(folder))
    assert (result.status, result.err.count("\n")) == (2, 1) and says in result.err, result
    assert list((tmp_path / "here").iterdir()) == []
