"""The bytes of a published file, in a release's folder, in its archive or at its URL, read in place.

A path may lead into an archive: `chairs.zip/pairs/chair_01/000.npz` is a file of the release in `chairs.zip`;
or it may be a URL. So whatever is given the path of a file, in this process or in another, reads them all.
"""

import errno
import hashlib
import os
import weakref
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from threading import Lock

from kinectbench.core.errors import ReleaseError
from kinectbench.core.store.address import shown, url_of
from kinectbench.core.store.attempts import MissingObjectError
from kinectbench.core.store.store import Store
from kinectbench.core.untrusted import decoded, read_plain
from kinectbench.release.contents import MAX_READ_BYTES, Contents, most_bytes
from kinectbench.release.opening import open_contents

# Of archives, a listing is kept of so many; one of 100,000 pairs takes 300 MB.
MOST_OPEN = 2


def release_text(path: Path) -> str:
    """A UTF-8 text file of a release or a build.

    Raises:
        ReleaseError: it cannot be read.
    """
    try:
        return decoded(_read(path, MAX_READ_BYTES), MAX_READ_BYTES, shown(path))
    except FileNotFoundError:
        raise ReleaseError(
            f"{shown(path)}: missing; make or download it again", what="missing-file"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ReleaseError(f"{shown(path)}: cannot be read ({error}); make or download it again") from error


def published_bytes(path: Path, sha256: str | None) -> bytes:
    """The bytes of a release's file in a folder, following a link, or in an archive.

    Args:
        path: the file.
        sha256: their expected hashes.

    Raises:
        ReleaseError: it is missing, larger than its kind may be, cannot be read, or is not the published one.
    """
    try:
        content = _read(path, most_bytes(str(path)))
    except OSError as error:
        reason = error.strerror or error
        raise ReleaseError(f"{shown(path)}: cannot be read ({reason}); download the release again") from error
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ReleaseError(
            f"{shown(path)}: changed since it was published (SHA-256 differs); download it again",
            what="changed",
        )
    return content


def release_store(url: str) -> Store:
    """The store of a release, or of its URL.

    Raises:
        ReleaseError: the URL has a query, to which no name of a file can be joined.
    """
    if "?" in url and not url.startswith(("file:", "memory:")):
        raise ReleaseError(
            f"{shown(url)}: a URL with a query, such as a presigned one, leads to one file alone; "
            "name the URL of the release's folder",
            what="bad-url",
        )
    return Store(url)


def is_there(path: Path) -> bool:
    """Whether a file exists in a folder, in an archive or at a URL.

    Raises:
        ReleaseError: the archive cannot be read.
        StorageError: the store fails.
    """
    url = url_of(path)
    if url is not None:
        store, name = _store_of(url)
        # The answer to HEAD has no body, in which alone a store says that the bucket is missing.
        return store.head(name) is not None or store.read_if_there(name) is not None
    if path.is_file():
        return True
    archive = _archive_above(path)
    return archive is not None and _name_in(path, archive) in _listed(archive).contents.entries


def _read(path: Path, limit: int) -> bytes:
    url = url_of(path)
    if url is not None:
        store, name = _store_of(url)
        try:
            return store.read(name, limit)
        except MissingObjectError as error:
            raise FileNotFoundError(errno.ENOENT, "missing", store.place(name)) from error
    try:
        return read_plain(path, limit)
    except NotADirectoryError:  # a part of the way is a file
        archive = _archive_above(path)
        if archive is None:
            raise
    opened = _listed(archive)
    with opened.lock:
        try:
            return opened.contents.read(_name_in(path, archive), limit)
        except ReleaseError as error:
            raise ReleaseError(f"{archive}: {error}", what=error.what) from error


def _store_of(url: str) -> tuple[Store, str]:
    """The bucket, host or machine of a URL, which shares one client, and the name in it.

    Raises:
        ReleaseError: as `release_store`.
    """
    release_store(url)
    scheme, _, place, *tail = url.split("/", 3)
    if not tail:  # a name without a bucket, which the store refuses
        return Store(f"{scheme}//"), place
    name = tail[0]
    return Store(f"{scheme}//{place}" if place else f"{scheme}///"), name


def _archive_above(path: Path) -> Path | None:
    """The file that a path leads into, if it does."""
    return next((parent for parent in path.parents if parent.is_file()), None)


def _name_in(path: Path, archive: Path) -> str:
    return path.relative_to(archive).as_posix()


@dataclass(frozen=True, eq=False)
class _Opened:
    """An archive that stays open.

    Attributes:
        contents: its files.
        lock: held while a file of it is read: they share one open file, and the place in it.
    """

    contents: Contents
    lock: Lock = field(default_factory=Lock)


def _listed(archive: Path) -> _Opened:
    """This process's open archive; reopened if the file was replaced.

    A process that was forked opens it again, too: the place in an open file is shared with the parent.

    Raises:
        ReleaseError: it holds no release, or is damaged.
        OSError: it is gone.
    """
    status = archive.stat()
    return _opened(archive, (os.getpid(), status.st_size, status.st_mtime_ns, status.st_ino))


@lru_cache(MOST_OPEN)
def _opened(archive: Path, _state: tuple[int, ...]) -> _Opened:
    closing = ExitStack()
    opened = _Opened(closing.enter_context(open_contents(archive)))
    weakref.finalize(opened, closing.close)  # when no thread reads it any more
    return opened
