"""URLs of stores: recognise one in place of a path, check it, join it, and print it without secrets."""

import os
import posixpath
import re
from pathlib import Path
from urllib.parse import urlsplit

from kinectbench.core.errors import SettingsError
from kinectbench.core.untrusted import printable

# Schemes that obstore opens; `s3`, `gs` and `az` need the environment variables of their command-line tools.
SCHEMES = ("s3", "s3a", "gs", "az", "abfs", "abfss", "file", "memory", "http", "https")
# Schemes whose first part is a bucket or a container.
IN_BUCKETS = ("s3", "s3a", "gs", "az", "abfs", "abfss")
# pathlib merges double slashes: a URL given as an option of type Path arrives as `s3:/bucket/name`.
_URL = re.compile(rf"({'|'.join(SCHEMES)}):(?:(/+)(.*))?")
# Two letters at least: a drive of Windows has one letter.
_OTHER = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]+):/")
NOT_READ = " is not supported; s3, gs, az, https, file are"
_WRITTEN = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]+):(/*)(.*)", re.DOTALL)
# Azure has `$web` and `container@account.dfs.core.windows.net`; a user may precede a host.
_BUCKET = re.compile(r"[A-Za-z0-9$][A-Za-z0-9._$@-]*(?=/|\?|$)")
_HOST = re.compile(r"([^/@]*@)?([^\s/@:?#\[\]]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?(?=/|\?|$)")
_SECRET = re.compile(r"(//)[^/]*@")
MISSING = "needs obstore; run pip install 'kinectbench[cluster]'"
# Variables that the Rust crate object_store reads; it panics if their value is no URL.
ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT")


def url_of(path: str | Path) -> str | None:
    """Return the URL that a path argument stands for, without trailing slash; None for a local path."""
    match = _URL.fullmatch(str(path))
    if match is None:
        return None
    scheme, slashes, path_part = match[1], match[2] or "", (match[3] or "").rstrip("/")
    if scheme in ("file", "memory"):
        return f"{scheme}:///{path_part}" if slashes else None
    return f"{scheme}:///{path_part}" if len(slashes) > 2 and path_part else f"{scheme}://{path_part}"


def other_scheme(path: str | Path) -> str | None:
    """Return an error message for a URL of an unsupported scheme; None for any other path."""
    match = _OTHER.match(str(path))
    if match is None or url_of(path) is not None or Path(path).parts[:1] != (f"{match[1]}:",):
        return None
    return f"{match[1]}://{NOT_READ}"


def unusable(text: str) -> str | None:
    """Return why a URL that the user typed is invalid; None if it is valid or the text is no URL.

    Call this before the text becomes a Path, which merges slashes, so that `s3:///x` would name the bucket x.
    """
    written = _WRITTEN.fullmatch(text)
    if written is None or (written[3] and len(written[2]) < 2):
        return None
    scheme, slashes, path_part = written[1], written[2], written[3]
    if scheme not in SCHEMES:
        return f"{scheme}://{NOT_READ}" if slashes else None
    if scheme == "file":
        return f"{_shown(text)}: wanted file:///PATH, of this machine" if len(slashes) == 2 else None
    if scheme == "memory":
        return None
    part = "bucket" if scheme in IN_BUCKETS else "host"
    if len(slashes) == 2 and (_BUCKET if part == "bucket" else _HOST).match(path_part):
        return None
    none = len(slashes) != 2 or not re.match(r"[^/?@:]", path_part)
    message = f"no {part} in the URL" if none else f"no {part} can be called so"
    return f"{_shown(text)}: {message}; wanted {scheme}://{part.upper()}/…"


def is_web(url: str) -> bool:
    """Whether a URL is that of a plain web server: files can be read by name, but not listed or written."""
    return url.startswith(("http://", "https://"))


def joined(url: str, name: str) -> str:
    """Return the URL of a file below a URL; `name` is relative, with "/" between folders."""
    return posixpath.join(url, name)


def parent_of(url: str) -> str:
    """Return the URL of the parent folder."""
    return url.rpartition("/")[0]


def shown(place: str | Path) -> str:
    """Return a path or URL to print, without user, password and query."""
    url = url_of(place)
    return str(place) if url is None else _shown(url)


def _shown(url: str) -> str:
    plain = _SECRET.sub(r"\1", url)
    return f"{plain.partition('?')[0]}?…" if "?" in plain and not plain.startswith("file:") else plain


def require_usable(url: str, place: str) -> None:
    """Check for problems that a retry cannot solve: no package obstore, an unusable URL, or a bad endpoint.

    `place` is the URL as messages show it.

    Raises:
        SettingsError: one of these problems.
    """
    try:
        import obstore  # noqa: F401
    except ImportError:
        raise SettingsError(f"{place}: {MISSING}", what="no-package") from None
    scheme = url.partition(":")[0]
    if text := unusable(url):
        raise SettingsError(text, what="bad-url")
    for name in ENDPOINTS if scheme in ("s3", "s3a") else ():
        endpoint = os.environ.get(name, "")
        if endpoint and not _is_endpoint(endpoint):
            text = printable(endpoint.rpartition("@")[2], 80)
            raise SettingsError(
                f"{name}={text}: must begin with http:// or https:// and name a host", what="bad-environment"
            )


def _is_endpoint(text: str) -> bool:
    """Whether an endpoint is a usable URL."""
    try:
        parts = urlsplit(text)
        _ = parts.port
    except ValueError:
        return False
    return bool(re.match(r"https?://[!-~]+$", text)) and bool(parts.hostname)
