"""Download files from web servers: from several addresses, resumable, and verified."""

import contextlib
import errno
import hashlib
import http.client
import socket
import ssl
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urljoin

from kinectbench._version import __version__
from kinectbench.core.errors import KinectBenchError, StorageError
from kinectbench.core.storage import sha256_file, storage_errors
from kinectbench.core.store.address import is_web, shown
from kinectbench.core.store.attempts import (
    LASTING,
    PASSING,
    StoreGoneError,
    UnsettledError,
    check_stopped,
    has_answered,
    note_answer,
    patiently,
)
from kinectbench.core.untrusted import COPIED_BYTES, printable

# Time limits: until the next bytes arrive, and until all headers have; as for one request to a store.
NEXT_S, HEADERS_S = 30.0, 60.0
# A slower download is given up: 1 kB/s is a seventh of a 56k modem's rate.
LEAST_BYTES, WITHIN_S = 64 << 10, 60.0
# Browsers follow 20, curl 50; file servers need one or two.
MOST_REDIRECTS = 5
FULL = (errno.ENOSPC, errno.EDQUOT)
# Largest download: 46 times the average of Redwood's scans (4 TB by 10,933).
MOST_FILE_BYTES = 16 << 30
# Suffix of a partial download, which lies beside the final file.
ENDING = ".part"


class Content(NamedTuple):
    """Size of a file in bytes, and its SHA-256 as hex."""

    size: int
    sha256: str


class _RefusedError(Exception):
    """This address will never deliver the file."""


class _UnknownError(_RefusedError):
    """The host is unknown: a wrong name, or no network."""


class _BrokenError(Exception):
    """This address does not deliver the file now, but may later."""


def download(
    urls: Sequence[str],
    path: Path,
    sha256: str | None = None,
    size: int | None = None,
    *,
    check: Callable[[Path], object] = lambda path: None,
    most_bytes: int = MOST_FILE_BYTES,
    room: Callable[[int], object] = lambda size: None,
) -> Content:
    """Download a file; it appears at `path` when it is complete and verified.

    A partial download lies beside `path`, and the next call resumes it if the server states an ETag or a
    date. The addresses are tried in turn, over and over until `attempts.patience_s` has passed without
    progress, or all refuse.

    Args:
        urls: addresses of the same file.
        path: place of the file; its folder is created.
        sha256: expected SHA-256; None: any content is accepted.
        size: expected bytes; None: unknown.
        check: called with the complete file; if it raises a KinectBenchError, the next address is tried.
        most_bytes: a larger file is refused.
        room: called before the download with the number of bytes to come; may raise to refuse it.

    Raises:
        StoreGoneError: no server answers; the message has the reasons.
        StorageError: no address delivers the file; the message has the reasons. Or the disk cannot be
            written.
    """
    order, furthest = list(urls), 0

    def come(at: int) -> None:
        nonlocal furthest
        furthest = max(furthest, at // LEAST_BYTES)

    def attempt() -> Content:
        """Try each address once, and return the content from the first one that delivers the file."""
        refused, broken, unknown = list[str](), list[str](), 0
        for url in tuple(order):
            try:
                return _Download(url, path, sha256, size, check, most_bytes, room, come).run()
            except _RefusedError as error:
                refused.append(f"{_host(url)}: {error}")
                unknown += isinstance(error, _UnknownError)
            except _BrokenError as error:
                broken.append(f"{_host(url)}: {error}")
            order.append(order.pop(0))  # the next attempt starts with another address
        if broken:
            raise UnsettledError("; ".join((*broken, *refused)))
        kind = StoreGoneError if unknown == len(order) else StorageError
        raise kind(f"{path.name} cannot be fetched: {'; '.join(refused)}", what="not-fetched")

    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    content = patiently(_shown(urls[0]), attempt, lambda: furthest, lambda: _any_answers(urls))
    for left in partial_downloads(path):
        left.unlink(missing_ok=True)
    return content


def partial_downloads(path: Path) -> list[Path]:
    """Return the partial downloads of a file, which lie beside its final path."""
    names = path.parent.glob("*" + ENDING) if path.parent.is_dir() else ()
    # The name between is a hash: x.1.tgz.HASH.part is no part of x.
    return [each for each in names if each.name.removesuffix(ENDING).rpartition(".")[0] == path.name]


@dataclass(frozen=True)
class _Download:
    """One attempt to download the file from one address.

    Attributes:
        url: the address.
        path, sha256, size, check, most_bytes, room: as for `download`.
        come: called with the offset that the download has reached, bytes.
    """

    url: str
    path: Path
    sha256: str | None
    size: int | None
    check: Callable[[Path], object]
    most_bytes: int
    room: Callable[[int], object]
    come: Callable[[int], None]

    def run(self) -> Content:
        """Download the file to its final path.

        Raises:
            _RefusedError, _BrokenError: this address does not deliver the file.
            StorageError: the disk cannot be written, or `room` raises it.
        """
        with _opened(self.url) as answer:
            size, mark = self._checked_size(answer), _mark(answer)
            key = hashlib.sha256(f"{self.url}\n{mark}\n{size}".encode()).hexdigest()[:8]
            part = self.path.with_name(f"{self.path.name}.{key}{ENDING}")
            at = part.stat().st_size if mark and part.is_file() else 0
            at = at if at <= size else 0
            self.room(size - at)
            if at == 0:
                self._copy(answer, part, 0, size)
        if 0 < at < size:
            with _opened(self.url, at, mark) as answer:
                self._copy(answer, part, self._goes_on(answer, at, size), size)
        return self._taken(part, size)

    def _checked_size(self, answer: http.client.HTTPResponse) -> int:
        coding, length = answer.headers.get("Content-Encoding"), answer.headers.get("Content-Length", "")
        if coding not in (None, "", "identity"):
            raise _RefusedError(f"sends it packed ({printable(coding, 20)}), though nobody asked for that")
        if not (length.isascii() and length.isdigit() and len(length) < 20):
            raise _RefusedError("does not say how long it is (no Content-Length)")
        size = int(length)
        if size > self.most_bytes:
            raise _RefusedError(f"{size} bytes are more than the {self.most_bytes} it may have")
        if self.size not in (None, size):
            raise _RefusedError(f"has {size} bytes, where {self.size} are known")
        return size

    def _goes_on(self, answer: http.client.HTTPResponse, at: int, size: int) -> int:
        """Offset of the first byte in a response: `at` as requested, or 0 if the whole file is sent."""
        if answer.status == http.HTTPStatus.OK:
            if self._checked_size(answer) != size:
                raise _BrokenError("changed while it was fetched")
            return 0
        span = answer.headers.get("Content-Range", "")
        if answer.status != http.HTTPStatus.PARTIAL_CONTENT or span != f"bytes {at}-{size - 1}/{size}":
            raise _RefusedError(f"asked for bytes from {at} of {size}, it sends '{printable(span, 40)}'")
        return at

    def _copy(self, answer: http.client.HTTPResponse, part: Path, at: int, size: int) -> None:
        """Write the bytes of a response to a partial file, from offset `at` (0: a new file) up to `size`."""
        with storage_errors(self.path), part.open("ab" if at else "wb") as out:
            since, then = time.monotonic(), at
            while at < size:
                check_stopped()
                data = _read(answer, min(COPIED_BYTES, size - at))
                if not data:
                    raise _BrokenError(f"ended after {at} of {size} bytes")
                out.write(data)
                at += len(data)
                self.come(at)
                if time.monotonic() - since > WITHIN_S:
                    if at - then < LEAST_BYTES:
                        raise _BrokenError(f"sends {at - then} bytes in {WITHIN_S:.0f} s")
                    since, then = time.monotonic(), at

    def _taken(self, part: Path, size: int) -> Content:
        """Move a complete download to its final path if its content is as expected; else delete it.

        Raises:
            _RefusedError: the content is not as expected.
            KinectBenchError: raised by `check` because the disk is full; the download is kept.
        """
        with storage_errors(self.path):
            content = Content(size, sha256_file(part))
            problem = ""
            if self.sha256 not in (None, content.sha256):
                problem = "sends other bytes than came first (SHA-256 differs)"
            else:
                try:
                    self.check(part)
                except KinectBenchError as error:
                    if isinstance(error.__cause__, OSError) and error.__cause__.errno in FULL:
                        raise  # the archive is good, the disk is full
                    problem = str(error).removeprefix(f"{part}: ")
            if problem:
                part.unlink()
                raise _RefusedError(problem)
            part.replace(self.path)
        return content


def _mark(answer: http.client.HTTPResponse) -> str:
    """Return the HTTP validator, which changes if the content does (RFC 9110, 8.8); "" if none is given."""
    tag = str(answer.headers.get("ETag", ""))
    return str(answer.headers.get("Last-Modified", "")) if not tag or tag.startswith("W/") else tag


def _shown(url: str) -> str:
    return printable(shown(url), 200)


def _host(url: str) -> str:
    return _shown(url).split("/")[2]


def _read(answer: http.client.HTTPResponse, most: int) -> bytes:
    try:
        return answer.read1(most)
    except (OSError, http.client.HTTPException) as error:
        raise _BrokenError(_why(error)) from None


@contextlib.contextmanager
def _opened(url: str, at: int = 0, mark: str = "") -> Iterator[http.client.HTTPResponse]:
    """Open a URL from byte `at` on, or from the start if its validator is no longer `mark`; follow redirects.

    Redirects to anything but a web server, or from https to http, are refused.
    """
    headers = {"User-Agent": f"kinectbench/{__version__}", "Accept-Encoding": "identity"}
    if at:
        headers |= {"Range": f"bytes={at}-", "If-Range": mark}
    for _ in range(MOST_REDIRECTS + 1):
        answer = _answer(urllib.request.Request(url, headers=headers))
        with contextlib.closing(answer):
            place = _next(url, answer)
            if place is None:
                note_answer(url)
                yield answer
                return
            url = place
    raise _RefusedError(f"redirects more than {MOST_REDIRECTS} times")


def _any_answers(urls: Sequence[str]) -> None:
    """Check that at least one of the servers responds to a HEAD request."""
    for url in urls:
        with contextlib.suppress(_RefusedError, _BrokenError):
            _answer(urllib.request.Request(url, method="HEAD")).close()
            return
    raise _BrokenError


def _next(url: str, answer: http.client.HTTPResponse) -> str | None:
    """Return the target URL of a redirect; None if the response is the file itself."""
    status = answer.status
    if status in (http.HTTPStatus.OK, http.HTTPStatus.PARTIAL_CONTENT):
        return None
    if status in (301, 302, 303, 307, 308):
        place = _joined(url, str(answer.headers.get("Location", "")))
        if not is_web(place) or (url.startswith("https:") and not place.startswith("https:")):
            raise _RefusedError(f"redirects to {_shown(place)}, which is not followed")
        return place
    message = f"answers {status} {printable(answer.reason or '', 40)}".rstrip()
    if status in PASSING or (status >= 500 and status not in LASTING):
        raise _BrokenError(message)
    raise _RefusedError(message)


def _joined(url: str, place: str) -> str:
    try:
        return urljoin(url, place)
    except ValueError:  # brackets without an address in it
        return place


def _answer(request: urllib.request.Request) -> http.client.HTTPResponse:
    opener = urllib.request.OpenerDirector()
    # No handler of errors or redirections: they read the body of an answer, however long it is.
    for handler in (urllib.request.ProxyHandler(), _Plain(), _Secure()):
        opener.add_handler(handler)
    try:
        answer: http.client.HTTPResponse = opener.open(request, timeout=NEXT_S)
        return answer
    except urllib.error.URLError as error:
        cause = error.reason if isinstance(error.reason, OSError) else error
        kind: type[Exception] = _BrokenError
        if isinstance(cause, ssl.SSLCertVerificationError):
            kind = _RefusedError
        elif isinstance(cause, socket.gaierror) and not has_answered(request.full_url):
            kind = _UnknownError
        raise kind(_why(cause)) from None
    except (ValueError, OverflowError, http.client.InvalidURL) as error:  # an invalid host or port
        raise _RefusedError(printable(str(error), 80)) from None
    except (OSError, http.client.HTTPException) as error:
        raise _BrokenError(_why(error)) from None


def _why(error: Exception) -> str:
    if isinstance(error, socket.gaierror):
        return "no such host is known; check the network, or the address"
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"no secure connection ({printable(error.verify_message, 60)})"
    if isinstance(error, TimeoutError):
        return f"sends nothing for {NEXT_S:.0f} s"
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return printable(reason, 80)


class _Bounded(http.client.HTTPConnection):
    """An HTTP connection with a time limit for all headers together, not only for each read."""

    def getresponse(self) -> http.client.HTTPResponse:
        """Read the status and headers of the response; close the connection after `HEADERS_S`."""
        timer = threading.Timer(HEADERS_S, self._cut)
        timer.daemon = True
        timer.start()
        try:
            return super().getresponse()
        finally:
            timer.cancel()

    def _cut(self) -> None:
        if (sock := self.sock) is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)


class _BoundedTls(_Bounded, http.client.HTTPSConnection):
    pass


class _Plain(urllib.request.HTTPHandler):
    def http_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_Bounded, req)


class _Secure(urllib.request.HTTPSHandler):
    def https_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_BoundedTls, req, context=ssl.create_default_context())
