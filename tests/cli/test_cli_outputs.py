"""Where commands may write: never into the release that they read, and nowhere with a traceback."""

import shutil
from pathlib import Path

import pytest
from command_lines import Command, check_line
from small_benchmark import hashes

from kinectbench.cli.common import refuse_in_release
from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.core.storage import append_plain
from kinectbench.release.release import Release

pytestmark = pytest.mark.xdist_group("commands")

SCORE = ["score", "--benchmark", "release"]
INTO: dict[str, list[str]] = {
    "scores": [*SCORE, "--out", "release"],
    "scores among pairs": [*SCORE, "--out", "release/pairs"],
    "scores through a link": [*SCORE, "--out", "link/scores"],
    "thresholds": [*SCORE, "predictions", "--save-thresholds", "release/benchmark.json"],
    "a page": ["report", "--benchmark", "release", "--out", "release/targets.csv"],
    "baselines": ["baseline", "partial", "--benchmark", "release", "--out", "release"],
    "a simulation": ["simulate", "release/recording"],
    "an export": ["export", "release/bop", "--layout", "bop", "--benchmark", "release"],
    "predictions of a network": ["predict", "recae-small", "release", "--out", "release"],
    "a release": ["synthesize", "release/synthetic"],
}
DEFAULTS: dict[str, list[str]] = {
    "scores": ["score", "--benchmark", "."],
    "predictions of a network": ["predict", "recae-small", "."],
    "a release of its folder": ["fetch", "."],
    "a release of another": ["fetch", "../other/benchmark"],
}


@pytest.mark.parametrize("name", INTO)
def test_nothing_is_written_into_a_release(
    command: Command, release: Release, tmp_path: Path, name: str
) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "release"))
    (tmp_path / "link").symlink_to("release")
    before = hashes(folder)
    check_line(
        command(tmp_path, *INTO[name]), 2, "in a release, release/, which must stay as it was published"
    )
    assert hashes(folder) == before


@pytest.mark.parametrize("name", DEFAULTS)
def test_nothing_is_written_into_a_release_by_default(
    command: Command, release: Release, tmp_path: Path, name: str
) -> None:
    if "network" in name:
        pytest.importorskip("torch")
    folder = Path(shutil.copytree(release.folder, tmp_path / "release"))
    shutil.copytree(release.folder, tmp_path / "other" / "benchmark")
    before = hashes(folder)
    check_line(command(folder, *DEFAULTS[name]), 2, "in a release, release/, which must stay")
    assert hashes(folder) == before


def test_a_command_that_makes_a_release_may_replace_one(release: Release, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(release.folder, tmp_path / "release"))
    refuse_in_release(folder, makes_release=True)
    with pytest.raises(SettingsError, match="in a release, release/"):
        refuse_in_release(folder)


def test_a_name_that_is_too_long_is_in_no_release(tmp_path: Path) -> None:
    refuse_in_release(tmp_path / ("a" * 300) / "scores")


@pytest.mark.parametrize("place", ["file", "file/below", "nowhere"])
def test_a_path_that_cannot_be_followed_is_one_line(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("kept", encoding="utf-8")
    (tmp_path / "nowhere").symlink_to(tmp_path / "missing/below")
    with pytest.raises(StorageError, match="the way to it holds a file, a broken link or nothing"):
        append_plain(tmp_path / place / "kept.jsonl", "line")
    assert (tmp_path / "file").read_text(encoding="utf-8") == "kept"
