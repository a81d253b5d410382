"""Storage of artefacts, their fingerprints, and atomic writes."""

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

from kinectbench.core.errors import StorageError
from kinectbench.core.untrusted import open_plain

# Names that are safe as those of files, and as paths of a release.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
# Recordings and methods name folders that lie beside files and folders of ours: publish.json in build/,
# scores.json, index.html and baselines/ in a folder of scores. No recording and no method may have
# that folder's name, or one that ends as those files do.
OUR_FOLDERS = ("baselines",)
OUR_ENDINGS = (".json", ".jsonl", ".csv", ".npz", ".glb", ".html", ".lock", ".part", ".old")

# The temporary folders and files that this process fills at present.
_half_filled: set[Path] = set()


def name_problem(name: str, also: str = "") -> str | None:
    """Why a recording, an object or a method cannot have this name, in a few words; None if it can.

    Args:
        name: as somebody wrote it.
        also: signs that are accepted besides those of `NAME`, but not at the beginning.
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
    """SHA-256 of a plain file's bytes, as hex, in streaming."""
    with open_plain(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_below(path: Path, content: bytes) -> None:
    """Write a file; create missing folders."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def open_to_add(path: Path) -> IO[str]:
    """Open a plain file, or create it, to read and append, without blocking.

    Raises:
        StorageError: a link, a folder, a pipe or a device is there.
        OSError: it cannot be made or opened.
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
    """Write a text, as UTF-8, to the end of a file that `open_to_add` opens; its folder is made.

    Raises:
        StorageError: as `open_to_add`, or the disk is full or read-only.
    """
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with open_to_add(path) as file:
            file.write(text)


# How every line about a disk that cannot be written ends.
UNTOUCHED = "; what was there before is untouched"


@contextlib.contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's complaints about what cannot be written into one clear line."""
    try:
        yield
    except OSError as error:
        if error.errno == errno.EFBIG and error.filename and not error.filename2:
            raise  # a file was too large to be read; of a write the system names none, of a copy two
        advice = {
            errno.ENOSPC: "the disk is full: free some space and run the command again",
            errno.EDQUOT: "the disk quota is used up: free some space and run the command again",
            errno.EROFS: "the disk is read-only: choose a folder that can be written",
            errno.EACCES: "no permission to write there: choose another folder or change its rights",
            errno.EFBIG: "files may not grow so large here: raise the limit (`ulimit -f`) and try again",
            errno.ENAMETOOLONG: "longer than a file's name can be here: choose a shorter one",
            errno.EPERM: "no permission to write there: choose another folder or change its rights",
        }.get(error.errno or 0)
        if not advice:
            raise
        raise StorageError(f"{path}: {advice}{UNTOUCHED}", what="not-writable") from error


@contextlib.contextmanager
def reachable(path: Path) -> Iterator[None]:
    """Turn a way to a place that leads nowhere into one clear line."""
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
    # The name comes first: an interrupt right after the folder is made must find it to take away.
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
                if folder.exists():
                    folder.rename(old)
                try:
                    temporary.rename(folder)
                except OSError:  # a full disk may have no room for the name
                    if old.exists():
                        old.rename(folder)
                    raise
            shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        _half_filled.discard(temporary)


def remove_half_filled() -> None:
    """Remove unfinished temporary folders and files when the process ends before their blocks."""
    for temporary in tuple(_half_filled):
        with contextlib.suppress(OSError):  # there is none, or it is a folder
            temporary.unlink()
        shutil.rmtree(temporary, ignore_errors=True)


@contextlib.contextmanager
def replaced_file(path: Path) -> Iterator[Path]:
    """Yield a temporary sibling, an empty file to write; it replaces `path` if the block succeeds.

    Raises:
        StorageError: a folder, a pipe or a device is there, or no file can be made or written there.
    """
    # Not the process id: containers that share a disk have the same ones.
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    if path.exists() and not path.is_file():
        raise StorageError(f"{path}: is no file that could be replaced; name another", what="no-plain-file")
    _half_filled.add(temporary)
    try:
        with storage_errors(path):
            with reachable(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                temporary.touch()  # whether it can be made
            yield temporary
            temporary.replace(path)
    finally:
        with contextlib.suppress(OSError):  # there is none, or the disk is read-only
            temporary.unlink()
        _half_filled.discard(temporary)
