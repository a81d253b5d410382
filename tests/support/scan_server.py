"""A web server of scans on the loopback, which gives ranges and, when told, misbehaves."""

import hashlib
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Literal

# cut: the connection ends in the middle; lie: other bytes of that length; short: another length; whole: 200
# in place of 206; shifted: a 206 of other bytes than asked for; endless: no length and no end; elsewhere: it
# redirects to `place`; loop: to itself; busy: 503; gone: 404; page: an HTML page; packed: a
# coding that nobody asked for.
Fault = Literal[
    "",
    "cut",
    "lie",
    "short",
    "whole",
    "shifted",
    "endless",
    "elsewhere",
    "loop",
    "busy",
    "gone",
    "page",
    "packed",
]
# Which fault a request meets, by its number from 0 and its path.
Choose = Callable[[int, str], Fault]


class ScanServer:
    """A server on a port of its own; a context manager.

    Attributes:
        files: by their paths, such as "/a.zip".
        choose: may be replaced at any time.
        place: where `elsewhere` redirects to.
        asked: (path, range or "") of each request so far.
        most_at_once: of requests that were answered at the same time.
    """

    def __init__(self, files: dict[str, bytes], choose: Choose = lambda number, path: "") -> None:
        self.files, self.choose = files, choose
        self.place = "file:///etc/passwd"
        self.asked: list[tuple[str, str]] = []
        self.most_at_once = self._now = 0
        self._counting = threading.Lock()
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                with owner._counting:
                    owner._now += 1
                    owner.most_at_once = max(owner.most_at_once, owner._now)
                    number = len(owner.asked)
                    owner.asked.append((self.path, self.headers.get("Range", "")))
                try:
                    owner._answer(self, owner.choose(number, self.path))
                except OSError:
                    pass
                finally:
                    with owner._counting:
                        owner._now -= 1

            def log_message(self, *args: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def __enter__(self) -> "ScanServer":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(10)

    def _answer(self, to: BaseHTTPRequestHandler, fault: Fault) -> None:
        content = self.files.get(to.path)
        if content is None or fault == "gone":
            _end(to, 404)
            return
        if fault in ("busy", "elsewhere", "loop"):
            place = {"elsewhere": self.place, "loop": to.path}.get(fault, "")
            _end(to, 302 if place else 503, place)
            return
        tag = f'"{hashlib.sha256(content).hexdigest()[:16]}"'
        content = {
            "lie": content[:4] + bytes(max(0, len(content) - 4)),
            "short": content[:-1],
            "page": b"<!DOCTYPE html>" + bytes(len(content)),
        }.get(fault, content)
        asked = to.headers.get("Range", "")
        at = int(asked.removeprefix("bytes=").rstrip("-")) if asked and fault != "whole" else 0
        to.send_response(206 if at else 200)
        to.send_header("ETag", tag)
        if fault == "endless":
            to.end_headers()
            while True:
                to.wfile.write(bytes(1 << 16))
        if at:
            begin = 0 if fault == "shifted" else at
            to.send_header("Content-Range", f"bytes {begin}-{len(content) - 1}/{len(content)}")
        if fault == "packed":
            to.send_header("Content-Encoding", "gzip")
        body = content[at:]
        to.send_header("Content-Length", str(len(body)))
        to.end_headers()
        to.wfile.write(body[: len(body) // 2] if fault == "cut" else body)


def _end(to: BaseHTTPRequestHandler, status: int, place: str = "") -> None:
    to.send_response(status)
    if place:
        to.send_header("Location", place)
    to.send_header("Content-Length", "0")
    to.end_headers()
