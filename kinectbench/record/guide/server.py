"""The guide's page: a small server on this machine, behind a token.

It listens on 127.0.0.1. A request must name that host (no rebinding of names), come from its own page if it
has an origin, and begin with a random token. It works over an SSH tunnel, with any port at the other end.
"""

import hmac
import secrets
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from urllib.parse import urlsplit

from kinectbench.core.errors import SettingsError

HOST, HOSTS = "127.0.0.1", ("127.0.0.1", "localhost")
TOKEN_BYTES = 16
# Files of the package by their names below the token.
FILES: Mapping[str, tuple[str, str]] = {
    "": ("record/guide/page.html", "text/html; charset=utf-8"),
    "page.css": ("record/guide/page.css", "text/css; charset=utf-8"),
    "page.js": ("record/guide/page.js", "text/javascript; charset=utf-8"),
    "three.js": ("report/vendor/three/three.bundle.min.js", "text/javascript; charset=utf-8"),
}
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
# What is asked for again and again: takes the query; content type and bytes, or None if there is nothing.
Answer = Callable[[str], tuple[str, bytes] | None]
# What is posted: takes the body, and says in a sentence why it cannot be used; "": it is.
TakePost = Callable[[bytes], str]
# A click is 60 bytes.
MOST_POSTED_BYTES = 1000


class PageServer:
    """Serves the page, and what it asks for.

    Attributes:
        url: where the page is, with its token.
    """

    def __init__(
        self, answers: Mapping[str, Answer], port: int = 0, posts: Mapping[str, TakePost] | None = None
    ) -> None:
        """Start it, on threads of its own.

        Args:
            answers: by the name below the token.
            posts: by the name below the token.
            port: 0: one that is free.

        Raises:
            SettingsError: the port cannot be had.
        """
        token = secrets.token_urlsafe(TOKEN_BYTES)
        own = {"token": token, "answers": dict(answers), "posts": dict(posts or {})}
        handler = type("Handler", (_Handler,), own)
        try:
            self._server = _Server((HOST, port), handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise SettingsError(f"--port {port}: cannot be used ({reason}); name another, or none") from error
        self.url = f"http://{HOST}:{self._server.server_address[1]}/{token}/"
        threading.Thread(target=self._server.serve_forever, name="page", daemon=True).start()

    def close(self) -> None:
        """Stop it."""
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Nothing is printed: a reader that has gone is no error, and the terminal has one line."""


class _Handler(BaseHTTPRequestHandler):
    """Answers GET and POST; what is not asked for rightly is refused without a reason."""

    token: str
    answers: Mapping[str, Answer]
    posts: Mapping[str, TakePost]
    protocol_version = "HTTP/1.1"
    # A connection that says nothing is closed.
    timeout = 30

    def do_GET(self) -> None:
        """Answer with a file of the page, or with what is asked for again and again."""
        name = self._allowed()
        if name is None:
            return self._answer(HTTPStatus.FORBIDDEN, "text/plain", b"")
        if name in FILES:
            path, kind = FILES[name]
            return self._answer(
                HTTPStatus.OK, kind, resources.files("kinectbench").joinpath(path).read_bytes()
            )
        if name not in self.answers:
            return self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"")
        answer = self.answers[name](urlsplit(self.path).query)
        if answer is None:
            return self._answer(HTTPStatus.NO_CONTENT, "text/plain", b"")
        return self._answer(HTTPStatus.OK, *answer)

    def do_POST(self) -> None:
        """Take what the page posts; the page itself must ask, with its origin."""
        name, length = self._allowed(), self.headers.get("Content-Length", "")
        self.close_connection = True  # a body that is refused is not read
        if name is None or self.headers.get("Origin") is None:
            return self._answer(HTTPStatus.FORBIDDEN, "text/plain", b"")
        if name not in self.posts or not _is_short(length):
            return self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"")
        why = self.posts[name](self.rfile.read(int(length)))
        status = HTTPStatus.UNPROCESSABLE_ENTITY if why else HTTPStatus.NO_CONTENT
        return self._answer(status, "text/plain; charset=utf-8", why.encode())

    def _allowed(self) -> str | None:
        """The name below the token; None: the request is not from the page's reader."""
        host = self.headers.get("Host", "")
        origin = self.headers.get("Origin")
        if _name_of(host) not in HOSTS or origin not in (None, f"http://{host}"):
            return None
        token, _, name = urlsplit(self.path).path.removeprefix("/").partition("/")
        return name if hmac.compare_digest(token.encode(), self.token.encode()) else None

    def _answer(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        for header, value in HEADERS.items():
            self.send_header(header, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is printed: the terminal has one line."""


def _is_short(length: str) -> bool:
    """Whether a Content-Length is one of a body that is read."""
    return length.isdecimal() and len(length) < 9 and int(length) <= MOST_POSTED_BYTES


def _name_of(host: str) -> str:
    """The name in a Host header, without its port."""
    name, colon, port = host.partition(":")
    return name if not colon or port.isdecimal() else ""
