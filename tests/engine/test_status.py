"""`build --status`: what is done, what failed and what is missing, without building anything."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run, copied, hashes
from stored_benchmark import know_sources, put_benchmark
from stores import s3, s3_server

from kinectbench.core.artefacts.manifest import Manifest
from kinectbench.core.store.attempts import MissingObjectError
from kinectbench.core.store.store import Store, StoredObject
from kinectbench.engine.pipeline import STAGE_NAMES
from kinectbench.engine.stages import Job
from kinectbench.engine.status import statuses
from kinectbench.settings.file import load_benchmark

__all__ = ["s3", "s3_server"]
Command = Callable[..., Run]
pytestmark = pytest.mark.xdist_group("resume")


def states(run: Run) -> dict[str, tuple[str, str | None]]:
    return {row["recording"]: (row["state"], row["next"]) for row in json.loads(run.out)}


def test_what_is_built_is_done(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b")
    before = hashes(root)
    result = command(root, "build", "--status", "--json")
    assert (result.status, result.err) == (0, "")
    assert states(result) == {"chair": ("done", None), "table": ("done", None)}
    assert command(root, "build", "--status").out == "2 of 2 done, 0 failed, 0 missing\n"
    assert hashes(root) == before
    shutil.rmtree(root / "build")
    nothing = command(root, "build", "--status")
    assert nothing.status == 3 and nothing.out.endswith("0 of 2 done, 0 failed, 2 missing\n")
    assert "note: nothing is built yet" in nothing.err and "status is 3" in nothing.err


def test_what_is_missing_failed_or_out_of_date_is_listed(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    shutil.rmtree(root / "build" / "table" / "object")
    assert states(command(root, "build", "--status", "--json"))["table"] == ("missing", "segment")
    changed = command(root, "build", "--status", "--json", "--set", "views.count=2")
    assert changed.status == 3 and states(changed)["chair"] == ("missing", "sample-views")
    assert [row["differs"] for row in json.loads(changed.out)] == ["views.count", None]
    ignored = command(root, "build", "--status", "--json", "--set", "recordings.chair.trajectory=ignore")
    assert json.loads(ignored.out)[0]["differs"] == "trajectory"
    told = command(root, "build", "--status", "--set", "views.count=2").out
    assert "other settings" in told and "views.count is changed" in told
    assert told.endswith("0 of 2 done, 0 failed, 1 missing, 1 of other settings\n")
    (root / "recordings" / "table").rename(root / "recordings" / "elsewhere")
    assert command(root, "build", "table", "--force", "--jobs", "1").status == 1
    shown = command(root, "build", "--status")
    assert shown.status == 3 and shown.out.endswith("1 of 2 done, 1 failed, 0 missing\n")
    assert "no such recording" in shown.out and "chair" not in shown.out
    assert json.loads(command(root, "build", "--status", "--json").out)[1]["code"] == "recording.not-found"


def test_a_forced_build_that_failed_is_told_though_the_earlier_result_is_there(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    table = root / "recordings" / "table"
    table.rename(root / "recordings" / "elsewhere")
    assert command(root, "build", "table", "--force", "--jobs", "1").status == 1
    result = command(root, "build", "--status", "--json")
    assert result.status == 3
    assert states(result) == {"chair": ("done", None), "table": ("failed", None)}
    assert "no such recording" in json.loads(result.out)[1]["error"]
    (root / "recordings" / "elsewhere").rename(table)
    assert command(root, "build", "--jobs", "1").status == 0
    assert command(root, "build", "--status").out == "2 of 2 done, 0 failed, 0 missing\n"


def test_status_of_a_part(command: Command, small: Path) -> None:
    listed = [
        name
        for number in (1, 2)
        for name in states(command(small, "build", "--status", "--json", "--shard", f"{number}/2"))
    ]
    assert sorted(listed) == ["chair", "table"]


def test_what_was_built_there_of_other_settings_is_told(
    command: Command, small: Path, tmp_path: Path, s3: str
) -> None:
    put_benchmark(small, s3, STAGE_NAMES[:-1])
    know_sources(s3)
    status = ("build", "--status", "--config", f"{s3}/benchmark.yaml")
    rows = json.loads(command(tmp_path, *status, "--json", "--set", "views.count=2").out)
    assert [(row["next"], row["differs"]) for row in rows] == [("sample-views", "views.count")] * 2
    told = command(tmp_path, *status, "--set", "views.count=2").out
    assert told.endswith("0 of 2 done, 0 failed, 0 missing, 2 of other settings\n")
    assert command(tmp_path, *status).out.endswith("0 of 2 done, 0 failed, 2 missing\n")


@pytest.mark.parametrize("lost", [False, True])
def test_a_manifest_that_is_deleted_meanwhile_ends_nothing_and_what_is_built_is_listed_once(
    small: Path, s3: str, monkeypatch: pytest.MonkeyPatch, lost: bool
) -> None:
    put_benchmark(small, s3, STAGE_NAMES[:1])
    settings = load_benchmark(Path(s3) / "benchmark.yaml")
    listed, objects, read = list[str](), Store.objects, Store.read

    def seen(self: Store, below: str = "", *most: int) -> list[StoredObject]:
        listed.append(below)
        return objects(self, below, *most)

    def gone(self: Store, name: str, *most: int) -> bytes:
        if lost and name.endswith(Manifest.FILE):
            raise MissingObjectError(f"{name}: is gone")
        return read(self, name, *most)

    monkeypatch.setattr(Store, "objects", seen)
    monkeypatch.setattr(Store, "read", gone)
    rows = statuses(Job(settings, each, Path(s3)) for each in settings.recordings)
    assert [(row.state, row.next, row.differs) for row in rows] == [("missing", "ingest", None)] * 2
    assert sorted(name for name in listed if name.startswith("build")) == ["build/chair", "build/table"]
