"""Folders in which recordings of stores are built: gone at the end, also those of killed runs."""

import os
import time
from pathlib import Path

import pytest
from raising import raises

from kinectbench.core.errors import StorageError
from kinectbench.engine.processes import CONTEXT
from kinectbench.engine.scratch import PREFIX, SCRATCH_VARIABLE, YOUNG_S, clear_scratch, scratch_folder


@pytest.fixture(autouse=True)
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(SCRATCH_VARIABLE, str(tmp_path))
    return tmp_path


def made_long_ago(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "depth.kbd").write_bytes(b"x")
    then = time.time() - 2 * YOUNG_S
    os.utime(folder, (then, then))
    return folder


def test_it_lasts_as_long_as_the_block(scratch: Path) -> None:
    with scratch_folder() as folder:
        assert folder.parent == scratch
        (folder / "build").mkdir()
    assert list(scratch.iterdir()) == []


def test_what_killed_runs_left_goes_and_nothing_else(scratch: Path) -> None:
    made_long_ago(scratch / f"{PREFIX}killed")
    others = [made_long_ago(scratch / "others"), scratch / f"{PREFIX}young", scratch / f"{PREFIX}link"]
    others[1].mkdir()
    others[2].symlink_to(others[0])
    with scratch_folder() as used:
        made_long_ago(used)
        with scratch_folder() as second:
            assert set(scratch.iterdir()) == {*others, used, second}
    assert set(scratch.iterdir()) == set(others)
    assert [file.name for file in others[0].iterdir()] == ["depth.kbd"]


def test_a_place_that_is_no_folder_is_told(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SCRATCH_VARIABLE, str(scratch / "none"))
    said = f"none: no such folder; make it, or correct {SCRATCH_VARIABLE}"
    with raises(StorageError, "storage.no-folder", match=said), scratch_folder():
        pass


def test_what_a_worker_left_that_was_ended_goes_with_the_run(scratch: Path) -> None:
    """At once, however young it is; but not what another run's worker has, nor one that still works."""
    worker = CONTEXT.Process(target=hold_scratch, args=(str(scratch),))
    worker.start()
    while not list(scratch.glob("*/begun")):
        time.sleep(0.01)
    (left,) = scratch.iterdir()
    other = scratch / f"{PREFIX}1-abc"
    other.mkdir()
    clear_scratch()
    assert left.is_dir()  # it is still locked
    worker.terminate()
    worker.join()
    clear_scratch()
    assert list(scratch.iterdir()) == [other]


def hold_scratch(base: str) -> None:
    os.environ[SCRATCH_VARIABLE] = base
    with scratch_folder() as folder:
        (folder / "begun").touch()
        time.sleep(60)
