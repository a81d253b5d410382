"""One run at a time in a folder: its lock, and what killed runs left.

The lock is the operating system's (flock): it goes with the process that holds it, however that ends, so
there is no stale lock. The file `.lock` only names its holder. The package filelock takes a lock file in its
place where a disk keeps no locks, which a killed run may leave behind.
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
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO

from kinectbench.core.errors import StorageError
from kinectbench.core.storage import open_to_add, storage_errors
from kinectbench.core.untrusted import listed_paths

LOCK = ".lock"
# Seconds in which whoever has just taken a lock will have written who it is.
SIGNING_S = 0.2
# A command line is cut here, to keep the line that quotes it readable.
COMMAND_CHARS = 100


@contextlib.contextmanager
def locked(
    folder: Path, *, wait: bool = True, waiting: Callable[[str], None] | None = None
) -> Iterator[None]:
    """Hold the folder's lock. Once it is held, leftovers of killed runs are removed.

    Args:
        folder: made if it is not there.
        wait: whether to wait for another run that holds it.
        waiting: called once with who holds it, before waiting.

    Raises:
        StorageError: another run holds it (without `wait`), or the disk cannot be written or keeps no locks.
    """
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = open_to_add(folder / LOCK)
    with lock:
        if not _taken(lock, folder, fcntl.LOCK_EX | fcntl.LOCK_NB):
            holder = _holder(folder / LOCK)
            if not wait:
                raise StorageError(
                    f"{folder}: in use by {holder}; run again when that has ended, or without --no-wait",
                    what="in-use",
                )
            if waiting is not None:
                waiting(holder)
            _taken(lock, folder, fcntl.LOCK_EX)
        _write(lock, _myself())
        try:
            sweep(folder / "*")
            yield
        finally:
            _write(lock, "")


def sweep(path: Path) -> None:
    """Remove leftovers of killed runs beside `path`, whose name may be a pattern and must not be in use.

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


def _taken(lock: IO[str], folder: Path, how: int) -> bool:
    """Whether the lock is ours now; False only if it was not to be waited for."""
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
    # Past the file's buffer, which would be written once more when it is closed.
    with contextlib.suppress(OSError):  # a full disk: the lock holds without a name on it
        os.ftruncate(lock.fileno(), 0)
        os.write(lock.fileno(), text.encode(errors="replace"))


def _myself() -> str:
    """One line: process, machine, command and time. A worker has the name of its parent."""
    parent = multiprocessing.parent_process()
    command = shlex.join(["kinectbench", *sys.argv[1:]])
    if len(command) > COMMAND_CHARS:
        command = command[:COMMAND_CHARS] + "…"
    process = os.getpid() if parent is None else parent.pid
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    return f"process {process} on {socket.gethostname()} (`{command}`, since {since})"
