"""Recordings of a benchmark in a store: built there, the same bytes, also by two at once."""

import errno
import json
import shutil
import tarfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from fault_proxy import Fault, FaultProxy, for_a_while
from raising import raises
from s3_server import S3Server
from slow import slow
from small_benchmark import Run, finish, hashes, start
from stored_benchmark import jobs_of, know_sources, put_benchmark
from stores import proxied, s3, s3_server

from kinectbench.core import StorageError, storage_errors
from kinectbench.core.artefacts.manifest import Failed, Manifest
from kinectbench.core.store.attempts import PATIENCE_VARIABLE
from kinectbench.core.store.store import Store
from kinectbench.engine.checkout import checkout, files_of_recording, named_as_there
from kinectbench.engine.orphans import find_orphans, remove_orphans
from kinectbench.engine.pipeline import STAGE_NAMES, artefacts_upto
from kinectbench.engine.stages import STAGES, Job
from kinectbench.engine.stored_build import put_failure
from kinectbench.engine.stored_stage import (
    ARCHIVE,
    fetch_stage,
    files_folder,
    pack_files,
    put_stage,
    stored_folder,
    unpack_files,
)

__all__ = ["proxied", "s3", "s3_server"]
pytestmark = pytest.mark.xdist_group("stores")

Command = Callable[..., Run]
# What is quick to make again.
LAST = "pairs"
BEFORE = STAGE_NAMES[:-1]


def config(url: str) -> tuple[str, str]:
    return ("--config", f"{url}/benchmark.yaml")


def built_there(url: str, to: Path, small: Path, recording: str) -> dict[str, str]:
    """Hashes of all that was built of a recording in a store, by the names that it has on a disk."""
    job = next(job for job in jobs_of(small) if job.recording.id == recording)
    found = checkout(replace(job, root=Path(url)), to)
    assert found.current == STAGE_NAMES
    for artefact in found.artefacts.values():
        fetch_stage(found.store, recording, artefact)
    return hashes(to / "build" / recording)


# --- what is built ------------------------------------------------------------------------------------


def test_what_is_current_is_not_made_again(
    command: Command, small: Path, tmp_path: Path, proxied: FaultProxy, s3: str
) -> None:
    put_benchmark(small, s3)
    know_sources(s3)
    proxied.requests.clear()
    status = command(tmp_path, "build", "--status", "--json", *config(s3))
    assert [row["state"] for row in json.loads(status.out)] == ["done", "done"]
    assert len(proxied.requests) <= 1 + 2 * 5, proxied.requests
    proxied.requests.clear()
    there = command(tmp_path, "build", "--json", *config(s3))
    assert (there.status, there.err) == (0, ""), there
    here = command(small, "build", "--json", "--jobs", "1")
    assert json.loads(there.out) == json.loads(here.out)
    # Of a recording: its listing, sources, build/, six JSON files.
    assert len(proxied.requests) <= 1 + 2 * 9, proxied.requests
    assert not any(method == "PUT" for method, _ in proxied.requests)


def test_what_is_missing_is_made_the_same(
    command: Command, small: Path, tmp_path: Path, proxied: FaultProxy, s3: str
) -> None:
    put_benchmark(small, s3, BEFORE)
    know_sources(s3)
    proxied.requests.clear()
    made = command(tmp_path, "build", "--json", "--jobs", "2", *config(s3))
    assert made.status == 0 and [row["made"] for row in json.loads(made.out)] == [[LAST], [LAST]], made
    for name in ("chair", "table"):
        assert built_there(s3, tmp_path / "there", small, name) == hashes(small / "build" / name)
    uploads = [path for method, path in proxied.requests if method == "PUT"]
    # pairs.json, the archive, timing.json and manifest.json of two recordings
    assert len(uploads) == 8 and sum(ARCHIVE in path for path in uploads) == 2, uploads


def test_a_failure_is_told_though_all_is_there_and_forgotten_by_the_next_build(
    command: Command, small: Path, tmp_path: Path, s3: str
) -> None:
    store = put_benchmark(small, s3)
    know_sources(s3)
    put_failure(replace(jobs_of(small)[0], root=Path(s3)), Failed(stage="fuse", error="too dark"))
    status = ("build", "--status", "--json", *config(s3))
    rows = json.loads(command(tmp_path, *status).out)
    assert [(row["state"], row["error"]) for row in rows] == [("failed", "too dark"), ("done", None)]
    assert command(tmp_path, "build", *config(s3)).status == 0
    assert store.head("build/chair/failed.json") is None
    assert [row["state"] for row in json.loads(command(tmp_path, *status).out)] == ["done", "done"]


def test_published_there_it_is_the_same(command: Command, small: Path, tmp_path: Path, s3: str) -> None:
    put_benchmark(small, s3)
    here = tmp_path / "here"
    shutil.copytree(small, here)
    wanted = command(here, "publish", "--json", "--jobs", "1")
    results = [command(tmp_path, "publish", "--json", *config(s3)) for _ in range(2)]
    assert [result.status for result in results] == [0, 0], results
    for result in results:
        told = json.loads(result.out)
        assert told["benchmark_sha256"] == json.loads(wanted.out)["benchmark_sha256"]
        assert told["release"] == f"{s3}/benchmark"
    assert command(tmp_path, "fetch", f"{s3}/benchmark", "--out", "got").status == 0
    assert hashes(tmp_path / "got") == hashes(here / "benchmark")


def test_a_changed_recording_is_noticed(small: Path, tmp_path: Path, s3: str) -> None:
    store = put_benchmark(small, s3)
    job = replace(jobs_of(small)[0], root=Path(s3))
    assert checkout(job, tmp_path / "a").current == STAGE_NAMES
    file = next(each.name for each in store.objects("recordings/chair") if each.name.endswith(".txt"))
    store.put(file, store.read(file) + b"# changed\n")
    again = checkout(job, tmp_path / "b")
    assert again.current == () and again.job.source.is_dir()


def test_what_lies_beside_a_sequence_belongs_to_it(small: Path, tmp_path: Path, s3: str) -> None:
    """As of 7-Scenes, where one camera file above all sequences holds their intrinsics."""
    store, names = Store(s3), ["r/camera-intrinsics.txt", "r/s/frame-000000.depth.png", "r/s/.hidden"]
    for name in [*names, "r/other.bag", "r/s/pick.json"]:
        store.put(name, b"1")
    job = replace(jobs_of(small)[0], root=Path(s3))
    job = replace(job, recording=job.recording.model_copy(update={"path": "r/s"}))
    assert sorted(each.name for each in files_of_recording(store, job)) == names[:2]


def test_a_recording_that_is_not_there(command: Command, small: Path, tmp_path: Path, s3: str) -> None:
    store = put_benchmark(small, s3, ())
    text = store.read("benchmark.yaml").decode()
    for path, said in (
        ("recordings/none", f"{s3}/recordings/none: no such recording; correct `path` of 'chair'"),
        ("../chair", f"recordings.chair.path: '../chair' leads out of {s3}; recordings of a benchmark in a"),
    ):
        store.put("benchmark.yaml", text.replace("recordings/chair", path).encode())
        result = command(tmp_path, "build", "chair", *config(s3))
        assert result.status == 1 and said in " ".join(result.err.split()), result
        status = json.loads(command(tmp_path, "build", "--status", "--json", *config(s3)).out)
        assert said in status[0]["error"] and status[1]["state"] == "missing"
    assert b"no such recording" in store.read("build/chair/failed.json")
    store.put("benchmark.yaml", text.encode())
    status = json.loads(command(tmp_path, "build", "--status", "--json", *config(s3)).out)
    assert [row["state"] for row in status] == ["failed", "missing"]


def test_a_line_of_settings_is_named_by_its_url(
    command: Command, small: Path, tmp_path: Path, s3: str
) -> None:
    Store(s3).put("benchmark.yaml", b"name: b\nrecordings: [\n")
    result = command(tmp_path, "build", *config(s3))
    assert result.status == 2 and f"error: {s3}/benchmark.yaml:3: " in result.err, result


def test_masks_that_are_not_there(command: Command, small: Path, tmp_path: Path, s3: str) -> None:
    """What is told names the store, never the folder that its files were fetched to."""
    store = put_benchmark(small, s3, ())
    text = store.read("benchmark.yaml")
    store.put("benchmark.yaml", text.replace(b"recordings/chair", b"recordings/chair, masks: drawn"))
    result = command(tmp_path, "build", "chair", *config(s3))
    said = f"{s3}/drawn: no such folder of masks of chair; make it, or correct `masks`"
    assert result.status == 1 and said in " ".join(result.err.split()), result
    assert said in store.read("build/chair/failed.json").decode()


def test_masks_there_are_tied_to_their_frames(command: Command, small: Path, tmp_path: Path, s3: str) -> None:
    store = put_benchmark(small, s3, STAGE_NAMES[:4])
    know_sources(s3)
    text = store.read("benchmark.yaml")
    store.put("benchmark.yaml", text.replace(b"recordings/chair", b"recordings/chair, masks: drawn"))
    picture = cv2.imencode(".png", np.full((120, 160), 255, np.uint8))[1].tobytes()
    store.put("drawn/frame_000004.png", picture)
    assert command(tmp_path, "sample-views", "chair", *config(s3)).status == 0
    assert set(json.loads(store.read("drawn/masks.json"))) == {"frame_000004.png"}
    store.put("drawn/000.png", picture)
    refused = command(tmp_path, "sample-views", "chair", *config(s3))
    assert refused.status == 1 and "drawn/000.png: nobody knows which image it was drawn on" in refused.err


def test_commands_that_need_a_folder_say_so(command: Command, small: Path, tmp_path: Path, s3: str) -> None:
    put_benchmark(small, s3, ())
    for words in (["report"], ["baseline"]):
        result = command(tmp_path, *words, *config(s3))
        assert result.status == 2 and "this command works on folders of this machine" in result.err, result
    assert list(tmp_path.iterdir()) == []


# --- stores that answer badly -------------------------------------------------------------------------


def test_a_bad_store_changes_nothing(
    command: Command,
    small: Path,
    tmp_path: Path,
    proxied: FaultProxy,
    s3: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """503 for a second; then of every seven requests one is cut, one is done without an answer, one busy."""
    monkeypatch.setenv(PATIENCE_VARIABLE, "30")  # a request may meet several faults, one after the other
    put_benchmark(small, s3, BEFORE)
    at_first = for_a_while(1.0)
    later: dict[int, Fault] = {1: "cut", 3: "lose", 5: "503"}
    proxied.choose = lambda number, method, path: (
        at_first(number, method, path) or (later.get(number % 7, "") if "benchmark.yaml" not in path else "")
    )
    result = command(tmp_path, "build", "chair", "--jobs", "1", *config(s3))
    assert result.status == 0, result.err
    assert {"cut", "lose", "503"} <= set(proxied.faults)
    proxied.choose = lambda number, method, path: ""
    assert built_there(s3, tmp_path / "there", small, "chair") == hashes(small / "build" / "chair")


def test_a_store_that_is_gone(
    command: Command, small: Path, tmp_path: Path, proxied: FaultProxy, s3: str
) -> None:
    put_benchmark(small, s3, BEFORE)
    know_sources(s3)
    proxied.choose = lambda number, method, path: "drop" if method == "PUT" else ""
    result = command(tmp_path, "build", "chair", *config(s3))
    assert result.status == 1
    assert "the store did not answer well for 2 s" in result.err and "Traceback" not in result.err
    proxied.choose = lambda number, method, path: ""
    assert command(tmp_path, "build", "chair", *config(s3)).status == 0


@pytest.mark.parametrize("jobs", [slow("1"), "2"])
def test_a_store_that_is_gone_ends_the_build_in_one_line(
    command: Command, small: Path, tmp_path: Path, proxied: FaultProxy, s3: str, jobs: str
) -> None:
    put_benchmark(small, s3, BEFORE)
    know_sources(s3)
    proxied.requests.clear()
    proxied.choose = lambda number, method, path: "503" if method == "PUT" else ""
    result = command(tmp_path, "build", "--jobs", jobs, *config(s3))
    assert result.status == 1 and result.err.count("did not answer well") == 1, result
    if jobs == "1":
        assert not any("/table/" in path for _, path in proxied.requests)
    proxied.choose = lambda number, method, path: ""
    assert command(tmp_path, "build", "--jobs", "1", *config(s3)).status == 0


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES])
def test_a_full_disk_of_this_machine_is_not_called_the_stores(tmp_path: Path, number: int) -> None:
    file, store = tmp_path / "recordings" / "chair" / "depth.png", Store("s3://bucket/lab")
    with (
        raises(StorageError, "storage.not-writable", match=f"KINECTBENCH_SCRATCH={file}"),
        named_as_there(store, tmp_path),
        storage_errors(file),
    ):
        raise OSError(number, "fails")
    with (
        raises(StorageError, "storage.damaged", match=r"s3://bucket/lab/recordings/chair/depth\.png"),
        named_as_there(store, tmp_path),
    ):
        raise StorageError(f"{file}: is damaged")


def test_two_clients_at_once(small: Path, tmp_path: Path, s3: str, s3_server: S3Server) -> None:
    put_benchmark(small, s3, BEFORE)
    both = [start(tmp_path, "build", "chair", "--jobs", "1", *config(s3)) for _ in range(2)]
    assert [finish(each).status for each in both] == [0, 0]
    assert built_there(s3, tmp_path / "there", small, "chair") == hashes(small / "build" / "chair")


# --- what strangers may have put there ----------------------------------------------------------------


@pytest.mark.parametrize(
    "change", ["leads out", "hidden", "other stage", "damaged", "archive", "missing", "other bytes"]
)
def test_a_stored_artefact_that_is_not_one(small: Path, tmp_path: Path, s3: str, change: str) -> None:
    store = put_benchmark(small, s3, ())
    job = jobs_of(small)[0]
    artefacts = artefacts_upto(job, LAST)
    put_stage(store, "chair", artefacts[LAST])
    where = stored_folder("chair", artefacts[LAST])
    manifest = store.read(f"{where}/manifest.json")
    files = files_folder(where, Manifest.parse(manifest.decode(), ""))
    if change in ("leads out", "hidden"):
        name = b'"../../../../out.npz"' if change == "leads out" else b'".bashrc"'
        store.put(f"{where}/manifest.json", manifest.replace(b'"000.npz"', name))
    elif change == "other stage":
        store.put(f"{where}/manifest.json", manifest.replace(b'"stage": "pairs"', b'"stage": "track"'))
    elif change == "damaged":
        store.put(f"{where}/manifest.json", b"\xff{")
    elif change == "archive":
        store.put(f"{files}/{ARCHIVE}", b"no archive" * 100)
    elif change == "other bytes":
        store.put(f"{files}/pairs.json", store.read(f"{files}/pairs.json").replace(b"0", b"1"))
    else:
        store.delete([f"{files}/{ARCHIVE}"])
    to = replace(artefacts[LAST], folder=tmp_path / "to" / "pairs")
    with pytest.raises(StorageError) as error:
        fetch_stage(store, "chair", to)
    assert len(str(error.value).splitlines()) == 1
    assert not to.is_current() and {path.name for path in tmp_path.iterdir()} <= {"to"}


def test_an_archive_holds_what_is_listed_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "from"
    (folder / "depth").mkdir(parents=True)
    names = ["depth/000.kbd", "long" * 40, "depth/ä.png"]
    for number, name in enumerate(names):
        (folder / name).write_bytes(bytes([number]) * number * 1000)
    sizes = {name: (folder / name).stat().st_size for name in names}
    for archive in ("a.tar", "b.tar"):
        pack_files(folder, sorted(names), tmp_path / archive)
    assert (tmp_path / "a.tar").read_bytes() == (tmp_path / "b.tar").read_bytes()
    unpack_files(tmp_path / "a.tar", tmp_path / "to", sizes)
    assert hashes(tmp_path / "to") == hashes(folder)
    for wrong in ({**sizes, "more": 1}, {**sizes, names[0]: 5}, {names[0]: sizes[names[0]]}):
        with raises(StorageError, "storage.damaged", match=r"a\.tar: "):
            unpack_files(tmp_path / "a.tar", tmp_path / "wrong", wrong)
    with tarfile.open(tmp_path / "link.tar", "w") as tar:
        entry = tarfile.TarInfo("x")
        entry.type, entry.linkname = tarfile.SYMTYPE, "/etc/passwd"
        tar.addfile(entry)
    with raises(StorageError, "storage.damaged", match="is not what manifest"):
        unpack_files(tmp_path / "link.tar", tmp_path / "wrong", {"x": 0})


# --- what nothing names -------------------------------------------------------------------------------


def test_gc_removes_only_what_no_manifest_names(
    command: Command, small: Path, tmp_path: Path, s3: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = put_benchmark(small, s3)
    before = {each.name for each in store.objects()}
    fingerprint = "0" * 64
    orphans = {f"build/chair/pairs/{fingerprint}/{name}" for name in (ARCHIVE, "timing.json")}
    whole = next(name for name in before if "/segment/" in name).rpartition("/")[0]
    orphans.add(f"{whole}/left.npz")
    others = {"recordings/notes.txt", "build/chair/failed.json", f"build/chair/sources/{fingerprint}.json"}
    for name in orphans | others:
        store.put(name, b"x" * 10)
    young = command(tmp_path, "gc", "--delete", *config(s3))
    assert young.status == 0 and "nothing that no manifest names" in young.out
    listed = command(tmp_path, "gc", "--all", "--json", *config(s3))
    assert set(json.loads(listed.out)["found"]) == orphans and json.loads(listed.out)["removed"] == 0
    assert "nothing is removed; --delete does" in command(tmp_path, "gc", "--all", *config(s3)).out
    assert before | orphans | others == {each.name for each in store.objects()}
    tomorrow = time.time() + 2 * 86_400
    with monkeypatch.context() as patch:
        patch.setattr("time.time", lambda: tomorrow)
        assert {each.name for each in find_orphans(store)} == orphans
    assert "removed 3 files" in command(tmp_path, "gc", "--all", "--delete", *config(s3)).out
    assert before | others == {each.name for each in store.objects()}


def test_gc_looks_once_more_before_it_removes(small: Path, s3: str) -> None:
    """What got its manifest between the listing and the removal stays."""
    store = put_benchmark(small, s3, ())
    artefact = artefacts_upto(jobs_of(small)[0], LAST)[LAST]
    put_stage(store, "chair", artefact)
    place = f"{stored_folder('chair', artefact)}/manifest.json"
    manifest = store.read(place)
    store.delete([place])
    found = find_orphans(store, young=True)
    assert len(found) == 3
    store.put(place, manifest)
    assert remove_orphans(store, found) == 0
    assert find_orphans(store, young=True) == []


def test_gc_is_for_stores(command: Command, small: Path) -> None:
    result = command(small, "gc")
    assert result.status == 2 and "gc is for stores" in result.err


def test_every_stage_has_a_file_for_the_table() -> None:
    from kinectbench.engine.stored_build import SHOWN

    assert set(SHOWN) == {stage.name for stage in STAGES}
    assert (
        Store("s3://b/x") == Store("s3://b/x") and Job.__dataclass_fields__["source_sha256"].default is None
    )
