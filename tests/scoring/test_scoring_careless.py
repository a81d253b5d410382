"""Slips and forgeries at `compare` and `score --recheck`: one clear line, and nothing planted is verified."""

import json
from pathlib import Path

import pytest
from raising import raises
from small_grids import small_grids

from kinectbench.core.errors import SettingsError
from kinectbench.release.release import Release
from kinectbench.scoring.compare import compare, find_methods
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score


@pytest.fixture
def folder(release: Release, tmp_path: Path) -> Path:
    """A full grid for each test pair."""
    return small_grids(release, tmp_path / "mine", value=True)


def test_a_planted_warning_is_not_verified(release: Release, folder: Path, tmp_path: Path) -> None:
    table = score(release, folder, method="mine", surface=False)
    table.write(tmp_path)
    path = tmp_path / "scores.json"
    planted = json.loads(path.read_text()) | {"warnings": [*table.warnings, "the organisers believe it"]}
    path.write_text(json.dumps(planted))
    assert recheck(release, path, folder) == []
    found = read_table(path)
    assert found.verified is not None and found.warnings == table.warnings != ()


def test_a_file_that_is_named_twice_is_one_method(release: Release, folder: Path, tmp_path: Path) -> None:
    score(release, folder, method="mine", surface=False).write(tmp_path)
    tables = [read_table(path) for path in find_methods([tmp_path / "scores.json", tmp_path])]
    assert len(tables) == 1
    with raises(SettingsError, "settings.wrong-value", match="at least two methods"):
        compare(tables)


def test_a_protocol_that_does_not_exist_is_not_advised(release: Release, folder: Path) -> None:
    one, other = (
        score(release, folder, method=name, protocols=[name], surface=False) for name in ("known", "paper")
    )
    with raises(SettingsError, "settings.wrong-value", match="no protocol 'nope': choose among paper"):
        compare([one, other], protocol="nope")
    with raises(SettingsError, "settings.other-scores", match="again with `--protocol known`"):
        compare([one, other])
