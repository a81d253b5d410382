"""Files in stores: put once, replaced, read within bounds, listed; and what is said where that fails."""

import pickle
import shutil
import subprocess
import time
from functools import partial
from pathlib import Path

import pytest
from fault_proxy import Fault, FaultProxy, for_a_while
from s3_server import S3Server, free_port, start_s3
from stores import proxied, s3, s3_server, url

from kinectbench.core.errors import StorageError
from kinectbench.core.store.address import joined, parent_of, shown, url_of
from kinectbench.core.store.attempts import PATIENCE_VARIABLE, MissingObjectError
from kinectbench.core.store.store import Store, fetch_all, in_parallel

__all__ = ["proxied", "s3", "s3_server", "url"]
pytestmark = pytest.mark.xdist_group("stores")


# --- addresses ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("s3://bucket/bench/benchmark.yaml", "s3://bucket/bench/benchmark.yaml"),
        ("file:///data/bench/", "file:///data/bench"),
        ("https://host/a", "https://host/a"),
        ("gs://bucket", "gs://bucket"),
    ],
)
def test_a_url_is_known_even_as_a_path(given: str, wanted: str) -> None:
    assert url_of(given) == url_of(Path(given)) == wanted


@pytest.mark.parametrize("given", ["data/bench", "/data/s3", "C:/data", "ftp://host/a", "s3", "a/s3:/b"])
def test_a_path_is_no_url(given: str) -> None:
    assert url_of(given) is None and url_of(Path(given)) is None


def test_urls_are_joined_and_shown() -> None:
    assert joined("s3://b/lab", "build/x") == "s3://b/lab/build/x"
    assert parent_of("s3://b/lab/benchmark.yaml") == "s3://b/lab"
    assert shown("https://me:secret@host/a") == "https://host/a"


# --- reading and writing ------------------------------------------------------------------------------


def test_what_is_put_is_read_and_listed(url: str) -> None:
    store = pickle.loads(pickle.dumps(Store(url)))
    store.put("a/one", b"1")
    store.put("a/one", b"11")
    store.put("ab/two words, ä", b"2")
    assert store.read("a/one") == b"11"
    assert store.read("ab/two words, ä") == b"2"
    assert [(each.name, each.size) for each in store.objects()] == [("a/one", 2), ("ab/two words, ä", 1)]
    assert [each.name for each in store.objects("a")] == ["a/one"]
    found = store.head("a/one")
    assert found is not None and found.size == 2 and found.e_tag
    assert store.head("a/three") is None and store.read_if_there("a/three") is None
    store.delete(["a/one"])
    assert [each.name for each in store.objects()] == ["ab/two words, ä"]


def test_put_new_writes_once(url: str) -> None:
    store = Store(url)
    assert store.put_new("manifest.json", b"{}")
    assert not store.put_new("manifest.json", b"{}")
    with pytest.raises(StorageError, match=r"manifest\.json: holds something else than .* and stays so"):
        store.put_new("manifest.json", b"[]")
    assert store.read("manifest.json") == b"{}"
    assert not store.put_new("manifest.json", b"[]", same=lambda there, ours: len(there) == len(ours))


def test_files_are_fetched_whole_and_within_bounds(url: str, tmp_path: Path) -> None:
    store, content = Store(url), bytes(range(256)) * (9 << 12)
    big = tmp_path / "big"
    big.write_bytes(content)
    store.put("x/big", big)  # in two parts
    store.put("x/empty", b"")
    fetch_all(store, [("x/empty", tmp_path / "to" / "empty", 0)])
    assert (tmp_path / "to" / "empty").read_bytes() == b"" == store.read("x/empty")
    fetch_all(store, [("x/big", tmp_path / "to" / name, len(content)) for name in "abc"])
    assert all((tmp_path / "to" / name).read_bytes() == content for name in "abc")
    for call in (lambda: store.fetch("x/big", tmp_path / "d", 1000), lambda: store.read("x/big", 1000)):
        with pytest.raises(StorageError, match="bytes are more than the 1000 it may have"):
            call()
    with pytest.raises(StorageError, match="x: holds more than 0 files"):
        store.objects("x", most=0)
    with pytest.raises(MissingObjectError, match="no such file"):
        store.fetch("x/none", tmp_path / "e")
    assert {path.name for path in tmp_path.iterdir()} <= {"big", "to", "store"}


@pytest.mark.parametrize("name", ["../out", "a/../../out", "a//b"])
def test_names_that_lead_out_are_refused(url: str, name: str) -> None:
    with pytest.raises(StorageError):
        Store(url).put(name, b"1")
    assert Store(url).objects() == []


# --- failures, in one line each -----------------------------------------------------------------------


def line(url: str) -> str:
    """What is said when a file is read there."""
    with pytest.raises(StorageError) as error:
        Store(url).read("a")
    assert len(error.value.lines) == 1 and "\n" not in str(error.value) and len(str(error.value)) < 400
    return str(error.value)


def test_no_such_bucket(s3: str) -> None:
    wanted = "there is no such bucket; make it, or correct the URL"
    assert line("s3://nobody/lab") == f"s3://nobody/lab/a: {wanted}"
    for call in (lambda store: store.put("a", b"1"), lambda store: store.objects()):
        with pytest.raises(StorageError, match=wanted):
            call(Store("s3://nobody/lab2"))


def test_no_credentials(s3: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    assert "no credentials were found; set those of the store, for s3://" in line("s3://else/lab")
    assert "no credentials were found" in line("az://else/lab")


def test_a_store_that_is_not_there(monkeypatch: pytest.MonkeyPatch, s3: str) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{free_port()}")
    monkeypatch.setenv(PATIENCE_VARIABLE, "0.3")
    assert "did not answer well for 0 s (Connection refused); run the same command again" in line(
        "s3://c/lab"
    )


def test_a_folder_that_is_not_there_or_not_ours(tmp_path: Path) -> None:
    assert line(f"file://{tmp_path}/none").endswith("there is no such file; correct the URL")
    (tmp_path / "file").write_text("")
    with pytest.raises((StorageError, OSError)):
        Store(f"file://{tmp_path}/file").put("a", b"1")


def test_a_full_disk_of_the_store(tmp_path: Path) -> None:
    words = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(tmp_path)]
    if shutil.which("mount") is None or subprocess.run(words, capture_output=True).returncode:
        pytest.skip("mounting a file system is not permitted here")
    try:
        with pytest.raises(StorageError, match="the disk is full: free some space"):
            Store(f"file://{tmp_path}").put("a", bytes(1 << 20))
    finally:
        subprocess.run(["umount", "-l", str(tmp_path)], check=True)


# --- a store that answers badly -----------------------------------------------------------------------


def test_503_for_a_while_and_for_long(proxied: FaultProxy, s3: str) -> None:
    proxied.choose = for_a_while(1.0)
    Store(s3).put("a", b"1")
    assert proxied.faults.count("503") > 1 and Store(s3).read("a") == b"1"
    proxied.choose = for_a_while(60)
    assert "did not answer well for 2 s (503 Service Unavailable, SlowDown); run the same command" in line(s3)


def test_cut_uploads(proxied: FaultProxy, s3: str, tmp_path: Path) -> None:
    content = bytes(20 << 20)
    (tmp_path / "big").write_bytes(content)
    cuts = iter([True, False, True, *[False] * 1000])
    proxied.choose = lambda number, method, path: "cut" if method == "PUT" and next(cuts) else ""
    Store(s3).put("big", tmp_path / "big")
    Store(s3).put("small", b"1" * 1000)
    assert proxied.faults.count("cut") == 2
    assert [(each.name, each.size) for each in Store(s3).objects()] == [
        ("big", len(content)),
        ("small", 1000),
    ]


@pytest.mark.parametrize("fault", ["lose", "drop", "503"])
def test_answers_that_are_lost(proxied: FaultProxy, s3: str, fault: Fault) -> None:
    """What was done although nobody heard of it is found the same the second time."""
    proxied.choose = lambda number, method, path: fault if number % 3 == 0 else ""
    store = Store(s3)
    for number in range(6):
        store.put_new(f"{number}", b"same")
        with pytest.raises(StorageError, match="holds something else"):
            store.put_new(f"{number}", b"other")
    assert len(store.objects()) == 6 and proxied.faults.count(fault) > 6


def test_a_failure_ends_what_waits_beside_it(
    proxied: FaultProxy, s3: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PATIENCE_VARIABLE, "60")
    store = Store(s3)
    proxied.choose = lambda number, method, path: "" if "bad" in path else "503"
    started = time.monotonic()
    with pytest.raises(MissingObjectError):
        in_parallel([*(partial(store.read, f"busy{n}") for n in range(4)), partial(store.read, "bad")][::-1])
    assert time.monotonic() - started < 20


def test_a_store_that_was_given_up_is_not_waited_for_again(proxied: FaultProxy, s3: str) -> None:
    proxied.choose = lambda number, method, path: "503"
    line(s3)
    proxied.requests.clear()
    line(s3)
    assert len(proxied.requests) == 1
    proxied.choose = lambda number, method, path: ""
    Store(s3).put("a", b"1")
    proxied.requests.clear()
    proxied.choose = lambda number, method, path: "503" if number == 0 else ""
    assert Store(s3).read("a") == b"1" and len(proxied.requests) == 2


def test_a_store_that_is_killed_for_good(monkeypatch: pytest.MonkeyPatch) -> None:
    server: S3Server = start_s3()
    for name, value in server.variables().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv(PATIENCE_VARIABLE, "1")
    store = Store(f"s3://{server.bucket()}/killed")
    store.put("a", b"1")
    server.kill()
    assert "did not answer well for 1 s (Connection refused)" in line(store.url)
