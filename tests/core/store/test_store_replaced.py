"""A download that is resumed from a server without ETags, after the file there was replaced."""

from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import ClassVar

import pytest
from raising import raises

from kinectbench.core.errors import StorageError
from kinectbench.core.store.attempts import PATIENCE_VARIABLE
from kinectbench.core.store.store import Store

SIZE = 24 << 20  # a store hands on 10 MB at a time


class Cutting(BaseHTTPRequestHandler):
    """Cuts the first answer in half; answers the rest from the file that is there then."""

    days: ClassVar[list[int]] = []

    def do_GET(self) -> None:
        day = self.days.pop(0)
        asked = self.headers.get("Range", "")
        at = int(asked.removeprefix("bytes=").rstrip("-") or 0)
        self.send_response(206 if asked else 200)
        self.send_header("Content-Length", str(SIZE - at))
        if asked:
            self.send_header("Content-Range", f"bytes {at}-{SIZE - 1}/{SIZE}")
        self.send_header("Last-Modified", f"Mon, 0{day} Jan 2024 00:00:00 GMT")
        self.end_headers()
        self.wfile.write(str(day).encode() * (SIZE - at if asked else SIZE // 2))
        self.close_connection = True

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv(PATIENCE_VARIABLE, "2")
    monkeypatch.setenv("no_proxy", "*")
    server = ThreadingHTTPServer(("127.0.0.1", 0), Cutting)
    Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


def test_parts_of_two_files_are_not_mixed(served: str, tmp_path: Path) -> None:
    Cutting.days[:] = [1, 1]
    Store(served).fetch("a", tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == b"1" * SIZE
    Cutting.days[:] = [1, 8]  # both are Mondays
    with raises(StorageError, "storage.refused", match="was replaced"):
        Store(served).fetch("a", tmp_path / "b")
    assert not (tmp_path / "b").exists()
