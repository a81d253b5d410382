"""Read the bytes of a release's file in place: from its folder, from its archive or from a URL.

A path may lead into an archive: `chairs.zip/pairs/chair_01/000.npz` is a file of the release in `chairs.zip`.
A path may also be a URL. So functions that only pass paths on work with folders, archives and URLs.
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
from urllib.parse import unquote

from kinectbench.core import ReleaseError, decoded, read_plain
from kinectbench.core.artefacts.targets import SHA256SUMS, parse_sums
from kinectbench.core.store.address import shown, url_of
from kinectbench.core.store.attempts import MissingObjectError
from kinectbench.core.store.store import Store
from kinectbench.core.types import Progress, no_progress
from kinectbench.release.contents import MAX_READ_BYTES, Contents, most_bytes
from kinectbench.release.opening import open_contents

# Number of archives whose listing is kept; a listing of 100,000 pairs takes 300 MB.
MOST_OPEN = 2


def release_text(path: Path) -> str:
    """Read a UTF-8 text file of a release or a build, from a folder, an archive or a URL.

    Raises:
        ReleaseError: the file cannot be read.
        StorageError: the store at the URL fails.
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
    """Return the bytes of a release's file from a folder (links are followed), an archive or a URL.

    Args:
        path: path or URL of the file, perhaps inside an archive.
        sha256: the expected hash; None (SHA256SUMS does not list the file) always raises an error.

    Raises:
        ReleaseError: the file is missing, too large for its kind, unreadable, or not the published one.
        StorageError: the store at the URL fails.
    """
    try:
        content = _read(path, most_bytes(str(path)))
    except OSError as error:
        reason = error.strerror or error
        raise ReleaseError(f"{shown(path)}: cannot be read ({reason}); download the release again") from error
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ReleaseError(
            f"{shown(path)}: changed since it was published (SHA-256 differs); download it again, or publish "
            "it again with --force",
            what="changed",
        )
    return content


def listed_files(folder: Path, progress: Progress = no_progress) -> dict[str, str]:
    """Check each file of a release's folder against SHA256SUMS; return its content as {file: SHA-256}.

    Args:
        folder: the release's folder.
        progress: called with (files checked, files in all).

    Raises:
        ReleaseError: SHA256SUMS is missing or damaged, or a file is missing or does not have its hash.
    """
    sums = parse_sums(release_text(folder / SHA256SUMS), str(folder / SHA256SUMS))
    for done, (name, sha256) in enumerate(sums.items(), start=1):
        published_bytes(folder / name, sha256)
        progress(done, len(sums))
    return sums


def release_store(url: str) -> Store:
    """Return the store at a release's URL.

    Raises:
        ReleaseError: the URL has a query, so that no file name can be appended.
    """
    if "?" in url and not url.startswith(("file:", "memory:")):
        raise ReleaseError(
            f"{shown(url)}: a URL with a query, such as a presigned one, leads to one file alone; "
            "name the URL of the release's folder",
            what="bad-url",
        )
    return Store(url)


def is_there(path: Path) -> bool:
    """Return whether a file exists in a folder, in an archive or at a URL.

    Raises:
        ReleaseError: the archive cannot be read.
        StorageError: the store fails.
    """
    url = url_of(path)
    if url is not None:
        store, name = _store_of(url)
        # An answer to HEAD has no body, but only the body says that the bucket is missing.
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
    except NotADirectoryError:  # a parent is a file
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
    """Split a file's URL: return the store of its bucket or host, and the file's name in that store.

    So all files of a bucket share one open store.
    """
    release_store(url)
    scheme, _, place, *tail = url.split("/", 3)
    if not tail:  # no bucket: the store refuses it
        return Store(f"{scheme}//"), place
    name = unquote(tail[0])  # as a store does with its own URL
    return Store(f"{scheme}//{place}" if place else f"{scheme}///"), name


def _archive_above(path: Path) -> Path | None:
    """Return the archive that a path leads into: the nearest parent that is a file; None if none is."""
    return next((parent for parent in path.parents if parent.is_file()), None)


def _name_in(path: Path, archive: Path) -> str:
    return path.relative_to(archive).as_posix()


@dataclass(frozen=True, eq=False)
class _Opened:
    """An archive that stays open between reads.

    Attributes:
        contents: the archive's files.
        lock: to be held while a member is read, because all members share one open file and its position.
    """

    contents: Contents
    lock: Lock = field(default_factory=Lock)


def _listed(archive: Path) -> _Opened:
    """Return an archive from a cache of open archives; open it again if the file was replaced.

    A forked process opens the archive again, because it would share the file's position with its parent.
    """
    status = archive.stat()
    return _opened(archive, (os.getpid(), status.st_size, status.st_mtime_ns, status.st_ino))


@lru_cache(MOST_OPEN)
def _opened(archive: Path, _state: tuple[int, ...]) -> _Opened:
    closing = ExitStack()
    opened = _Opened(closing.enter_context(open_contents(archive)))
    weakref.finalize(opened, closing.close)  # when no thread reads it any more
    return opened
