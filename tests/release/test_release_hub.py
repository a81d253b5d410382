"""`publish --to hf://user/name`, against a module that stands in for huggingface_hub."""

import importlib.machinery
import shutil
import sys
import types
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
from file_damage import flip
from raising import raises
from small_benchmark import Run, copied, hashes

from kinectbench.core.errors import ReleaseError, SettingsError, StorageError
from kinectbench.core.storage import write_below
from kinectbench.release.put import hub_name, put_on_hub
from kinectbench.release.release import Release

Command = Callable[..., Run]


class Hub:
    """What huggingface_hub's HfApi does to a data set, in a folder of this machine."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.commits: list[str] = []
        self.error: Exception | None = None

    def create_repo(self, repo_id: str, repo_type: str, exist_ok: bool) -> None:
        if self.error is not None:
            raise self.error
        assert repo_type == "dataset" and exist_ok
        (self.folder / repo_id).mkdir(parents=True, exist_ok=True)
        (self.folder / repo_id / ".gitattributes").touch()

    def list_repo_files(self, repo_id: str, repo_type: str) -> list[str]:
        root = self.folder / repo_id
        return [path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()]

    def hf_hub_download(self, repo_id: str, filename: str, repo_type: str, local_dir: str) -> str:
        return shutil.copy(self.folder / repo_id / filename, local_dir)

    def upload_folder(
        self,
        repo_id: str,
        repo_type: str,
        folder_path: Path,
        commit_message: str,
        delete_patterns: list[str],
        ignore_patterns: list[str],
    ) -> None:
        for name in delete_patterns:
            (self.folder / repo_id / name).unlink()
        names = [
            path.relative_to(folder_path).as_posix() for path in folder_path.rglob("*") if path.is_file()
        ]
        for name in names:
            if not any(fnmatch(name, pattern) for pattern in ignore_patterns):
                write_below(self.folder / repo_id / name, (folder_path / name).read_bytes())
        self.commits.append(commit_message)


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Hub:
    found = Hub(tmp_path / "hub")
    module: Any = types.ModuleType("huggingface_hub")
    module.__spec__ = importlib.machinery.ModuleSpec("huggingface_hub", None)
    module.HfApi = lambda: found
    monkeypatch.setitem(sys.modules, "huggingface_hub", module)
    return found


def on_the_hub(hub: Hub) -> dict[str, str]:
    """The files of the data set by their hashes, without the hub's own."""
    (hub.folder / "lab/chairs/.gitattributes").unlink()
    return hashes(hub.folder / "lab/chairs")


def test_a_release_becomes_a_data_set_in_one_commit(hub: Hub, release: Release) -> None:
    put = put_on_hub(release.folder, "lab/chairs")
    assert (put.put, put.removed) == (len(release.sums) + 1, 0)
    (message,) = hub.commits
    assert release.metadata.name in message and release.metadata.benchmark_sha256 in message
    assert on_the_hub(hub) == hashes(release.folder)


def test_only_the_files_of_a_whole_release_go_to_the_hub(hub: Hub, release: Release, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(release.folder, tmp_path / "copy"))
    for name in (".env", "notes [1].txt"):
        (copy / name).write_text("of nobody else")
    put_on_hub(copy, "lab/chairs")
    assert on_the_hub(hub) == hashes(release.folder)
    flip(copy / release.targets[0].file)
    with raises(ReleaseError, "release.changed", match=release.targets[0].file):
        put_on_hub(copy, "lab/chairs")
    assert len(hub.commits) == 1


def test_another_release_takes_its_place_on_the_hub(hub: Hub, release: Release, analytic: Path) -> None:
    put_on_hub(release.folder, "lab/chairs")
    (hub.folder / "lab/chairs/of-the-earlier.npz").touch()
    with (hub.folder / "lab/chairs/SHA256SUMS").open("a") as sums:
        sums.write(f"{'0' * 64}  of-the-earlier.npz\n")
    assert put_on_hub(analytic / "benchmark", "lab/chairs").removed == 1
    assert on_the_hub(hub) == hashes(analytic / "benchmark")


def test_a_data_set_of_something_else_stays(hub: Hub, release: Release) -> None:
    (hub.folder / "lab/chairs").mkdir(parents=True)
    (hub.folder / "lab/chairs/train.csv").write_text("1")
    with raises(ReleaseError, "release.other-content", match=r"train\.csv"):
        put_on_hub(release.folder, "lab/chairs")
    assert hub.commits == []


@pytest.mark.parametrize("damaged", [False, True])
def test_what_lies_beside_a_release_on_the_hub_stays(hub: Hub, release: Release, damaged: bool) -> None:
    put_on_hub(release.folder, "lab/chairs")
    if damaged:
        (hub.folder / "lab/chairs/SHA256SUMS").write_text("cut o")
    (hub.folder / "lab/chairs/thesis.txt").write_text("1")
    with raises(ReleaseError, "release.other-content", match=r"thesis\.txt"):
        put_on_hub(release.folder, "lab/chairs")
    (hub.folder / "lab/chairs/thesis.txt").unlink()
    assert put_on_hub(release.folder, "lab/chairs").removed == 0


def test_what_the_hub_says_is_a_line(hub: Hub, release: Release) -> None:
    refusal: Any = OSError("403 Forbidden\nmore")
    refusal.response = types.SimpleNamespace(status_code=403)
    busy: Any = OSError("500 Server Error")
    busy.response = types.SimpleNamespace(status_code=500)
    for error, code in (
        (refusal, "storage.not-permitted"),
        (busy, "storage.refused"),
        (ConnectionError("no route"), "storage.no-answer"),
    ):
        hub.error = error
        with raises(StorageError, code, match="hf://lab/chairs") as caught:
            put_on_hub(release.folder, "lab/chairs")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("url", ["hf://", "hf://chairs", "hf://a/b/c", "hf://../x", "hf://a/b?c"])
def test_a_name_that_is_no_data_sets_is_a_line(hub: Hub, url: str) -> None:
    with raises(SettingsError, "settings.bad-url", match="hf://user/name"):
        hub_name(url)


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinectbench.core.extras.find_spec", lambda name: None)
    with raises(SettingsError, "settings.no-package", match=r"kinectbench\[hub\]"):
        hub_name("hf://lab/chairs")


def test_the_command_puts_it_there(hub: Hub, small: Path, tmp_path: Path, command: Command) -> None:
    root = copied(small, tmp_path / "small")
    config = root / "benchmark.yaml"
    config.write_text(f"license: CC0-1.0\nsource: simulated\n{config.read_text()}")
    done = command(root, "publish", "--to", "hf://lab/chairs", "--jobs", "1", "--allow-poor")
    assert done.status == 0, done.err
    assert "put to hf://lab/chairs: " in done.out
    assert on_the_hub(hub) == hashes(root / "benchmark")
