"""A downloaded release and a folder of predictions are all that scoring needs."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run, hashes

from kinectbench.release.release import Release

pytestmark = pytest.mark.xdist_group("commands")

Command = Callable[..., Run]


@pytest.fixture
def alone(release: Release, tmp_path: Path) -> Path:
    """An empty folder but for a copy of a release."""
    shutil.copytree(release.folder, tmp_path / "alone" / "release")
    return tmp_path / "alone"


def test_baseline_check_and_score(command: Command, alone: Path) -> None:
    before = hashes(alone / "release")
    steps = (
        ["verify", "release"],
        ["baseline", "partial", "empty"],
        ["check", "predictions"],
        ["score", "predictions"],
    )
    for step in steps:
        benchmark = [] if step[0] == "verify" else ["--benchmark", "release", "--jobs", "1"]
        result = command(alone, *step, *benchmark)
        assert result.status == 0, result
        assert "Traceback" not in result.err
    assert sorted(path.name for path in alone.iterdir()) == ["predictions", "release", "scores"]
    page = (alone / "scores" / "index.html").read_text()
    assert "partial" in page and "empty" in page
    assert hashes(alone / "release") == before, "scoring changed the release"


def test_the_number_of_processes_changes_nothing(command: Command, alone: Path) -> None:
    for jobs in ("1", "2"):
        for step in (["baseline", "partial", "--out", jobs], ["score", jobs, "--out", f"scores{jobs}"]):
            more = ("--no-baselines",) if step[0] == "score" else ()
            assert command(alone, *step, *more, "--benchmark", "release", "--jobs", jobs).status == 0
    assert hashes(alone / "1") == hashes(alone / "2")
    one, two = (json.loads((alone / f"scores{j}" / "scores.json").read_text()) for j in "12")
    assert one == two


def test_a_damaged_pair_is_not_scored(command: Command, alone: Path) -> None:
    assert command(alone, "baseline", "empty", "--benchmark", "release", "--jobs", "1").status == 0
    pair = sorted((alone / "release" / "pairs").rglob("*.npz"))[0]
    pair.write_bytes(pair.read_bytes()[:-1])
    result = command(alone, "score", "predictions", "--benchmark", "release", "--jobs", "1")
    assert result.status == 1
    assert len(result.err.splitlines()) == 1 and pair.name in result.err


def test_scores_of_another_release_in_the_folder(command: Command, alone: Path) -> None:
    assert command(alone, "baseline", "empty", "--benchmark", "release", "--jobs", "1").status == 0
    other = alone / "scores" / "other"
    other.mkdir(parents=True)
    (other / "scores.json").write_text('{"method": "stranger", "benchmark_sha256": "%s"}' % ("0" * 64))
    score = ("score", "predictions/empty", "--benchmark", "release", "--jobs", "1", "--no-baselines")
    result = command(alone, *score)
    assert result.status == 0 and "other/scores.json" in result.err
    assert "stranger" not in (alone / "scores" / "index.html").read_text()
