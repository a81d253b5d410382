"""URLs of places: recognised where a path may stand, joined, and shown without what is secret in them."""

import posixpath
import re
from pathlib import Path

# What obstore opens; `s3` needs the variables of the AWS command line, `gs` and `az` those of theirs.
SCHEMES = ("s3", "s3a", "gs", "az", "abfs", "abfss", "file", "memory", "http", "https")
# pathlib makes one slash of two: a URL that was an option of type Path comes as `s3:/bucket/name`.
_URL = re.compile(rf"({'|'.join(SCHEMES)}):/+(.*)")
_SECRET = re.compile(r"(//)[^/]*@")


def url_of(path: str | Path) -> str | None:
    """The URL that a path stands for, without a slash at its end; None if it is a path of this machine."""
    match = _URL.fullmatch(str(path))
    if match is None:
        return None
    scheme, rest = match[1], match[2].rstrip("/")
    return f"{scheme}:///{rest}" if scheme in ("file", "memory") else f"{scheme}://{rest}"


def is_web(url: str) -> bool:
    """Whether it is a plain web server's: files are read there by their names, and none is listed or put."""
    return url.startswith(("http://", "https://"))


def joined(url: str, name: str) -> str:
    """The URL of something below a URL; `name` is relative to it, with "/" between folders."""
    return posixpath.join(url, name)


def parent_of(url: str) -> str:
    """The URL of the folder that something lies in."""
    return url.rpartition("/")[0]


def shown(place: str | Path) -> str:
    """A path or URL as a line for people may quote it: without user, password and query."""
    url = url_of(place)
    if url is None:
        return str(place)
    plain = _SECRET.sub(r"\1", url)
    return f"{plain.partition('?')[0]}?…" if "?" in plain and not plain.startswith("file:") else plain
