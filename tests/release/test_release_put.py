"""Releases are put into stores: whole or not at all, from where a put was stopped, over nothing else."""

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fault_proxy import FaultProxy
from file_damage import flip
from raising import raises
from slow import slow
from small_benchmark import Run, hashes
from stores import copy_to, proxied, s3, s3_server, url

from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.targets import SHA256SUMS, benchmark_sha256
from kinectbench.core.errors import KinectBenchError, ReleaseError
from kinectbench.core.storage import sha256_file
from kinectbench.core.store.store import Store
from kinectbench.release.check.verify import MISSING, verify_checksums
from kinectbench.release.fetch import fetch_release
from kinectbench.release.put import PutSummary, put_release
from kinectbench.release.release import Release

__all__ = ["proxied", "s3", "s3_server", "url"]
pytestmark = pytest.mark.xdist_group("stores")


def test_what_is_put_is_fetched(release: Release, url: str, tmp_path: Path) -> None:
    files = len(release.sums) + 1  # SHA256SUMS has a line for every file but itself
    assert put_release(release.folder, Store(url)) == PutSummary(put=files, kept=0, removed=0)
    found = fetch_release(url, tmp_path / "got")
    assert hashes(tmp_path / "got") == hashes(release.folder)
    assert found.pairs == len(release.targets) and found.kept == 0
    assert found.fetched == len(release.sums)
    assert put_release(release.folder, Store(url)) == PutSummary(put=0, kept=files, removed=0)


def test_each_checked_and_put_file_is_progress(release: Release, tmp_path: Path) -> None:
    steps, files = list[tuple[int, int]](), len(release.sums)
    put_release(release.folder, Store(f"file://{tmp_path}/store"), lambda *step: steps.append(step))
    assert steps[:files] == [(done, files) for done in range(1, files + 1)]
    assert steps[-1] == (2 * files + 1, 2 * files + 1) and steps == sorted(steps)
    assert len(steps) == 2 * files


def test_another_release_takes_its_place(release: Release, analytic: Path, s3: str, tmp_path: Path) -> None:
    put_release(release.folder, Store(s3))
    put = put_release(analytic / "benchmark", Store(s3))
    assert put.replaced == release.metadata
    fetch_release(s3, tmp_path / "got")
    assert hashes(tmp_path / "got") == hashes(analytic / "benchmark")
    assert {each.name for each in Store(s3).objects()} == set(hashes(analytic / "benchmark"))


def test_the_command_tells_what_was_put_and_replaced(
    release: Release, small: Path, command: Callable[..., Run], tmp_path: Path
) -> None:
    root, there = Path(shutil.copytree(small, tmp_path / "b")), f"file://{tmp_path}/store"
    put_release(release.folder, Store(there))
    stated = ("--set", "license=CC0-1.0", "--set", "source=simulated", "--jobs", "1", "--to", there)
    first = command(root, "publish", *stated)
    new, old, before = hashes(root / "benchmark"), hashes(release.folder), release.metadata
    files, kept = len(new), len(new.items() & old.items())
    counts = f"put to {there}: {files - kept} files put, {kept} kept, {len(old.keys() - new)} removed"
    assert first.status == 0 and counts in first.out.splitlines(), first
    note = f"note: {there}: replaced {before.name} {before.version or ''}".rstrip()
    assert f"{note}, benchmark_sha256 {before.benchmark_sha256}" in first.err.splitlines()
    again = command(root, "publish", *stated, "--json")
    want = {"url": there, "put": 0, "kept": files, "removed": 0, "replaced": None}
    assert json.loads(again.out)["put"] == want and "replaced" not in again.err
    Store(there).delete([each.name for each in Store(there).objects()])
    put_release(release.folder, Store(there))
    keys = {"name": before.name, "version": before.version, "benchmark_sha256": before.benchmark_sha256}
    assert json.loads(command(root, "publish", *stated, "--json").out)["put"]["replaced"] == keys
    assert json.loads(command(root, "publish", *stated[:-2], "--json").out)["put"] is None


def test_a_put_that_was_stopped_is_no_release(
    release: Release, proxied: FaultProxy, s3: str, tmp_path: Path
) -> None:
    proxied.choose = lambda number, method, path: "drop" if method == "PUT" and number > 20 else ""
    with raises(KinectBenchError, "storage.no-answer", match="for 2 s"):
        put_release(release.folder, Store(s3))
    proxied.choose = lambda number, method, path: ""
    with raises(ReleaseError, "release.not-one"):
        fetch_release(s3, tmp_path / "no")
    assert not (tmp_path / "no").exists()
    assert MISSING.format(BENCHMARK_JSON) in verify_checksums(s3, tmp_path / "mirror")
    put_release(release.folder, Store(s3))
    fetch_release(s3, tmp_path / "got")
    assert hashes(tmp_path / "got") == hashes(release.folder)


def test_a_damaged_release_is_mended(release: Release, s3: str, tmp_path: Path) -> None:
    store = copy_to(release, s3)
    name = release.targets[0].file
    store.delete([name])
    store.put(release.targets[1].file, b"cut off")
    assert put_release(release.folder, store).put == 3  # and benchmark.json
    assert fetch_release(s3, tmp_path / "got").fetched == len(release.sums)


@pytest.mark.parametrize("after", [1, 2, 20, 34])
def test_a_put_that_was_stopped_goes_on_from_there(
    release: Release, s3: str, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    done: list[str] = []
    put = Store.put

    def stopping(store: Store, name: str, content: bytes | Path) -> None:
        if len(done) >= after:
            raise KinectBenchError("stopped")
        done.append(name)
        put(store, name, content)

    with monkeypatch.context() as patch:
        patch.setattr("kinectbench.core.store.store.AT_ONCE", 1)
        patch.setattr(Store, "put", stopping)
        with raises(KinectBenchError, "run.failed", match="stopped"):
            put_release(release.folder, Store(s3))
    assert done[0] == SHA256SUMS
    files = len(release.sums) + 1
    assert put_release(release.folder, Store(s3)) == PutSummary(files - after, after, 0)


def changed_release(release: Release, folder: Path) -> str:
    """Another release: without a file, whose name is returned, and with another one of the same size."""
    shutil.copytree(release.folder, folder)
    gone, other = (target.file for target in release.targets[:2])
    (folder / gone).unlink()
    (folder / other).write_bytes(bytes((folder / other).stat().st_size))
    sums = {name: sha256_file(folder / name) for name in release.sums if name != gone}
    text = "".join(f"{sha256}  {name}\n" for name, sha256 in sums.items())
    stated = json.loads((folder / BENCHMARK_JSON).read_text())
    stated["benchmark_sha256"] = benchmark_sha256(text, json.dumps(stated))
    (folder / BENCHMARK_JSON).write_text(json.dumps(stated))
    text = text.replace(sums[BENCHMARK_JSON], sha256_file(folder / BENCHMARK_JSON))
    (folder / SHA256SUMS).write_text(text)
    return gone


def test_what_a_stopped_put_left_of_another_release_goes(release: Release, s3: str, tmp_path: Path) -> None:
    store, gone = Store(s3), changed_release(release, tmp_path / "new")
    put_release(release.folder, store)
    store.delete([BENCHMARK_JSON])  # as if the last step had not been reached
    # The list, the file that changed, and benchmark.json.
    assert put_release(tmp_path / "new", store) == PutSummary(3, len(release.sums) - 3, 1)
    assert {each.name for each in store.objects()} == set(hashes(release.folder)) - {gone}


@pytest.mark.parametrize("steps", [step if step in (0, 2, 5, 7) else slow(step) for step in range(8)])
@pytest.mark.parametrize("before", ["whole", "benchmark.json of another", "damaged list"])
def test_wherever_a_put_is_stopped_the_next_one_is_right(
    release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: str, steps: int
) -> None:
    store, new = Store(f"file://{tmp_path}/store"), tmp_path / "new"
    changed_release(release, new)
    put_release(release.folder, store)
    if before == "benchmark.json of another":
        store.put(BENCHMARK_JSON, new / BENCHMARK_JSON)
        store.put(release.targets[1].file, new / release.targets[1].file)
    if before == "damaged list":
        store.put(SHA256SUMS, b"cut o")
    left = [steps]

    def stopping(act: Callable[..., None]) -> Callable[..., None]:
        def step(*words: Any) -> None:
            left[0] -= 1
            if left[0] < 0:
                raise KinectBenchError("stopped")
            act(*words)

        return step

    with monkeypatch.context() as patch:
        patch.setattr("kinectbench.core.store.store.AT_ONCE", 1)
        patch.setattr(Store, "put", stopping(Store.put))
        patch.setattr(Store, "delete", stopping(Store.delete))
        with contextlib.suppress(KinectBenchError):
            put_release(new, store)
    for folder in (release.folder, new):
        put_release(folder, store)
        fetched = tmp_path / f"got-{folder.name}"
        fetch_release(store.url, fetched, None)
        assert hashes(fetched) == hashes(folder) == hashes(tmp_path / "store")


def test_a_folder_with_a_damaged_file_is_not_put(release: Release, tmp_path: Path) -> None:
    store, copy = Store(f"file://{tmp_path}/store"), tmp_path / "copy"
    shutil.copytree(release.folder, copy)
    flip(copy / release.targets[0].file)
    with raises(ReleaseError, "release.changed", match=release.targets[0].file):
        put_release(copy, store)
    (copy / release.targets[0].file).unlink()
    with raises(ReleaseError, "release.damaged", match=release.targets[0].file):
        put_release(copy, store)
    assert store.objects() == []


def test_a_url_with_a_query_is_refused(release: Release) -> None:
    with raises(ReleaseError, "release.bad-url", match=r"s3://bucket/rel\?…") as raised:
        put_release(release.folder, Store("s3://bucket/rel?X-Amz-Signature=SECRET"))
    assert "SECRET" not in str(raised.value)


@pytest.mark.parametrize(
    "others",
    [
        {"thesis.txt": b"years of work"},
        {"README.md": b"of another project"},
        {SHA256SUMS: b"0" * 64 + b"  disk.iso\n", "disk.iso": b"x"},
        {BENCHMARK_JSON: b"{}", "thesis.txt": b"years of work"},
    ],
    ids=["file", "of a name that releases have", "list", "benchmark.json"],
)
def test_what_is_no_release_is_not_replaced(release: Release, s3: str, others: dict[str, bytes]) -> None:
    store = Store(s3)
    for name, content in others.items():
        store.put(name, content)
    with raises(ReleaseError, "release.other-content"):
        put_release(release.folder, store)
    assert {each.name: store.read(each.name) for each in store.objects()} == others


@pytest.mark.parametrize("name", ["thesis.txt", "v1/benchmark.json"])
@pytest.mark.parametrize("state", ["whole", "stopped", "damaged list"])
def test_what_lies_beside_a_release_stays(
    release: Release, analytic: Path, tmp_path: Path, state: str, name: str
) -> None:
    store = Store(f"file://{tmp_path}/store")
    put_release(release.folder, store)
    store.put(name, b"years of work")
    if state == "stopped":
        store.delete([BENCHMARK_JSON])
    if state == "damaged list":
        store.put(SHA256SUMS, b"cut o")
    before = hashes(tmp_path / "store")
    for folder in (release.folder, analytic / "benchmark"):
        with raises(ReleaseError, "release.other-content"):
            put_release(folder, store)
    assert hashes(tmp_path / "store") == before
