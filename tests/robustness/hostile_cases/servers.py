"""Servers that mean no good: stores that list without end, ports that are silent; and their cases.

    python tests/robustness/hostile_cases/servers.py KIND PORT

is such a server, in a process of its own that ends by itself.
"""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlparse

sys.path.append(str(Path(__file__).resolve().parents[1]))

from hostile_cases.case import Case

# No case waits longer, with the time of its command.
LIVES_S = 100
EMPTY, FLOODING, SILENT = "empty pages", "pages without end", "silent"
PAGE = 1000
SUMS = b"0" * 64 + b"  benchmark.json\n"
YAML = "name: b\nrecordings: [{id: r, path: recordings/r, category: chair}]\n"
ROW = (
    "<Contents><Key>{}/{}</Key><Size>1</Size><ETag>e</ETag>"
    "<LastModified>2024-01-01T00:00:00.000Z</LastModified></Contents>"
)
ANSWER = (
    '<?xml version="1.0"?><ListBucketResult><Name>b</Name><Prefix></Prefix><KeyCount>{}</KeyCount>'
    "<MaxKeys>1000</MaxKeys><IsTruncated>true</IsTruncated>{}"
    "<NextContinuationToken>{}</NextContinuationToken></ListBucketResult>"
)


class _Listing(BaseHTTPRequestHandler):
    """A store that has every file, and every page of whose listings says that there is more."""

    protocol_version = "HTTP/1.1"
    rows = 0

    def do_GET(self) -> None:
        query = parse_qs(urlparse(self.path).query)
        if "list-type" not in query:
            self._answer(self._file())
            return
        page = int(query.get("continuation-token", ["0"])[0])
        below = query.get("prefix", [""])[0].rstrip("/")
        rows = "".join(ROW.format(below, f"{page * self.rows + n:012d}") for n in range(self.rows))
        content = ANSWER.format(self.rows, rows, page + 1).encode()
        self._answer(content)

    def do_HEAD(self) -> None:
        self._answer(self._file())

    def _file(self) -> bytes:
        """A list of hashes, or a benchmark of one recording in the store."""
        return YAML.encode() if urlparse(self.path).path.endswith(".yaml") else SUMS

    def _answer(self, content: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "application/xml")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("ETag", "e")
        self.send_header("Last-Modified", "Mon, 01 Jan 2024 00:00:00 GMT")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, *_: object) -> None: ...


class _Flood(_Listing):
    rows = PAGE


def serve(kind: str, port: int) -> None:
    """Be a server for a while."""
    if kind == SILENT:
        with socket.create_server(("127.0.0.1", port), backlog=64):
            time.sleep(LIVES_S)
        return
    server = ThreadingHTTPServer(("127.0.0.1", port), _Flood if kind == FLOODING else _Listing)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    time.sleep(LIVES_S)


def free_port() -> int:
    """A port that nobody listens on now."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port: int = taken.getsockname()[1]
        return port


def started(kind: str, port: int) -> Callable[[Path], None]:
    """Writes nothing, but starts a server that outlives whoever starts it, and waits until it listens."""

    def make(folder: Path) -> None:
        command = [sys.executable, str(Path(__file__).resolve()), kind, str(port)]
        nothing = subprocess.DEVNULL
        subprocess.Popen(
            command, cwd="/", stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True
        )
        end = time.monotonic() + 20
        while time.monotonic() < end:
            with socket.socket() as tried:
                if tried.connect_ex(("127.0.0.1", port)) == 0:
                    return
            time.sleep(0.1)
        raise TimeoutError(f"{kind}: the server did not start")

    return make


LISTING = (
    "verify s3://b/benchmark",
    "verify --checksums s3://b/benchmark",
    "build --config s3://b/lab/benchmark.yaml --jobs 1",
    "gc --config s3://b/lab/benchmark.yaml",
)
CREDENTIALS = {
    **{"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"},
    "KINECTBENCH_STORE_PATIENCE_S": "2",
}
# A store may take 65 s with its next page (`LISTED_S` in kinectbench/core/store/store.py).
WAITING = Case("M6", "", "", statuses=(1, 3), most_idle_s=70)


def cases() -> Iterator[Case]:
    for kind in (EMPTY, FLOODING):
        for command in LISTING:
            port = free_port()
            variables = CREDENTIALS | {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}"}
            yield replace(
                WAITING,
                name=f"a store of {kind}",
                command=command,
                make=started(kind, port),
                variables=variables,
            )
    port = free_port()
    yield replace(
        WAITING,
        name="a scheduler that is silent",
        command=f"build --jobs 1 --cluster tcp://127.0.0.1:{port}",
        make=_with_yaml(started(SILENT, port)),
        says="no scheduler answers there",
    )


def _with_yaml(make: Callable[[Path], None]) -> Callable[[Path], None]:
    """A benchmark of one recording beside the server."""

    def both(folder: Path) -> None:
        (folder / "benchmark.yaml").write_text(YAML, encoding="utf-8")
        make(folder)

    return both


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]))
