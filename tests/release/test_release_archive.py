"""Archives: the same bytes twice, read by unzip and sha256sum, refused where the data must stay at home."""

import json
import os
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from file_damage import flip
from raising import raises
from small_benchmark import Run, hashes
from synthetic_release import synthetic_settings, write_build

from kinectbench.core.artefacts.benchmark import PublishOptions
from kinectbench.core.errors import ReleaseError
from kinectbench.release.publish.archive import write_archive
from kinectbench.release.publish.publish import publish
from kinectbench.release.release import Release

Command = Callable[..., Run]


def test_twice_the_same_bytes(release: Release, tmp_path: Path) -> None:
    first = write_archive(release.folder, tmp_path / "one")
    copy = Path(shutil.copytree(release.folder, tmp_path / "copy"))
    for number, path in enumerate(sorted(copy.rglob("*"), reverse=True)):
        path.chmod(0o700 if path.is_dir() else 0o600)
        os.utime(path, (number, number))
    second = write_archive(copy, tmp_path / "two")
    assert first.name == second.name == f"synthetic-{release.benchmark_sha256[:8]}.zip"
    assert first.read_bytes() == second.read_bytes()
    assert [path.name for path in (tmp_path / "one").iterdir() if path.name.startswith(".")] == []
    subprocess.run(["sha256sum", "-c", "--quiet", f"{first.name}.sha256"], cwd=first.parent, check=True)


def test_each_checked_and_packed_file_is_progress(release: Release, tmp_path: Path) -> None:
    steps = list[tuple[int, int]]()
    write_archive(release.folder, tmp_path, lambda done, total: steps.append((done, total)))
    files = 2 * len(release.sums)
    assert steps[0] == (1, files) and steps[-1] == (files, files)
    assert [done for done, _ in steps] == sorted(done for done, _ in steps) and len(steps) == files + 1


def test_content(release: Release, tmp_path: Path) -> None:
    path = write_archive(release.folder, tmp_path)
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        names = archive.namelist()
        assert names == sorted(names)
        for entry in archive.infolist():
            stored = entry.filename.endswith((".npz", ".png", ".jpg"))
            assert entry.compress_type == (zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED)
            assert (entry.date_time, entry.external_attr >> 16) == ((1980, 1, 1, 0, 0, 0), 0o100644)
        archive.extractall(tmp_path / "out")
    assert hashes(tmp_path / "out" / path.stem) == hashes(release.folder)


def test_only_the_files_of_a_whole_release_are_packed(release: Release, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(release.folder, tmp_path / "copy"))
    (copy / ".env").write_text("of nobody else")
    inside, beside = write_archive(copy, copy), write_archive(release.folder, tmp_path)
    assert inside.read_bytes() == beside.read_bytes()
    flip(copy / release.targets[0].file)
    with raises(ReleaseError, "release.changed", match=release.targets[0].file):
        write_archive(copy, tmp_path / "out")
    (copy / "SHA256SUMS").unlink()
    with raises(ReleaseError, "release.missing-file", match="SHA256SUMS"):
        write_archive(copy, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_names_of_versions_and_parts(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    settings = synthetic_settings(publish={"citation": {"version": "1.0.0"}})
    options = PublishOptions(hold_back=("test",), thresholds=None)
    summary = publish(settings, tmp_path / "build", tmp_path / "b", ["chair_02"], options)
    assert summary.private is not None
    names = [write_archive(part, tmp_path).name for part in (summary.folder, summary.private)]
    assert names == ["synthetic-1.0.0.zip", "synthetic-1.0.0-private.zip"]


def test_what_must_stay_at_home(tmp_path: Path) -> None:
    write_build(tmp_path / "build")
    settings = synthetic_settings(license="unspecified", source="unspecified")
    publish(settings, tmp_path / "build", tmp_path / "b", ["chair_02"])
    with raises(ReleaseError, "release.no-archive"):
        write_archive(tmp_path / "b", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.xdist_group("commands")
def test_commands(small: Path, command: Command, tmp_path: Path) -> None:
    root = Path(shutil.copytree(small, tmp_path / "b"))
    refused = command(root, "publish", "--archives", "--jobs", "1")
    assert (
        refused.status == 1 and "no licence is stated" in refused.err and len(refused.err.splitlines()) == 1
    )
    assert not (root / "benchmark").exists()
    stated = ("--set", "license=CC0-1.0", "--set", "source=simulated", "--jobs", "1", "--json")
    (root / "t.json").write_text('{"thresholds": {"chair": 0.4}, "objects": ["table"], "method": "m"}')
    first = command(root, "publish", "--archives", "--thresholds", "t.json", *stated)
    assert first.status == 0, first
    result = json.loads(first.out)
    (archive,) = result["archives"]
    before = (root / archive).read_bytes()
    assert (
        command(root, "publish", "--force", "--archives-to", "x", "--thresholds", "t.json", *stated).status
        == 0
    )
    assert (root / "x" / Path(archive).name).read_bytes() == before
    assert json.loads((root / "benchmark" / "thresholds.json").read_text())["thresholds"] == {"chair": 0.4}
    assert (root / "benchmark" / "schemas" / "thresholds.schema.json").is_file()
    assert "not stated in datasheet.md: motivation" in first.err
