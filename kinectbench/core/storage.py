"""Atomic writing of artefacts, fingerprints (SHA-256), and valid names."""

import contextlib
import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from kinectbench.core.errors import TOO_LONG, StorageError
from kinectbench.core.untrusted import open_plain

# Names that are safe as names of files, and in paths of a release.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
# Recordings and methods name folders beside files and folders of this package: publish.json in build/,
# scores.json, index.html and baselines/ in a folder of scores. So no recording and no method may have the
# name of such a folder, or the suffix of such a file.
OUR_FOLDERS = ("baselines",)
OUR_ENDINGS = (".json", ".jsonl", ".csv", ".npz", ".glb", ".html", ".lock", ".part", ".old")

# Temporary folders and files that this process is filling.
_half_filled: set[Path] = set()


def name_problem(name: str, also: str = "") -> str | None:
    """Return why a recording, object or method cannot have this name, in a few words; None if it can.

    Characters in `also` are accepted besides those of `NAME`, but not as the first.
    """
    plain = "".join("-" if sign in also and place else sign for place, sign in enumerate(name))
    if not NAME.fullmatch(plain):
        signs = ", ".join(f"'{sign}'" for sign in "._" + also)
        return f"use letters, digits, {signs} and '-' only (at most 80, not starting with '.')"
    if name.lower() in OUR_FOLDERS or name.lower().endswith(OUR_ENDINGS):
        return "files and folders of kinectbench have such names; choose another"
    return None


def canonical_json(value: object) -> str:
    """JSON with sorted keys and no spaces: the same text for the same value."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def pretty_json(value: object) -> str:
    """Indented JSON with keys in the given order and a final newline."""
    return json.dumps(value, indent=1, allow_nan=False) + "\n"


def sha256_text(text: str) -> str:
    """SHA-256 of a text's UTF-8 bytes, as hex."""
    return hashlib.sha256(text.encode()).hexdigest()


def sha256_file(path: Path) -> str:
    """SHA-256 of a plain file's bytes, as hex, read in pieces."""
    with open_plain(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_below(path: Path, content: bytes) -> None:
    """Write a file; create its folder if missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def open_to_add(path: Path) -> IO[str]:
    """Open a plain file to read and append, without blocking; create it if missing.

    Raises:
        StorageError: the path is a link, a folder, a pipe or a device.
        OSError: the file cannot be created or opened.
    """
    refused = StorageError(f"{path}: is no file that could be added to; remove it", what="no-plain-file")
    how = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        handle = os.open(path, how, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):  # a link, a folder, a socket
            raise refused from error
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise refused
    return os.fdopen(handle, "a+", encoding="utf-8", errors="replace")


def append_plain(path: Path, text: str) -> None:
    """Append a text, as UTF-8, to a file that `open_to_add` opens; create the file's folder.

    Raises:
        StorageError: as for `open_to_add`, or the disk is full or read-only.
    """
    with storage_errors(path):
        with reachable(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        with open_to_add(path) as file:
            file.write(text)


# The end of every message about a disk that cannot be written.
UNTOUCHED = "; what was there before is untouched"


@contextlib.contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn OSErrors of writes in the block, such as a full disk, into a `StorageError` with advice."""
    try:
        yield
    except OSError as error:
        if error.errno == errno.EFBIG and error.filename and not error.filename2:
            raise  # of reading a large file: an error of writing names no file, one of copying two
        advice = {
            errno.ENOSPC: "the disk is full: free some space and run the command again",
            errno.EDQUOT: "the disk quota is used up: free some space and run the command again",
            errno.EROFS: "the disk is read-only: choose a folder that can be written",
            errno.EACCES: "no permission to write there: choose another folder or change its rights",
            errno.EFBIG: "files may not grow so large here: raise the limit (`ulimit -f`) and try again",
            errno.ENAMETOOLONG: TOO_LONG,
            errno.EPERM: "no permission to write there: choose another folder or change its rights",
        }.get(error.errno or 0)
        if not advice:
            raise
        raise StorageError(f"{path}: {advice}{UNTOUCHED}", what="not-writable") from error


@contextlib.contextmanager
def reachable(path: Path) -> Iterator[None]:
    """Turn errors about a path whose parent is missing or is no folder into a `StorageError`."""
    try:
        yield
    except (FileNotFoundError, NotADirectoryError, FileExistsError) as error:
        raise StorageError(
            f"{path}: the way to it holds a file, a broken link or nothing; choose another place",
            what="no-way",
        ) from error


@contextlib.contextmanager
def replaced_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary sibling folder that replaces `folder` if the block succeeds."""
    # Register the name first: an interrupt right after the folder is made must still remove it.
    temporary = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}.part")
    _half_filled.add(temporary)
    try:
        with storage_errors(folder), reachable(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            temporary.mkdir()
            temporary.chmod(0o755)
        with storage_errors(folder):
            yield temporary
            old = temporary.with_suffix(".old")
            with reachable(folder):
                try:
                    if folder.exists():
                        folder.rename(old)
                    temporary.rename(folder)
                except BaseException:  # a full disk may have no room for the name; or an interrupt
                    if old.exists() and not folder.exists():
                        old.rename(folder)
                    raise
                finally:
                    if folder.exists():
                        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        _half_filled.discard(temporary)


def remove_half_filled() -> None:
    """Remove temporary folders and files that are still unfinished when the process ends."""
    for temporary in tuple(_half_filled):
        with contextlib.suppress(OSError):  # the file is gone, or it is a folder
            temporary.unlink()
        shutil.rmtree(temporary, ignore_errors=True)


@contextlib.contextmanager
def replaced_file(path: Path) -> Iterator[Path]:
    """Yield a temporary sibling, an empty file; it replaces `path` if the block succeeds.

    Raises:
        StorageError: `path` is a folder, a pipe or a device, or no file can be created or written there.
    """
    # A random name, because processes of containers that share a disk may have the same id.
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    if path.exists() and not path.is_file():
        raise StorageError(f"{path}: is no file that could be replaced; name another", what="no-plain-file")
    _half_filled.add(temporary)
    try:
        with storage_errors(path):
            with reachable(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                temporary.touch()  # fails here if it cannot be created
            yield temporary
            temporary.replace(path)
    finally:
        with contextlib.suppress(OSError):  # the file is gone, or the disk is read-only
            temporary.unlink()
        _half_filled.discard(temporary)
