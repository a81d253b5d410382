"""Releases in stores and on web servers: put, fetched whole or in part, verified and scored from there."""

import functools
import http.server
import json
import shutil
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from fault_proxy import FaultProxy
from small_benchmark import Run, hashes, leftovers
from stores import proxied, s3, s3_server, url

from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.targets import SHA256SUMS
from kinectbench.core.errors import KinectBenchError, ReleaseError, SettingsError
from kinectbench.core.store.store import Store, in_parallel
from kinectbench.release.fetch import Part, cached_release, chosen, fetch_release, mirror_release, release_url
from kinectbench.release.put import put_release
from kinectbench.release.release import Release, open_release

__all__ = ["proxied", "s3", "s3_server", "url"]
pytestmark = pytest.mark.xdist_group("stores")
Command = Callable[..., Run]


@pytest.fixture
def web(release: Release) -> Iterator[str]:
    """The URL of the release on a plain web server."""
    quiet = type("Quiet", (http.server.SimpleHTTPRequestHandler,), {"log_message": lambda *words: None})
    handler = functools.partial(quiet, directory=str(release.folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def copy_to(release: Release, url: str) -> Store:
    """Put a release's files there as they are."""
    store = Store(url)
    files = [path for path in release.folder.rglob("*") if path.is_file()]
    in_parallel(partial(store.put, path.relative_to(release.folder).as_posix(), path) for path in files)
    return store


# --- put ----------------------------------------------------------------------------------------------


def test_what_is_put_is_fetched(release: Release, url: str, tmp_path: Path) -> None:
    count = put_release(release.folder, Store(url))
    assert count == len(release.sums) + 1  # SHA256SUMS has a line for every file but itself
    found = fetch_release(url, tmp_path / "got")
    assert hashes(tmp_path / "got") == hashes(release.folder)
    assert found.pairs == len(release.targets) and found.kept == 0
    assert put_release(release.folder, Store(url)) == 0


def test_another_release_takes_its_place(release: Release, analytic: Path, s3: str, tmp_path: Path) -> None:
    put_release(release.folder, Store(s3))
    put_release(analytic / "benchmark", Store(s3))
    fetch_release(s3, tmp_path / "got")
    assert hashes(tmp_path / "got") == hashes(analytic / "benchmark")
    assert {each.name for each in Store(s3).objects()} == set(hashes(analytic / "benchmark"))


def test_a_put_that_was_stopped_is_no_release(
    release: Release, proxied: FaultProxy, s3: str, tmp_path: Path
) -> None:
    proxied.choose = lambda number, method, path: "drop" if method == "PUT" and number > 20 else ""
    with pytest.raises(KinectBenchError, match="the store did not answer well for 2 s"):
        put_release(release.folder, Store(s3))
    proxied.choose = lambda number, method, path: ""
    for call in (lambda: fetch_release(s3, tmp_path / "no"), lambda: mirror_release(s3, tmp_path / "no")):
        with pytest.raises(ReleaseError, match="no release there"):
            call()
    assert not (tmp_path / "no").exists()
    put_release(release.folder, Store(s3))
    fetch_release(s3, tmp_path / "got")
    assert hashes(tmp_path / "got") == hashes(release.folder)


def test_a_damaged_release_is_mended(release: Release, s3: str, tmp_path: Path) -> None:
    store = copy_to(release, s3)
    name = release.targets[0].file
    store.delete([name])
    assert put_release(release.folder, store) > 0
    assert fetch_release(s3, tmp_path / "got").fetched == len(release.sums) - 1


def test_what_is_no_release_is_not_replaced(release: Release, s3: str) -> None:
    Store(s3).put("thesis.txt", b"years of work")
    with pytest.raises(ReleaseError, match=r"thesis\.txt: not of a release; publish to a place that"):
        put_release(release.folder, Store(s3))
    assert [each.name for each in Store(s3).objects()] == ["thesis.txt"]


# --- fetched in part ----------------------------------------------------------------------------------


def test_parts_are_chosen(release: Release) -> None:
    every = release.targets
    assert chosen(every, Part()) == tuple(sorted(every))
    test = chosen(every, Part(split="test"))
    assert test and {target.split for target in test} == {"test"}
    category = test[0].category
    assert {t.category for t in chosen(every, Part(categories=(category,)))} == {category}
    one = chosen(every, Part(views=1))
    assert set(Counter(target.recording for target in one).values()) == {1}
    assert {target.view for target in one} == {min(t.view for t in every)}


def test_a_part_is_enough_for_its_split(release: Release, web: str, tmp_path: Path) -> None:
    out = tmp_path / "got"
    found = fetch_release(web, out, Part(split="test", views=1))
    opened = open_release(out)
    assert found.benchmark_sha256 == opened.benchmark_sha256 == release.benchmark_sha256
    wanted = chosen(release.targets, Part(split="test", views=1))
    assert {path.relative_to(out).as_posix() for path in out.glob("pairs/*/*")} == {t.file for t in wanted}
    recordings = {target.recording for target in wanted}
    there = {path.name for path in (out / "objects").iterdir()}
    assert there == recordings | {f"{recording}.glb" for recording in recordings}
    for target in wanted:
        assert opened.pair_content(target)
    more = fetch_release(web, out)
    assert hashes(out) == hashes(release.folder) and more.kept == found.fetched + found.kept


def test_a_fetch_that_was_stopped_goes_on(
    release: Release, proxied: FaultProxy, s3: str, tmp_path: Path
) -> None:
    copy_to(release, s3)
    proxied.requests.clear()
    proxied.choose = lambda number, method, path: "drop" if number > 20 else ""
    with pytest.raises(KinectBenchError, match="the store did not answer well for 2 s"):
        fetch_release(s3, tmp_path / "got")
    assert not (tmp_path / "got" / BENCHMARK_JSON).exists() and leftovers(tmp_path) == []
    proxied.choose = lambda number, method, path: ""
    found = fetch_release(s3, tmp_path / "got")
    assert found.kept >= 10 and hashes(tmp_path / "got") == hashes(release.folder)


def test_one_request_a_file(release: Release, proxied: FaultProxy, s3: str, tmp_path: Path) -> None:
    copy_to(release, s3)
    proxied.requests.clear()
    fetch_release(s3, tmp_path / "got")
    # benchmark.json and targets.csv are read once more, to know what is wanted.
    assert len(proxied.requests) <= len(release.sums) + 1 + 2


def test_releases_by_name(release: Release, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("KINECTBENCH_RELEASES", "https://lab.example/releases/")
    assert release_url("chairs") == "https://lab.example/releases/chairs"
    assert release_url("s3://bucket/chairs/") == "s3://bucket/chairs"
    assert release_url(str(release.folder)) == f"file://{release.folder}"
    for name in ("../chairs", "a/b"):
        with pytest.raises(SettingsError, match="no such folder and no URL"):
            release_url(name)
    monkeypatch.delenv("KINECTBENCH_RELEASES")
    with pytest.raises(SettingsError, match="set KINECTBENCH_RELEASES"):
        release_url("chairs")


# --- what is wrong there ------------------------------------------------------------------------------


def test_a_file_that_was_changed_is_refused(release: Release, s3: str, tmp_path: Path) -> None:
    store, name = copy_to(release, s3), release.targets[0].file
    store.put(name, b"other bytes")
    with pytest.raises(ReleaseError, match=rf"{name}: changed since it was published"):
        fetch_release(s3, tmp_path / "got")
    assert not (tmp_path / "got" / name).exists() and not (tmp_path / "got" / BENCHMARK_JSON).exists()


@pytest.mark.parametrize("line", ["../out", "/etc/passwd", ".bashrc", "a/../../out", "a\\..\\b", ""])
def test_names_that_lead_out_are_refused(release: Release, s3: str, tmp_path: Path, line: str) -> None:
    store = copy_to(release, s3)
    sums = store.read(SHA256SUMS).decode() + f"{'0' * 64}  {line}\n"
    store.put(SHA256SUMS, sums.encode())
    for call in (lambda: fetch_release(s3, tmp_path / "got"), lambda: mirror_release(s3, tmp_path / "m")):
        with pytest.raises(ReleaseError):
            call()
    assert not (tmp_path / "got").exists() and not (tmp_path / "m").exists()


def test_files_beyond_bounds_are_refused(
    release: Release, s3: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy_to(release, s3)
    with monkeypatch.context() as patch:
        patch.setattr("kinectbench.release.fetch.MOST_FILES", 10)
        with pytest.raises(ReleaseError, match="lists more than 10 files"):
            fetch_release(s3, tmp_path / "got")
    monkeypatch.setattr("kinectbench.release.fetch.most_bytes", lambda name: 10)
    with pytest.raises(KinectBenchError, match="bytes are more than the 10 it may have"):
        fetch_release(s3, tmp_path / "got")


def test_folders_that_hold_something_else_are_left(
    release: Release, analytic: Path, web: str, tmp_path: Path
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    shutil.copytree(analytic / "benchmark", tmp_path / "other")
    (tmp_path / "file").write_text("mine")
    for name, said in (
        ("mine", "something else than a release"),
        ("other", "another release"),
        ("file", "a file"),
    ):
        before = hashes(tmp_path)
        with pytest.raises(ReleaseError, match=said):
            fetch_release(web, tmp_path / name)
        assert hashes(tmp_path) == before


# --- commands -----------------------------------------------------------------------------------------


def test_verify_says_of_a_url_what_it_says_of_a_folder(
    command: Command, release: Release, s3: str, web: str, tmp_path: Path
) -> None:
    assert command(tmp_path, "verify", web).out == f"{web}: all well\n"
    store, (first, second) = copy_to(release, s3), [target.file for target in release.targets[:2]]
    store.put(first, b"changed")
    store.delete([second])
    store.put("extra.txt", b"1")
    result = command(tmp_path, "verify", "--json", s3)
    problems = json.loads(result.out)
    assert result.status == 1
    assert f"{first}: changed since it was published (SHA-256 differs)" in problems
    assert f"{second}: missing" in problems and "extra.txt: not part of the release" in problems


def test_fetch_and_score_by_url(
    command: Command, release: Release, web: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KINECTBENCH_CACHE", str(tmp_path / "cache"))
    fetched = command(tmp_path, "fetch", web, "--json", "--split", "test", "--out", "got")
    told = json.loads(fetched.out)
    assert told["benchmark_sha256"] == release.benchmark_sha256 and told["release"] == "got"
    words = ("--no-surface", "--out", "scores", "--jobs", "1")
    assert command(tmp_path, "score", "--benchmark", web, *words).status == 0
    scores = json.loads((tmp_path / "scores" / "empty" / "scores.json").read_text())
    assert scores["benchmark_sha256"] == release.benchmark_sha256
    assert cached_release(web) == tmp_path / "cache" / "releases" / release.benchmark_sha256
    bad = command(tmp_path, "fetch", web, "--split", "all")
    assert bad.status == 2 and "--split all: choose among" in bad.err
    none = command(tmp_path, "fetch", web, "--category", "unicorn", "--out", "none")
    assert none.status == 2 and "no pair of that split and category" in none.err
    assert command(tmp_path, "fetch", f"{web}/none").status == 1
