"""The guide's page: a small server on this machine, behind a token.

It listens on 127.0.0.1. A request must name that host (against DNS rebinding), must not come from another
origin than the page, and its path must begin with a random token. An SSH tunnel from any local port works.
"""

import hmac
import secrets
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from urllib.parse import urlsplit

from kinectbench.core import SettingsError

HOST, HOSTS = "127.0.0.1", ("127.0.0.1", "localhost")
TOKEN_BYTES = 16
# Files of the package, by their names below the token.
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
# Answers a repeated request: takes the query, and returns content type and bytes, or None.
Answer = Callable[[str], tuple[str, bytes] | None]
# Handles a post: takes the body, and returns a sentence why it cannot be used; "" if it can.
TakePost = Callable[[bytes], str]
# Largest body; a click has 60 bytes.
MOST_POSTED_BYTES = 1000


class PageServer:
    """Serves the page and answers its requests.

    Attributes:
        url: URL of the page, with its token.
    """

    def __init__(
        self, answers: Mapping[str, Answer], port: int = 0, posts: Mapping[str, TakePost] | None = None
    ) -> None:
        """Start the server on separate threads.

        Args:
            answers: {name in the URL: function from the query to (content type, bytes), or None}.
            posts: {name in the URL: function from the body of a POST to the text of the answer}.
            port: the port; 0: any free port.

        Raises:
            SettingsError: the port is not available.
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
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Print nothing: a client that has gone is no error, and the recorder owns the terminal."""


class _Handler(BaseHTTPRequestHandler):
    """Answers GET and POST; requests that do not come from the page get an empty 403, other methods 501."""

    token: str
    answers: Mapping[str, Answer]
    posts: Mapping[str, TakePost]
    protocol_version = "HTTP/1.1"
    # Seconds after which a silent connection is closed.
    timeout = 30

    def do_GET(self) -> None:
        """Answer with a file of the page, or with data that the page polls."""
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
        """Handle a post by the page; the request must state the page's origin."""
        name, length = self._allowed(), self.headers.get("Content-Length", "")
        self.close_connection = True  # a refused body is not read
        if name is None or self.headers.get("Origin") is None:
            return self._answer(HTTPStatus.FORBIDDEN, "text/plain", b"")
        if name not in self.posts or not _is_short(length):
            return self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"")
        why = self.posts[name](self.rfile.read(int(length)))
        status = HTTPStatus.UNPROCESSABLE_ENTITY if why else HTTPStatus.NO_CONTENT
        return self._answer(status, "text/plain; charset=utf-8", why.encode())

    def _allowed(self) -> str | None:
        """Return the part of the path after the token; None if host, origin or token is wrong."""
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
        """Print nothing: the recorder owns the terminal."""


def _is_short(length: str) -> bool:
    """Return whether a Content-Length is small enough for the body to be read."""
    return length.isdecimal() and len(length) < 9 and int(length) <= MOST_POSTED_BYTES


def _name_of(host: str) -> str:
    """Return the name in a Host header, without its port."""
    name, colon, port = host.partition(":")
    return name if not colon or port.isdecimal() else ""
