"""Files from plain web servers that stop, lie, change and never end: each becomes the file or one line."""

import hashlib
import http.client
import random
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from pathlib import Path

import pytest
from raising import raises
from s3_server import free_port
from scan_server import Fault, ScanServer

from kinectbench.core.errors import StorageError
from kinectbench.core.store import attempts
from kinectbench.core.store import download as downloads
from kinectbench.core.store.download import Content, download, partial_downloads

CONTENT = b"PK\x03\x04" + random.Random(0).randbytes(700_000)
KNOWN = Content(len(CONTENT), hashlib.sha256(CONTENT).hexdigest())
# With which no test takes longer: of a server that fails for good.
PATIENCE = "1"


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[ScanServer]:
    monkeypatch.setenv(attempts.PATIENCE_VARIABLE, PATIENCE)
    monkeypatch.setenv("no_proxy", "*")
    with ScanServer({"/a.zip": CONTENT}) as found:
        yield found


def refuse_pages(path: Path) -> None:
    if path.read_bytes().startswith(b"<"):
        raise StorageError(f"{path}: sends a page")


def said(*urls: str, path: Path, known: Content | None = None) -> str:
    """The one line that a download ends with."""
    begun_at = time.monotonic()
    with pytest.raises(StorageError) as error:
        download(urls, path, *((known.sha256, known.size) if known else ()), check=refuse_pages)
    assert time.monotonic() - begun_at < 10
    assert not path.exists() and "\n" not in str(error.value)
    return str(error.value)


def test_two_interruptions_are_gone_on_from(server: ScanServer, tmp_path: Path) -> None:
    server.choose = lambda number, path: "cut" if number in (0, 2) else ""
    assert download([f"{server.url}/a.zip"], tmp_path / "a.zip") == KNOWN
    assert (tmp_path / "a.zip").read_bytes() == CONTENT and partial_downloads(tmp_path / "a.zip") == []
    ranges = [asked for _, asked in server.asked if asked]
    half = len(CONTENT) // 2
    assert ranges == [f"bytes={half}-", f"bytes={half + (len(CONTENT) - half) // 2}-"]


def test_the_next_call_goes_on_where_the_last_one_stopped(server: ScanServer, tmp_path: Path) -> None:
    server.choose = lambda number, path: "cut" if number == 0 else "busy"
    assert "answers 503" in said(f"{server.url}/a.zip", path=tmp_path / "a.zip")
    (left,) = partial_downloads(tmp_path / "a.zip")
    assert left.stat().st_size == len(CONTENT) // 2
    server.choose = lambda number, path: ""
    assert download([f"{server.url}/a.zip"], tmp_path / "a.zip") == KNOWN
    assert server.asked[-1][1] == f"bytes={len(CONTENT) // 2}-"


def test_a_server_without_ranges_begins_anew(server: ScanServer, tmp_path: Path) -> None:
    server.choose = lambda number, path: ("cut", "", "whole")[min(number, 2)]
    assert download([f"{server.url}/a.zip"], tmp_path / "a.zip") == KNOWN


def test_another_file_meanwhile_is_not_put_behind_the_first(server: ScanServer, tmp_path: Path) -> None:
    server.choose = lambda number, path: "cut" if number == 0 else "busy"
    said(f"{server.url}/a.zip", path=tmp_path / "a.zip")
    server.choose = lambda number, path: ""
    server.files["/a.zip"] = other = CONTENT[:4] + CONTENT[4:][::-1]
    download([f"{server.url}/a.zip"], tmp_path / "a.zip")
    assert (tmp_path / "a.zip").read_bytes() == other


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("lie", "sends other bytes than came first (SHA-256 differs)"),
        ("short", f"has {len(CONTENT) - 1} bytes, where {len(CONTENT)} are known"),
        ("endless", "does not say how long it is"),
        ("elsewhere", "redirects to file:///etc/passwd, which is not followed"),
        ("loop", "redirects more than 5 times"),
        ("gone", "answers 404"),
        ("packed", "sends it packed (gzip)"),
        ("cut", "ended after"),
        ("busy", "answers 503"),
    ],
)
def test_a_lying_server_is_a_line_and_the_next_one_is_asked(
    server: ScanServer, tmp_path: Path, fault: Fault, words: str
) -> None:
    server.choose = lambda number, path: fault
    assert words in said(f"{server.url}/a.zip", path=tmp_path / "a.zip", known=KNOWN)
    with ScanServer({"/b.zip": CONTENT}) as good:
        urls = [f"{server.url}/a.zip", f"{good.url}/b.zip"]
        assert download(urls, tmp_path / "a.zip", KNOWN.sha256, KNOWN.size) == KNOWN


def test_what_is_no_such_file_goes_and_the_next_address_is_asked(server: ScanServer, tmp_path: Path) -> None:
    server.choose = lambda number, path: "page"
    assert said(f"{server.url}/a.zip", path=tmp_path / "a.zip").endswith(": sends a page")
    assert list(tmp_path.iterdir()) == []
    with ScanServer({"/a.zip": CONTENT}) as good:
        urls = [f"{server.url}/a.zip", f"{good.url}/a.zip"]
        assert download(urls, tmp_path / "a.zip", check=refuse_pages) == KNOWN


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("ftp://127.0.0.1/a.zip", "which is not followed"),
        ("data:,PK", "which is not followed"),
        ("http://[::1", "127.0.0.1"),
        ("http://127.0.0.1:99999/", "127.0.0.1"),
        ("http://127.0.0.1:x/", "nonnumeric port"),
        ("http:///a.zip", "redirects more than 5 times"),
        ("http://h h/", "127.0.0.1"),
        ("http://\xe4.invalid/\xe4", "127.0.0.1"),
        ("", "127.0.0.1"),
    ],
)
def test_redirections_to_no_web_server(server: ScanServer, tmp_path: Path, place: str, words: str) -> None:
    server.choose, server.place = lambda number, path: "elsewhere", place
    assert words in said(f"{server.url}/a.zip", path=tmp_path / "a.zip")


def test_a_redirection_to_a_web_server_is_followed(server: ScanServer, tmp_path: Path) -> None:
    with ScanServer({"/moved/b.zip": CONTENT}, lambda number, path: "cut" if number == 0 else "") as good:
        server.choose, server.place = lambda number, path: "elsewhere", f"{good.url}/moved/b.zip"
        assert download([f"{server.url}/a.zip"], tmp_path / "a.zip") == KNOWN
        assert [asked for _, asked in good.asked if asked] == [f"bytes={len(CONTENT) // 2}-"]


def test_a_range_that_was_not_asked_for(server: ScanServer, tmp_path: Path) -> None:
    server.choose = lambda number, path: ("cut", "", "shifted")[min(number, 2)]
    assert "it sends 'bytes 0-" in said(f"{server.url}/a.zip", path=tmp_path / "a.zip")


def test_a_larger_file_than_one_may_be_is_refused_before_it_comes(server: ScanServer, tmp_path: Path) -> None:
    with raises(StorageError, "storage.not-fetched", match=f"{len(CONTENT)}.*1000"):
        download([f"{server.url}/a.zip"], tmp_path / "a.zip", most_bytes=1000)
    assert list(tmp_path.iterdir()) == []


def test_without_a_network_one_line_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("no_proxy", "*")
    begun_at = time.monotonic()
    line = said("https://nowhere.invalid/a.zip", "https://neither.invalid/a.zip", path=tmp_path / "a.zip")
    assert "nowhere.invalid: no such host is known; check the network" in line and "neither.invalid" in line
    assert time.monotonic() - begun_at < 5


def test_nobody_listens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(attempts.PATIENCE_VARIABLE, PATIENCE)
    monkeypatch.setenv("no_proxy", "*")
    line = said(f"http://127.0.0.1:{free_port()}/a.zip", path=tmp_path / "a.zip")
    assert "Connection refused" in line and "run the same command again" in line


def test_drops_are_no_progress(server: ScanServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that gives a byte now and then is given up, however long it would go on."""
    monkeypatch.setattr(downloads, "WITHIN_S", 0.2)
    real = http.client.HTTPResponse.read1

    def slowly(answer: http.client.HTTPResponse, most: int = -1) -> bytes:
        time.sleep(0.05)
        return real(answer, 1)

    monkeypatch.setattr(http.client.HTTPResponse, "read1", slowly)
    assert "bytes in 0 s" in said(f"{server.url}/a.zip", path=tmp_path / "a.zip")


def test_headers_that_never_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, server: ScanServer) -> None:
    monkeypatch.setattr(downloads, "HEADERS_S", 0.3)

    def answer(to: BaseHTTPRequestHandler, fault: str) -> None:
        for _ in range(99):
            to.wfile.write(b"H")
            time.sleep(0.1)

    monkeypatch.setattr(server, "_answer", answer)
    begun_at = time.monotonic()
    said(f"{server.url}/a.zip", path=tmp_path / "a.zip")
    assert time.monotonic() - begun_at < 6


def test_what_has_no_room_does_not_come(server: ScanServer, tmp_path: Path) -> None:
    def room(size: int) -> None:
        raise StorageError(f"no room for {size}")

    with raises(StorageError, "storage.damaged", match=f"for {len(CONTENT)}"):
        download([f"{server.url}/a.zip"], tmp_path / "a.zip", room=room)
    assert list(tmp_path.iterdir()) == []
