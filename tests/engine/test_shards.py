"""Parts of a benchmark: each recording is in exactly one, and all parts together are the whole."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from raising import raises
from small_benchmark import Run, copied, hashes

from kinectbench.core.artefacts.counted import JOURNALS
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.errors import SettingsError
from kinectbench.engine.shards import Shard, parse_shard
from kinectbench.release.release import Release
from kinectbench.scoring import pair_result
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.pair_result import LEAST_CHECKED
from kinectbench.scoring.rounds import plan
from kinectbench.scoring.score import count_methods, score_methods

Command = Callable[..., Run]
NAMES = [f"chair_{number:05}" for number in range(2000)]
pytestmark = pytest.mark.xdist_group("resume")


@pytest.mark.parametrize("of", [1, 2, 7, 40])
def test_each_recording_is_in_exactly_one_part(of: int) -> None:
    parts = [[name for name in NAMES if Shard(number + 1, of).holds(name)] for number in range(of)]
    assert sorted(name for part in parts for name in part) == NAMES
    # Of 2000 drawn evenly: within six standard deviations.
    mean = len(NAMES) / of
    assert all(abs(len(part) - mean) <= 6 * mean**0.5 for part in parts)


def test_the_part_of_a_recording_is_fixed() -> None:
    """Runs of other versions and machines must agree: a part is never drawn by Python's own hash."""
    found = [
        next(n for n in range(1, 41) if Shard(n, 40).holds(name)) for name in ("chair_01", "b", "stühle")
    ]
    assert found == [25, 27, 35]


@pytest.mark.parametrize(
    "text", ["", "3", "0/4", "5/4", "1/0", "-1/4", "1/4/2", "1.0/4", "x/4", "1 / 4", "1/9999999"]
)
def test_a_part_that_does_not_exist_is_refused(text: str) -> None:
    with raises(SettingsError, "settings.wrong-value", match="--shard"):
        parse_shard(text)


def test_parts_build_what_one_run_builds(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b", "benchmark.yaml", "recordings")
    built = [command(root, "ingest", "--shard", f"{number}/3", "--jobs", "1") for number in (1, 2, 3)]
    assert [run.status for run in built] == [0, 0, 0]
    assert sum("no recording belongs to part" in run.err for run in built) >= 1
    assert {path.parent.name for path in root.glob("build/*/sequence")} == {"chair", "table"}
    assert hashes(root / "build" / "chair" / "sequence") == hashes(small / "build" / "chair" / "sequence")


def test_parts_of_scores_make_the_same_table(release: Release, tmp_path: Path) -> None:
    write_baselines(release, tmp_path / "predictions", ["partial", "mirror"])
    whole = score_methods(release, tmp_path / "predictions", tmp_path / "whole")
    for number in (1, 2, 3):
        failed = count_methods(release, tmp_path / "predictions", tmp_path / "parts", Shard(number, 3))
        assert failed == 0
    assert len(list((tmp_path / "parts").glob(f"*/{JOURNALS}"))) == 6
    tables = score_methods(release, tmp_path / "predictions", tmp_path / "parts")
    assert [table.text() for table in tables] == [table.text() for table in whole]
    assert list((tmp_path / "parts").glob(f"*/{JOURNALS}")) == []


def test_a_part_counts_the_validation_pairs_that_its_surfaces_need(release: Release, tmp_path: Path) -> None:
    write_baselines(release, tmp_path / "predictions", ["partial"])
    asked = plan(release, tmp_path / "predictions" / "partial", None, "error")
    for surface in (True, False):
        parts = [asked.part(Shard(number, 5), surface=surface) for number in range(1, 6)]
        for number, part in enumerate(parts, 1):
            tested = {target.category for target in part if target.split == "test"}
            others = {target for target in part if not Shard(number, 5).holds(target.recording)}
            assert {target.category for target in others} <= (tested if surface else set())
            assert all(target.split == "validation" for target in others)
            if surface:  # a threshold needs all of them
                wanted = [t for t in asked.files if t.split == "validation" and t.category in tested]
                assert set(wanted) <= set(part)
        once = [target for part in parts for target in part if not surface or target.split == "test"]
        assert sorted(once) == sorted(t for t in asked.files if not surface or t.split == "test")


def test_a_category_without_validation_needs_that_of_all_others(release: Release, tmp_path: Path) -> None:
    """Their pooled threshold; the method's own needs none."""
    for target in release.targets:
        (tmp_path / target.recording).mkdir(exist_ok=True)
        (tmp_path / f"{target.name}.npz").touch()
    asked = plan(release, tmp_path, None, "error")
    of_chairs = {t: f for t, f in asked.files.items() if (t.split, t.category) != ("validation", "table")}
    searched = {target for target in of_chairs if target.split == "validation"}
    assert searched
    for method in (None, MethodFile(name="net", threshold=0.3)):
        few = replace(asked, files=of_chairs, found=replace(asked.found, method=method))
        for number in range(1, 6):
            part = few.part(Shard(number, 5), surface=True)
            if {target.category for target in part if target.split == "test"} == {"table"}:
                assert searched.issubset(part) == (method is None)


def test_without_surfaces_the_table_counts_nothing_again_and_failures_are_told_once(
    release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_baselines(release, tmp_path / "predictions", ["partial"])
    validation = next(target for target in release.targets if target.split == "validation")
    (broken,) = (tmp_path / "predictions" / "partial").glob(f"{validation.name}.*")
    broken.write_bytes(b"no prediction")
    asked = release, tmp_path / "predictions", tmp_path / "out"
    counted: list[object] = []
    count = pair_result.count

    def noted(*given: Any) -> Any:
        counted.append(given)
        return count(*given)

    for surface in (False, True):
        failed = [count_methods(*asked, Shard(number, 3), surface=surface) for number in (1, 2, 3)]
        assert sum(failed) == 1
        with monkeypatch.context() as patched:
            patched.setattr(pair_result, "count", noted)
            score_methods(*asked, surface=surface)
        # But for those that are drawn to be compared with what was kept.
        assert len(counted) <= LEAST_CHECKED
        counted.clear()
