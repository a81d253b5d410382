"""Files in stores: put once, replaced, read within bounds, listed; and what is said where that fails."""

import pickle
import shutil
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
from fault_proxy import Fault, FaultProxy, for_a_while
from raising import raises
from s3_server import S3Server, free_port, start_s3
from stores import proxied, s3, s3_server, url

from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.core.store import store as store_module
from kinectbench.core.store.address import joined, parent_of, shown, url_of
from kinectbench.core.store.attempts import PATIENCE_VARIABLE, MissingObjectError, StoreGoneError
from kinectbench.core.store.store import WAITING, Store, fetch_all, in_parallel

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


def test_a_missing_file_does_not_keep_the_others_from_being_deleted(url: str) -> None:
    store, names = Store(url), [f"a/{number:03d}" for number in range(40)]
    for name in names:
        store.put(name, b"1")
    store.delete(["a/missing", *names, "b"])
    assert store.objects() == []
    store.delete(names)


def test_put_new_writes_once(url: str) -> None:
    store = Store(url)
    assert store.put_new("manifest.json", b"{}")
    assert not store.put_new("manifest.json", b"{}")
    with raises(StorageError, "storage.other-content", match=r"manifest\.json"):
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
        with raises(StorageError, "storage.too-large", match="1000"):
            call()
    with raises(StorageError, "storage.too-large", match="than 0 files"):
        store.objects("x", most=0)
    with raises(MissingObjectError, "storage.no-file"):
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
    calls: tuple[Callable[[Store], object], ...] = (
        lambda store: store.put("a", b"1"),
        lambda store: store.objects(),
    )
    for call in calls:
        with raises(StorageError, "storage.no-bucket", match=wanted):
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
        with raises(StorageError, "storage.not-writable"):
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
        with raises(StorageError, "storage.other-content", match="holds something else"):
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
    time.sleep(1.6)
    # As long as it really was: the store failed for two seconds, and has not answered since.
    assert "did not answer well for 4 s (503" in line(s3)
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


def test_a_file_that_cannot_be_read_does_not_end_all(proxied: FaultProxy, s3: str) -> None:
    Store(s3).put("b", b"1")
    proxied.choose = lambda number, method, path: "503" if path.endswith("/a") else ""
    with raises(StorageError, "storage.no-answer", match="for 2 s") as error:
        Store(s3).read("a")
    assert not isinstance(error.value, StoreGoneError) and Store(s3).read("b") == b"1"
    proxied.choose = lambda number, method, path: "503"
    for call in (lambda: Store(s3).read("b"), lambda: Store(s3).put("b", b"2")):
        with pytest.raises(StoreGoneError):
            call()


def test_a_listing_goes_on_where_it_failed(proxied: FaultProxy, s3: str) -> None:
    """A page holds a thousand names; of the requests for pages each second one fails."""
    store, names = Store(s3), [f"many/{number:04d}" for number in range(2100)]
    in_parallel(partial(store.put, name, b"") for name in [*names, "other/0"])
    pages: list[str] = []

    def choose(number: int, method: str, path: str) -> Fault:
        if "list-type" in path:
            pages.append(path)
        return "503" if "list-type" in path and len(pages) % 2 == 0 else ""

    proxied.choose = choose
    assert [each.name for each in store.objects("many")] == names
    assert len(pages) == 5


class _EmptyPages(BaseHTTPRequestHandler):
    """A store that answers every listing with no object, and says that there is more."""

    def do_GET(self) -> None:
        page = (
            b"<ListBucketResult><Name>bucket</Name><KeyCount>0</KeyCount><MaxKeys>1000</MaxKeys>"
            b"<IsTruncated>true</IsTruncated><NextContinuationToken>on</NextContinuationToken>"
            b"</ListBucketResult>"
        )
        self.send_response(200)
        self.send_header("content-length", str(len(page)))
        self.end_headers()
        self.wfile.write(page)

    def log_message(self, format: str, *args: object) -> None:
        pass


def test_a_listing_of_empty_pages_ends(s3: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_module, "LISTED_S", 1.0)
    with ThreadingHTTPServer(("127.0.0.1", 0), _EmptyPages) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.server_port}")
        begun = time.monotonic()
        for call in (Store("s3://empty-pages").objects, Store("s3://empty-pages")._first_listed):
            with raises(StorageError, "storage.refused", match=r"s3://empty-pages.*1"):
                call()
        assert time.monotonic() - begun < 10
        server.shutdown()


def test_calls_do_not_wait_in_memory() -> None:
    ahead, ended = [], [0]

    def calls() -> Iterator[Callable[[], int]]:
        for number in range(3 * WAITING):
            ahead.append(number - ended[0])
            yield partial(int, number)

    assert in_parallel(calls(), lambda done: ended.__setitem__(0, done)) == list(range(3 * WAITING))
    assert max(ahead) <= WAITING


# --- what no further attempt would change -------------------------------------------------------------


def test_a_file_of_this_machine_that_is_missing(url: str, tmp_path: Path) -> None:
    with raises(StorageError, "storage.unreadable"):
        Store(url).put("a", tmp_path / "gone")


def test_no_such_host(monkeypatch: pytest.MonkeyPatch) -> None:
    started = time.monotonic()
    assert "no such host is known; correct the URL" in line("https://no-such-host.invalid/lab")
    assert time.monotonic() - started < 20


def test_a_certificate_that_is_not_trusted(tmp_path: Path) -> None:
    files = {"keyout": str(tmp_path / "key"), "out": str(tmp_path / "cert")}
    words = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    words += [word for name, file in files.items() for word in (f"-{name}", file)]
    if shutil.which("openssl") is None or subprocess.run(["openssl", *words], capture_output=True).returncode:
        pytest.skip("openssl is not there")
    server = HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files["out"], files["keyout"])
    server.socket = context.wrap_socket(server.socket, server_side=True)
    Thread(target=server.serve_forever, daemon=True).start()
    started = time.monotonic()
    assert "no secure connection" in line(f"https://127.0.0.1:{server.server_port}/lab")
    assert time.monotonic() - started < 20
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize("given", ["nan", "inf", "-1", "soon"])
def test_a_patience_that_is_no_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, given: str) -> None:
    monkeypatch.setenv(PATIENCE_VARIABLE, given)
    with raises(SettingsError, "settings.bad-environment", match=f"KINECTBENCH_STORE_PATIENCE_S={given}"):
        Store(f"file://{tmp_path}").objects()


FORKED = """
import os, sys
from kinectbench.core.errors import StorageError
from kinectbench.core.store.store import Store
store = Store(sys.argv[1])
store.put("a", b"1")
if os.fork() == 0:
    try:
        store.read("a")
    except StorageError as error:
        print(error, flush=True)
    os._exit(0)
os.wait()
assert store.read("a") == b"1"
"""


def test_a_forked_process_is_told_and_does_not_hang(tmp_path: Path) -> None:
    words = [sys.executable, "-c", FORKED, f"file://{tmp_path}/store"]
    told = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True).stdout
    assert told.endswith("a DataLoader's by multiprocessing_context='spawn'\n") and told.count("\n") == 1
