"""Wrong arguments are told before a benchmark is built for them."""

from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run, copied

pytestmark = pytest.mark.xdist_group("commands")

WRONG = {
    "score no folder": (["score", "nowhere"], 1, "nowhere: there is no such folder"),
    "check no folder": (["check", "nowhere"], 1, "nowhere: there is no such folder"),
    "protocol": (["score", "mine", "--protocol", "papre"], 2, "no protocol 'papre'"),
    "protocol of baselines": (["score", "--protocol", "papre"], 2, "no protocol 'papre'"),
    "thresholds saved of baselines": (
        ["score", "--save-thresholds", "t.json"],
        2,
        "--save-thresholds applies to predictions",
    ),
    "missing": (["score", "mine", "--missing", "zero"], 2, "--missing zero"),
    "upsampling": (["score", "mine", "--upsampling", "corners"], 2, "no upsampling 'corners'"),
    "thresholds": (["score", "mine", "--thresholds", "benchmark.yaml"], 2, "benchmark.yaml: cannot be read"),
    "scores": (["report", "--scores", "nowhere"], 2, "nowhere: no such file or folder"),
    "scores of no kind": (["report", "--scores", "benchmark.yaml"], 1, "benchmark.yaml: not valid JSON"),
}
RECORDINGS = {"a": "chair", "b": "unknown", "c": "unknown"}


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


@pytest.mark.parametrize("name", ["build", "publish"])
def test_a_category_that_nobody_stated_is_told(
    command: Callable[..., Run], tmp_path: Path, name: str
) -> None:
    lines = [f"  - {{id: {key}, path: none, category: {what}}}" for key, what in RECORDINGS.items()]
    (tmp_path / "benchmark.yaml").write_text("\n".join(["name: b", "recordings:", *lines]))
    for ids, told in (((), "(b, c)"), (("a",), None), (("b", "c"), "(every recording)")):
        result = command(tmp_path, name, *ids, "--jobs", "1")
        warnings = [line for line in result.err.splitlines() if "category" in line]
        assert result.status == 1 and len(warnings) == (told is not None), result
        assert told is None or (warnings[0].startswith("warning: no category") and told in warnings[0])
