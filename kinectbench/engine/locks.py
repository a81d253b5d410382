"""Lock a folder so that one run at a time works in it, and remove leftovers of killed runs.

The lock is one of the operating system (flock): it disappears with the process that holds it, so no lock can
be stale. The file `.lock` only names the holder. The package filelock is not used: on a disk without locks it
would rely on lock files, and a killed run may leave these behind.
"""

import contextlib
import errno
import fcntl
import multiprocessing
import os
import shlex
import shutil
import socket
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO

from kinectbench.core import StorageError, listed_paths, open_to_add, storage_errors

LOCK = ".lock"
# Seconds within which a run that has taken a lock writes its name.
SIGNING_S = 0.2
# Longest command line in a message, to keep the message readable.
COMMAND_CHARS = 100


@contextlib.contextmanager
def locked(
    folder: Path, *, wait: bool = True, waiting: Callable[[str], None] | None = None
) -> Iterator[None]:
    """Hold the folder's lock within the block; first remove temporary files that killed runs left there.

    Args:
        folder: the folder; created if missing.
        wait: whether to wait while another run holds the lock.
        waiting: called once before waiting, with the name of the holder.

    Raises:
        StorageError: another run holds the lock (without `wait`), or the disk is read-only or has no locks.
    """
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = open_to_add(folder / LOCK)
    with lock:
        if not _try_lock(lock, folder, fcntl.LOCK_EX | fcntl.LOCK_NB):
            holder = _holder(folder / LOCK)
            if not wait:
                raise StorageError(
                    f"{folder}: in use by {holder}; run again when that has ended, or without --no-wait",
                    what="in-use",
                )
            if waiting is not None:
                waiting(holder)
            _try_lock(lock, folder, fcntl.LOCK_EX)
        _write(lock, _describe_run())
        try:
            sweep(folder / "*")
            yield
        finally:
            _write(lock, "")


def refuse_in_use(folders: Iterable[Path]) -> None:
    """Refuse folders in which another run works, before slow work; folders that do not exist are skipped.

    Raises:
        StorageError: another run holds the lock of a folder.
    """
    for folder in folders:
        if folder.is_dir():
            with locked(folder, wait=False):
                pass


@contextlib.contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Hold a lock on a folder within the block, which is short, against other callers of this function.

    Nothing is printed while waiting. The folder itself is locked, because users share its files, and a file
    `.lock` would be one more of them. On a disk without locks the block runs without a lock.
    """
    with storage_errors(folder):
        handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def sweep(path: Path) -> None:
    """Remove temporary files that killed runs left beside `path`, a path or pattern that no run uses now.

    A file that was moved aside is moved back if its replacement is missing.
    """

    def is_left(name: str) -> bool:
        return any(fnmatchcase(name, f".{path.name}.*.{end}") for end in ("part", "old"))

    for leftover in list(listed_paths(path.parent, wanted=is_left)) if path.parent.is_dir() else []:
        original = leftover.with_name(leftover.name[1:].rsplit(".", 2)[0])
        if leftover.suffix == ".old" and not original.exists():
            leftover.rename(original)
        elif leftover.is_dir():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            leftover.unlink(missing_ok=True)


def _try_lock(lock: IO[str], folder: Path, how: int) -> bool:
    """Try to take the lock of a folder; False if another run holds it and the flags `how` forbid waiting."""
    try:
        fcntl.flock(lock, how)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
            raise
        raise StorageError(
            f"{folder}: this file system keeps no locks (flock): build on another disk, and copy the result",
            what="no-locks",
        ) from error
    return True


def _holder(file: Path) -> str:
    end = time.monotonic() + SIGNING_S
    while not (text := file.read_text(errors="replace", encoding="utf-8").strip()) and time.monotonic() < end:
        time.sleep(0.01)
    return text or "another run of kinectbench"


def _write(lock: IO[str], text: str) -> None:
    # Written without the file's buffer, whose content would be written again on closing.
    with contextlib.suppress(OSError):  # on a full disk the lock works without a name
        os.ftruncate(lock.fileno(), 0)
        os.write(lock.fileno(), text.encode(errors="replace"))


def _describe_run() -> str:
    """Describe this run in a line: process, machine, command and time; a worker names its parent."""
    parent = multiprocessing.parent_process()
    command = shlex.join(["kinectbench", *sys.argv[1:]])
    if len(command) > COMMAND_CHARS:
        command = command[:COMMAND_CHARS] + "…"
    process = os.getpid() if parent is None else parent.pid
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    return f"process {process} on {socket.gethostname()} (`{command}`, since {since})"
