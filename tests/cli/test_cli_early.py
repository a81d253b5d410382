"""Wrong arguments are told before a benchmark is built for them."""

from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run, copied

pytestmark = pytest.mark.xdist_group("commands")

WRONG = {
    "score no folder": (["score", "nowhere"], 1, "nowhere: no such folder of predictions"),
    "check no folder": (["check", "nowhere"], 1, "nowhere: no such folder of predictions"),
    "protocol": (["score", "mine", "--protocol", "papre"], 2, "no protocol 'papre'"),
    "missing": (["score", "mine", "--missing", "zero"], 2, "--missing zero"),
    "upsampling": (["score", "mine", "--upsampling", "corners"], 2, "no upsampling 'corners'"),
    "thresholds": (["score", "mine", "--thresholds", "benchmark.yaml"], 2, "benchmark.yaml: cannot be read"),
    "scores": (["report", "--scores", "nowhere"], 2, "nowhere: "),
    "scores of no kind": (["report", "--scores", "benchmark.yaml"], 2, "benchmark.yaml: not valid JSON"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_arguments_are_told_before_anything_is_built(
    command: Callable[..., Run], small: Path, tmp_path: Path, name: str
) -> None:
    arguments, status, words = WRONG[name]
    root = copied(small, tmp_path / "b", "benchmark.yaml", "recordings")
    (root / "mine").mkdir()
    result = command(root, *arguments)
    assert (result.status, result.err.count("\n")) == (status, 1) and words in result.err, result
    assert not (root / "build").exists()
